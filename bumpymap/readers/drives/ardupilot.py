"""Messages of ArduPilot logs that ``mavlogdump.py`` wrote as CSV: several sensors in one file, z downwards."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError
from bumpymap.readers.drives.column_names import DriveColumn
from bumpymap.readers.drives.quantities import ACCELERATIONS, ANGLES, RATES
from bumpymap.readers.drives.signals import Floats
from bumpymap.readers.source import open_source

__all__ = ["instance_column", "is_dataflash", "keep_first_instance", "refuse_binary", "to_flu"]

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
