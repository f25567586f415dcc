"""The CSV of a batch: a row for each survey, whose columns are settings of its map."""

import csv
import io
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any, get_args, get_origin

from bumpymap.core import (
    CLASHES,
    BumpymapError,
    MapConfig,
    UsageError,
    parse_crs,
    parse_record,
    parse_share,
    path_fault,
    refuse_clashes,
    refuse_faults,
)
from bumpymap.rating import find_calibration
from bumpymap.survey.batch.names import plain_name
from bumpymap.survey.batch.settings import OWN_SETTINGS

__all__ = ["SettingsCheck", "read_table"]

_SURVEY, _NAME = "survey", "name"
_TABLES = ("features", "csf")
"""Settings that are tables, which a cell cannot hold."""
_KINDS = {item.name: item.type for item in fields(MapConfig) if item.name not in {*OWN_SETTINGS, *_TABLES}}
"""Column -> type of its setting."""
_WORDS = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}

Row = tuple[Path | str, str | None, dict[str, Any]]


def read_table(
    text: str, origin: str, folder: Path, check: Callable[[Mapping[str, Any]], list[str]] = lambda _: []
) -> list[Row]:
    """Parse the CSV of a batch.

    Parameters
    ----------
    text : str
        With the column ``survey``, if wanted ``name``, and settings of a map, spelled as options or as in Python. An
        empty cell means that the setting is not given. A table that Excel wrote with semicolons is read too.
    origin : str
        Name of the file, for messages.
    folder : Path
        Folder at which relative paths start.
    check : callable, optional
        Returns what else is wrong with the settings of a row.

    Returns
    -------
    list of (place, name or None, settings)

    Raises
    ------
    UsageError
        Unknown columns or values that are not allowed; the message lists all.
    """
    header, _, _ = text.partition("\n")
    lines = csv.reader(io.StringIO(text), delimiter=";" if ";" in header and "," not in header else ",")
    try:
        rows = [(lines.line_num, [cell.strip() for cell in row]) for row in lines]
    except csv.Error as error:
        raise UsageError(f"{origin}: line {lines.line_num} is not CSV: {error}") from error
    rows = [(number, row) for number, row in rows if any(row)]
    columns = _columns(rows[0][1] if rows else [], origin)
    faults: list[str] = []
    found = [_row(number, row, columns, folder, faults, check) for number, row in rows[1:]]
    names = [name.casefold() for _, name, _ in found if name]
    faults += [f"the name {name} is given twice" for name in sorted(set(names)) if names.count(name) > 1]
    refuse_faults(faults, origin, UsageError)
    return found


def _columns(titles: list[str], origin: str) -> list[str]:
    columns = [title.lower().lstrip("-").replace("-", "_") for title in titles]
    unknown = [title for title, name in zip(titles, columns, strict=True) if name not in {_SURVEY, _NAME, "", *_KINDS}]
    if _SURVEY not in columns or unknown:
        what = f"unknown column {', '.join(unknown)}" if unknown else f"there is no column {_SURVEY}"
        raise UsageError(f"{origin}: {what}; there are: {', '.join([_SURVEY, _NAME, *_KINDS])}")
    if repeated := sorted({name for name in columns if name and columns.count(name) > 1}):
        raise UsageError(f"{origin}: the column {', '.join(repeated)} is there twice")
    return columns


def _row(
    number: int,
    cells: list[str],
    columns: list[str],
    folder: Path,
    faults: list[str],
    check: Callable[[Mapping[str, Any]], list[str]],
) -> Row:
    """Return a row; append what is wrong with it to ``faults``."""
    wrong = [f"it has {len(cells)} cells, the header has {len(columns)}"] if any(cells[len(columns) :]) else []
    given = {name: cell for name, cell in zip(columns, cells, strict=False) if cell and name}
    place, name = given.pop(_SURVEY, ""), given.pop(_NAME, None)
    if not place or path_fault(place):
        wrong.append(path_fault(place) or "the survey is empty")
    if name is not None and (why := plain_name(name)):
        wrong.append(f"the name is {name!r}; {why}")
    elif "://" not in place and not (folder / place).exists():
        wrong.append(f"there is no file or folder {folder / place}")
    settings, more = parse_record({key: _value(key, cell) for key, cell in given.items()}, MapConfig, folder)
    if not more:
        with _noted(more):
            refuse_clashes(settings, CLASHES)
            MapConfig(surveys=(), out=Path(), **settings)
            more += check(settings)
    wrong += more
    faults += [f"line {number}: {why}" for why in wrong]
    return (place if "://" in place else folder / place, name, settings)


def _value(name: str, text: str) -> Any:
    """Convert a cell to the type of its setting; one that cannot be is left for the message."""
    kinds = get_args(_KINDS[name]) or (_KINDS[name],)
    if name == "max_unknown":
        share = parse_share(text)
        return text if share is None else share
    if bool in kinds:
        return _WORDS.get(text.lower(), text)
    if any(get_origin(kind) is tuple for kind in kinds):  # of numbers
        with suppress(ValueError):
            return [float(word) for word in text.replace(",", " ").split()]
    for kind in (int, float):
        if kind in kinds:
            with suppress(ValueError):
                return kind(text)
    return text


class SettingsCheck:
    """Finds what is wrong with the settings of surveys: values, CRS, and vehicles and files that are not there."""

    def __init__(self) -> None:
        self._calibration = cache(find_calibration)

    def faults(self, settings: Mapping[str, Any], *, complete: bool = True) -> list[str]:
        """Return the faults; ``complete``: no others come to these, so that they must also fit each other."""
        faults: list[str] = []
        for name in ("crs", "force_crs"):
            if settings.get(name) is not None:
                with _noted(faults):
                    parse_crs(settings[name], name)
        with _noted(faults):
            config = MapConfig(surveys=(), out=Path(), **settings)
            calibration = self._calibration(config.vehicle, config.calibration)
            if complete:
                calibration.require_grid(config.tile_size, config.pixels)
        if settings.get("model") is not None and not settings["model"].is_file():
            faults.append(f"there is no file {settings['model']}, given as the model")
        return faults


@contextmanager
def _noted(faults: list[str]) -> Iterator[None]:
    """Append the message of an error to a list instead."""
    try:
        yield
    except BumpymapError as error:
        faults.append(str(error).replace("`", ""))  # columns: no options of the command line
