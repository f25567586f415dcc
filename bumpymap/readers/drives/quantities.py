"""Quantities of a drive: their units, the names that columns give them, and what the user names with `columns`.

Patterns of names have their words in lower case, joined by underscores. Other words may stand before what a pattern
describes (``imu_gyro_x``), unless it begins with ``=``. Patterns stand in the order in which they are tried, the surest
first; what they capture tells which quantity of the group is meant.
"""

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
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


class _Known(NamedTuple):
    """Quantities that are found together or not at all."""

    quantities: tuple[str, ...]
    dimension: str
    patterns: tuple[str, ...]


_KNOWN = (
    _Known(
        RATES,
        "rate",
        (
            r"(?:angular_velocity|angular_rate|ang_vel|gyroscope|gyro|gyr|gyro_rad|omega|w)_?([xyz012])",
            r"(?:rotation_rate|turn_rate|rate|body_rate|angular)_?([xyz])",
            r"([xyz])_?(?:gyro|rate)",
            r"(roll|pitch|yaw)_?(?:rate|speed|vel|velocity)",
            r"=g_?([xyz])",
        ),
    ),
    _Known(
        ACCELERATIONS,
        "acceleration",
        (
            r"(?:linear_acceleration|lin_acc|accelerometer|acceleration|accel|accelerometer_m_s2|acc|a)_?([xyz012])",
            r"specific_force_?([xyz])",
            r"([xyz])_?(?:acc|accel)",
        ),
    ),
    _Known(QUATERNION, "number", (r"(?:orientation|quaternion|quat|rotation|attitude|q)_?([xyzw])",)),
    _Known(ANGLES, "angle", (r"(roll|pitch|yaw)(?:_angle)?",)),
    _Known(LONLAT, "degree", (r"(lon|lng|long|longitude|lat|latitude)",)),
    _Known(
        EASTING_NORTHING,
        "length",
        (r"(easting|northing)", r"=(?:utm_|map_)?(east|north|e|n)", r"utm_?([xy])"),
    ),
    _Known(LOCAL, "length", (r"(?:position|translation|pos|odom|odometry|pose|local)_?([xy])", r"=([xy])")),
    _Known(
        SIDES,
        "speed",
        (
            r"(?:wheel_?speed|wheel_?vel|wheel_?velocity|wheel|speed|vel|velocity|v)_?(l|r|left|right)",
            r"(left|right|l|r)_?(?:wheel_?)?(?:speed|vel|velocity)",
        ),
    ),
    _Known(("nanosec",), "time", ()),
    _Known(
        ("time",),
        "time",
        (
            r"(?:header_)?stamp(?:_secs?)?",
            r"timestamp|time_stamp",
            r"=(?:time|t|ts)",
            r"=(?:date_?time|utc|time_utc|gpst|unix|epoch|seconds_elapsed|time_elapsed|elapsed|elapsed_time|secs?|seconds)",
            r"=date",
            r"time|time_boot",
        ),
    ),
    _Known(("date",), "time", (r"=(?:date|utc_date|day)",)),
    _Known(
        ("speed",),
        "speed",
        (
            r"wheel_?(?:speed|velocity|vel)",
            r"=(?:.*twist_)?linear(?:_velocity)?_x",
            r"=(?:gps_?|gnss_?|vehicle_?|robot_?|ground_?|odom_?|base_?|g_?)?(?:speed|velocity|vel|v|spd)",
        ),
    ),
    _Known(
        ("error",),
        "length",
        (
            r"h_?acc|horizontal_accuracy|hor_acc|h_accuracy|h_rms|eph|horizontal_error|position_error|pos_error|pos_sd",
            r"=(?:accuracy|sigma|error)",
            r"=(?:sdn|sd_n|sd_north|std_n)",
        ),
    ),
    _Known(("fix",), "number", (r"fix_type|fix|status_status|gps_qual", r"=(?:quality|status)")),
)
_PLACE = {
    **dict.fromkeys(("", "x", "0", "roll", "lon", "lng", "long", "longitude", "easting", "east", "e", "l", "left"), 0),
    **dict.fromkeys(("y", "1", "pitch", "lat", "latitude", "northing", "north", "n", "r", "right"), 1),
    **dict.fromkeys(("z", "2", "yaw"), 2),
    "w": 3,
}
"""Text that a pattern captures -> the place of the quantity in its group."""
DIMENSIONS: Mapping[str, str] = {quantity: each.dimension for each in _KNOWN for quantity in each.quantities}
"""Quantity -> what its unit is a unit of."""
QUANTITIES = tuple(DIMENSIONS)
_G = 9.80665
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
"""Dimension -> unit, as `plain_unit` spells it -> factor to the unit of `DriveLog`."""
_SPELLED = {
    other: unit
    for unit, others in {
        "s": "sec secs second seconds",
        "ms": "msec msecs millis millisec milliseconds",
        "us": "usec usecs micros microsec microseconds",
        "ns": "nsec nsecs nanos nanosec nanoseconds",
        "rad/s": "rads rad/sec radps radians/s radian/s rps",
        "deg/s": "dps degs deg/sec degps degrees/s degree/s",
        "mdeg/s": "mdps mdegs",
        "m/s2": "ms2 ms-2 mps2 m/s/s m/s/2 m/sec2 mss",
        "g": "gs gee g0",
        "rad": "radian radians",
        "deg": "degree degrees d",
        "dege7": "e7 dege-7 1e-7deg 1e7deg",
        "m": "meter metre meters metres",
        "m/s": "mps m/sec",
        "km/h": "kmh kph kmph km/hr",
    }.items()
    for other in others.split()
}
_LETTERS = str.maketrans({"µ": "u", "μ": "u", "°": "deg", "²": "2", "^": "", "*": "", " ": "", "_": "/"})
_SUFFIX = re.compile(
    r"_(s|secs?|ms|msec|millis|us|usec|micros|ns|nsec|nanos|dps|mdps|degs?|deg_s|deg_per_s|degps|rads?|rad_s|rad_per_s"
    r"|g|mg|m_s2|m_s_2|mps2|ms2|mps|m_s|kmh|kph|km_h|deg_?e7|e7|degrees|m|mm|cm)$"
)
"""A unit at the end of a name."""
_UNIT = re.compile(r"\s*(?:\[([^\]]*[A-Za-z°][^\]]*)\]|\(([^)]*[A-Za-z°][^)]*)\)|:([A-Za-z°][^:]*))\s*$")
_SPLIT = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])|[^A-Za-z0-9]+")
_CLOCKS = {"millis", "micros", "nanos"}
"""Names of times that are nothing but a unit."""
_NANOSECONDS = re.compile(r"n(?:ano)?(secs?|seconds)$")


