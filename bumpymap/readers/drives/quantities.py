"""Quantities of a drive: their units, the names of their columns, and what the user names with `columns`."""

import re
from collections.abc import Collection, Mapping, Sequence
from math import pi
from typing import NamedTuple

from bumpymap.core import BadInputError, UsageError

RATES = ("rate_x", "rate_y", "rate_z")
ACCELERATIONS = ("acc_x", "acc_y", "acc_z")
ANGLES = ("roll", "pitch", "yaw")
QUATERNION = ("q_x", "q_y", "q_z", "q_w")
LONLAT = ("longitude", "latitude")
EASTING_NORTHING = ("easting", "northing")
LOCAL = ("x", "y")
SIDES = ("speed_left", "speed_right")
DOWN = frozenset({"rate_y", "rate_z", "acc_y", "acc_z", "pitch", "yaw", "q_y", "q_z"})
"""Quantities whose sign differs between x forward, y right, z down and x forward, y left, z up."""
DIMENSIONS: Mapping[str, str] = {
    "time": "time",
    **dict.fromkeys(RATES, "rate"),
    **dict.fromkeys(ACCELERATIONS, "acceleration"),
    **dict.fromkeys(ANGLES, "angle"),
    **dict.fromkeys(QUATERNION, "number"),
    **dict.fromkeys(LONLAT, "degree"),
    **dict.fromkeys((*EASTING_NORTHING, *LOCAL, "error"), "length"),
    "fix": "number",
    **dict.fromkeys(("speed", *SIDES), "speed"),
}
"""Quantity -> what its unit is a unit of."""
QUANTITIES = tuple(DIMENSIONS)
NAMES: Mapping[str, str] = {
    **dict(zip(QUANTITIES, QUANTITIES, strict=True)),
    **{f"{name}{axis}": f"rate_{axis}" for name in ("gyro_", "w") for axis in "xyz"},
    **{f"a{axis}": f"acc_{axis}" for axis in "xyz"},
    **{f"q{axis}": f"q_{axis}" for axis in "xyzw"},
    "lon": "longitude",
    "lat": "latitude",
    "horizontal_error": "error",
    "vell": "speed_left",
    "velr": "speed_right",
}
"""Name of a column in lower case, without its unit -> quantity."""
_G = 9.80665
"""Standard gravity, m/s2 (ISO 80000-3)."""
_DEGREE = pi / 180.0
UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "rate": {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": _DEGREE, "mdeg/s": 1e-3 * _DEGREE},
    "acceleration": {"m/s2": 1.0, "g": _G, "mg": 1e-3 * _G},
    "angle": {"rad": 1.0, "deg": _DEGREE},
    "degree": {"deg": 1.0, "rad": 1.0 / _DEGREE, "dege7": 1e-7},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "km": 1e3},
    "speed": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "km/h": 1 / 3.6, "mph": 0.44704},
    "number": {"": 1.0},
}
"""Dimension -> unit -> factor to the unit of `DriveLog`, which is the first."""


class DriveColumn(NamedTuple):
    """A column of a file and what it holds."""

    name: str
    unit: str | None = None
    """Key of `UNITS`; None: its name does not say, and it is the first."""
    sign: float = 1.0


_IN_BRACKETS = re.compile(r"([^\[(]+?)\s*[\[(]([^\[\]()]+)[\])]")


def named_columns(source: str, names: Sequence[str], skip: Collection[str] = ()) -> dict[str, DriveColumn]:
    """Return the columns that have the name of a quantity but those to ``skip``, perhaps with its unit in brackets.

    Raises BadInputError: two columns have names of one quantity, or a unit is unknown.
    """
    found: dict[str, DriveColumn] = {}
    for name in names:
        with_unit = _IN_BRACKETS.fullmatch(name)
        bare, unit = with_unit.groups() if with_unit else (name, None)
        quantity = NAMES.get(bare.strip().lower())
        if quantity is None or quantity in skip:
            continue
        if quantity in found:
            raise BadInputError(
                f"{source} has two columns of {quantity}: {found[quantity].name}, {name}. Name one: "
                f"`columns='{quantity}={name}'`"
            )
        unit = None if unit is None else unit.strip()
        units = UNITS[DIMENSIONS[quantity]]
        if unit is not None and unit not in units:
            raise BadInputError(
                f"the column {name} of {source} has the unit '{unit}', which is none of {', '.join(units)}. State it: "
                f"`columns='{quantity}={name}[{next(iter(units))}]'`"
            )
        found[quantity] = DriveColumn(name, unit)
    return found


TOPICS = ("imu", "gnss", "odometry", "twist")
"""Quantities of bags: the topics that they are read from."""
_EXPLAINED = (
    f"Quantities are {', '.join(QUANTITIES)}; in bags {', '.join(TOPICS)}. For example "
    "`columns='rate_y=GyrY[deg/s],time=t[ms]'`"
)
_STATED = re.compile(r"(.+?)\s*(?:\[([^\[\]]+)\]|:([^:]+))")


def parse_columns(text: str) -> dict[str, str]:
    """Return what was named for each quantity: ``rate_y=GyrY[deg/s],time=t`` is {"rate_y": "GyrY[deg/s]", "time": "t"}.

    Raises UsageError: the text is not of this form, or names something that is no quantity.
    """
    found: dict[str, str] = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        quantity, equals, name = part.partition("=")
        if not equals:
            raise UsageError(f"`columns` is QUANTITY=COLUMN,..., not '{part}'. {_EXPLAINED}")
        if quantity.strip() in found:
            raise UsageError(f"`columns` names {quantity.strip()} twice. Name it once")
        found[quantity.strip()] = name.strip()
    unknown_quantities(found)
    return found


def unknown_quantities(columns: Mapping[str, str]) -> None:
    """Raise UsageError if columns are named for something that is no quantity."""
    unknown = sorted(set(columns) - {*QUANTITIES, *TOPICS})
    if unknown:
        raise UsageError(f"`columns` names {', '.join(unknown)}, which is no quantity. {_EXPLAINED}")


def chosen_columns(columns: Mapping[str, str], names: Sequence[str]) -> dict[str, DriveColumn]:
    """Return the named columns that a file has, by quantity.

    ``columns``: quantity -> name of a column, perhaps with a sign before it, and a unit behind it
    in square brackets or after a colon. An empty name: nothing is read for this quantity;
    ``names``: columns of the file. Raises UsageError: a unit is unknown.
    """
    found: dict[str, DriveColumn] = {}
    for quantity, text in columns.items():
        units = UNITS[DIMENSIONS[quantity]]
        sign, bare = (-1.0, text[1:]) if text.startswith("-") and _named(text, names) is None else (1.0, text)
        name, stated = _named(bare, names), None
        if name is None and (match := _STATED.fullmatch(bare)) is not None:
            name, stated = _named(match.group(1), names), match.group(2) or match.group(3)
        if name is None:
            continue
        if stated is not None and stated not in units:
            allowed = ", ".join(filter(None, units)) or "none"
            raise UsageError(f"'{stated}' is no unit of {quantity} in `columns`. Units of it are: {allowed}")
        own = _IN_BRACKETS.fullmatch(name)
        found[quantity] = DriveColumn(name, stated or (own[2] if own and own[2] in units else None), sign)
    return found


def _named(text: str, names: Sequence[str]) -> str | None:
    """Return the name of the column that is meant; capital letters count only where they tell columns apart."""
    if text in names:
        return text
    same = [name for name in names if name.lower() == text.strip().lower()]
    return same[0] if len(same) == 1 else None
