"""Turn the columns of a table of text into the signals of a drive: sensors, positions, messages of ArduPilot logs."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, PlaceKind, PlaceTrack, WheelTrack
from bumpymap.readers.drives.clock import days_of_text, in_order, numbers_of_times, seconds_of_numbers
from bumpymap.readers.drives.columns import (
    DriveColumn,
    check_lonlat,
    chosen_columns,
    guess_acceleration,
    guess_angle_unit,
    guess_columns,
    guess_local,
    refuse_odd_rates,
)
from bumpymap.readers.drives.signals import (
    ACCELERATIONS,
    ANGLES,
    DIMENSIONS,
    EASTING_NORTHING,
    LOCAL,
    LONLAT,
    QUATERNION,
    RATES,
    SIDES,
    UNITS,
    DriveSignals,
    Floats,
    Signal,
    quaternions_of_angles,
)
from bumpymap.readers.drives.text_table import TextTable
from bumpymap.readers.source import open_source

__all__ = [
    "PLACE_GROUPS",
    "find_columns",
    "fresh_places",
    "instance_column",
    "is_dataflash",
    "keep_first_instance",
    "read_places",
    "refuse_binary",
    "table_signals",
    "to_flu",
]

_TIME = "TimeUS"
_SYNC = b"\xa3\x95"
"""First bytes of every message of a binary log."""
_DOWN = ("rate_y", "rate_z", "acc_y", "acc_z", "pitch", "yaw")
"""Quantities whose sign differs between x forward, y right, z down and x forward, y left, z up."""


def is_dataflash(names: Sequence[str]) -> bool:
    """Return whether columns are those of a message of an ArduPilot log."""
    return _TIME in names


def instance_column(names: Sequence[str]) -> str | None:
    """Return the column that numbers the sensors of one kind; None if there is none."""
    return "I" if is_dataflash(names) and "I" in names else None


def keep_first_instance(
    values: Mapping[str, Floats], instance: NDArray[Any], source: str, notes: list[str]
) -> dict[str, Floats]:
    """Return the rows of the first sensor only."""
    numbers = instance.astype(np.float64)
    first = numbers == np.nanmin(numbers) if np.isfinite(numbers).any() else np.ones(len(numbers), bool)
    if not first.all():
        notes.append(f"{source} holds several sensors; the first one is read (I = {np.nanmin(numbers):g})")
    return {quantity: column[first] for quantity, column in values.items()}


def to_flu(
    values: Mapping[str, Floats], columns: Mapping[str, DriveColumn], source: str, notes: list[str]
) -> tuple[dict[str, Floats], dict[str, DriveColumn]]:
    """Turn x forward, y right, z down into x forward, y left, z up; rates are rad/s, angles degrees."""
    if set(columns) & {*RATES, *ACCELERATIONS, *ANGLES}:
        notes.append(f"{source} is of ArduPilot: x forward, y right, z down is turned into x forward, y left, z up")
    units = {
        **dict.fromkeys(RATES, "rad/s"),
        **dict.fromkeys(ACCELERATIONS, "m/s2"),
        **dict.fromkeys(ANGLES, "deg"),
        "speed": "m/s",
    }
    unstated = {quantity for quantity, unit in units.items() if quantity in columns and columns[quantity].unit is None}
    factor = {quantity: np.deg2rad(1.0) for quantity in ANGLES if quantity in unstated}
    lowest = {"fix": 2.0}  # 0: no receiver, 1: no fix
    turned = {
        quantity: (column - lowest.get(quantity, 0.0))
        * ((-1.0 if quantity in _DOWN else 1.0) * factor.get(quantity, 1.0))
        for quantity, column in values.items()
        if quantity != "time"
    }
    stated = {
        quantity: column._replace(unit=units[quantity]) if quantity in unstated else column
        for quantity, column in columns.items()
    }
    return {**turned, "time": values["time"]}, stated


def refuse_binary(path: Path) -> None:
    """Raise BadInputError for the binary logs of ArduPilot, whose readers cannot be shipped with bumpymap."""
    with open_source(path) as stream:
        if stream.read(2) != _SYNC:
            return
    stem = path.stem
    raise BadInputError(
        f"{path} is a binary log of ArduPilot, which is not read itself. Make CSV files of it with pymavlink: "
        f"mavlogdump.py --format csv --types IMU {path.name} > {stem}_imu.csv, the same with --types GPS > "
        f"{stem}_gps.csv, and give {stem}_imu.csv,{stem}_gps.csv"
    )


PLACE_GROUPS = (LONLAT, EASTING_NORTHING, LOCAL)
_LEAST_FIX = {"fix_type": 2.0, "fix": 1.0, "quality": 1.0, "gps_qual": 1.0}
"""Name -> least value of a position that was measured; 0 for others (``status`` of ROS)."""
_HELD = 0.5
"""From this share of repeated positions on, the table repeats the last one in rows between two positions."""


def read_places(
    source: str, columns: Mapping[str, DriveColumn], values: Mapping[str, Floats], notes: list[str]
) -> PlaceTrack | None:
    """Return the positions of a table: longitude and latitude before eastings and northings, these before odometry.

    Raises
    ------
    BadInputError
        Degrees are out of range, or times are out of order.
    """
    for group in PLACE_GROUPS:
        if set(group) <= set(values):
            found = _track(source, group, (columns, values), notes)
            if found is not None:
                return found
    return None


def _track(
    source: str,
    group: tuple[str, ...],
    table: tuple[Mapping[str, DriveColumn], Mapping[str, Floats]],
    notes: list[str],
) -> PlaceTrack | None:
    columns, values = table
    time, x, y = values["time"], values[group[0]], values[group[1]]
    rows = np.isfinite(time) & np.isfinite(x) & np.isfinite(y)
    bad = np.zeros_like(rows)
    if "fix" in values:
        name = columns["fix"].name.lower()
        bad |= values["fix"] < next((least for key, least in _LEAST_FIX.items() if key in name), 0.0)
    if group == LONLAT:
        bad |= (x == 0.0) & (y == 0.0)
    if lost := int((bad & rows).sum()):
        notes.append(f"{lost:,} positions of {source} were taken without a fix and are left out")
    places = np.flatnonzero(rows & ~bad)
    if not len(places):
        return None
    keep, note = in_order(time[places], f"the positions of {source}")
    notes.extend([note] if note else [])
    places = places[keep]
    error = values["error"][places] if "error" in values else np.full(len(places), np.nan)
    return _settled(source, group, (columns, notes), (time[places], x[places], y[places], error))


def _settled(
    source: str,
    group: tuple[str, ...],
    told: tuple[Mapping[str, DriveColumn], list[str]],
    samples: tuple[Floats, Floats, Floats, Floats],
) -> PlaceTrack:
    columns, notes = told
    time, x, y, error = samples
    kind: PlaceKind = "lonlat" if group == LONLAT else "projected"
    note: str | None = None
    if group == LONLAT:
        x, y, note = check_lonlat(x, y, source, tuple(columns[quantity].name for quantity in group))
    elif group == LOCAL:
        kind, note = guess_local(x, y, source)
    notes.extend([note] if note else [])
    fresh = fresh_places(time, x, y)
    if len(fresh) < len(time):
        notes.append(f"{len(time) - len(fresh):,} positions of {source} only repeat the one before and are left out")
    return PlaceTrack(time[fresh], x[fresh], y[fresh], error[fresh], kind)


def fresh_places(time: Floats, x: Floats, y: Floats) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Return which positions were measured, where a table repeats the last one in each row until the next.

    Repetitions stay at the receiver's own interval while the vehicle stands: where the next position is as near as
    positions usually are.

    Parameters
    ----------
    time, x, y : (n,) float64
        s, and positions in any unit.

    Returns
    -------
    (m,) int
        All positions, unless more than half of them repeat the one before.
    """
    count = len(time)
    steps = np.hypot(np.diff(x), np.diff(y))
    changes = np.flatnonzero(np.append(True, steps > 0.0))
    if len(changes) < 3 or (count - len(changes)) <= _HELD * count:
        return np.arange(count)
    interval = float(np.median(np.diff(time[changes])))
    usual = 3.0 * float(np.median(steps[changes[1:] - 1]))
    # A run of equal positions that ends in a usual step is a standstill; one that ends in a long step is a dropout.
    ends = np.append(steps[changes[1:] - 1] <= usual, True)
    run = np.searchsorted(changes, np.arange(count), "right") - 1
    number = np.floor((time - time[changes[run]]) / interval + 1e-6)
    new_interval = np.append(True, np.diff(number) > 0)
    first = np.zeros(count, bool)
    first[changes] = True
    kept: np.ndarray[tuple[int], np.dtype[np.intp]] = np.flatnonzero(first | (ends[run] & new_interval))
    return kept


