"""Tell from column names, from what the user names and from values which quantity columns hold, in which unit.

Patterns of names have their words in lower case, joined by underscores. Other words may stand before what a pattern
describes (``imu_gyro_x``), unless it begins with ``=``. Patterns stand in the order in which they are tried, the surest
first.
"""

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from difflib import get_close_matches
from typing import NamedTuple

import numpy as np

from bumpymap.core import BadInputError, PlaceKind, UsageError
from bumpymap.readers.drives.signals import (
    ACCELERATIONS,
    ANGLES,
    DIMENSIONS,
    EASTING_NORTHING,
    LOCAL,
    LONLAT,
    QUANTITIES,
    QUATERNION,
    RATES,
    SIDES,
    UNITS,
    Floats,
    plain_unit,
)

__all__ = [
    "TOPICS",
    "DriveColumn",
    "check_lonlat",
    "chosen_columns",
    "guess_acceleration",
    "guess_angle_unit",
    "guess_columns",
    "guess_local",
    "parse_columns",
    "refuse_odd_rates",
    "unit_in_name",
    "unknown_quantities",
]

_MOST_RATE = 3.0
"""Median angular rate, rad/s: no ground vehicle turns that fast for half of a drive."""
_MOST_PEAK = 20.0
"""99th percentile of angular rates, rad/s."""
_LARGE_M = 1e5
"""No odometry reaches so far, m; eastings and northings do."""


def refuse_odd_rates(rates: Floats, source: str, names: tuple[str, ...], *, known: bool) -> str | None:
    """Refuse angular rates that cannot be rad/s; return a note if their unit is only taken to be rad/s.

    Parameters
    ----------
    rates : (n, 3) float64
        rad/s.
    source : str
        Name of the file.
    names : tuple of str
        Columns.
    known : bool
        Whether the unit was stated.

    Raises
    ------
    BadInputError
        The rates are too large, or all of them are zero.
    """
    with np.errstate(over="ignore"):
        size = np.linalg.norm(rates, axis=1)
    middle, peak = (float(value) for value in np.percentile(size, (50, 99)))
    if not size.any():
        raise BadInputError(
            f"the angular rates of {source} ({', '.join(names)}) are all zero: these columns hold no gyroscope. Name "
            f"those that do: `columns='rate_x=NAME,rate_y=NAME,rate_z=NAME'`"
        )
    if middle > _MOST_RATE or peak > _MOST_PEAK:
        stated = ",".join(f"rate_{axis}={name}[deg/s]" for axis, name in zip("xyz", names, strict=True))
        raise BadInputError(
            f"the angular rates of {source} ({', '.join(names)}) are too large for rad/s: half of them are above "
            f"{middle:.3g}, one in a hundred above {peak:.3g}. State their unit: `columns='{stated}'` (rad/s, deg/s, "
            "mrad/s or mdeg/s)"
        )
    return None if known else f"angular rates of {source} ({', '.join(names)}) name no unit and are taken as rad/s"


def guess_acceleration(values: Floats, source: str, *, known: bool) -> tuple[Floats | None, str | None]:
    """Return accelerations in m/s2, (n, 3), and a note on their unit; None if they hold no gravity.

    Without a stated unit, the size of gravity decides between g and mg.
    """
    middle = float(np.linalg.norm(np.median(values, axis=0)))  # of noise alone it would be small
    units = {"m/s2": 1.0} if known else UNITS["acceleration"]
    for unit, factor in units.items():
        if 7.0 < middle * factor < 13.0:
            note = None if known or unit == "m/s2" else f"accelerations of {source} are taken as {unit}"
            return values * factor, note
    return None, (
        f"accelerations of {source} are not used: their median is {middle:.3g} m/s2, and with gravity it would be "
        "about 9.8"
    )


def guess_angle_unit(angles: Floats, source: str) -> tuple[float, str]:
    """Return the factor from angles, (n, 3), to rad, found from their size, and a note."""
    in_degrees = float(np.abs(angles).max(initial=0.0)) > 2.0 * np.pi + 0.01
    unit = "deg" if in_degrees else "rad"
    return UNITS["angle"][unit], f"roll, pitch and yaw of {source} name no unit and are taken as {unit}"


