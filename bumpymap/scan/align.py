"""How frames of a drive are compared: the ground near each, the objects around it, and how far it sees.

Each frame leaves a `VIEW`: the mean height of its ground in squares of half a metre of the world, one point of each
column of a standing object, and the nearest range in every direction. Two views at their poses show by how much the
same ground differs in height and slope, at which move and turn the objects of one lie on those of the other, and how
many of them the other frame saw through. Objects that keep their place beside the sensor while it moves, as an escort
does, show nothing of poses.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Floats, loops

_SQUARE_M, _REACH_M = 0.5, 25.0
"""Side of the squares in which ground is compared, and distance from the sensor beyond which it is not, nor objects, m
(chosen): an angle makes too much of a height there."""
_SIDE = 2 * int(_REACH_M / _SQUARE_M)
"""Squares in a row around a sensor."""
_COLUMN_M, _RISES_M, _BODY_M, _BELOW_M = 0.2, 0.3, 2.0, 2.0
"""Width of the column that an object fills, and height that it fills at least; distance from the sensor that the
robot's own body takes, and height above the sensor beyond which nothing is compared, m (chosen)."""
_MOST_OBJECTS = 800
"""Most objects of a frame (chosen)."""
_CELL_M, _CELLS, _MOVES, _TURNS = 0.25, 256, 9, 4
"""Side, m, and number of the cells about the sensor in which objects are matched; largest move, in cells, and largest
turn, in degrees, that are tried (chosen)."""
_LEAST_OBJECTS, _LEAST_BEST = 50, 0.2
"""Fewest objects, and least share found at the best place, of a match that is evidence (chosen)."""
_ALONG_M, _MOVED_M = 0.4, 0.4
"""Distance within which an object has kept its place beside the sensor, and way of the sensor that shows it, m
(chosen)."""
_LEAST_SQUARES, _LEVER_M = 30, 2.5
"""Fewest squares in common that show a difference of height, and their least spread, m, that shows one of slope
(chosen)."""
_LEAST_M, _FITS = 0.03, 5
"""Difference of heights that counts half as much as none, m: at least; rounds of a fit (chosen)."""
VIEW_SHAPE, _LOWEST = (240, 480), -0.25
"""Rows and columns of an image of the nearest ranges, and its first row in turns: from straight down to straight up."""
VIEW_REACH_M = 40.0
"""Distance of the places that a frame may have seen through, m (chosen)."""
_VIEW_LIMITS = np.array([VIEW_REACH_M, 0.5, 0.02])
"""That distance; by how much a beam that ends well behind a place is longer: m, and share of the distance (chosen)."""
VIEW = np.dtype(
    [("ranges", "<u2", VIEW_SHAPE), ("heights", "<f4", (_SIDE, _SIDE)), ("objects", "<f4", (_MOST_OBJECTS, 3))]
)
"""Record that a frame leaves for comparisons: `nearest_ranges`, `ground_heights`, `standing_objects` (NaN in unused
rows)."""


def view_of(points: NDArray[np.float32], is_ground: NDArray[np.bool_], pose: Floats) -> NDArray[Any]:
    """Return the `VIEW` (1,) of a frame: points (n, 3) in the frame of the sensor, m; pose (4, 4) to the world, m."""
    view = np.zeros(1, VIEW)
    view["ranges"] = nearest_ranges(points)
    view["heights"] = ground_heights(points, is_ground, pose)
    objects = standing_objects(points, is_ground, pose)
    view["objects"] = np.nan
    view["objects"][0, : len(objects)] = objects
    return view


def _corner(pose: Floats) -> NDArray[np.int64]:
    """Return the first column and row of the squares around a sensor."""
    return np.floor(pose[:2, 3] / _SQUARE_M).astype(np.int64) - _SIDE // 2


def ground_heights(points: NDArray[np.float32], is_ground: NDArray[np.bool_], pose: Floats) -> NDArray[np.float32]:
    """Average the ground of a frame in squares of the world around its sensor.

    Returns (rows, columns) heights from the sensor along the world's axis, m; NaN without ground.
    """
    chosen = points[is_ground & (np.hypot(points[:, 0], points[:, 1]) <= _REACH_M)]
    # Not a matrix product: its library would start threads of its own in each of ours, for half of the time.
    turned = np.einsum("nj,ij->ni", chosen.astype(np.float64), pose[:3, :3])
    column, row = (np.floor((turned[:, :2] + pose[:2, 3]) / _SQUARE_M).astype(np.int64) - _corner(pose)).T
    inside = (column >= 0) & (column < _SIDE) & (row >= 0) & (row < _SIDE)
    at = (row * _SIDE + column)[inside]
    count = np.bincount(at, minlength=_SIDE * _SIDE)
    with np.errstate(invalid="ignore"):
        mean = np.bincount(at, turned[inside, 2], _SIDE * _SIDE) / count
    return mean.astype(np.float32).reshape(_SIDE, _SIDE)


