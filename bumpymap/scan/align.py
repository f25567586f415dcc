"""How well the poses of a drive agree: what can be corrected, and which poses are refused because they smear the drive.

Each frame leaves the mean height of its ground in squares of half a metre near the sensor. Squares that several frames
have seen tell by how much the poses disagree; small corrections of height and tilt, one set per frame, take most of it
away: each frame is fitted to the mean of all frames in turn, until they rest.

Poses are refused by how much the height of the same ground then differs between frames, and by how much of what stands
on it in one frame is seen through in another: that also finds poses on level ground that are wrong along it. Usual
mistakes are undone one after another, to see with which the frames agree.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError
from bumpymap.scan._merge_kernels import judge_places

__all__ = [
    "LIMITS",
    "LOWEST",
    "MOST_DEGREES",
    "MOST_METRES",
    "REACH_M",
    "Alignment",
    "DriveHeights",
    "FramesOfDrive",
    "GroundHeights",
    "WrongPosesError",
    "align_frames",
    "ground_heights",
    "refuse_wrong_poses",
]

MOST_METRES, MOST_DEGREES = 0.3, 1.0
"""A frame is corrected by at most so much in height and in tilt about each axis."""
_SQUARE_M = 0.5
_REACH_M = 25.0
"""Ground farther from the sensor is not compared: an angle makes too much of a height there."""
_ROUNDS = 40
_LEAST_M = 0.03
"""Heights that differ by this count half as much as equal ones."""
_PRIOR = (1.0, 100.0, 100.0)
"""Weight that keeps corrections small where the ground asks for none: as one square more at a correction of 0."""
_SIDE = 1 << 31
_MOST_SQUARES = 1_000_000
"""Squares of all frames together that are kept: 130 frames at least have all of theirs. They take 20 MB, and the
corrections are found in some seconds; a frame needs a few dozen."""
_MOST_HALVED = 32
_SPREADING = np.uint64(0x9E3779B97F4A7C15)

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class GroundHeights:
    """Ground heights of one frame near its sensor."""

    square: NDArray[np.int64]
    """(n,) which square of the world, increasing."""
    east: NDArray[np.float32]
    """(n,) mean x and y of its points from the sensor, along the axes of the world, m."""
    north: NDArray[np.float32]
    z: NDArray[np.float32]
    """(n,) mean height from the sensor, m."""
    up: float
    """Height of the sensor in the world, m."""


@dataclass(frozen=True, slots=True)
class Alignment:
    """Corrections of the poses, and the disagreement that they were made from."""

    shift: Floats
    """(frames, 3) what is added to heights: m, and m per m of x and of y from the sensor, along the world's axes."""
    before_m: float
    """Standard deviation between frames of the height of the same ground; NaN if frames share none."""
    after_m: float
    """The same with the corrections."""
    squares: int
    """Squares that two frames or more have seen."""

    def record(self) -> dict[str, float | int | None]:
        """Return the entry in scan.json."""
        tilt = np.degrees(np.arctan(np.hypot(self.shift[:, 1], self.shift[:, 2])))
        return {
            "before_m": None if np.isnan(self.before_m) else round(self.before_m, 4),
            "after_m": None if np.isnan(self.after_m) else round(self.after_m, 4),
            "squares": self.squares,
            "largest_shift_m": round(float(np.abs(self.shift[:, 0]).max(initial=0.0)), 4),
            "largest_tilt_deg": round(float(tilt.max(initial=0.0)), 3),
        }


class DriveHeights:
    """The ground heights of frame after frame.

    If there are too many squares together, half of the squares of the world go, the same ones from every frame: those
    that stay are still shared. Memory is therefore bounded, but for some bytes a frame.

    ``most``: squares of all frames together.
    """

    def __init__(self, most: int = _MOST_SQUARES) -> None:
        self.frames: list[GroundHeights] = []
        self._most, self._held, self._halved = most, 0, 0

    def add(self, heights: GroundHeights) -> None:
        """Take the heights of the next frame."""
        self.frames.append(self._thinned(heights))
        self._held += len(self.frames[-1].square)
        while self._held > self._most and self._halved < _MOST_HALVED:
            self._halved += 1
            self.frames = [self._thinned(each) for each in self.frames]
            self._held = sum(len(each.square) for each in self.frames)

    def _thinned(self, heights: GroundHeights) -> GroundHeights:
        """Return the heights without the squares that went."""
        if not self._halved:
            return heights
        spread = (heights.square.astype(np.uint64) * _SPREADING) >> np.uint64(64 - self._halved)
        stays = spread == 0
        east, north, z = (values[stays] for values in (heights.east, heights.north, heights.z))
        return GroundHeights(heights.square[stays], east, north, z, heights.up)


