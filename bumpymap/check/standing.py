"""When the vehicle stood still, by how quiet the sensor is and how little the positions move."""

import numpy as np
from numpy.typing import NDArray

from bumpymap.check.signals import EvenImu, low_pass, pieces, rolling_mean

__all__ = ["find_standing", "rate_bias"]

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


def find_standing(imu: EvenImu, speed: Floats, speed_sd: float, band_hz: float) -> Mask:
    """Return when the vehicle stood still.

    Parameters
    ----------
    imu : EvenImu
    speed : float64 array (n,)
        Rough speed from positions or wheels, m/s; NaN where not known.
    speed_sd : float
        Error of it, m/s.
    band_hz : float

    Returns
    -------
    bool array (n,)
    """
    rate = low_pass(imu.rate, imu.known, imu.hertz, band_hz)
    samples = round(_WINDOW_S * imu.hertz)
    mean = rolling_mean(rate, samples)
    spread = np.sqrt(np.maximum(rolling_mean(rate**2, samples) - mean**2, 0.0).sum(axis=1))
    slow = ~(np.abs(speed) > _SLOW_MPS + 2.0 * speed_sd)
    known = imu.known & slow
    if not known.any():
        return np.zeros_like(known)
    moving = np.abs(np.nan_to_num(speed, nan=0.0)) > 2.0 * (_SLOW_MPS + speed_sd)
    usual = float(np.median(spread[imu.known & moving])) if (imu.known & moving).any() else np.inf
    limit = min(_QUIET * float(np.quantile(spread[known], 0.02)), _QUIET_SHARE * usual)
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
