"""What the sensors of a drive say from knot to knot of its way."""

import numpy as np
from numpy.typing import NDArray

from bumpymap.check.signals import EvenImu
from bumpymap.check.track_system import Knots
from bumpymap.core import WheelTrack

__all__ = ["drive_knots"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_KNOT_S = 0.25
_MOST_KNOTS = 20_000
_BESIDE_STOP_S = 2.5


def drive_knots(
    imu: EvenImu, heading: Floats, standing: Mask, wheels: WheelTrack | None, force: NDArray[np.complex128] | None
) -> Knots:
    """Return what the sensors say of a drive, four times a second.

    Parameters
    ----------
    imu : EvenImu
    heading : float64 array (n,)
        By the gyroscope, rad.
    standing : bool array (n,)
    wheels : WheelTrack or None
    force : complex128 array (n,) or None
        Acceleration along the sensor's levelled axes, x + i y, m/s2.
    """
    seconds = imu.time[-1] - imu.time[0]
    count = int(np.clip(seconds / _KNOT_S, 8, _MOST_KNOTS)) + 1
    time = np.linspace(imu.time[0], imu.time[-1], count)
    direction = np.exp(1j * heading)
    total = np.concatenate([[0.0], np.cumsum(0.5 * (direction[1:] + direction[:-1]))]) / imu.hertz
    steps = np.diff(np.interp(time, imu.time, total.real) + 1j * np.interp(time, imu.time, total.imag))
    nearest = np.clip(np.round((time - imu.time[0]) * imu.hertz).astype(np.int64), 0, len(imu.time) - 1)
    stands = standing[nearest]
    beside = round(_BESIDE_STOP_S / (time[1] - time[0]))
    near = np.convolve(stands, np.ones(2 * beside + 1), mode="same") > 0
    gap = ~imu.known[nearest]
    changing = (near & ~stands)[1:] | (near & ~stands)[:-1] | gap[1:] | gap[:-1]
    speed = np.full(count, np.nan)
    if wheels is not None:
        speed = _wheel_speed(wheels, time)
    turned = np.interp(time, imu.time, heading)
    gained = np.full(count - 1, np.nan + 0j)
    if force is not None:
        felt = np.concatenate([[0.0], np.cumsum(0.5 * (force[1:] + force[:-1]))]) / imu.hertz
        gained = np.where(
            gap[1:] | gap[:-1],
            np.nan,
            np.diff(np.interp(time, imu.time, felt.real) + 1j * np.interp(time, imu.time, felt.imag)),
        )
    return Knots(time, steps, turned, gained, stands, changing, speed)


def _wheel_speed(wheels: WheelTrack, time: Floats) -> Floats:
    good = np.isfinite(wheels.speed) & np.isfinite(wheels.time)
    if good.sum() < 2:
        return np.full(len(time), np.nan)
    at, value = wheels.time[good], wheels.speed[good]
    speed = np.interp(time, at, value, left=np.nan, right=np.nan)
    gap = np.diff(at, prepend=-np.inf, append=np.inf)[np.searchsorted(at, time)]
    return np.where(gap > max(1.0, 3.0 * float(np.median(np.diff(at)))), np.nan, speed)
