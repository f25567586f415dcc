"""Records of real drives: what a vehicle's sensors recorded, and how a map compares with it.

Times are seconds on the recorder's clock, angles radians, rates rad/s, accelerations m/s2, lengths metres.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bumpymap.core.settings import brief_repr
from bumpymap.core.types import Floats

PlaceKind = Literal["lonlat", "projected", "local"]
"""Positions are degrees of longitude and latitude (WGS 84), in the units of the map's CRS, or metres in a frame of the
vehicle's own (odometry), which says how far it drove but not where."""


@dataclass(frozen=True, slots=True)
class ImuTrack:
    """The record of the inertial sensor, in the sensor's own axes."""

    time: Floats
    """(n,) s, increasing."""
    rate: Floats
    """(n, 3) angular rates about x, y, z, rad/s."""
    acceleration: Floats
    """(n, 3) specific force along x, y, z, m/s2: about 9.81 upwards at rest. NaN where it was not recorded."""


@dataclass(frozen=True, slots=True)
class PlaceTrack:
    """Where the vehicle was."""

    time: Floats
    """(m,) s, increasing, on the positions' own clock: it may be off from that of the IMU."""
    x: Floats
    """(m,) longitude [deg], easting or x, as ``kind`` says."""
    y: Floats
    """(m,) latitude [deg], northing or y."""
    error: Floats
    """(m,) standard deviation of the horizontal position as the receiver states it, m; NaN where it does not."""
    kind: PlaceKind


@dataclass(frozen=True, slots=True)
class WheelTrack:
    """How fast the wheels turned."""

    time: Floats
    """(k,) s, increasing."""
    speed: Floats
    """(k,) mean speed of both sides, m/s, positive forwards."""
    difference: Floats
    """(k,) speed of the right side minus that of the left, m/s; NaN where only one speed was recorded."""


@dataclass(frozen=True, slots=True)
class DriveLog:
    """One recorded drive."""

    name: str
    """Short name for messages and reports."""
    paths: tuple[Path, ...]
    """The files that it was read from."""
    imu: ImuTrack
    places: PlaceTrack | None
    wheels: WheelTrack | None
    columns: Mapping[str, str] = field(default_factory=dict)
    """Quantity -> column or topic that it was read from, such as ``{"rate_y": "gyro_y [deg/s]"}``."""
    notes: tuple[str, ...] = ()
    """Guesses and conversions, one sentence each."""


@dataclass(frozen=True, slots=True)
class CheckedDrive:
    """Findings about one drive and its sensors."""

    __repr__ = brief_repr

    name: str
    paths: tuple[Path, ...]
    seconds: float
    way_m: float
    """Length of the whole way."""
    used_m: float
    """Length of the part that counts: moving, straight enough, on the map."""
    left_out_m: Mapping[str, float]
    """Reason -> length that does not count for it, m."""
    speed_mps: float
    """Median speed of the part that counts."""
    rate_hz: float
    """Samples of the IMU in a second."""
    band_hz: float
    """Pitch rates are low-passed at this frequency."""
    clock_offset_s: float
    """Time to add to the times of the positions for those of the IMU; NaN if it cannot be determined."""
    clock_offset_sd_s: float
    clock_drift_ppm: float
    """Drift of that offset, microseconds per second; NaN if it cannot be determined."""
    mount_deg: tuple[float, float, float]
    """Roll, pitch and yaw of the sensor in the vehicle, degrees; NaN where one cannot be determined."""
    floor_radps: float
    """Mean absolute pitch rate at standstill after the band limit, rad/s: what sensor and engine alone read; NaN
    without a standstill."""
    position_error_m: float
    """Standard deviation of a horizontal position."""
    columns: Mapping[str, str]
    notes: tuple[str, ...]
    warnings: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class DrivenStretches:
    """Stretches of drives, one row each: what was measured, and what the map says of the same way."""

    __repr__ = brief_repr

    drive: NDArray[np.int64]
    """(n,) number of the drive."""
    start_s: Floats
    """(n,) s, on the clock of the IMU."""
    end_s: Floats
    """(n,) s."""
    easting: Floats
    """(n,) middle of the stretch in the map's CRS, m (NaN without a map or positions)."""
    northing: Floats
    """(n,) m."""
    way_m: Floats
    """(n,) length, m."""
    speed_mps: Floats
    """(n,) mean speed."""
    measured: Floats
    """(n,) C_r of the drive, less the sensor's floor, rad/m."""
    measured_sd: Floats
    """(n,) standard error of it, rad/m."""
    c_r: Floats
    """(n,) of the map, mean along the way weighted by where the vehicle may have been, rad/m; NaN off the map."""
    c_r_low: Floats
    """(n,) lower end of its 80 % interval."""
    c_r_high: Floats
    """(n,) upper end."""
    place_sd: Floats
    """(n,) standard deviation of ``c_r`` over the places where the vehicle may have been, rad/m."""
    class_id: NDArray[np.uint8]
    """(n,) class of the map's ``c_r``, 255 off the map."""
    measured_class: NDArray[np.uint8]
    """(n,) class of ``measured`` by the same limits."""


@dataclass(frozen=True, slots=True)
class MapAgreement:
    """How well map and drives agree over some stretches."""

    stretches: int
    way_m: float
    spearman: float
    """NaN with fewer than five stretches."""
    median_ratio: float
    """Median of c_r of the map / measured."""
    median_error: float
    """Median of abs(map / measured - 1)."""
    inside: float
    """Share of stretches whose measured C_r lies in the map's interval, widened by the error of the measurement."""
    same_class: float


@dataclass(frozen=True, slots=True)
class CheckedMap:
    """The map that drives are checked against."""

    name: str
    folder: Path
    vehicle: str
    calibration_id: str
    speed_mps: float
    """Of the vehicle profile."""
    class_limits: tuple[float, float, float]
    """rad/m."""


@dataclass(frozen=True, slots=True)
class CheckResult:
    """All findings of ``bumpymap check``."""

    __repr__ = brief_repr

    ground: CheckedMap | None
    """None: drives were measured without a map."""
    drives: tuple[CheckedDrive, ...]
    stretches: DrivenStretches
    agreement: MapAgreement | None
    """Over all stretches on the map; None without a map."""
    by_class: Mapping[int, MapAgreement]
    """By class of the map."""
    warnings: tuple[str, ...]
    skipped: Mapping[str, str] = field(default_factory=dict)
    """Drives that could not be used, as they were given, with the error message."""
    by_line: DrivenStretches | None = None
    """The same stretches, where the map's values are those of the driven line itself; None if it cannot tell them."""
    agreement_by_line: MapAgreement | None = None
    """Of these."""