def check_lonlat(lon: Floats, lat: Floats, source: str, names: tuple[str, ...]) -> tuple[Floats, Floats, str | None]:
    """Return longitude and latitude in degrees; a note if they were whole numbers of 1e-7 degrees.

    Raises
    ------
    BadInputError
        They are out of range, perhaps because they are swapped.
    """
    note = None
    if min(np.median(np.abs(lon)), np.median(np.abs(lat))) > 1e5 and not (lon % 1.0).any() and np.abs(lon).max() > 1e7:
        lon, lat = lon * 1e-7, lat * 1e-7
        note = f"longitude and latitude of {source} are taken as 1e-7 degrees"
    far_lon, far_lat = float(np.abs(lon).max()), float(np.abs(lat).max())
    if far_lat <= 90.0 and far_lon <= 360.0:
        return lon, lat, note
    why = "Longitudes are -180 to 180 degrees, latitudes -90 to 90."
    if far_lat <= 360.0 and far_lon <= 90.0:
        why = f"They seem to be swapped: `columns='longitude={names[1]},latitude={names[0]}'`."
    elif far_lat > 360.0:
        why += " Degrees with minutes (NMEA) are not read. Metres are named so: `columns='easting=NAME,northing=NAME'`"
    raise BadInputError(
        f"the positions of {source} ({', '.join(names)}) reach longitude {far_lon:.6g}, latitude {far_lat:.6g}. {why}"
    )


def guess_local(x: Floats, y: Floats, source: str) -> tuple[PlaceKind, str]:
    """Tell whether columns x and y are of odometry, or eastings and northings."""
    if max(float(np.median(np.abs(x))), float(np.median(np.abs(y)))) > _LARGE_M:
        return "projected", f"x and y of {source} are as large as eastings and northings, and are taken for those"
    return "local", f"x and y of {source} are taken for odometry: they say how far it drove, but not where"


class ColumnGroup(NamedTuple):
    """Quantities that are found together or not at all."""

    quantities: tuple[str, ...]
    patterns: Sequence[str]
    places: Mapping[str, int]
    """Text that the pattern captures -> the quantity that it means."""


_AXES = {"x": 0, "y": 1, "z": 2, "w": 3, "0": 0, "1": 1, "2": 2, "roll": 0, "pitch": 1, "yaw": 2}
_EAST = dict.fromkeys(("lon", "lng", "long", "longitude", "easting", "east", "e", "x"), 0)
_NORTH = dict.fromkeys(("lat", "latitude", "northing", "north", "n", "y"), 1)
_PLACES = {**_EAST, **_NORTH}
_LEFT_RIGHT = {"l": 0, "left": 0, "r": 1, "right": 1}

GROUPS = (
    ColumnGroup(
        RATES,
        (
            r"(?:angular_velocity|angular_rate|ang_vel|gyroscope|gyro|gyr|gyro_rad|omega|w)_?([xyz012])",
            r"(?:rotation_rate|turn_rate|rate|body_rate|angular)_?([xyz])",
            r"([xyz])_?(?:gyro|rate)",
            r"(roll|pitch|yaw)_?(?:rate|speed|vel|velocity)",
            r"=g_?([xyz])",
        ),
        _AXES,
    ),
    ColumnGroup(
        ACCELERATIONS,
        (
            r"(?:linear_acceleration|lin_acc|accelerometer|acceleration|accel|accelerometer_m_s2|acc|a)_?([xyz012])",
            r"specific_force_?([xyz])",
            r"([xyz])_?(?:acc|accel)",
        ),
        _AXES,
    ),
    ColumnGroup(QUATERNION, (r"(?:orientation|quaternion|quat|rotation|attitude|q)_?([xyzw])",), _AXES),
    ColumnGroup(ANGLES, (r"(roll|pitch|yaw)(?:_angle)?",), _AXES),
    ColumnGroup(LONLAT, (r"(lon|lng|long|longitude|lat|latitude)",), _PLACES),
    ColumnGroup(EASTING_NORTHING, (r"(easting|northing)", r"=(?:utm_|map_)?(east|north|e|n)", r"utm_?([xy])"), _PLACES),
    ColumnGroup(LOCAL, (r"(?:position|translation|pos|odom|odometry|pose|local)_?([xy])", r"=([xy])"), _AXES),
    ColumnGroup(
        SIDES,
        (
            r"(?:wheel_?speed|wheel_?vel|wheel_?velocity|wheel|speed|vel|velocity|v)_?(l|r|left|right)",
            r"(left|right|l|r)_?(?:wheel_?)?(?:speed|vel|velocity)",
        ),
        _LEFT_RIGHT,
    ),
)
SINGLE: Mapping[str, Sequence[str]] = {
    "time": (
        r"(?:header_)?stamp(?:_secs?)?",
        r"timestamp|time_stamp",
        r"=(?:time|t|ts)",
        r"=(?:date_?time|utc|time_utc|gpst|unix|epoch|seconds_elapsed|time_elapsed|elapsed|elapsed_time|secs?|seconds)",
        r"=date",
        r"time|time_boot",
    ),
    "date": (r"=(?:date|utc_date|day)",),
    "speed": (
        r"wheel_?(?:speed|velocity|vel)",
        r"=(?:.*twist_)?linear(?:_velocity)?_x",
        r"=(?:gps_?|gnss_?|vehicle_?|robot_?|ground_?|odom_?|base_?|g_?)?(?:speed|velocity|vel|v|spd)",
    ),
    "error": (
        r"h_?acc|horizontal_accuracy|hor_acc|h_accuracy|h_rms|eph|horizontal_error|position_error|pos_error|pos_sd",
        r"=(?:accuracy|sigma|error)",
        r"=(?:sdn|sd_n|sd_north|std_n)",
    ),
    "fix": (r"fix_type|fix|status_status|gps_qual", r"=(?:quality|status)"),
}
_SUFFIX = re.compile(
    r"_(s|secs?|ms|msec|millis|us|usec|micros|ns|nsec|nanos|dps|mdps|degs?|deg_s|deg_per_s|degps|rads?|rad_s|rad_per_s"
    r"|g|mg|m_s2|m_s_2|mps2|ms2|mps|m_s|kmh|kph|km_h|deg_?e7|e7|degrees|m|mm|cm)$"
)
"""A unit at the end of a name."""