def standing_objects(points: NDArray[np.float32], is_ground: NDArray[np.bool_], pose: Floats) -> NDArray[np.float32]:
    """Return where objects stand around the sensor, (n, 3) along the axes of the world, m: one point of each column."""
    other = points[~is_ground]
    flat = np.hypot(other[:, 0], other[:, 1])
    at = np.einsum("nj,ij->ni", other[(flat > _BODY_M) & (flat < _REACH_M)].astype(np.float64), pose[:3, :3])
    at = at[(np.abs(at[:, :2]).max(axis=1, initial=0.0) < _REACH_M) & (at[:, 2] < _BELOW_M)]
    half = int(_REACH_M / _COLUMN_M)
    row, column = np.floor(at[:, :2].T / _COLUMN_M).astype(np.int64) + half
    key, size = 2 * half * row + column, 4 * half * half
    low, high = np.full(size, np.inf), np.full(size, -np.inf)
    np.minimum.at(low, key, at[:, 2])
    np.maximum.at(high, key, at[:, 2])
    stands = np.flatnonzero(high - low > _RISES_M)
    stands = stands[:: max(1, math.ceil(len(stands) / _MOST_OBJECTS))]
    number = np.maximum(np.bincount(key, minlength=size), 1)
    x, y, z = (np.bincount(key, at[:, axis], size) / number for axis in range(3))
    above = np.flatnonzero(at[:, 2] >= z[key] - 1e-6)  # a point about the middle: those at its height may be none
    z[key[above]] = at[above, 2]
    return np.column_stack([x[stands], y[stands], z[stands]]).astype(np.float32)