def plain_unit(text: str, dimension: str) -> str | None:
    """Return a unit of a dimension as `UNITS` spells it: ``Deg/sec``, ``deg_s``, ``dps`` are ``deg/s``; or None."""
    unit = text.strip().lower().translate(_LETTERS)
    unit = re.sub(r"/?per/?", "/", unit)
    unit = _SPELLED.get(unit, unit)
    return unit if unit in UNITS[dimension] else None


class DriveColumn(NamedTuple):
    """A column of a file and what it holds."""

    name: str
    unit: str | None = None
    """As `UNITS` spells it; None: its name does not say."""
    sign: float = 1.0


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
    spelled = {name: list(_spellings(name)) for name in names}
    found = {} if "time" in skip else _stamp(spelled)
    for group in _KNOWN:
        found.update(_guess_group(source, spelled, group, {*skip, *found}))
    return found


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


def _joined(name: str) -> str:
    """Return the words of a name in lower case, joined with underscores: ``GyrY`` is ``gyr_y``."""
    return "_".join(part.lower() for part in _SPLIT.split(name) if part)


def _stamp(spelled: Mapping[str, Sequence[tuple[str, str]]]) -> dict[str, DriveColumn]:
    """Return the columns of seconds and nanoseconds of a stamp that has both."""
    words = {spellings[0][0]: name for name, spellings in spelled.items()}
    for rest, name in words.items():
        whole = words.get(_NANOSECONDS.sub(r"\1", rest))
        if whole is not None and whole != name:
            return {"time": DriveColumn(whole, "s"), "nanosec": DriveColumn(name, "ns")}
    return {}


