"""What was measured along one drive, sample by sample: the record that stretches and tiles are made from."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.check.track import DrivenTrack

__all__ = ["COUNTS", "LEFT_OUT", "DriveMeasure", "WayStretch"]

Floats = NDArray[np.float64]

COUNTS = 0
"""Value of ``DriveMeasure.reason`` for samples that count."""
LEFT_OUT = (
    "",
    "gap in the record of the IMU",
    "no position",
    "too slow",
    "turning",
    "too short between the parts left out",
    "off the map",
    "unknown ground",
)
"""Why a part of the way does not count, by the value of ``DriveMeasure.reason``."""


@dataclass(frozen=True, slots=True)
class DriveMeasure:
    """One drive at the even samples of its inertial sensor."""

    name: str
    time: Floats
    """(n,) s, on the clock of the IMU."""
    pitch_rate: Floats
    """(n,) about the vehicle's own y axis, low-passed, rad/s."""
    speed: Floats
    """(n,) m/s."""
    easting: Floats
    """(n,) m; from the start where there are no positions."""
    northing: Floats
    """(n,) m."""
    reason: NDArray[np.uint8]
    """(n,) number in ``LEFT_OUT``; 0: counts."""
    track: DrivenTrack
    hertz: float
    band_hz: float
    clock_offset_s: float
    """What to add to the times of the positions; NaN if it cannot be told."""
    clock_offset_sd_s: float
    clock_drift_ppm: float
    mount_deg: tuple[float, float, float]
    floor_radps: float
    """Mean absolute pitch rate at standstill, rad/s; NaN without one."""
    notes: tuple[str, ...]

    @property
    def floor(self) -> float:
        """The floor, 0 where it is not known, rad/s."""
        return 0.0 if np.isnan(self.floor_radps) else self.floor_radps


@dataclass(frozen=True, slots=True)
class WayStretch:
    """Stretches of one drive, one row each."""

    label: NDArray[np.int64]
    """(samples,) number of the stretch of each sample, -1 where it belongs to none."""
    start_s: Floats
    """(n,) s."""
    end_s: Floats
    """(n,) s."""
    way_m: Floats
    """(n,) m."""
    speed_mps: Floats
    """(n,) mean speed."""
    measured: Floats
    """(n,) rad/m."""
    measured_sd: Floats
    """(n,) rad/m."""
    easting: Floats
    """(n,) middle, m."""
    northing: Floats
    """(n,) m."""
