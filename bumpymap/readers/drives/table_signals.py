"""Turn the columns of a table of text into the signals of a drive: sensors, positions, messages of ArduPilot logs."""

import re
from collections.abc import Mapping
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
    attitudes,
    quaternions_of_angles,
)
from bumpymap.readers.drives.text_table import TextTable
from bumpymap.readers.source import open_source

__all__ = ["find_columns", "fresh_places", "refuse_binary", "table_signals"]

_TIME_US, _INSTANCE = "TimeUS", "I"
"""Columns of the messages of ArduPilot logs: the time, by which they are known, and the number of the sensor."""
_SYNC = b"\xa3\x95"
"""First bytes of every message of a binary log."""
_DOWN = ("rate_y", "rate_z", "acc_y", "acc_z", "pitch", "yaw")
"""Quantities whose sign differs between x forward, y right, z down and x forward, y left, z up."""
_ARDUPILOT_UNITS = {
    **dict.fromkeys(RATES, "rad/s"),
    **dict.fromkeys(ACCELERATIONS, "m/s2"),
    **dict.fromkeys(ANGLES, "deg"),
    "speed": "m/s",
}
_PLACE_GROUPS = (LONLAT, EASTING_NORTHING, LOCAL)
_LEAST_FIX = {"fix_type": 2.0, "fix": 1.0, "quality": 1.0, "gps_qual": 1.0}
"""Name -> least value of a position that was measured; 0 for others (``status`` of ROS)."""
_HELD = 0.5
"""From this share of repeated positions on, the table repeats the last one in rows between two positions."""
_SENSOR = re.compile(r"gyroscope|gyro|acceleration|accelerometer|accel", re.IGNORECASE)
_GPS_AHEAD_S = 18.0
"""Leap seconds between the time of GPS and UTC, since 2017."""


def _of_ardupilot(
    values: Mapping[str, Floats], columns: Mapping[str, DriveColumn], source: str, notes: list[str]
) -> tuple[dict[str, Floats], dict[str, DriveColumn]]:
    """Turn x forward, y right, z down into x forward, y left, z up; state the units of the log."""
    if set(columns) & {*RATES, *ACCELERATIONS, *ANGLES}:
        notes.append(f"{source} is of ArduPilot: x forward, y right, z down is turned into x forward, y left, z up")
    stated, turned = dict(columns), dict(values)
    for quantity in set(values) - {"time"}:
        column = columns[quantity]
        factor = -1.0 if quantity in _DOWN else 1.0
        if column.unit is None and quantity in _ARDUPILOT_UNITS:
            stated[quantity] = column._replace(unit=_ARDUPILOT_UNITS[quantity])
            factor *= np.deg2rad(1.0) if quantity in ANGLES else 1.0
        # A fix of 0 is no receiver, of 1 no fix.
        turned[quantity] = (values[quantity] - (2.0 if quantity == "fix" else 0.0)) * factor
    return turned, stated


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

    def places(self) -> PlaceTrack | None:
        """Return longitude and latitude before eastings and northings, these before odometry."""
        groups = (group for group in _PLACE_GROUPS if set(group) <= set(self.values))
        return next((track for group in groups if (track := self._track(group)) is not None), None)

    def _track(self, group: tuple[str, ...]) -> PlaceTrack | None:
        source, values, notes = self.source, self.values, self.notes
        time, x, y = values["time"], values[group[0]], values[group[1]]
        rows = np.isfinite(time) & np.isfinite(x) & np.isfinite(y)
        bad = np.zeros_like(rows)
        if "fix" in values:
            name = self.columns["fix"].name.lower()
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
        time, x, y = time[places], x[places], y[places]
        error = values["error"][places] if "error" in values else np.full(len(places), np.nan)
        kind: PlaceKind = "projected"
        if group == LONLAT:
            kind = "lonlat"
            x, y, note = check_lonlat(x, y, source, self.names(group))
            notes.extend([note] if note else [])
        elif group == LOCAL:
            kind, told = guess_local(x, y, source)
            notes.append(told)
        fresh = fresh_places(time, x, y)
        if lost := len(time) - len(fresh):
            notes.append(f"{lost:,} positions of {source} only repeat the one before and are left out")
        return PlaceTrack(time[fresh], x[fresh], y[fresh], error[fresh], kind)


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
    for group in _PLACE_GROUPS:
        if set(group) & set(columns):
            known |= {quantity for other in _PLACE_GROUPS if other != group for quantity in other}
    if "speed" in columns or set(SIDES) & set(columns):
        known |= {"speed"} if set(SIDES) & set(columns) else set(SIDES)
    # A file may be named after its sensor: x of Gyroscope.csv.
    sensor = _SENSOR.search(table.path.stem)
    axis = f"{sensor.group().lower()}_" if sensor else ""
    spelled = {axis * (name.strip().lower() in {"x", "y", "z"}) + name: name for name in names}
    guessed = guess_columns(table.path.name, list(spelled), known)
    return {**{quantity: each._replace(name=spelled[each.name]) for quantity, each in guessed.items()}, **chosen}


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
    return DriveSignals(
        source=source,
        rate=_rates(values),
        acceleration=_accelerations(values),
        attitude=_attitude(values),
        places=values.places(),
        wheels=_wheels(values),
        columns={
            quantity: name if unit is None or unit in name else f"{name} [{unit}]"
            for quantity, (name, unit, _) in columns.items()
        },
        notes=tuple(values.notes),
        listing=listing,
    )


def _read(table: TextTable, columns: Mapping[str, DriveColumn]) -> _Values:
    notes: list[str] = []
    source = table.path.name
    is_ardupilot = _TIME_US in table.head.names
    instance = _INSTANCE if is_ardupilot and _INSTANCE in table.head.names else None
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
        numbers = arrays[instance].to_numpy().astype(np.float64)
        first = numbers == np.nanmin(numbers) if np.isfinite(numbers).any() else np.ones(len(numbers), bool)
        if not first.all():
            notes.append(f"{source} holds several sensors; the first one is read (I = {np.nanmin(numbers):g})")
        kept = {quantity: column[first] for quantity, column in kept.items()}
    if is_ardupilot:
        kept, columns = _of_ardupilot(kept, columns, source, notes)
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
        return attitudes(*found)
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
