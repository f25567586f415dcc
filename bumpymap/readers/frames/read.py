"""Read the points of a scan file; returns that are not points of the scene are dropped and counted."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, BagMessage, Dropped, Scan, UsageError
from bumpymap.readers.frames.bag import BagReader
from bumpymap.readers.frames.raw import RawScan, read_cloud
from bumpymap.readers.source import pinned_version, require_unchanged, version_of

__all__ = ["Robot", "read_message", "read_scan", "scene_points"]


@dataclass(frozen=True, slots=True)
class Robot:
    """The region, in the sensor frame, in which returns are from the robot that carries the sensor."""

    radius_m: float = 0.5
    """Returns closer than this, horizontally, are on the robot; 0: none are. The default covers the robot's deck: from
    a roof or a mast, no beam hits the ground as close."""
    box_m: tuple[float, float, float, float] | None = None
    """Rear, front, right and left end (x from, x to, y from, y to) of a longer robot, m; at any height."""

    def __post_init__(self) -> None:
        rear, front, right, left = self.box_m or (0.0, 1.0, 0.0, 1.0)
        if not self.radius_m >= 0.0:
            raise UsageError(f"`radius_m` is {self.radius_m}; the radius of the robot must be 0 m or more")
        if not (rear < front and right < left):
            raise UsageError(
                f"box_m is {self.box_m}; the box of the robot goes from rear to front and from right to left, in "
                "metres: x from, x to, y from, y to"
            )


def read_scan(path: Path, robot: Robot | None = None, columns: int | None = None) -> Scan:
    """Read one scan: PLY, PCD, or KITTI-style ``.bin`` with its labels.

    Parameters
    ----------
    path : Path
    robot : Robot, optional
        Returns on the robot are dropped.
    columns : int, optional
        Number of columns of a ``.bin`` file: 4, 5 or 6; None: told from its values.

    Returns
    -------
    Scan
        May have no points; ``dropped`` counts the reasons.

    Raises
    ------
    BadInputError
        The file cannot be read, is empty, truncated or of another format, changes while it is read, its labels do not
        match, or the number of its columns is in doubt.
    """
    version = version_of(path)
    with pinned_version(path, version):
        raw = _read(path, columns)
    require_unchanged(path, version)
    return _keep_points(raw, robot or Robot(), path.stem)


def read_message(bag: BagReader, message: BagMessage, robot: Robot, name: str) -> Scan:
    """Read a scan from an open bag. Raises BadInputError if the message is damaged or holds no points."""
    try:
        return _keep_points(read_cloud(bag.read(message)), robot, name)
    except BadInputError as error:
        raise BadInputError(
            f"cannot read message {message.number} of {message.topic} in {bag.path}: {error}"
        ) from error


def _read(path: Path, columns: int | None) -> RawScan:
    if path.suffix.lower() == ".bin":
        from bumpymap.readers.frames.kitti import read_kitti

        return read_kitti(path, columns)
    from bumpymap.readers.frames.table import read_table

    return read_table(path)


def scene_points(points: NDArray[np.float32], robot: Robot) -> NDArray[np.bool_]:
    """Return which returns (n, 3) are points of the scene, (n,): finite, not (0, 0, 0), not on the robot."""
    finite, nothing, on_robot = _return_kinds(points, robot)
    return finite & ~nothing & ~on_robot


def _return_kinds(
    points: NDArray[np.float32], robot: Robot
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which returns are finite, which are (0, 0, 0), and which of the others are on the robot."""
    finite = np.asarray(np.isfinite(points).all(axis=1))
    nothing = np.asarray((points == 0.0).all(axis=1))
    x, y = points[:, 0], points[:, 1]
    with np.errstate(over="ignore", invalid="ignore"):
        on_robot = np.asarray(np.hypot(x, y) < robot.radius_m)
        if robot.box_m is not None:
            rear, front, right, left = robot.box_m
            on_robot = on_robot | ((rear <= x) & (x <= front) & (right <= y) & (y <= left))
    return finite, nothing, on_robot & finite & ~nothing


def _keep_points(raw: RawScan, robot: Robot, name: str) -> Scan:
    finite, nothing, on_robot = _return_kinds(raw.points, robot)
    kept = finite & ~nothing & ~on_robot
    missing = nothing.sum() + np.isnan(raw.points[~finite]).all(axis=1).sum()
    time = None if raw.time is None else raw.time[kept]
    return Scan(
        np.ascontiguousarray(raw.points[kept], np.float32),
        None if raw.intensity is None else raw.intensity[kept].astype(np.float32),
        None if raw.label is None else raw.label[kept],
        name,
        Dropped(int(missing), int((~finite).sum() + nothing.sum() - missing), int(on_robot.sum())),
        time if time is not None and np.isfinite(time).all() else None,
    )