_SENSOR = re.compile(r"gyroscope|gyro|acceleration|accelerometer|accel", re.IGNORECASE)
_GPS_AHEAD_S = 18.0
"""Leap seconds between the time of GPS and UTC, since 2017."""


class _Values(NamedTuple):
    """The values of a table by quantity, and what is said about them."""

    source: str
    columns: Mapping[str, DriveColumn]
    values: Mapping[str, Floats]
    """(n,), in units of `DriveLog` where the unit of the column is known; NaN where missing."""
    notes: list[str]

    def names(self, group: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(self.columns[quantity].name for quantity in group)

    def known(self, group: tuple[str, ...]) -> bool:
        return all(self.columns[quantity].unit is not None for quantity in group if quantity in self.columns)

    def rows(self, group: tuple[str, ...], what: str) -> tuple[Floats, Floats] | None:
        """Return the times (n,) and values (n, k) of the samples that have all quantities of a group."""
        if not set(group) <= set(self.values):
            return None
        time, values = self.values["time"], np.stack([self.values[quantity] for quantity in group], axis=1)
        rows = np.flatnonzero(np.isfinite(time) & np.isfinite(values).all(axis=1))
        if not len(rows):
            return None
        keep, note = in_order(time[rows], f"{what} of {self.source}")
        self.notes.extend([note] if note else [])
        return time[rows][keep], values[rows][keep]


def find_columns(table: TextTable, columns: Mapping[str, str]) -> dict[str, DriveColumn]:
    """Return which columns of a table hold what: as named, the others as their names tell.

    Raises
    ------
    BadInputError
        Several columns may hold the same quantity.
    UsageError
        A named unit is unknown.
    """
    names = table.head.names
    chosen = chosen_columns(columns, names)
    known = (set(columns) - {"time"}) | set(chosen)
    for group in PLACE_GROUPS:
        if set(group) & set(columns):
            known |= {quantity for other in PLACE_GROUPS if other != group for quantity in other}
    if "speed" in columns or set(SIDES) & set(columns):
        known |= {"speed"} if set(SIDES) & set(columns) else set(SIDES)
    spelled = {_with_sensor(table.path.stem, name): name for name in names}
    guessed = guess_columns(table.path.name, list(spelled), known)
    return {**{quantity: each._replace(name=spelled[each.name]) for quantity, each in guessed.items()}, **chosen}


def _with_sensor(stem: str, name: str) -> str:
    """Return the name of an axis with the sensor that the file is named after: x of Gyroscope.csv."""
    sensor = _SENSOR.search(stem)
    return f"{sensor.group().lower()}_{name}" if sensor and name.strip().lower() in {"x", "y", "z"} else name


def table_signals(table: TextTable, columns: Mapping[str, DriveColumn]) -> DriveSignals:
    """Read the signals of a table.

    Parameters
    ----------
    table : TextTable
    columns : mapping
        Of `find_columns`.

    Raises
    ------
    BadInputError
        There is no time, or values cannot be meant.
    """
    source = table.path.name
    listing = f"{source}: {', '.join(table.head.names)}"
    if not set(columns) - {"time", "nanosec", "date", "fix", "error"}:
        return DriveSignals(source, listing=listing)
    if "time" not in columns:
        raise BadInputError(
            f"{table.path} has no column of times that is known by its name; its columns are "
            f"{', '.join(table.head.names)}. Name it, with its unit: `columns='time=NAME[s]'`"
        )
    values = _read(table, columns)
    rate = _rates(values)
    return DriveSignals(
        source=source,
        rate=rate,
        acceleration=_accelerations(values),
        attitude=_attitude(values),
        places=read_places(source, values.columns, values.values, values.notes),
        wheels=_wheels(values),
        columns={quantity: _told(column) for quantity, column in columns.items()},
        notes=tuple(values.notes),
        listing=listing,
    )


def _told(column: DriveColumn) -> str:
    return column.name if column.unit is None or column.unit in column.name else f"{column.name} [{column.unit}]"


def _read(table: TextTable, columns: Mapping[str, DriveColumn]) -> _Values:
    notes: list[str] = []
    source = table.path.name
    instance = instance_column(table.head.names)
    names = list(dict.fromkeys([*(column.name for column in columns.values()), *([instance] if instance else [])]))
    arrays, broken = table.read(names)
    if broken:
        notes.append(f"{broken:,} lines of {source} are cut off or broken and are left out")
    if not len(arrays[names[0]]):
        raise BadInputError(f"{table.path} has a header line, but no samples")
    values = {
        quantity: _numbers(arrays[column.name], quantity, column, source)
        for quantity, column in columns.items()
        if DIMENSIONS[quantity] != "time"
    }
    kept = {quantity: each for quantity, each in values.items() if each is not None}
    kept["time"] = _times(arrays, columns, source, notes)
    if instance is not None:
        kept = keep_first_instance(kept, arrays[instance].to_numpy(), source, notes)
    if is_dataflash(table.head.names):
        kept, columns = to_flu(kept, columns, source, notes)
    return _Values(source, columns, kept, notes)


def _times(arrays: Mapping[str, Any], columns: Mapping[str, DriveColumn], source: str, notes: list[str]) -> Floats:
    column = columns["time"]
    numbers = numbers_of_times(arrays[column.name], source, column.name)
    kind = "rates" if set(RATES) <= set(columns) or set(QUATERNION) <= set(columns) else "positions"
    if "nanosec" in columns:
        rest = numbers_of_times(arrays[columns["nanosec"].name], source, columns["nanosec"].name)
        return numbers.values.astype(np.float64) + rest.values * np.float64(1e-9)
    seconds, note = seconds_of_numbers(numbers.values, numbers.unit or column.unit, kind, (source, column.name))
    notes.extend([note] if note else [])
    if not numbers.has_date:
        days = days_of_text(arrays[columns["date"].name]) if "date" in columns else None
        if days is None:
            notes.append(f"times of {source} (column {column.name}) are times of day")
        else:
            seconds = seconds + days * 86_400.0
    if numbers.unit is not None and numbers.has_date and column.name.strip().lower() == "gpst":
        notes.append(f"times of {source} are those of GPS; {_GPS_AHEAD_S:g} s are taken off for UTC")
        seconds = seconds - _GPS_AHEAD_S
    return seconds


def _numbers(column: Any, quantity: str, stated: DriveColumn, source: str) -> Floats | None:
    """Return a column in the unit of `DriveLog`, where its unit is known; None if it is text that may be left out."""
    from pyarrow import types

    kind = column.type
    if not (types.is_integer(kind) or types.is_floating(kind) or types.is_null(kind)):
        if quantity == "fix":
            return None
        word = next((str(word) for word in column.drop_null().to_pylist() if not _is_number(str(word))), "")
        raise BadInputError(
            f"the column {stated.name} of {source} ({quantity}) holds '{word}' among its numbers. Leave such cells "
            f"empty, name another column (`columns='{quantity}=NAME'`), or none (`columns='{quantity}='`)"
        )
    values: NDArray[np.float64] = column.to_numpy().astype(np.float64)
    factor = stated.sign * (1.0 if stated.unit is None else UNITS[DIMENSIONS[quantity]][stated.unit])
    return values if factor == 1.0 else values * factor


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _rates(table: _Values) -> Signal | None:
    found = table.rows(RATES, "the angular rates")
    if found is None:
        return None
    note = refuse_odd_rates(found[1], table.source, table.names(RATES), known=table.known(RATES))
    table.notes.extend([note] if note else [])
    return Signal(*found)


def _accelerations(table: _Values) -> Signal | None:
    found = table.rows(ACCELERATIONS, "the accelerations")
    if found is None:
        return None
    values, note = guess_acceleration(found[1], table.source, known=table.known(ACCELERATIONS))
    table.notes.extend([note] if note else [])
    return None if values is None else Signal(found[0], values)


def _attitude(table: _Values) -> Signal | None:
    found = table.rows(QUATERNION, "the attitudes")
    if found is not None:
        length = np.linalg.norm(found[1], axis=1)
        good = np.abs(length - 1.0) < 0.1
        return Signal(found[0][good], found[1][good]) if good.sum() > 1 else None
    full = {**table.values}
    if "yaw" not in full and {"roll", "pitch"} <= set(full):
        full["yaw"] = np.zeros_like(full["roll"])
        table.notes.append(f"{table.source} has roll and pitch, but no yaw: turning is left out of its rates")
    found = table._replace(values=full).rows(ANGLES, "the attitudes")
    if found is None:
        return None
    angles = found[1]
    if not table.known(ANGLES):
        factor, note = guess_angle_unit(angles, table.source)
        angles = angles * factor
        table.notes.append(note)
    return Signal(found[0], quaternions_of_angles(*angles.T))


def _wheels(table: _Values) -> WheelTrack | None:
    sides = table.rows(SIDES, "the wheel speeds")
    if sides is not None:
        time, speeds = sides
        return WheelTrack(time, speeds.mean(axis=1), speeds[:, 1] - speeds[:, 0])
    one = table.rows(("speed",), "the speeds")
    return None if one is None else WheelTrack(one[0], one[1][:, 0], np.full(len(one[0]), np.nan))