def ground_heights(points: NDArray[np.float32], is_ground: NDArray[np.bool_], pose: Floats) -> GroundHeights:
    """Average the ground of a frame in squares of the world.

    ``points`` (n, 3): in the frame of the sensor, m; ``pose`` (4, 4): transform from the sensor's frame to the world,
    m.
    """
    chosen = points[is_ground & (np.hypot(points[:, 0], points[:, 1]) <= _REACH_M)]
    turned = np.einsum("nj,ij->ni", chosen.astype(np.float64), pose[:3, :3])
    at = np.floor((turned[:, :2] + pose[:2, 3]) / _SQUARE_M).astype(np.int64)
    square, place, count = np.unique(at[:, 0] * _SIDE + at[:, 1], return_inverse=True, return_counts=True)
    east, north, z = (np.bincount(place, turned[:, axis], len(square)) / count for axis in range(3))
    return GroundHeights(
        square, east.astype(np.float32), north.astype(np.float32), z.astype(np.float32), float(pose[2, 3])
    )


@dataclass(frozen=True, slots=True)
class _SharedSquares:
    """Squares that several frames have seen: one row for each frame in each."""

    frame: NDArray[np.int64]
    square: NDArray[np.int64]
    sides: Floats
    """(n, 3) one, and x and y from the sensor, m."""
    z: Floats
    number: NDArray[np.int64]
    """(squares,) rows of each."""


def _shared(frames: list[GroundHeights]) -> _SharedSquares:
    number = np.repeat(np.arange(len(frames)), np.array([len(each.square) for each in frames], np.int64))
    empty = [np.empty(0)]
    square = np.concatenate([*(each.square for each in frames), np.empty(0, np.int64)])
    sides = [np.concatenate([*(getattr(each, name) for each in frames), *empty]) for name in ("east", "north", "z")]
    z = sides[2] + np.array([each.up for each in frames], np.float64)[number]
    _, place, count = np.unique(square, return_inverse=True, return_counts=True)
    several = count[place] > 1
    _, place, count = np.unique(place[several], return_inverse=True, return_counts=True)
    columns = np.stack([np.ones(len(place)), sides[0][several], sides[1][several]], axis=1)
    return _SharedSquares(number[several], place, columns, z[several], count)


def _spread(rows: _SharedSquares, z: Floats) -> float:
    """Return the standard deviation of heights between frames, from the median of distances to each square's mean."""
    if not len(z):
        return float("nan")
    mean = np.bincount(rows.square, z) / rows.number
    number = rows.number[rows.square]
    return float(1.4826 * np.median(np.abs(z - mean[rows.square]) * np.sqrt(number / (number - 1.0))))


def align_frames(frames: list[GroundHeights]) -> Alignment:
    """Find the corrections of height and tilt with which the frames agree best about the ground.

    All corrections are 0 where frames share no ground.
    """
    rows, count = _shared(frames), len(frames)
    shift: Floats = np.zeros((count, 3))
    before = _spread(rows, rows.z)
    if not len(rows.z):
        return Alignment(shift, before, before, 0)
    pairs = [(a, b) for a in range(3) for b in range(a, 3)]
    z = rows.z
    for _ in range(_ROUNDS):
        mean = np.bincount(rows.square, z) / rows.number
        scale = max(_LEAST_M, _spread(rows, z))
        weight = 1.0 / (1.0 + ((z - mean[rows.square]) / scale) ** 2)
        mean = np.bincount(rows.square, weight * z) / np.bincount(rows.square, weight)
        wanted = weight * (mean[rows.square] - rows.z)
        normal = np.empty((count, 3, 3))
        for a, b in pairs:
            sums = np.bincount(rows.frame, weight * rows.sides[:, a] * rows.sides[:, b], count)
            normal[:, a, b] = normal[:, b, a] = sums
        normal += np.diag(_PRIOR)
        right = np.stack([np.bincount(rows.frame, wanted * rows.sides[:, a], count) for a in range(3)], axis=1)
        shift[:] = np.linalg.solve(normal, right[..., None])[..., 0]
        z = rows.z + (rows.sides * shift[rows.frame]).sum(axis=1)
    most = np.array([MOST_METRES, *2 * [np.tan(np.radians(MOST_DEGREES))]])
    shift = np.clip(shift, -most, most)
    z = rows.z + (rows.sides * shift[rows.frame]).sum(axis=1)
    after = _spread(rows, z)
    if after > before:  # frames that contradict each other beyond any correction
        return Alignment(np.zeros((count, 3)), before, before, len(rows.number))
    return Alignment(shift, before, after, len(rows.number))


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
_LEAST_AGREED_M, _MOST_M = 5.0, 30.0
"""Distance of two frames that are compared."""
_PAIRS, _POINTS = 24, 3000
"""Pairs of frames, and points of each, that are compared."""
_LEAST_COMPARED = 300
_AXES = np.array([[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""From the axes of a LiDAR to those of a camera: x right, y down, z forward."""


class WrongPosesError(BadInputError):
    """Poses with which the frames contradict each other: the same run would end in the same way again."""


class FramesOfDrive(Protocol):
    """Poses and points of the frames of a drive."""

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

    ``given``: of the poses as they were given. Raises WrongPosesError: the ground is smeared, or the frames agree much
    better when a usual mistake is undone.
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
        far = np.flatnonzero((away >= _LEAST_AGREED_M) & (away <= _MOST_M))
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
