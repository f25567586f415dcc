"""Refuse poses that smear a drive, and say what is likely wrong with them.

Two things tell: how much the height of the same ground differs between frames, and how much of what stands on it in
one frame is seen through in another. The second also finds poses on level ground that are wrong along it. Usual
mistakes are then undone one after another, to see with which the frames agree.
"""

from collections.abc import Iterator
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError
from bumpymap.scan._merge_kernels import judge_places
from bumpymap.scan.align import Alignment, align_frames, ground_heights

__all__ = ["LIMITS", "LOWEST", "REACH_M", "FramesOfDrive", "WrongPosesError", "refuse_wrong_poses"]

Floats = NDArray[np.float64]

REACH_M = 40.0
"""Places nearer than this are judged by a frame whether it saw through them."""
LIMITS = np.array([[REACH_M, 0.5, 0.02]])
"""As `judge_places` takes them."""
LOWEST = -0.25
"""Range images go from straight down to straight up."""
_THICK_M, _THIN_M = 0.5, 0.2
"""Ground that differs by more between frames is refused; by less, it agrees."""
_THROUGH = 0.08
"""Share of what stands there that other frames see through, above which poses are suspect."""
_LEAST_M, _MOST_M = 5.0, 30.0
"""Distance of two frames that are compared."""
_PAIRS, _POINTS = 24, 3000
"""Pairs of frames, and points of each, that are compared."""
_LEAST_COMPARED = 300
_AXES = np.array([[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""From the axes of a LiDAR to those of a camera: x right, y down, z forward."""


class WrongPosesError(BadInputError):
    """Poses with which the frames contradict each other: the same run would end in the same way again."""


class FramesOfDrive(Protocol):
    """What is known of the frames of a drive."""

    @property
    def poses(self) -> Floats:
        """(frames, 4, 4) as they were given."""
        ...

    def read(self, number: int) -> tuple[Floats, NDArray[np.bool_]]:
        """Read the points (n, 3) of a frame in the frame of the sensor, m, and whether each is ground (n,)."""
        ...

    def image(self, number: int) -> NDArray[np.uint16]:
        """Read the range image of a frame."""
        ...


def refuse_wrong_poses(given: Alignment, frames: FramesOfDrive) -> None:
    """Raise WrongPosesError if the frames contradict each other.

    Parameters
    ----------
    given : Alignment
        Of the poses as they were given.
    frames : FramesOfDrive

    Raises
    ------
    WrongPosesError
        The ground is smeared, or the frames agree much better when a usual mistake is undone.
    """
    poses = frames.poses
    if len(poses) < 2:
        return
    thick = given.before_m > _THICK_M
    through = _seen_through(frames, poses)
    apart = not given.squares and np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).min() > 2.0 * REACH_M
    if not (thick or apart or through > _THROUGH):
        return
    found = [(_disagreement(frames, other), why) for why, other in _mistakes(poses)]
    least, reason = min(found, key=lambda each: each[0])
    if thick:
        what = f"according to the poses, the height of the same ground differs by {given.before_m:.1f} m between frames"
    elif apart:
        what = "according to the poses, the frames are so far apart that they share no ground"
    else:
        what = f"according to the poses, frames see through {through:.0%} of what stands in others"
    if least <= (0.55 * through if through > _THROUGH else 2 * _THROUGH):
        raise WrongPosesError(f"{what}. {reason}")
    if thick:
        raise WrongPosesError(
            f"{what}. Are `poses` those of the LiDAR (not of a camera or of the robot's base), one per frame in order "
            "of time, in metres, and from the sensor's frame to the world's?"
        )


def _mistakes(poses: Floats) -> Iterator[tuple[str, NDArray[np.floating]]]:
    """Yield what may be wrong with poses, and the poses without it."""
    yield (
        "They agree when the poses are inverted. Give the transforms from the sensor to the world in `poses`",
        np.linalg.inv(poses),
    )
    yield (
        "They agree when turned from a camera's axes to the LiDAR's. Put calib.txt beside `poses`, or give the LiDAR's",
        np.linalg.inv(_AXES) @ poses @ _AXES,
    )
    for unit, metres in (("millimetres", 0.001), ("centimetres", 0.01), ("feet", 0.3048)):
        scaled = poses.copy()
        scaled[:, :3, 3] *= metres
        yield f"They agree when the positions are taken for {unit}. Give `poses` in metres", scaled
    yield "They agree when the poses are taken from last to first. Give `poses` in order of time", poses[::-1]
    by_text = np.empty_like(poses)
    by_text[sorted(range(len(poses)), key=str)] = poses
    yield (
        "They agree when the frames' numbers are sorted as text (1, 10, 11, 2). Give `poses` in order of time",
        by_text,
    )


def _disagreement(frames: FramesOfDrive, poses: NDArray[np.floating]) -> float:
    """Return the share that is seen through with other poses; infinite if that is unknown or their ground is thick."""
    numbers = np.unique([number for pair in _pairs(poses) for number in pair]).astype(int)
    heights = []
    for number in numbers:
        points, is_ground = frames.read(number)
        heights.append(ground_heights(points.astype(np.float32), is_ground, poses[number]))
    through = _seen_through(frames, poses)
    return through if align_frames(heights).before_m < _THIN_M and not np.isnan(through) else np.inf


def _pairs(poses: NDArray[np.floating]) -> list[tuple[int, int]]:
    """Choose pairs of frames that are some metres apart, evenly over the drive."""
    pairs = []
    for first in np.unique(np.linspace(0, len(poses) - 1, _PAIRS).round().astype(int)):
        away = np.linalg.norm(poses[first + 1 :, :3, 3] - poses[first, :3, 3], axis=1)
        far = np.flatnonzero((away >= _LEAST_M) & (away <= _MOST_M))
        if len(far):
            pairs.append((int(first), int(first + 1 + far[0])))
    return pairs


def _seen_through(frames: FramesOfDrive, poses: NDArray[np.floating]) -> float:
    """Return the share of points above the ground through which a frame some metres away sees; NaN if unknown."""
    through = near = 0
    for first, second in _pairs(poses):
        points, is_ground = frames.read(first)
        standing = points[~is_ground & (np.linalg.norm(points, axis=1) < REACH_M)]
        standing = standing[:: max(1, len(standing) // _POINTS)]
        found = np.zeros((4, len(standing)), np.int32)
        way = np.ascontiguousarray((np.linalg.inv(poses[second]) @ poses[first])[:3])
        judge_places(np.round(1000.0 * standing).astype(np.int32), way, LOWEST, frames.image(second), LIMITS, found)
        through += int(found[0].sum())
        near += int(found[3].sum())
    return through / (through + near) if through + near >= _LEAST_COMPARED else float("nan")
