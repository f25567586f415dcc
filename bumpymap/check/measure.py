"""From the log of a drive to its pitch rate along the way: each step of the measurement in order."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from bumpymap.check.inertial import (
    DrivenMotion,
    EvenImu,
    Mounting,
    even_imu,
    find_mounting,
    fit_clock,
    heading_of,
    level_force,
    levelling,
    low_pass,
    pieces,
    refuse_wrong_unit,
    rolling_mean,
    turned,
    upward_in_sensor,
)
from bumpymap.check.places import MetrePlaces, SlopeAt, near_place, smooth_velocity
from bumpymap.check.track import DrivenTrack, TrackStart, fit_track
from bumpymap.core import BadInputError, DriveLog, Floats, Mask, WheelTrack

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
    """One drive at the even samples of its inertial sensor; arrays (n,)."""

    name: str
    time: Floats
    """s, on the clock of the IMU."""
    pitch_rate: Floats
    """About the vehicle's own y axis, low-passed, rad/s."""
    speed: Floats
    """m/s."""
    easting: Floats
    """m; from the start where there are no positions."""
    northing: Floats
    reason: NDArray[np.uint8]
    """Number in ``LEFT_OUT``; 0: counts."""
    track: DrivenTrack
    hertz: float
    band_hz: float
    clock_offset_s: float
    """Time to add to the times of the positions, s; NaN if it cannot be determined."""
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


_WINDOW_S = 1.0
"""Time over which the shaking of a vehicle is measured, s (chosen)."""
_QUIET, _QUIET_SHARE = 3.0, 0.35
"""Most shaking of a standing vehicle: times that of its quietest second, and share of its usual one (chosen)."""
_SILENT_RADPS = 1e-5
"""Shaking below which no vehicle moves, rad/s (chosen)."""
_LEAST_S, _MARGIN_S = 2.0, 0.5
"""Shortest stop, and time off both its ends in which the vehicle still rocks, s (chosen)."""
_SLOW_MPS, _TURNING_MPS = 0.15, 0.03
"""Speeds below which a vehicle may stand, by positions, and above which its wheels move it, m/s (chosen)."""
_MOST_ERROR_MPS = 0.3
"""Largest error of the speed by positions that is assumed, m/s (chosen)."""


def rough_speed(imu: EvenImu, places: MetrePlaces | None, wheels: WheelTrack | None) -> tuple[Floats, float, bool]:
    """Return a rough speed, from wheels if their speed is known, else from positions, before the way is known.

    First at the samples of the IMU, (n,) m/s; NaN where not known; of wheels, that of the faster side. Second the speed
    below which a vehicle may stand, m/s. Third whether it is by wheels: what is slower stands unless it shakes.
    """
    if wheels is not None and np.isfinite(wheels.speed).sum() > 1:
        good = np.isfinite(wheels.speed)
        faster = np.abs(wheels.speed[good]) + 0.5 * np.abs(np.nan_to_num(wheels.difference[good]))
        return np.interp(imu.time, wheels.time[good], faster, left=np.nan, right=np.nan), _TURNING_MPS, True
    if places is None:
        return np.full(len(imu.time), np.nan), _SLOW_MPS, False
    even = np.arange(imu.time[0], imu.time[-1], 0.1)
    velocity, known = smooth_velocity(places, even, 1.0)
    speed = np.where(known, np.abs(velocity), np.nan)
    still = speed[np.isfinite(speed)]
    error = min(float(np.quantile(still, 0.02)) if len(still) else 0.0, _MOST_ERROR_MPS)
    return np.interp(imu.time, even, speed), _SLOW_MPS + 2.0 * error, False


def find_standing(imu: EvenImu, rough: tuple[Floats, float, bool], band_hz: float) -> Mask:
    """Return when the vehicle stood still; ``rough`` is from `rough_speed`."""
    speed, slowest, sure = rough
    rate = low_pass(imu.rate, imu.known, imu.hertz, band_hz)
    samples = round(_WINDOW_S * imu.hertz)
    mean = rolling_mean(rate, samples)
    spread = np.sqrt(np.maximum(rolling_mean(rate**2, samples) - mean**2, 0.0).sum(axis=1))
    known = imu.known & ~(speed > slowest)
    if not known.any():
        return np.zeros_like(known)
    moving = imu.known & (speed > 2.0 * slowest)
    usual = float(np.median(spread[moving])) if moving.any() else np.inf
    limit = min(_QUIET * float(np.quantile(spread[known], 0.02)), np.inf if sure else _QUIET_SHARE * usual)
    quiet = known & (spread <= max(limit, _SILENT_RADPS))
    standing = np.zeros_like(known)
    margin = round(_MARGIN_S * imu.hertz)
    for part in pieces(quiet):
        if part.stop - part.start >= _LEAST_S * imu.hertz:
            standing[part.start + margin : part.stop - margin] = True
    return standing


