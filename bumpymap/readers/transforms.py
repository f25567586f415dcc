"""Transforms between coordinate frames over time, as the messages of a bag tell them."""

from array import array
from collections.abc import Sequence
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, PoseTrack

ROUNDING = 0.02
"""Tolerance of rotation matrices and quaternions: some files have only three decimals."""

FIXED_FRAMES = ("map", "odom")
"""Coordinate frames that a drive can be mapped in; the first one that is known is taken (REP-105)."""


def frame_name(name: str) -> str:
    """Return the name of a coordinate frame without the slash that older drivers put before it."""
    return name.strip("/")


def seconds_since(origin_ns: int, times_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return times in seconds after an origin; equal times stay equal."""
    return np.asarray((times_ns - origin_ns) * np.float64(1e-9))


class Trajectory:
    """The transform from one coordinate frame to another over time; 64 bytes a sample.

    ``name``: for messages.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._times = array("q")
        self._rows = array("d")

    def add(self, stamp: Any, place: Any, turn: Any) -> None:
        """Add a sample: time (``sec``, ``nanosec``), place (``x`` to ``z``, m) and quaternion (``x`` to ``w``)."""
        self._times.append(stamp.sec * 1_000_000_000 + stamp.nanosec)
        self._rows.extend((place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w))

    def track(self, origin_ns: int) -> PoseTrack:
        """Return the samples in the order of time, in seconds after an origin; of equal times the last one counts.

        Raises BadInputError: a sample is not finite, or the length of its quaternion is not 1.
        """
        times, rows = np.frombuffer(self._times, np.int64), np.frombuffer(self._rows, np.float64).reshape(-1, 7)
        if not np.isfinite(rows).all():
            raise BadInputError(f"{self._name} holds a transform that is not finite")
        order = np.argsort(times, kind="stable")
        order = order[np.append(np.diff(times[order]) > 0, True)]
        return PoseTrack(seconds_since(origin_ns, times[order]), from_quaternions(self._name, rows[order]))


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
                self._static.pop(child, None)  # the last one counts
            samples = self._static if static else self._moving
            part = each.transform
            trajectory = samples.setdefault(child, Trajectory(f"tf of {child}"))
            trajectory.add(each.header.stamp, part.translation, part.rotation)

    def mount(self, base: str, sensor: str) -> NDArray[np.float64] | None:
        """Return the fixed transform (4, 4) from a sensor to the base; None if it is unknown or the sensor moves."""
        if base == sensor:
            return np.eye(4)
        up, down = self._ancestors(sensor), self._ancestors(base)
        common = next((frame for frame in up if frame in down), None)
        if common is None:
            return None
        ways = [way[: way.index(common)] for way in (up, down)]
        if any(frame in self._moving for way in ways for frame in way):
            return None
        ends = [_product([self._fixed(frame) for frame in way]) for way in ways]
        return np.asarray(np.linalg.inv(ends[1]) @ ends[0])

    def track(self, sensor: str, origin_ns: int, times: NDArray[np.float64]) -> PoseTrack | None:
        """Return the poses of a sensor in a fixed frame.

        ``sensor``: its coordinate frame; ``times`` (n,) float64: times at which poses are wanted, s
        after the origin. Returns them at these times and at those of all transforms between, as far as
        all of them are known. None if the sensor is not connected with a fixed frame, or at no such
        time.
        """
        chain, fixed = self._ancestors(sensor), self.fixed_frame(sensor)
        if fixed is None:
            return None
        links = chain[: chain.index(fixed)]
        moving = {frame: self._moving[frame].track(origin_ns) for frame in links if frame in self._moving}
        times = np.unique(np.concatenate([times, *(track.times for track in moving.values())]))
        for track in moving.values():
            times = times[track.covers(times)]
        if not len(times):
            return None
        steps = [moving[frame].at(times) if frame in moving else self._fixed(frame) for frame in links]
        return PoseTrack(times, np.broadcast_to(_product(steps), (len(times), 4, 4)))

    def fixed_frame(self, sensor: str) -> str | None:
        """Return the fixed frame that a sensor is connected with; None without one."""
        return next((frame for frame in FIXED_FRAMES if frame in self._ancestors(sensor)[1:]), None)

    def _ancestors(self, frame: str) -> list[str]:
        """Return a frame, its parent, and so on up to the root."""
        found = [frame]
        while (parent := self._parent.get(found[-1])) is not None and parent not in found:
            found.append(parent)
        return found

    def _fixed(self, frame: str) -> NDArray[np.float64]:
        """Return the fixed transform (4, 4) from a frame to its parent."""
        return np.asarray(self._static[frame].track(0).poses[-1])


def _product(steps: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Multiply transforms, (4, 4) or (n, 4, 4), each from a frame to its parent, beginning with the lowest frame."""
    return reduce(lambda product, step: step @ product, steps, np.eye(4))


def from_quaternions(path: Path | str, table: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the transforms (n, 4, 4) of places (m) and quaternions, (n, 7): x, y, z, qx, qy, qz, qw.

    Raises BadInputError: a quaternion is invalid; ``path`` says where the poses are from.
    """
    length = np.linalg.norm(table[:, 3:], axis=1)
    far = np.abs(length - 1.0)
    refuse_poses(path, np.isnan(far) | (far > ROUNDING), "a quaternion whose length is not 1")
    from scipy.spatial.transform import Rotation

    poses = np.tile(np.eye(4), (len(table), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = Rotation.from_quat(table[:, 3:]).as_matrix(), table[:, :3]
    return poses


def refuse_poses(path: Path | str, bad: NDArray[np.bool_], what: str) -> None:
    """Raise BadInputError if any of some poses (n,) is bad: the first one is named."""
    if bad.any():
        raise BadInputError(
            f"pose {int(bad.argmax()):,} of {path} (counted from 0) has {what}; {int(bad.sum()):,} of {len(bad):,} do"
        )
