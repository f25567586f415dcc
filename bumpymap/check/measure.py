"""From the log of a drive to its pitch rate along the way: each step of the measurement in order."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from bumpymap.check.attitude import heading_of, levelling, turned, upward_in_sensor
from bumpymap.check.clock import ClockFit, fit_clock, refuse_wrong_unit
from bumpymap.check.drive_measure import COUNTS, LEFT_OUT, DriveMeasure
from bumpymap.check.mounting import DrivenMotion, Mounting, find_mounting, gravity_is_plausible, level_force
from bumpymap.check.places import MetrePlaces, near_place
from bumpymap.check.settings import ReadingSettings
from bumpymap.check.signals import EvenImu, even_imu, low_pass, rolling_mean
from bumpymap.check.standing import find_standing, rate_bias, rough_speed
from bumpymap.check.track import DrivenTrack, TrackStart, fit_track
from bumpymap.core import BadInputError, DriveLog

__all__ = ["SlopeAt", "measure_drive"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
SlopeAt = Callable[[Floats, Floats, Floats], tuple[Floats, Floats]]
"""Easting, northing [m] and course [rad] -> rise of the ground ahead and to the left over a metre, NaN if unknown."""

_UNSURE_OFFSET_S = 0.2
_SURE_OFFSET_S = 0.05
"""An offset that starts and stops tell so closely needs no turns."""
_LEAST_CLOCK_M = 20.0
"""A shorter way tells no offset, whatever the fit says of its error."""
_UNSURE_DRIFT = 5e-5
_BESIDE_GAP_S, _LEAST_FAR = 5.0, 0.2
"""The mounting of the sensor rests on what is so far from gaps, unless that is less than this share of the drive."""
_LEAST_WAY_M, _PARKED_MPS = 5.0, 0.1
_TURN_S = 1.0
"""Yaw rates are averaged over this: bumps turn a vehicle to and fro."""


@dataclass(frozen=True, slots=True)
class _Rates:
    """Angular rates without bias, and what follows from them."""

    standing: Mask
    rate: Floats
    attitude: Rotation
    heading: Floats
    clock: ClockFit
    force: NDArray[np.complex128] | None
    """Acceleration along the sensor's levelled axes, m/s2."""


def measure_drive(
    log: DriveLog,
    places: MetrePlaces | None,
    settings: ReadingSettings,
    slope_at: SlopeAt | None = None,
) -> DriveMeasure:
    """Measure the pitch rate about the vehicle's own axis, the speed and the way of a drive.

    Parameters
    ----------
    log : DriveLog
    places : MetrePlaces or None
        Positions of the log in metres.
    settings : ReadingSettings
    slope_at : function, optional
        Slopes of the ground, for the mounting of the sensor.

    Raises
    ------
    BadInputError
        The log cannot be used: too slow, too short, without way, or in another unit.
    """
    if places is None and log.wheels is None:
        raise BadInputError(
            f"{log.name} has neither positions nor wheel speeds, so C_r, which is per metre, cannot be measured. "
            "Give a log with one of them, or name their columns with `columns`"
        )
    imu = even_imu(log.imu, log.name, settings.band_hz)
    notes: list[str] = []
    imu = _usable_force(imu, notes)
    rates = _rates(log, imu, places, settings.band_hz)
    start = TrackStart(rates.clock.offset_s, rates.clock.heading_0, rates.force, rough=imu.has_force)
    track = fit_track(imu, rates.heading, rates.standing, places, log.wheels, start)
    _refuse_parked(log, track)
    mounting = _mounting(imu, rates, track, slope_at, settings)
    if mounting is not None:  # again, with gravity and driving told apart
        force = level_force(imu, mounting.rotation, mounting.upward)
        begun = track.offset_s if places is not None else start.offset_s
        start = replace(start, offset_s=begun, force=force, rough=False, spread_s=track.offset_spread_s)
        track = fit_track(imu, rates.heading, rates.standing, places, log.wheels, start)
        mounting = _mounting(imu, rates, track, slope_at, settings)
    if mounting is None:
        notes.append("there is no accelerometer, so how the sensor is mounted cannot be told: no tilt is assumed")
    elif np.isnan(mounting.degrees[2]):
        notes.append(
            "the drive hardly turns or changes its speed, so how far the sensor is turned to the side is not told"
        )
    rotation = Rotation.identity() if mounting is None else mounting.rotation
    vehicle = low_pass(rotation.apply(rates.rate), imu.known, imu.hertz, settings.band_hz)
    sure = rates.clock.sure or track.offset_sd_s < _SURE_OFFSET_S
    driven_m = float(np.abs(track.speed).sum()) * (track.time[1] - track.time[0])
    told = places is not None and sure and track.offset_sd_s < _UNSURE_OFFSET_S and driven_m > _LEAST_CLOCK_M
    return DriveMeasure(
        name=log.name,
        time=imu.time,
        pitch_rate=vehicle[:, 1],
        speed=np.interp(imu.time, track.time, track.speed),
        easting=np.interp(imu.time, track.time, track.easting),
        northing=np.interp(imu.time, track.time, track.northing),
        reason=_reasons(imu, vehicle, track, places, settings),
        track=track,
        hertz=imu.hertz,
        band_hz=settings.band_hz,
        clock_offset_s=track.offset_s if told else float("nan"),
        clock_offset_sd_s=track.offset_sd_s if told else float("nan"),
        clock_drift_ppm=1e6 * track.drift if told and track.drift_sd < _UNSURE_DRIFT else float("nan"),
        mount_deg=(float("nan"),) * 3 if mounting is None else mounting.degrees,
        floor_radps=_floor(vehicle[:, 1], rates.standing),
        notes=tuple(notes),
    )


