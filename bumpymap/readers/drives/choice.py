"""The columns that a user names: ``rate_y=GyrY[deg/s],time=t[ms]``."""

import re
from collections.abc import Mapping, Sequence
from difflib import get_close_matches

from bumpymap.core import UsageError
from bumpymap.readers.drives.column_names import DriveColumn, unit_in_name
from bumpymap.readers.drives.quantities import DIMENSIONS, QUANTITIES, UNITS, plain_unit

__all__ = ["TOPICS", "chosen_columns", "listed", "parse_columns", "unknown_quantities"]

TOPICS = ("imu", "gnss", "odometry", "twist")
"""Quantities of bags: the topics that they are read from."""
_STATED = re.compile(r"(.+?)\s*(?:\[([^\[\]]+)\]|:([^:]+))")


def parse_columns(text: str) -> dict[str, str]:
    """Return what was named for each quantity: ``rate_y=GyrY[deg/s],time=t`` is {"rate_y": "GyrY[deg/s]", "time": "t"}.

    Raises
    ------
    UsageError
        The text is not of this form, or names something that is no quantity.
    """
    found: dict[str, str] = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        quantity, equals, name = part.partition("=")
        if not equals:
            raise UsageError(f"`columns` is QUANTITY=COLUMN,..., not '{part}'. {_explained()}")
        if quantity.strip() in found:
            raise UsageError(f"`columns` names {quantity.strip()} twice. Name it once")
        found[quantity.strip()] = name.strip()
    unknown_quantities(found, (*QUANTITIES, *TOPICS))
    return found


def unknown_quantities(columns: Mapping[str, str], known: Sequence[str]) -> None:
    """Raise UsageError if columns are named for something that is no quantity."""
    unknown = sorted(set(columns) - set(known))
    if unknown:
        raise UsageError(f"`columns` names {', '.join(unknown)}, which is no quantity. {_explained()}")


def _explained() -> str:
    return (
        f"Quantities are {', '.join(QUANTITIES)}; in bags {', '.join(TOPICS)}. For example "
        "`columns='rate_y=GyrY[deg/s],time=t[ms]'`"
    )


def chosen_columns(columns: Mapping[str, str], names: Sequence[str]) -> dict[str, DriveColumn]:
    """Return the named columns that a file has, by quantity.

    Parameters
    ----------
    columns : mapping
        Quantity -> name of a column, perhaps with a sign before it, and a unit behind it in square brackets or after
        a colon. An empty name: nothing is read for this quantity.
    names : sequence of str
        Columns of the file.

    Raises
    ------
    UsageError
        A unit is unknown.
    """
    found: dict[str, DriveColumn] = {}
    for quantity, text in columns.items():
        sign, bare = (-1.0, text[1:]) if text.startswith("-") and _named(text, names) is None else (1.0, text)
        name, stated = _named(bare, names), None
        if name is None and (match := _STATED.fullmatch(bare)) is not None:
            name, stated = _named(match.group(1), names), match.group(2) or match.group(3)
        if name is not None:
            unit = unit_in_name(name, quantity) if stated is None else _unit(quantity, stated)
            found[quantity] = DriveColumn(name, unit, sign)
    return found


def _named(text: str, names: Sequence[str]) -> str | None:
    """Return the name of the column that is meant; capital letters count only where they tell columns apart."""
    if text in names:
        return text
    same = [name for name in names if name.lower() == text.strip().lower()]
    return same[0] if len(same) == 1 else None


def _unit(quantity: str, stated: str) -> str:
    unit = plain_unit(stated, DIMENSIONS[quantity])
    if unit is None:
        allowed = ", ".join(filter(None, UNITS[DIMENSIONS[quantity]])) or "none"
        close = get_close_matches(stated, filter(None, UNITS[DIMENSIONS[quantity]]), 1)
        meant = f" Did you mean '{close[0]}'?" if close else ""
        raise UsageError(f"'{stated}' is no unit of {quantity} in `columns`.{meant} Units of it are: {allowed}")
    return unit


def listed(names: Sequence[str]) -> str:
    """Return the names of columns for a message."""
    shown = ", ".join(names[:60])
    return shown if len(names) <= 60 else f"{shown} and {len(names) - 60} more"
