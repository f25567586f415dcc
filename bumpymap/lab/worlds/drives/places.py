"""A satellite receiver and wheel encoders on a driven vehicle."""

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import PlaceTrack, WheelTrack
from bumpymap.lab.worlds.drives.grades import ClockFault, DriveSensors, GnssGrade
from bumpymap.lab.worlds.drives.motion import TrueDrive
from bumpymap.lab.worlds.drives.random_series import slow_noise

__all__ = ["sense_places", "sense_wheels"]

Floats = NDArray[np.float64]


def sense_places(drive: TrueDrive, sensors: DriveSensors, grade: GnssGrade, rng: np.random.Generator) -> PlaceTrack:
    """Simulate the fixes of a receiver, in the coordinates of the drive; time stamps are those of its own clock."""
    at = np.arange(rng.uniform(0, 1 / grade.sample_hz), drive.time[-1], 1 / grade.sample_hz)
    true = drive.place_of(sensors.antenna_arm_m)
    shape = (len(at), 2)
    error = grade.white_m * rng.standard_normal(shape)
    error = error + grade.slow_m * slow_noise(rng, shape, grade.slow_s, grade.sample_hz)
    x, y = (np.interp(at, drive.time, true[:, axis]) + error[:, axis] for axis in (0, 1))
    kept = _without_gaps(at, grade, rng)
    stated = np.full(len(at), grade.error_m if grade.stated else np.nan)
    stamp = _on_clock(at + grade.latency_s, sensors.clock, drive)
    return PlaceTrack(stamp[kept], x[kept], y[kept], stated[kept], "projected")


def sense_wheels(drive: TrueDrive, sensors: DriveSensors, rate_hz: float) -> WheelTrack:
    """Simulate wheel encoders on the clock of the positions."""
    at = np.arange(0.0, drive.time[-1], 1 / rate_hz)
    left, right = (np.interp(at, drive.time, drive.wheels[:, side]) for side in (0, 1))
    return WheelTrack(_on_clock(at, sensors.clock, drive), (left + right) / 2, right - left)


def _on_clock(at: Floats, clock: ClockFault, drive: TrueDrive) -> Floats:
    """Return times of the IMU's clock as the other clock shows them."""
    return np.asarray(at - clock.offset_s - 1e-6 * clock.drift_ppm * (at - drive.time[-1] / 2))


def _without_gaps(at: Floats, grade: GnssGrade, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return which fixes are left after dropouts at random times, not during the first and last tenth of the drive."""
    kept = np.ones(len(at), np.bool_)
    for _ in range(grade.gaps):
        start, seconds = rng.uniform(0.1, 0.9) * at[-1], rng.uniform(*grade.gap_s)
        kept &= (at < start) | (at >= start + min(seconds, 0.9 * at[-1] - start))
    return kept