def _usable_force(imu: EvenImu, notes: list[str]) -> EvenImu:
    if not imu.has_force or gravity_is_plausible(imu):
        return imu
    usual = float(np.median(np.linalg.norm(imu.force[imu.known], axis=1)))
    notes.append(
        f"the accelerometer reads {usual:.3g} where gravity is 9.81 m/s2, so it is not used; name its unit "
        "with `columns`"
    )
    return replace(imu, force=np.full_like(imu.force, np.nan))


def _rates(log: DriveLog, imu: EvenImu, places: MetrePlaces | None, band_hz: float) -> _Rates:
    standing = find_standing(imu, rough_speed(imu, places, log.wheels), band_hz)
    upward = np.median(imu.force[imu.known], axis=0) if imu.has_force else np.array([0.0, 0.0, 1.0])
    upward /= np.linalg.norm(upward)
    rate = (imu.rate - rate_bias(imu, standing, upward)) * imu.known[:, None]
    attitude = turned(rate, imu.hertz)
    none = np.zeros_like(rate)
    up = upward_in_sensor(imu, attitude, none) if imu.has_force else attitude.inv().apply(upward + none)
    heading = heading_of(attitude, up)
    clock = ClockFit(0.0, sure=False, heading_0=0.0)
    if places is not None:
        clock = fit_clock(places, imu.time, heading, log.name)
        refuse_wrong_unit(places, clock, imu.time, heading, log.name)
    force = level_force(imu, levelling(up.mean(axis=0)), up) if imu.has_force else None
    return _Rates(standing, rate, attitude, heading, clock, force)


def _refuse_parked(log: DriveLog, track: DrivenTrack) -> None:
    speed, step = np.abs(track.speed), track.time[1] - track.time[0]
    if float(speed[speed > _PARKED_MPS].sum() * step) < _LEAST_WAY_M:
        raise BadInputError(
            f"{log.name}: the vehicle moves {speed.sum() * step:.1f} m in {len(speed) * step:.0f} s and never drives. "
            "Give a log of a drive"
        )


def _mounting(
    imu: EvenImu, rates: _Rates, track: DrivenTrack, slope_at: SlopeAt | None, settings: ReadingSettings
) -> Mounting | None:
    if not imu.has_force:
        return None
    easting, northing, speed, course = (
        np.interp(imu.time, track.time, part) for part in (track.easting, track.northing, track.speed, track.course)
    )
    along = left = np.full_like(speed, np.nan)
    if slope_at is not None:
        along, left = slope_at(easting, northing, course)
    yaw_rate = np.gradient(rates.heading) * imu.hertz
    moving = _far_from_gaps(imu) & (np.abs(speed) > settings.least_speed_mps)
    motion = DrivenMotion(speed, yaw_rate, along, left)
    return find_mounting(imu, rates.rate, rates.attitude, motion, moving)


def _far_from_gaps(imu: EvenImu) -> Mask:
    """Return when the sensor has been known for a while: how it turned in a gap is not, and spoils what is upward."""
    share = rolling_mean(imu.known.astype(np.float64), round(2.0 * _BESIDE_GAP_S * imu.hertz))
    far = np.asarray(imu.known & (share > 1.0 - 1e-9), np.bool_)
    return far if far.mean() > _LEAST_FAR else imu.known


def _reasons(
    imu: EvenImu, vehicle: Floats, track: DrivenTrack, places: MetrePlaces | None, settings: ReadingSettings
) -> NDArray[np.uint8]:
    """Return for each sample why it does not count, as a number in ``LEFT_OUT``."""
    speed = np.interp(imu.time, track.time, track.speed)
    turning = np.abs(rolling_mean(vehicle[:, 2], round(_TURN_S * imu.hertz)))
    reason = np.full(len(imu.time), COUNTS, np.uint8)
    reason[turning * settings.turn_radius_m > np.abs(speed)] = LEFT_OUT.index("turning")
    reason[np.abs(speed) < settings.least_speed_mps] = LEFT_OUT.index("too slow")
    if places is not None:
        at = imu.time - track.offset_s
        reason[~near_place(at, places)] = LEFT_OUT.index("no position")
    reason[~imu.known] = LEFT_OUT.index("gap in the record of the IMU")
    return reason


def _floor(pitch_rate: Floats, standing: Mask) -> float:
    """Return the mean absolute pitch rate at standstill, rad/s; NaN without one."""
    return float(np.abs(pitch_rate[standing]).mean()) if standing.any() else float("nan")
