"""Turn the columns of a table of text into the signals of a drive."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, WheelTrack
from bumpymap.readers.drives import ardupilot
from bumpymap.readers.drives.attitude import quaternions_of_angles
from bumpymap.readers.drives.choice import chosen_columns
from bumpymap.readers.drives.clock import in_order, numbers_of_times, seconds_of_numbers
from bumpymap.readers.drives.column_names import DriveColumn, guess_columns
from bumpymap.readers.drives.guesses import guess_acceleration, guess_angle_unit, refuse_odd_rates
from bumpymap.readers.drives.place_columns import PLACE_GROUPS, read_places
from bumpymap.readers.drives.quantities import (
    ACCELERATIONS,
    ANGLES,
    DIMENSIONS,
    QUATERNION,
    RATES,
    SIDES,
    UNITS,
)
from bumpymap.readers.drives.signals import DriveSignals, Floats, Signal
from bumpymap.readers.drives.text_table import TextTable

__all__ = ["find_columns", "table_signals"]


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
    return {**guess_columns(table.path.name, names, known), **chosen}


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
    if not set(columns) - {"time", "nanosec", "fix", "error"}:
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
    instance = ardupilot.instance_column(table.head.names)
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
        kept = ardupilot.keep_first_instance(kept, arrays[instance].to_numpy(), source, notes)
    if ardupilot.is_dataflash(table.head.names):
        kept, columns = ardupilot.to_flu(kept, columns, source, notes)
    return _Values(source, columns, kept, notes)


def _times(arrays: Mapping[str, Any], columns: Mapping[str, DriveColumn], source: str, notes: list[str]) -> Floats:
    column = columns["time"]
    numbers = numbers_of_times(arrays[column.name], source, column.name)
    unit = "ns" if numbers.is_date else column.unit
    kind = "rates" if set(RATES) <= set(columns) or set(QUATERNION) <= set(columns) else "positions"
    if "nanosec" in columns:
        rest = numbers_of_times(arrays[columns["nanosec"].name], source, columns["nanosec"].name)
        return numbers.values.astype(np.float64) + rest.values * np.float64(1e-9)
    seconds, note = seconds_of_numbers(numbers.values, unit, kind, (source, column.name))
    notes.extend([note] if note else [])
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
