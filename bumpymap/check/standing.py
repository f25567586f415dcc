"""When the vehicle stood still, by how quiet the sensor is and how little the positions move."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.check.places import MetrePlaces, smooth_velocity
from bumpymap.check.signals import EvenImu, low_pass, pieces, rolling_mean
from bumpymap.core import WheelTrack

__all__ = ["RoughSpeed", "find_standing", "rate_bias", "rough_speed"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_WINDOW_S = 1.0
_QUIET = 3.0
"""A standing vehicle shakes at most this many times as much as in its quietest second."""
_QUIET_SHARE = 0.35
"""And at most this share of what it shakes in the middle of the record."""
_SILENT_RADPS = 1e-5
"""No moving vehicle is quieter."""
_LEAST_S = 2.0
_MARGIN_S = 0.5
"""Taken off at both ends of a stop: the vehicle still rocks."""
_SLOW_MPS = 0.15
"""A vehicle whose positions move less than this may stand."""
_TURNING_MPS = 0.03
"""Wheels that turn faster move the vehicle, however quiet the ground is."""
_MOST_ERROR_MPS = 0.3
"""Of the speed by positions."""


@dataclass(frozen=True, slots=True)
class RoughSpeed:
    """How fast the vehicle may have moved, before its way is known."""

    value: Floats
    """(n,) at the samples of the IMU, m/s; NaN where not known. Of wheels, that of the faster side."""
    slow: float
    """A vehicle that is slower may stand, m/s."""
    sure: bool = False
    """By wheels: a vehicle that is slower stands unless it shakes."""


def rough_speed(imu: EvenImu, places: MetrePlaces | None, wheels: WheelTrack | None) -> RoughSpeed:
    """Return a rough speed, from wheels if their speed is known, else from positions."""
    if wheels is not None and np.isfinite(wheels.speed).sum() > 1:
        good = np.isfinite(wheels.speed)
        faster = np.abs(wheels.speed[good]) + 0.5 * np.abs(np.nan_to_num(wheels.difference[good]))
        return RoughSpeed(
            np.interp(imu.time, wheels.time[good], faster, left=np.nan, right=np.nan), _TURNING_MPS, sure=True
        )
    if places is None:
        return RoughSpeed(np.full(len(imu.time), np.nan), _SLOW_MPS)
    even = np.arange(imu.time[0], imu.time[-1], 0.1)
    velocity, known = smooth_velocity(places, even, 1.0)
    speed = np.where(known, np.abs(velocity), np.nan)
    still = speed[np.isfinite(speed)]
    error = min(float(np.quantile(still, 0.02)) if len(still) else 0.0, _MOST_ERROR_MPS)
    return RoughSpeed(np.interp(imu.time, even, speed), _SLOW_MPS + 2.0 * error)


def find_standing(imu: EvenImu, speed: RoughSpeed, band_hz: float) -> Mask:
    """Return when the vehicle stood still.

    Parameters
    ----------
    imu : EvenImu
    speed : RoughSpeed
        From positions or wheels.
    band_hz : float

    Returns
    -------
    bool array (n,)
    """
    rate = low_pass(imu.rate, imu.known, imu.hertz, band_hz)
    samples = round(_WINDOW_S * imu.hertz)
    mean = rolling_mean(rate, samples)
    spread = np.sqrt(np.maximum(rolling_mean(rate**2, samples) - mean**2, 0.0).sum(axis=1))
    slow = ~(speed.value > speed.slow)
    known = imu.known & slow
    if not known.any():
        return np.zeros_like(known)
    moving = speed.value > 2.0 * speed.slow
    usual = float(np.median(spread[imu.known & moving])) if (imu.known & moving).any() else np.inf
    limit = min(_QUIET * float(np.quantile(spread[known], 0.02)), np.inf if speed.sure else _QUIET_SHARE * usual)
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

    Parameters
    ----------
    imu : EvenImu
    standing : bool array (n,)
    upward : float64 array (3,)
        Unit vector in the axes of the sensor.

    Returns
    -------
    float64 array (n, 3)
        rad/s.
    """
    stops = pieces(standing)
    if not stops:
        whole = imu.rate[imu.known].mean(axis=0)
        return np.broadcast_to(whole - (whole @ upward) * upward, imu.rate.shape)
    middle = np.array([0.5 * (imu.time[part.start] + imu.time[part.stop - 1]) for part in stops])
    mean = np.stack([imu.rate[part].mean(axis=0) for part in stops])
    return np.stack([np.interp(imu.time, middle, mean[:, axis]) for axis in range(3)], axis=1)
