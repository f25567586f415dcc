"""Poses over time, and the pose at any time between them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["LONGEST_GAP_S", "NEAREST_S", "SCAN_S", "PoseTrack", "rotations"]

NEAREST_S = 0.2
"""A time has a pose if one of the track is as near as this ..."""
LONGEST_GAP_S = 1.5
"""... or if it lies between two that are no farther apart than this: poses at 1 Hz are interpolated."""
_SPEED_S = 0.05
"""Beyond the ends, the motion is that over at least this long: two poses a moment apart tell no speed."""
SCAN_S = 2.0
"""Poses this long before and after a frame are kept for deskewing: no scan takes longer."""


@dataclass(frozen=True, slots=True)
class PoseTrack:
    """Poses of a sensor in the order of time."""

    times: NDArray[np.float64]
    """(n,) s, increasing."""
    poses: NDArray[np.float64]
    """(n, 4, 4) transforms from the sensor frame to the world frame, m."""

    def at(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the poses at given times, (m, 4, 4).

        The place is interpolated along a line, the rotation at constant speed (slerp). Before the first and after the
        last pose, the motion continues as between the nearest ones, see ``_SPEED_S``.
        """
        if len(self.times) == 1:
            return np.repeat(self.poses, len(times), axis=0)
        end = len(self.times) - 1
        before = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, end - 1)
        after = before + 1
        after[times < self.times[0]] = min(int(np.searchsorted(self.times, self.times[0] + _SPEED_S)), end)
        late = int(np.searchsorted(self.times, self.times[-1] - _SPEED_S, side="right")) - 1
        before[times > self.times[-1]] = max(late, 0)
        share = (times - self.times[before]) / (self.times[after] - self.times[before])
        first, second = self.poses[before], self.poses[after]
        poses = np.tile(np.eye(4), (len(times), 1, 1))
        poses[:, :3, 3] = first[:, :3, 3] + share[:, None] * (second[:, :3, 3] - first[:, :3, 3])
        between = first[:, :3, :3].transpose(0, 2, 1) @ second[:, :3, :3]
        poses[:, :3, :3] = first[:, :3, :3] @ rotations(_rotation_vectors(between) * share[:, None])
        return poses

    def covers(self, times: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which times have a pose, see ``NEAREST_S`` and ``LONGEST_GAP_S``."""
        after = np.searchsorted(self.times, times)
        left, right = np.clip(after - 1, 0, len(self.times) - 1), np.clip(after, 0, len(self.times) - 1)
        nearest = np.minimum(np.abs(times - self.times[left]), np.abs(times - self.times[right]))
        inside = (times >= self.times[0]) & (times <= self.times[-1])
        is_short = self.times[right] - self.times[left] <= LONGEST_GAP_S
        covered: NDArray[np.bool_] = (nearest <= NEAREST_S) | (inside & is_short)
        return covered

    def around(self, time: float, seconds: float) -> "PoseTrack":
        """Return the poses within so many seconds of a time, and one more on each side; times are relative to it."""
        first = max(int(np.searchsorted(self.times, time - seconds)) - 1, 0)
        last = int(np.searchsorted(self.times, time + seconds, side="right")) + 1
        return PoseTrack(self.times[first:last] - time, self.poses[first:last])


def rotations(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the matrices (n, 3, 3) of rotation vectors (n, 3), rad, by the formula of Rodrigues."""
    angle = np.linalg.norm(vectors, axis=1)
    x, y, z = (vectors / np.where(angle > 0.0, angle, 1.0)[:, None]).T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    sine, cosine = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    turned: NDArray[np.float64] = np.eye(3) + sine * cross + (1.0 - cosine) * (cross @ cross)
    return turned


def _rotation_vectors(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation vectors (n, 3), rad, of matrices (n, 3, 3); of half a turn, one of the two."""
    w, axis = _quaternions(matrices)
    length = np.linalg.norm(axis, axis=1)
    angle = 2.0 * np.arctan2(length, w)
    vectors: NDArray[np.float64] = axis * (angle / np.where(length > 0.0, length, 1.0))[:, None]
    return vectors


def _quaternions(matrices: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return w >= 0 (n,) and x, y, z (n, 3) of unit quaternions, exact for every rotation.

    Each row of the outer product of a quaternion with itself is linear in the matrix; the row with the largest diagonal
    is the quaternion, up to its length.
    """
    m = matrices
    trace = np.trace(m, axis1=1, axis2=2)
    outer = np.empty((len(m), 4, 4))
    outer[:, 0, 0] = 1.0 + trace
    for i in range(3):
        outer[:, i + 1, i + 1] = 1.0 + 2.0 * m[:, i, i] - trace
        j, k = (i + 1) % 3, (i + 2) % 3
        outer[:, 0, i + 1] = outer[:, i + 1, 0] = m[:, k, j] - m[:, j, k]
        outer[:, j + 1, k + 1] = outer[:, k + 1, j + 1] = m[:, j, k] + m[:, k, j]
    largest = np.argmax(np.diagonal(outer, axis1=1, axis2=2), axis=1)
    q = outer[np.arange(len(m)), largest]
    q *= np.where(q[:, :1] < 0.0, -1.0, 1.0) / np.linalg.norm(q, axis=1, keepdims=True)
    return q[:, 0], q[:, 1:]
