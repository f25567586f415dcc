"""Tell from the names of columns which quantity they hold, and in which unit."""

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import NamedTuple

from bumpymap.core import BadInputError
from bumpymap.readers.drives.column_patterns import GROUPS, SINGLE, UNIT_SUFFIX, ColumnGroup
from bumpymap.readers.drives.quantities import ANGLES, DIMENSIONS, plain_unit

__all__ = ["DriveColumn", "guess_columns", "unit_in_name"]

_SPLIT = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])|[^A-Za-z0-9]+")
_UNIT = re.compile(r"\s*(?:\[([^\]]*[A-Za-z°][^\]]*)\]|\(([^)]*[A-Za-z°][^)]*)\)|:([A-Za-z°][^:]*))\s*$")
_SUFFIX = re.compile(UNIT_SUFFIX)
_CLOCKS = {"millis", "micros", "nanos"}
"""Names of times that are nothing but a unit."""
_NANOSECONDS = re.compile(r"n(?:ano)?(secs?|seconds)$")


class DriveColumn(NamedTuple):
    """A column of a file and what it holds."""

    name: str
    unit: str | None = None
    """As `UNITS` spells it; None: its name does not say."""
    sign: float = 1.0


class _Spelled(NamedTuple):
    """A name of a column, and the (words, unit) that it may mean."""

    name: str
    spellings: Sequence[tuple[str, str]]


class _Match(NamedTuple):
    name: str
    before: str
    """Words before those that the pattern describes."""
    key: str
    """What the pattern captures."""
    unit: str


def guess_columns(source: str, names: Sequence[str], skip: Collection[str] = ()) -> dict[str, DriveColumn]:
    """Return the columns that names tell, by quantity; groups such as three rates only as a whole.

    Parameters
    ----------
    source : str
        Name of the file, for messages.
    names : sequence of str
    skip : collection of str
        Quantities that are known already.

    Raises
    ------
    BadInputError
        Several columns may hold the same quantity.
    """
    spelled = [_Spelled(name, list(_spellings(name))) for name in names]
    found: dict[str, DriveColumn] = {}
    for group in GROUPS:
        found.update(_guess_group(source, spelled, group, skip))
    if "time" not in skip:
        found.update(_stamp(spelled))
    for quantity in SINGLE:
        if quantity not in found and quantity not in skip:
            found.update(_guess_single(spelled, quantity))
    return found


def _joined(name: str) -> str:
    """Return the words of a name in lower case, joined with underscores: ``GyrY`` is ``gyr_y``."""
    return "_".join(part.lower() for part in _SPLIT.split(name) if part)


def _spellings(name: str) -> Iterator[tuple[str, str]]:
    """Yield (words, unit) that a name may mean: without its unit in brackets, as it is, without a unit at its end."""
    bracket = _UNIT.search(name)
    if bracket is not None:
        yield _joined(name[: bracket.start()]), next(part for part in bracket.groups() if part is not None)
        return
    words = _joined(name)
    if words in _CLOCKS:
        yield "time", words
        return
    yield words, ""
    suffix = _SUFFIX.search(words)
    if suffix is not None:
        yield words[: suffix.start()], suffix.group(1)


def unit_in_name(name: str, quantity: str) -> str | None:
    """Return the unit that the name of a column states for a quantity; None if it states none."""
    units = [plain_unit(unit, DIMENSIONS[quantity]) for _, unit in _spellings(name) if unit]
    return units[0] if units else None


def _matches(spelled: Sequence[_Spelled], pattern: str) -> Iterator[_Match]:
    before = "()" if pattern.startswith("=") else "(?:(.*?)_)??"
    whole = re.compile(f"{before}(?:{pattern.removeprefix('=')})")
    for name, spellings in spelled:
        for words, unit in spellings:
            match = whole.fullmatch(words)
            if match is not None:
                yield _Match(name, match.group(1) or "", match.group(2) if whole.groups > 1 else "", unit)
                break


def _column(match: _Match, quantity: str) -> DriveColumn:
    return DriveColumn(match.name, plain_unit(match.unit, DIMENSIONS[quantity]) if match.unit else None)


def _stamp(spelled: Sequence[_Spelled]) -> dict[str, DriveColumn]:
    """Return the columns of seconds and nanoseconds of a stamp that has both."""
    words = {each.spellings[0][0]: each.name for each in spelled}
    for rest, name in words.items():
        whole = words.get(_NANOSECONDS.sub(r"\1", rest))
        if whole is not None and whole != name:
            return {"time": DriveColumn(whole, "s"), "nanosec": DriveColumn(name, "ns")}
    return {}


def _guess_group(
    source: str, spelled: Sequence[_Spelled], group: ColumnGroup, skip: Collection[str]
) -> dict[str, DriveColumn]:
    wanted = [quantity for quantity in group.quantities if quantity not in skip]
    least = set(wanted) - ({"yaw"} if group.quantities == ANGLES else set())
    for pattern in group.patterns if wanted else ():
        sets: dict[str, dict[str, DriveColumn]] = {}
        for match in _matches(spelled, pattern):
            place = group.places[match.key]
            if place < len(group.quantities):
                quantity = group.quantities[place]
                sets.setdefault(match.before, {}).setdefault(quantity, _column(match, quantity))
        full = {before: columns for before, columns in sets.items() if least <= set(columns)}
        if full:
            return {quantity: each for quantity, each in _only(source, full).items() if quantity in wanted}
    return {}


def _only(source: str, full: Mapping[str, dict[str, DriveColumn]]) -> dict[str, DriveColumn]:
    """Return the only set of columns, or the one with nothing before its names."""
    first = next(iter(full.values()))
    if len(full) > 1 and "" not in full:
        sets = "; ".join(", ".join(column.name for column in columns.values()) for columns in full.values())
        example = ",".join(f"{quantity}={column.name}" for quantity, column in first.items())
        raise BadInputError(
            f"{source} has several sets of columns for {', '.join(first)}: {sets}. Name one of them, for example "
            f"`columns='{example}'`"
        )
    return full.get("", first)


def _guess_single(spelled: Sequence[_Spelled], quantity: str) -> dict[str, DriveColumn]:
    for pattern in SINGLE[quantity]:
        found = list(_matches(spelled, pattern))
        if found:
            return {quantity: _column(next((each for each in found if not each.before), found[0]), quantity)}
    return {}