def nearest_ranges(points: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Return the distance of the nearest of a frame's points in every direction, cm; 0 where there is none."""
    image = np.zeros(VIEW_SHAPE, np.uint16)
    loops.range_image(np.ascontiguousarray(points, np.float32), _LOWEST, image)
    return image


def judge_by_view(
    places: NDArray[np.int32], pose: Floats, image: NDArray[np.uint16], found: NDArray[np.int32] | None = None
) -> NDArray[np.int32]:
    """Tell places (n, 3), mm, that a frame saw through from hidden ones and others.

    A place is seen through if all beams near its direction ended well behind it, hidden if all ended well before it.
    Returned are the numbers of frames (4, n) that saw through each, from which it was hidden, that had no return near
    its direction, and that had returns near it. ``pose`` (4, 4): from the sensor to the frame of the places, m;
    ``found``: counts of other frames, added to.
    """
    found = np.zeros((4, len(places)), np.int32) if found is None else found
    loops.judge_places(places, np.ascontiguousarray(np.linalg.inv(pose)[:3]), _LOWEST, image, _VIEW_LIMITS, found)
    return found


def fit_plane(at: Floats, z: Floats) -> Floats:
    """Fit heights (n,) at places (n, 2) by a plane; returns height at the origin and slopes (3,), m and m per m.

    Outliers count little (Cauchy's weights).
    """
    sides = np.column_stack([np.ones(len(z)), at])
    plane: NDArray[np.floating[Any]] = np.array([np.median(z), 0.0, 0.0])
    for _ in range(_FITS):
        rest = z - sides @ plane
        scale = max(_LEAST_M, 1.4826 * float(np.median(np.abs(rest))))
        weight = 1.0 / (1.0 + (rest / scale) ** 2)
        normal = (sides * weight[:, None]).T @ sides + np.diag([1e-6, 1.0, 1.0])
        plane = np.linalg.solve(normal, (sides * weight[:, None]).T @ z)
    return np.asarray(plane, np.float64)


def places_of_squares(heights: NDArray[np.float32], pose: Floats) -> tuple[Floats, Floats]:
    """Return the middles (n, 2) of squares with ground, from the sensor along the world's axes, and heights (n,), m."""
    row, column = np.nonzero(np.isfinite(heights))
    at = (np.column_stack([column, row]) + _corner(pose) + 0.5) * _SQUARE_M - pose[:2, 3]
    return at, heights[row, column].astype(np.float64)


@dataclass(frozen=True, slots=True)
class HeightDifference:
    """How the ground of a frame differs from the same ground of an earlier one."""

    higher_m: float = math.nan
    """By how much it is higher, in the median; NaN if they share too little."""
    spread_m: float = math.nan
    """Standard deviation of a height of either, from the median of all differences."""
    at_sensor_m: float = math.nan
    """By how much it is higher at the sensor of the later frame."""
    slope: tuple[float, float] = (math.nan, math.nan)
    """By how much more it rises along the axes of the world, m per m; NaN if they share too little."""

    @property
    def leaning_deg(self) -> float:
        """Angle between both, degrees; NaN if unknown."""
        return math.degrees(math.atan(math.hypot(*self.slope)))


def compare_heights(
    later: NDArray[np.float32], earlier: NDArray[np.float32], poses: tuple[Floats, Floats]
) -> HeightDifference:
    """Compare the `ground_heights` of two frames at their poses."""
    east, north = (_corner(poses[0]) - _corner(poses[1])).tolist()
    if max(abs(east), abs(north)) >= _SIDE:
        return HeightDifference()
    rows, columns = slice(max(0, -north), _SIDE - max(0, north)), slice(max(0, -east), _SIDE - max(0, east))
    own = np.full_like(later, np.nan)
    own[rows, columns] = later[rows, columns] - earlier[
        rows.start + north : rows.stop + north, columns.start + east : columns.stop + east
    ]  # fmt: skip
    at, z = places_of_squares(own, poses[0])
    if len(z) < _LEAST_SQUARES:
        return HeightDifference()
    z += poses[0][2, 3] - poses[1][2, 3]
    found = HeightDifference(float(np.median(z)), float(1.4826 * np.median(np.abs(z)) / math.sqrt(2.0)))
    if np.linalg.eigvalsh(np.cov(at.T))[0] < _LEVER_M**2:
        return found
    plane = fit_plane(at, z).tolist()
    return replace(found, at_sensor_m=plane[0], slope=(plane[1], plane[2]))


def keeps_beside(objects: NDArray[np.float32], others: NDArray[np.float32], poses: tuple[Floats, Floats]) -> Any:
    """Return which objects (n,) of a later frame, and others (m,) of an earlier one, keep their place at the sensor.

    None do if the sensor has hardly moved.
    """
    from scipy.spatial import KDTree

    beside = [np.zeros(len(each), np.bool_) for each in (objects, others)]
    if not (len(objects) and len(others)) or np.linalg.norm((poses[0] - poses[1])[:2, 3]) < _MOVED_M:
        return beside
    turned = [
        np.einsum("nj,ji->ni", each.astype(np.float64), pose[:3, :3])[:, :2]
        for each, pose in zip((objects, others), poses, strict=True)
    ]
    for number, (own, other) in enumerate((turned, turned[::-1])):
        beside[number] = KDTree(other).query(own)[0] < _ALONG_M
    return beside


@dataclass(frozen=True, slots=True)
class ObjectFit:
    """How the objects of a frame fit those of an earlier one."""

    objects: int = 0
    """Of the later frame near enough to the earlier one."""
    found: float = 0.0
    """Share found at the poses, 0..1; objects beside count by half."""
    best: float = 0.0
    """Largest share found at any place near by."""
    move: tuple[float, float] = (0.0, 0.0)
    """How the later frame has to move to lie on the earlier one, m along the axes of the world."""
    turn: float = 0.0
    """And to turn, degrees counter-clockwise."""

    def is_displaced(self, share: float) -> bool:
        """Return True if at the poses less than a share of what is found at the best place is found, not by chance."""
        is_enough = self.objects >= _LEAST_OBJECTS and self.best >= _LEAST_BEST
        by_chance = 3.0 * np.sqrt(self.best / max(1, self.objects))
        return bool(is_enough and self.found < min(share * self.best, self.best - by_chance))


def fit_objects(objects: NDArray[np.float32], middle: Floats, others: NDArray[np.float32]) -> ObjectFit:
    """Look for objects (n, 3) of a later frame, whose sensor is at ``middle`` (2,) from the earlier one, among others.

    They are tried at moves by up to 2.25 m and turns by up to 4 degrees.
    """
    angle = np.radians(np.arange(-_TURNS, _TURNS + 1.0))
    drawn = np.zeros((_CELLS, _CELLS), np.uint8)
    found = np.zeros((len(angle), 2 * _MOVES + 1, 2 * _MOVES + 1), np.int32)
    loops.draw_objects(others, _CELL_M, drawn)
    near = objects[np.linalg.norm(objects[:, :2] + middle, axis=1) < _REACH_M]
    loops.match_objects(near, middle, np.column_stack([np.cos(angle), np.sin(angle)]), _CELL_M, drawn, found)
    full, here, most = 4.0 * max(1, len(near)), int(found[_TURNS, _MOVES, _MOVES]), int(found.max())
    best = np.unravel_index(found.argmax(), found.shape)
    turn, up, right = (
        int(each) - half + _between(found, best, axis)
        for axis, (each, half) in enumerate(zip(best, (_TURNS, _MOVES, _MOVES), strict=True))
    )
    return ObjectFit(len(near), here / full, most / full, (_CELL_M * right, _CELL_M * up), turn)


def _between(found: NDArray[np.int32], best: tuple[np.intp, ...], axis: int) -> float:
    """Return how far beyond the best place along an axis a parabola through its neighbours has its top, in steps."""
    at = int(best[axis])
    if not 0 < at < found.shape[axis] - 1:
        return 0.0
    low, mid, high = (float(found[(*best[:axis], at + step, *best[axis + 1 :])]) for step in (-1, 0, 1))
    bend = low - 2.0 * mid + high
    return 0.5 * (low - high) / bend if bend < 0.0 else 0.0
