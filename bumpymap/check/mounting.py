"""How the inertial sensor sits in the vehicle: roll and pitch by gravity, yaw by how the vehicle speeds up and turns.

Gravity is taken along the whole way, not at one stop, because a vehicle stands on a slope as readily as on level
ground: the mean slope of the way is known from a map, and small without one. Yaw: the acceleration along the
vehicle is that of its speed, and across it speed times yaw rate; which way they point in the sensor's axes tells how it is turned.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from bumpymap.check.attitude import levelling, upward_in_sensor
from bumpymap.check.signals import EvenImu, low_pass

__all__ = ["DrivenMotion", "Mounting", "find_mounting", "gravity_is_plausible", "level_force"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_MOTION_HZ = 0.5
"""Accelerations of driving are slower; those of bumps are faster."""
_LEAST_ACCELERATION = 1.0
"""m/s2 sqrt(s): with less driving the yaw cannot be told."""
_MOST_YAW_SD = np.radians(15.0)
_GRAVITY = (7.0, 12.5)
"""m/s2: what an accelerometer at rest may read."""


@dataclass(frozen=True, slots=True)
class DrivenMotion:
    """How the vehicle moved, at the samples of the sensor."""

    speed: Floats
    """(n,) m/s."""
    yaw_rate: Floats
    """(n,) rad/s, positive to the left."""
    along_slope: Floats
    """(n,) rise of the ground ahead over a metre, by the map; NaN where not known."""
    left_slope: Floats
    """(n,) rise of it to the left."""


@dataclass(frozen=True, slots=True)
class Mounting:
    """How the sensor sits in the vehicle."""

    rotation: Rotation
    """Turns vectors of the sensor's axes into those of the vehicle: x ahead, y left, z up."""
    degrees: tuple[float, float, float]
    """Roll, pitch and yaw, NaN where not told."""
    yaw_sd: float
    """Standard deviation of the yaw, degrees."""
    upward: Floats
    """(n, 3) upward direction in the sensor's axes, with the motion of the vehicle taken into account."""


def find_mounting(imu: EvenImu, rate: Floats, attitude: Rotation, motion: DrivenMotion, moving: Mask) -> Mounting:
    """Find how the sensor sits in the vehicle.

    Parameters
    ----------
    imu : EvenImu
        With an accelerometer.
    rate : float64 array (n, 3)
        Angular rates without bias, in the sensor's axes, rad/s.
    attitude : Rotation of n
    motion : DrivenMotion
    moving : bool array (n,)
    """
    upward = upward_in_sensor(imu, attitude, np.zeros_like(rate))
    rotation = levelling(upward[moving].mean(axis=0))
    yaw, yaw_sd = 0.0, float("nan")
    for _ in range(3):
        yaw, yaw_sd = _yaw(imu, rotation, upward, motion, moving)
        if not yaw_sd <= _MOST_YAW_SD:
            yaw = 0.0
        aligned = Rotation.from_euler("z", yaw) * rotation
        upward = upward_in_sensor(imu, attitude, _motion_in_sensor(motion, aligned, imu.hertz))
        rotation = _level(aligned.apply(upward), motion, moving) * aligned
    yaw_found = yaw_sd <= _MOST_YAW_SD
    roll, pitch, turn = (float(angle) for angle in rotation.as_euler("ZYX", degrees=True)[::-1])
    return Mounting(rotation, (roll, pitch, turn if yaw_found else float("nan")), float(np.degrees(yaw_sd)), upward)


def level_force(imu: EvenImu, rotation: Rotation, upward: Floats) -> NDArray[np.complex128]:
    """Return the acceleration along the sensor's levelled axes, x + i y, (n,) m/s2; 0 in gaps.

    Parameters
    ----------
    imu : EvenImu
    rotation : Rotation
        Levels the sensor.
    upward : float64 array (n, 3)
        Unit vectors in the sensor's axes.
    """
    level, up = rotation.apply(imu.force), rotation.apply(upward)
    level -= up * (level * up).sum(axis=1, keepdims=True)
    return np.asarray((level[:, 0] + 1j * level[:, 1]) * imu.known)


def _motion_in_sensor(motion: DrivenMotion, rotation: Rotation, hertz: float) -> Floats:
    """Return the acceleration of the vehicle in the sensor's axes, (n, 3) m/s2."""
    ahead = np.gradient(motion.speed) * hertz
    return np.asarray(rotation.inv().apply(np.stack([ahead, motion.speed * motion.yaw_rate, 0.0 * ahead], axis=1)))


def _yaw(imu: EvenImu, rotation: Rotation, upward: Floats, motion: DrivenMotion, moving: Mask) -> tuple[float, float]:
    """Return the yaw of the levelled sensor in the vehicle and its standard deviation, rad."""
    felt = _band(level_force(imu, rotation, upward), imu.hertz)
    speeding = np.gradient(motion.speed) * imu.hertz
    driven = _band(speeding + 1j * motion.speed * motion.yaw_rate, imu.hertz)
    use = moving & imu.known
    power = float((np.abs(driven[use]) ** 2).sum()) / imu.hertz
    if power < _LEAST_ACCELERATION**2:
        return 0.0, float("nan")
    both = (driven * felt.conj())[use].sum() / imu.hertz
    yaw = float(np.angle(both))
    across = (felt * np.exp(1j * yaw) * driven.conj()).imag[use]
    block = round(4.0 * imu.hertz)
    sums = np.add.reduceat(across, np.arange(0, len(across), block)) / imu.hertz
    return yaw, float(np.sqrt((sums**2).sum()) / power)


def _band(values: NDArray[np.complex128], hertz: float) -> NDArray[np.complex128]:
    """Keep what lies between the slow errors of the levelling and the bumps."""
    everywhere = np.ones(len(values), np.bool_)
    both = np.stack([values.real, values.imag], axis=1)
    fast = low_pass(both, everywhere, hertz, _MOTION_HZ)
    fast -= low_pass(fast, everywhere, hertz, 0.02)
    return np.asarray(fast[:, 0] + 1j * fast[:, 1])


def _level(upward: Floats, motion: DrivenMotion, moving: Mask) -> Rotation:
    """Return the small rotation after which the vehicle is on average as tilted as the ground of its way."""
    norm = np.sqrt(1.0 + motion.along_slope**2 + motion.left_slope**2)
    tilted = np.stack([motion.along_slope / norm, motion.left_slope / norm], axis=1)
    known = np.asarray(np.isfinite(tilted).all(axis=1), np.bool_)
    if not (known & moving).any():
        known, tilted = np.ones_like(known), np.zeros_like(tilted)
    tilted = np.where(known[:, None], tilted, 0.0)
    weight = np.abs(motion.speed) * (moving & known)
    off = ((upward[:, :2] - tilted) * weight[:, None]).sum(axis=0) / max(weight.sum(), 1e-9)
    return Rotation.from_rotvec([off[1], -off[0], 0.0])


def gravity_is_plausible(imu: EvenImu) -> bool:
    """Return whether the accelerometer reads gravity in m/s2."""
    usual = float(np.median(np.linalg.norm(imu.force[imu.known], axis=1)))
    return _GRAVITY[0] < usual < _GRAVITY[1]
