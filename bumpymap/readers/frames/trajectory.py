"""Transforms between the coordinate frames of a robot over time, as the messages of a bag give them."""

from array import array
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError

__all__ = ["FIXED_FRAMES", "FrameTree", "Trajectory", "frame_name"]

FIXED_FRAMES = ("map", "odom")
"""Coordinate frames that a drive can be mapped in; the first one that is known is taken (REP-105)."""
_LONGEST_GAP_NS = 1_000_000_000
"""Between transforms farther apart than this, nothing is interpolated."""


def frame_name(name: str) -> str:
    """Return the name of a coordinate frame without the slash that older drivers put before it."""
    return name.strip("/")


class Trajectory:
    """The transform from one coordinate frame to another over time; 64 bytes a sample."""

    def __init__(self) -> None:
        self._times = array("q")
        self._rows = array("d")

    def add(self, stamp: Any, place: Any, turn: Any) -> None:
        """Add a sample: time (``sec``, ``nanosec``), place (``x`` to ``z``, m) and quaternion (``x`` to ``w``)."""
        self._times.append(stamp.sec * 1_000_000_000 + stamp.nanosec)
        self._rows.extend((place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w))

    def at(self, times_ns: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Interpolate: the place linearly, the turn along the shortest arc.

        Parameters
        ----------
        times_ns : (n,) int64

        Returns
        -------
        (n, 4, 4) float64
            Transforms.
        (n,) bool
            Whether each is known: its time is that of a sample, or lies between two that are at most 1 s apart.

        Raises
        ------
        BadInputError
            A sample is not finite, or its quaternion has no length.
        """
        times, rows = np.frombuffer(self._times, np.int64), np.frombuffer(self._rows, np.float64).reshape(-1, 7)
        length = np.linalg.norm(rows[:, 3:], axis=1)
        if not (np.isfinite(rows).all() and (length > 0.5).all()):
            raise BadInputError("it holds a transform that is not finite, or a quaternion whose length is not 1")
        order = np.argsort(times, kind="stable")
        order = order[np.append(np.diff(times[order]) > 0, True)]  # of equal times the last one counts
        times, rows = times[order], rows[order]
        after = np.clip(np.searchsorted(times, times_ns), 0, len(times) - 1)
        before = np.where(times[after] > times_ns, np.maximum(after - 1, 0), after)
        gap = times[after] - times[before]
        share = np.divide(times_ns - times[before], gap, out=np.zeros(len(times_ns)), where=gap > 0)
        known = (times[before] <= times_ns) & (times_ns <= times[after]) & (gap <= _LONGEST_GAP_NS)
        place = rows[before, :3] + share[:, None] * (rows[after, :3] - rows[before, :3])
        return _matrices(place, _slerp(rows[before, 3:], rows[after, 3:], share)), known


class FrameTree:
    """The coordinate frames of ``/tf`` and ``/tf_static``, each with its parent."""

    def __init__(self) -> None:
        self._parent: dict[str, str] = {}
        self._static: dict[str, Trajectory] = {}
        self._moving: dict[str, Trajectory] = {}

    def add(self, message: Any, *, static: bool) -> None:
        """Add the transforms of a message ``tf2_msgs/TFMessage``."""
        for each in message.transforms:
            child = frame_name(each.child_frame_id)
            self._parent[child] = frame_name(each.header.frame_id)
            if static:
                self._static[child] = Trajectory()  # the last one counts
            samples = self._static if static else self._moving
            part = each.transform
            samples.setdefault(child, Trajectory()).add(each.header.stamp, part.translation, part.rotation)

    def ancestors(self, frame: str) -> list[str]:
        """Return a frame, its parent, and so on up to the root."""
        found = [frame]
        while (parent := self._parent.get(found[-1])) is not None and parent not in found:
            found.append(parent)
        return found

    def mount(self, base: str, sensor: str) -> NDArray[np.float64] | None:
        """Return the fixed transform (4, 4) from a sensor to the base; None if it is unknown or the sensor moves."""
        if base == sensor:
            return np.eye(4)
        up, down = self.ancestors(sensor), self.ancestors(base)
        common = next((frame for frame in up if frame in down), None)
        if common is None:
            return None
        ways = [way[: way.index(common)] for way in (up, down)]
        if any(frame in self._moving for way in ways for frame in way):
            return None
        ends = [_product([self._static[frame].at(np.zeros(1, np.int64))[0] for frame in way])[0] for way in ways]
        pose: NDArray[np.float64] = np.linalg.inv(ends[1]) @ ends[0]
        return pose

    def poses(self, sensor: str, times_ns: NDArray[np.int64]) -> tuple[str, NDArray[np.float64], NDArray[np.bool_]]:
        """Return the pose of a sensor in a fixed frame.

        Returns
        -------
        str
            Name of the fixed frame; empty if the sensor is not connected with one.
        (n, 4, 4) float64
        (n,) bool
            Whether each pose is known.
        """
        chain = self.ancestors(sensor)
        fixed = next((frame for frame in FIXED_FRAMES if frame in chain[1:]), "")
        if not fixed:
            return "", np.tile(np.eye(4), (len(times_ns), 1, 1)), np.zeros(len(times_ns), np.bool_)
        known, steps = np.ones(len(times_ns), np.bool_), []
        for frame in chain[: chain.index(fixed)]:
            if frame in self._moving:
                step, there = self._moving[frame].at(times_ns)
                known &= there
            else:
                step = self._static[frame].at(np.zeros(1, np.int64))[0]
            steps.append(step)
        return fixed, np.broadcast_to(_product(steps), (len(times_ns), 4, 4)), known


def _product(steps: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Multiply transforms (n or 1, 4, 4), each from a frame to its parent, beginning with the lowest frame."""
    product = np.eye(4)[None]
    for step in steps:
        product = step @ product
    return product


def _slerp(first: NDArray[np.float64], last: NDArray[np.float64], share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Interpolate between quaternions (n, 4) along the shortest arc; they need not have length 1."""
    first, last = (turn / np.linalg.norm(turn, axis=1, keepdims=True) for turn in (first, last))
    cosine = np.sum(first * last, axis=1)
    last, cosine = np.where(cosine[:, None] < 0.0, -last, last), np.minimum(np.abs(cosine), 1.0)
    angle = np.arccos(cosine)
    sine = np.sin(angle)
    wide = sine > 1e-6  # nearly equal quaternions are interpolated linearly
    with np.errstate(invalid="ignore", divide="ignore"):
        weights = [np.where(wide, np.sin(part * angle) / sine, part) for part in (1.0 - share, share)]
    return weights[0][:, None] * first + weights[1][:, None] * last


def _matrices(place: NDArray[np.float64], turn: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y, z, w = (turn / np.linalg.norm(turn, axis=1, keepdims=True)).T
    poses = np.tile(np.eye(4), (len(place), 1, 1))
    poses[:, :3, 3] = place
    poses[:, 0, :3] = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], axis=1)
    poses[:, 1, :3] = np.stack([2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)], axis=1)
    poses[:, 2, :3] = np.stack([2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)], axis=1)
    return poses
