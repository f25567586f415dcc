"""Attitudes of a sensor: from angles to quaternions, and from quaternions to angular rates."""

import numpy as np

from bumpymap.readers.drives.signals import Floats, Signal

__all__ = ["body_rates", "quaternions_of_angles"]

_LONGEST_STEP_S = 0.5
"""Between attitudes further apart, nothing is known about the rate."""


def quaternions_of_angles(roll: Floats, pitch: Floats, yaw: Floats) -> Floats:
    """Return quaternions, (n, 4) x, y, z, w, of angles, (n,) rad.

    They turn by yaw about z, then by pitch about the new y, then by roll about the new x.
    """
    cr, sr, cp, sp, cy, sy = (f(0.5 * angle) for angle in (roll, pitch, yaw) for f in (np.cos, np.sin))
    return np.stack(
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ],
        axis=1,
    )


def body_rates(attitude: Signal) -> Signal:
    """Return the angular rates about the sensor's own axes between each two attitudes that follow each other.

    Parameters
    ----------
    attitude : Signal
        Quaternions (n, 4), x, y, z, w, of any length but 0.

    Returns
    -------
    Signal
        Rates (m, 3), rad/s, constant rotation being assumed from one attitude to the next, in the middle of both. None
        across gaps of more than half a second.
    """
    q = attitude.values / np.linalg.norm(attitude.values, axis=1, keepdims=True)
    step = np.diff(attitude.time)
    before, after = q[:-1], q[1:]
    # The turn from one to the next in the sensor's axes: conjugate of the first times the second.
    vector = before[:, 3:] * after[:, :3] - after[:, 3:] * before[:, :3] - np.cross(before[:, :3], after[:, :3])
    scalar = (before * after).sum(axis=1, keepdims=True)
    vector, scalar = np.where(scalar < 0.0, -vector, vector), np.abs(scalar)  # q and -q are the same attitude
    sine = np.linalg.norm(vector, axis=1, keepdims=True)
    # angle / sine tends to 2 for no turn at all
    factor = np.where(sine > 1e-9, 2.0 * np.arctan2(sine, scalar) / np.maximum(sine, 1e-9), 2.0)
    near = step <= _LONGEST_STEP_S
    rates = vector * factor / step[:, None]
    return Signal((attitude.time[:-1] + 0.5 * step)[near], rates[near])