def rate_bias(imu: EvenImu, standing: Mask, upward: Floats) -> Floats:
    """Return what the gyroscope reads without turning: its mean at each stop, and straight lines between stops.

    Without a stop it is the mean of the whole record about level axes, since no vehicle keeps rolling over; about the
    upward axis it is then 0.

    ``upward`` (3,): unit vector in the axes of the sensor. Returns (n, 3): rad/s.
    """
    stops = pieces(standing)
    if not stops:
        whole = imu.rate[imu.known].mean(axis=0)
        return np.broadcast_to(whole - (whole @ upward) * upward, imu.rate.shape)
    middle = np.array([0.5 * (imu.time[part.start] + imu.time[part.stop - 1]) for part in stops])
    mean = np.stack([imu.rate[part].mean(axis=0) for part in stops])
    return np.stack([np.interp(imu.time, middle, mean[:, axis]) for axis in range(3)], axis=1)


_UNSURE_OFFSET_S, _SURE_OFFSET_S = 0.2, 0.05
"""Standard deviations of a clock offset, s: that is not reported, and that needs no turns to be sure (chosen)."""
_LEAST_CLOCK_M = 20.0
"""Shortest way from which an offset is reported, whatever the fit says of its error, m (chosen)."""
_UNSURE_DRIFT = 5e-5
"""Standard deviation of a clock drift that is not reported (chosen)."""
_BESIDE_GAP_S, _LEAST_FAR = 5.0, 0.2
"""The mounting rests on what is farther from gaps, s, unless that is less than this share of the drive (chosen)."""
_LEAST_WAY_M = 5.0
"""Shortest way of a drive, m: that of the shortest stretch."""
_LEAST_SPEED_MPS, _TURN_RADIUS_M = 0.1, 4.0
"""Parts that are slower, m/s, or turn more sharply, m, do not count (chosen)."""
_TURN_S = 1.0
"""Time over which yaw rates are averaged, s (chosen): bumps turn a vehicle to and fro."""


@dataclass(frozen=True, slots=True)
class _Rates:
    """Angular rates without bias, and what follows from them."""

    standing: Mask
    rate: Floats
    attitude: Rotation
    heading: Floats
    clock: tuple[float, bool, float]
    """From `fit_clock`."""
    force: NDArray[np.complex128] | None
    """Acceleration along the sensor's levelled axes, m/s2."""


def measure_drive(
    log: DriveLog, places: MetrePlaces | None, band_hz: float, slope_at: SlopeAt | None = None
) -> DriveMeasure:
    """Measure the pitch rate about the vehicle's own axis, the speed and the way of a drive.

    ``places``: positions of the log in metres; ``slope_at``: slopes of the ground, for the mounting of the sensor.
    Raises BadInputError: the log cannot be used: too slow, too short, without way, or in another unit.
    """
    if places is None and log.wheels is None:
        raise BadInputError(
            f"{log.name} has neither positions nor wheel speeds, so C_r, which is per metre, cannot be measured. "
            "Give a log with one of them, or name their columns with `columns`"
        )
    imu = even_imu(log.imu, log.name, band_hz)
    notes: list[str] = []
    rates = _rates(log, imu, places, band_hz)
    offset_s, is_sure, heading_0 = rates.clock
    start = TrackStart(offset_s, heading_0, rates.force, rough=imu.has_force)
    track = fit_track(imu, rates.heading, rates.standing, places, log.wheels, start)
    speed, step = np.abs(track.speed), track.time[1] - track.time[0]
    if float(speed[speed > _LEAST_SPEED_MPS].sum() * step) < _LEAST_WAY_M:
        raise BadInputError(
            f"{log.name}: the vehicle moves {speed.sum() * step:.1f} m in {len(speed) * step:.0f} s and never drives. "
            "Give a log of a drive"
        )
    mounting = _mounting(imu, rates, track, slope_at)
    if mounting is not None:  # again, with gravity and driving separated
        force = level_force(imu, mounting[0], mounting[2])
        begun = track.offset_s if places is not None else start.offset_s
        start = replace(start, offset_s=begun, force=force, rough=False, spread_s=track.offset_spread_s)
        track = fit_track(imu, rates.heading, rates.standing, places, log.wheels, start)
        mounting = _mounting(imu, rates, track, slope_at)
    if mounting is None:
        notes.append("there is no accelerometer, so how the sensor is mounted cannot be determined: no tilt is assumed")
    elif np.isnan(mounting[1][2]):
        notes.append(
            "the drive hardly turns or changes its speed, so how far the sensor is turned to the side is not known"
        )
    nan = float("nan")
    rotation, degrees, _ = mounting or (Rotation.identity(), (nan, nan, nan), None)
    vehicle = low_pass(rotation.apply(rates.rate), imu.known, imu.hertz, band_hz)
    sure = is_sure or track.offset_sd_s < _SURE_OFFSET_S
    driven_m = float(np.abs(track.speed).sum()) * (track.time[1] - track.time[0])
    reported = places is not None and sure and track.offset_sd_s < _UNSURE_OFFSET_S and driven_m > _LEAST_CLOCK_M
    return DriveMeasure(
        name=log.name,
        time=imu.time,
        pitch_rate=vehicle[:, 1],
        speed=np.interp(imu.time, track.time, track.speed),
        easting=np.interp(imu.time, track.time, track.easting),
        northing=np.interp(imu.time, track.time, track.northing),
        reason=_reasons(imu, vehicle, track, places),
        track=track,
        hertz=imu.hertz,
        band_hz=band_hz,
        clock_offset_s=track.offset_s if reported else float("nan"),
        clock_offset_sd_s=track.offset_sd_s if reported else float("nan"),
        clock_drift_ppm=1e6 * track.drift if reported and track.drift_sd < _UNSURE_DRIFT else float("nan"),
        mount_deg=degrees,
        floor_radps=float(np.abs(vehicle[rates.standing, 1]).mean()) if rates.standing.any() else float("nan"),
        notes=tuple(notes),
    )


