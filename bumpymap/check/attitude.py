"""How the sensor turned: its attitude from the angular rates, and which way is up in its axes."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from bumpymap.check.signals import EvenImu, low_pass

__all__ = ["heading_of", "levelling", "turned", "upward_in_sensor"]

Floats = NDArray[np.float64]

_UP_HZ = 0.02
"""Attitude by rates drifts more slowly than this; accelerations of a vehicle change faster."""


def turned(rate: Floats, hertz: float) -> Rotation:
    """Return the attitude of the sensor at each sample, relative to the first, from its rates.

    Parameters
    ----------
    rate : float64 array (n, 3)
        In the sensor's own axes, rad/s, without bias.
    hertz : float

    Returns
    -------
    Rotation of n
        Turns vectors of the sensor's axes into those that it had at the first sample.
    """
    step = 0.5 * (rate[1:] + rate[:-1]) / hertz
    total = Rotation.from_rotvec(np.concatenate([np.zeros((1, 3)), step]))
    reach = 1
    while reach < len(rate):  # prefix products by doubling
        quaternions = total.as_quat()
        quaternions[reach:] = (total[:-reach] * total[reach:]).as_quat()
        total = Rotation.from_quat(quaternions)
        reach *= 2
    return total


def upward_in_sensor(imu: EvenImu, attitude: Rotation, motion: Floats) -> Floats:
    """Return the upward direction in the sensor's axes: by rates in the short run, by gravity in the long run.

    Parameters
    ----------
    imu : EvenImu
    attitude : Rotation of n
        From `turned`.
    motion : float64 array (n, 3)
        Acceleration of the vehicle in the sensor's axes as far as known, taken off, m/s2.

    Returns
    -------
    float64 array (n, 3)
        Unit vectors.
    """
    fixed = attitude.apply(imu.force - motion)
    everywhere = np.ones_like(imu.known)
    fixed[~imu.known] = np.median(fixed[imu.known], axis=0)
    slow = low_pass(fixed, everywhere, imu.hertz, _UP_HZ)
    slow /= np.maximum(np.linalg.norm(slow, axis=1, keepdims=True), 1e-9)
    return np.asarray(attitude.inv().apply(slow))


def levelling(upward: Floats) -> Rotation:
    """Return the smallest rotation that turns a direction of the sensor's axes into z.

    Parameters
    ----------
    upward : float64 array (3,)
    """
    unit = upward / np.linalg.norm(upward)
    axis = np.cross(unit, [0.0, 0.0, 1.0])
    sine, cosine = float(np.linalg.norm(axis)), float(unit[2])
    if sine < 1e-9:
        return Rotation.identity() if cosine > 0 else Rotation.from_rotvec([np.pi, 0.0, 0.0])
    return Rotation.from_rotvec(axis / sine * np.arctan2(sine, cosine))


def heading_of(attitude: Rotation, upward: Floats) -> Floats:
    """Return the heading of the sensor's levelled x axis, rad, positive to the left; any zero.

    It is the direction of that axis seen from above, not the sum of rates about the vertical: a vehicle that rolls
    while it is pitched sums to a turn that it does not make.

    Parameters
    ----------
    attitude : Rotation of n
        From `turned`.
    upward : float64 array (n, 3)
        Unit vectors in the sensor's axes.
    """
    ahead = levelling(upward.mean(axis=0)).inv().apply([1.0, 0.0, 0.0])
    fixed = levelling(attitude.apply(upward).mean(axis=0)).apply(attitude.apply(ahead))
    return np.asarray(np.unwrap(np.arctan2(fixed[:, 1], fixed[:, 0])))
