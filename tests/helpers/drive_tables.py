"""Made-up drives as tables of text."""

import numpy as np
import pytest

from bumpymap.core import BadInputError
from bumpymap.readers import read_drive

GRAVITY = 9.81
NAMES = ("time", "gyro_x", "gyro_y", "gyro_z", "acc_x", "acc_y", "acc_z", "lon", "lat")


def drive(count=400, rate=100.0, start=0.0):
    """Columns of a drive, by the names of `NAMES`."""
    rng = np.random.default_rng(3)
    time = start + np.arange(count) / rate
    gyro = rng.normal(0.0, 0.2, (count, 3))
    acceleration = np.array([0.0, 0.0, GRAVITY]) + rng.normal(0.0, 0.5, (count, 3))
    lon, lat = -99.1 + 1e-7 * np.arange(count), 19.4 + 1e-7 * np.arange(count)
    return dict(zip(NAMES, (time, *gyro.T, *acceleration.T, lon, lat), strict=True))


def write(path, columns, separator=",", before="", end="\n"):
    """Write columns; NaN as an empty cell."""
    lines = [separator.join(columns)]
    rows = zip(*columns.values(), strict=True)
    lines += [separator.join("" if value != value else str(value) for value in row) for row in rows]  # noqa: PLR0124
    path.write_text(before + end.join(lines) + end, encoding="utf-8", newline="")
    return str(path)


def renamed(columns, **names):
    return {names.get(name, name): values for name, values in columns.items()}


def refusal(path, columns=None, error=BadInputError):
    with pytest.raises(error) as caught:
        read_drive(str(path), columns)
    return str(caught.value)


def gyro(columns):
    return np.stack([columns[f"gyro_{axis}"] for axis in "xyz"], axis=1)