def _rates(log: DriveLog, imu: EvenImu, places: MetrePlaces | None, band_hz: float) -> _Rates:
    standing = find_standing(imu, rough_speed(imu, places, log.wheels), band_hz)
    upward = np.median(imu.force[imu.known], axis=0) if imu.has_force else np.array([0.0, 0.0, 1.0])
    upward /= np.linalg.norm(upward)
    rate = (imu.rate - rate_bias(imu, standing, upward)) * imu.known[:, None]
    attitude = turned(rate, imu.hertz)
    up = upward_in_sensor(imu, attitude) if imu.has_force else attitude.inv().apply(np.tile(upward, (len(rate), 1)))
    heading = heading_of(attitude, up)
    clock = 0.0, False, 0.0
    if places is not None:
        clock = fit_clock(places, imu.time, heading, log.name)
        refuse_wrong_unit(places, clock[0], imu.time, heading, log.name)
    force = level_force(imu, levelling(up.mean(axis=0)), up) if imu.has_force else None
    return _Rates(standing, rate, attitude, heading, clock, force)


def _mounting(imu: EvenImu, rates: _Rates, track: DrivenTrack, slope_at: SlopeAt | None) -> Mounting | None:
    if not imu.has_force:
        return None
    easting, northing, speed, course = (
        np.interp(imu.time, track.time, part) for part in (track.easting, track.northing, track.speed, track.course)
    )
    along = left = np.full_like(speed, np.nan)
    if slope_at is not None:
        along, left = slope_at(easting, northing, course)
    yaw_rate = np.gradient(rates.heading) * imu.hertz
    # How the sensor turned in a gap is not known, and spoils what is upward for a while.
    share = rolling_mean(imu.known.astype(np.float64), round(2.0 * _BESIDE_GAP_S * imu.hertz))
    far = imu.known & (share > 1.0 - 1e-9)
    moving = (far if far.mean() > _LEAST_FAR else imu.known) & (np.abs(speed) > _LEAST_SPEED_MPS)
    motion = DrivenMotion(speed, np.gradient(speed) * imu.hertz + 1j * speed * yaw_rate, along, left)
    return find_mounting(imu, rates.attitude, motion, moving)


def _reasons(imu: EvenImu, vehicle: Floats, track: DrivenTrack, places: MetrePlaces | None) -> NDArray[np.uint8]:
    """Return for each sample why it does not count, as a number in ``LEFT_OUT``."""
    speed = np.interp(imu.time, track.time, track.speed)
    turning = np.abs(rolling_mean(vehicle[:, 2], round(_TURN_S * imu.hertz)))
    reason = np.full(len(imu.time), COUNTS, np.uint8)
    reason[turning * _TURN_RADIUS_M > np.abs(speed)] = LEFT_OUT.index("turning")
    reason[np.abs(speed) < _LEAST_SPEED_MPS] = LEFT_OUT.index("too slow")
    if places is not None:
        at = imu.time - track.offset_s
        reason[~near_place(at, places)] = LEFT_OUT.index("no position")
    reason[~imu.known] = LEFT_OUT.index("gap in the record of the IMU")
    return reason