def _guess_group(
    source: str, spelled: Mapping[str, Sequence[tuple[str, str]]], group: _Known, skip: Collection[str]
) -> dict[str, DriveColumn]:
    """Return the columns of the only whole set that a pattern finds, or of the one with nothing before its names."""
    wanted = [quantity for quantity in group.quantities if quantity not in skip]
    least = set(wanted) - ({"yaw"} if group.quantities == ANGLES else set())
    for pattern in group.patterns if wanted else ():
        before = "()" if pattern.startswith("=") else "(?:(.*?)_)??"
        whole = re.compile(f"{before}(?:{pattern.removeprefix('=')})")
        sets: dict[str, dict[str, DriveColumn]] = {}
        for name, spellings in spelled.items():
            matched = next(((m, unit) for words, unit in spellings if (m := whole.fullmatch(words))), None)
            place = len(group.quantities) if matched is None else _PLACE[(*matched[0].groups(), "")[1]]
            if matched is not None and place < len(group.quantities):
                quantity, unit = group.quantities[place], plain_unit(matched[1], group.dimension)
                sets.setdefault(matched[0].group(1) or "", {}).setdefault(quantity, DriveColumn(name, unit or None))
        full = {before: columns for before, columns in sets.items() if least <= set(columns)}
        if len(full) > 1 and "" not in full and len(group.quantities) > 1:
            listed = "; ".join(", ".join(column.name for column in columns.values()) for columns in full.values())
            example = ",".join(f"{quantity}={each.name}" for quantity, each in next(iter(full.values())).items())
            raise BadInputError(
                f"{source} has several sets of columns for {', '.join(wanted)}: {listed}. Name one of them, for "
                f"example `columns='{example}'`"
            )
        if full:
            columns = full.get("", next(iter(full.values())))
            return {quantity: each for quantity, each in columns.items() if quantity in wanted}
    return {}


TOPICS = ("imu", "gnss", "odometry", "twist")
"""Quantities of bags: the topics that they are read from."""
_EXPLAINED = (
    f"Quantities are {', '.join(QUANTITIES)}; in bags {', '.join(TOPICS)}. For example "
    "`columns='rate_y=GyrY[deg/s],time=t[ms]'`"
)
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
        dimension = DIMENSIONS[quantity]
        sign, bare = (-1.0, text[1:]) if text.startswith("-") and _named(text, names) is None else (1.0, text)
        name, stated = _named(bare, names), None
        if name is None and (match := _STATED.fullmatch(bare)) is not None:
            name, stated = _named(match.group(1), names), match.group(2) or match.group(3)
        if name is None:
            continue
        unit = plain_unit(next((each for _, each in _spellings(name) if each), ""), dimension)
        if stated is not None and (unit := plain_unit(stated, dimension)) is None:
            allowed = ", ".join(filter(None, UNITS[dimension])) or "none"
            raise UsageError(f"'{stated}' is no unit of {quantity} in `columns`. Units of it are: {allowed}")
        found[quantity] = DriveColumn(name, unit or None, sign)
    return found


def _named(text: str, names: Sequence[str]) -> str | None:
    """Return the name of the column that is meant; capital letters count only where they tell columns apart."""
    if text in names:
        return text
    same = [name for name in names if name.lower() == text.strip().lower()]
    return same[0] if len(same) == 1 else None