_SPLIT = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])|[^A-Za-z0-9]+")
_UNIT = re.compile(r"\s*(?:\[([^\]]*[A-Za-z°][^\]]*)\]|\(([^)]*[A-Za-z°][^)]*)\)|:([A-Za-z°][^:]*))\s*$")
_CLOCKS = {"millis", "micros", "nanos"}
"""Names of times that are nothing but a unit."""
_NANOSECONDS = re.compile(r"n(?:ano)?(secs?|seconds)$")


class DriveColumn(NamedTuple):
    """A column of a file and what it holds."""

    name: str
    unit: str | None = None
    """As `UNITS` spells it; None: its name does not say."""
    sign: float = 1.0


Spelled = Mapping[str, Sequence[tuple[str, str]]]
"""Name of a column -> the (words, unit) that it may mean."""


class _Match(NamedTuple):
    name: str
    before: str
    """Words before those that the pattern describes."""
    key: str
    """Text that the pattern captures."""
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
    spelled = {name: list(_spellings(name)) for name in names}
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


def _matches(spelled: Spelled, pattern: str) -> Iterator[_Match]:
    before = "()" if pattern.startswith("=") else "(?:(.*?)_)??"
    whole = re.compile(f"{before}(?:{pattern.removeprefix('=')})")
    for name, spellings in spelled.items():
        for words, unit in spellings:
            match = whole.fullmatch(words)
            if match is not None:
                yield _Match(name, match.group(1) or "", match.group(2) if whole.groups > 1 else "", unit)
                break


def _column(match: _Match, quantity: str) -> DriveColumn:
    return DriveColumn(match.name, plain_unit(match.unit, DIMENSIONS[quantity]) if match.unit else None)


def _stamp(spelled: Spelled) -> dict[str, DriveColumn]:
    """Return the columns of seconds and nanoseconds of a stamp that has both."""
    words = {spellings[0][0]: name for name, spellings in spelled.items()}
    for rest, name in words.items():
        whole = words.get(_NANOSECONDS.sub(r"\1", rest))
        if whole is not None and whole != name:
            return {"time": DriveColumn(whole, "s"), "nanosec": DriveColumn(name, "ns")}
    return {}


def _guess_group(source: str, spelled: Spelled, group: ColumnGroup, skip: Collection[str]) -> dict[str, DriveColumn]:
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


def _guess_single(spelled: Spelled, quantity: str) -> dict[str, DriveColumn]:
    for pattern in SINGLE[quantity]:
        found = list(_matches(spelled, pattern))
        if found:
            return {quantity: _column(next((each for each in found if not each.before), found[0]), quantity)}
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
    unknown_quantities(found, (*QUANTITIES, *TOPICS))
    return found


def unknown_quantities(columns: Mapping[str, str], known: Sequence[str]) -> None:
    """Raise UsageError if columns are named for something that is no quantity."""
    unknown = sorted(set(columns) - set(known))
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
