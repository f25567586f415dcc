"""How well the poses of a drive agree about the ground, and what can be corrected.

Each frame leaves the mean height of its ground in squares of half a metre near the sensor. Squares that several frames
have seen tell by how much the poses disagree; small corrections of height and tilt, one set per frame, take most of it
away: each frame is fitted to the mean of all frames in turn, until they rest.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "MOST_DEGREES",
    "MOST_METRES",
    "Alignment",
    "DriveHeights",
    "GroundHeights",
    "align_frames",
    "ground_heights",
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
