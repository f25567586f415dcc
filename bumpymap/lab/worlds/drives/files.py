"""CSV files as a user's logger writes them."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import DriveLog, atomic

__all__ = ["write_drive_files"]

Floats = NDArray[np.float64]

_IMU = "time [s],gyro_x [rad/s],gyro_y [rad/s],gyro_z [rad/s],acc_x [m/s2],acc_y [m/s2],acc_z [m/s2]"
_PLACES = {
    "lonlat": ("time [s],longitude [deg],latitude [deg],horizontal_error [m]", "%.9f"),
    "projected": ("time [s],easting [m],northing [m],horizontal_error [m]", "%.4f"),
    "local": ("time [s],x [m],y [m],horizontal_error [m]", "%.4f"),
}
_WHEELS = "time [s],speed_left [m/s],speed_right [m/s]"


def write_drive_files(log: DriveLog, folder: Path) -> list[Path]:
    """Write a log as NAME_imu.csv, NAME_gnss.csv and NAME_wheels.csv, the latter two if there are such readings."""
    columns = np.column_stack([log.imu.time, log.imu.rate, log.imu.acceleration])
    files = [_write(folder / f"{log.name}_imu.csv", _IMU, columns, ["%.6f"] * 7)]
    if log.places is not None:
        header, form = _PLACES[log.places.kind]
        columns = np.column_stack([log.places.time, log.places.x, log.places.y, log.places.error])
        files.append(_write(folder / f"{log.name}_gnss.csv", header, columns, ["%.6f", form, form, "%.3f"]))
    if log.wheels is not None:
        half = log.wheels.difference / 2
        columns = np.column_stack([log.wheels.time, log.wheels.speed - half, log.wheels.speed + half])
        files.append(_write(folder / f"{log.name}_wheels.csv", _WHEELS, columns, ["%.6f"] * 3))
    return files


def _write(path: Path, header: str, columns: Floats, form: list[str]) -> Path:
    with atomic(path) as part:
        np.savetxt(part, columns, fmt=form, delimiter=",", header=header, comments="")
    return path
