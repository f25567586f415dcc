"""How well the poses of a drive agree with what its frames saw, and what can be corrected.

Each frame leaves the mean height of its ground in squares of half a metre near the sensor. Squares that several frames
have seen tell by how much the poses disagree; small corrections of height and tilt, one set per frame, take most of it
away: each frame is fitted to the mean of all frames in turn, until they rest.

In plan, the objects around a frame are laid on those around an earlier one: points on the edges that others lie on, and
posts on posts (Segal, Haehnel and Thrun, "Generalized-ICP", RSS 2009, in two dimensions). The moves and turns
of all pairs, each with the weight that its objects give it in each direction, are one system of linear equations for
the corrections of all frames (a pose graph). Along a bare wall nothing is known, and nothing is moved.
"""

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import loops

if TYPE_CHECKING:
    from scipy.spatial import KDTree

MOST_METRES, MOST_DEGREES = 0.3, 1.0
"""Largest correction of a frame in height, and in tilt about each axis (chosen)."""
_SQUARE_M, _REACH_M = 0.5, 25.0
"""Side of the squares in which ground is compared, and distance from the sensor beyond which it is not, nor objects, m
(chosen): an angle makes too much of a height there."""
_ROUNDS = 40
"""Rounds in which all frames are fitted to their mean (chosen)."""
_LEAST_M = 0.03
"""Difference of heights that counts half as much as none, m: at least (chosen)."""
_PRIOR = (1.0, 100.0, 100.0)
"""Weight of a correction of 0 in height and tilts, as of one square more 10 m away (chosen)."""
_SIDE = 1 << 31
"""Squares in a row of the world."""
_MOST_SQUARES = 1_000_000
"""Squares of all frames together that are kept: 130 frames at least have all of theirs. They take 20 MB, and the
corrections are found in some seconds; a frame needs a few dozen."""
_MOST_HALVED = 32
"""Most times that their number is halved."""
_SPREADING = np.uint64(0x9E3779B97F4A7C15)
"""Factor that spreads the numbers of squares: 2 ** 64 over the golden ratio (Knuth, Fibonacci hashing)."""
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
_APART_M, _BEFORE = (5.0, 15.0), 16
"""A frame is compared with the last one at such a distance, m, or else with the one that many frames before
(chosen)."""
_PATH_M, _FLOOR_M = 40.0, 2.0
"""And with the nearest one that came that much path before, at most that far above or below, m (chosen): beyond, it may
be on another floor."""
_LEAST_SQUARES = 30
"""Fewest squares in common that show a difference of height (chosen)."""
_OBJECT_M, _NEAR_OBJECTS, _AROUND_M, _EDGE = 0.05, 9, 2.0, 9.0
"""Error of the place of an object, m; number of objects near one that show on which edge it lies, and their largest
distance, m; ratio of the variance along an edge to that across it, at least (chosen)."""
_STEPS_M = (*4 * (0.6,), *8 * (0.3,))
"""Farthest object that one is laid on in each step, m (chosen)."""
_LOOSE = (0.3, 0.3, math.radians(0.5))
"""Usual errors of poses in plan, m, m and rad (chosen): corrections stay small where objects do not ask for more."""
_PLAN_ROUNDS = 4
"""Steps of Gauss and Newton (chosen)."""
_ALIKE = 4.0
"""Number of objects that count as one: those of two frames err alike (chosen)."""
VIEW_SHAPE, _LOWEST = (240, 480), -0.25
"""Rows and columns of an image of the nearest ranges, and its first row in turns: from straight down to straight up."""
VIEW_REACH_M = 40.0
"""Distance of the places that a frame may have seen through, m (chosen)."""
_VIEW_LIMITS = np.array([VIEW_REACH_M, 0.5, 0.02])
"""That distance; by how much a beam that ends well behind a place is longer: m, and share of the distance (chosen)."""

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

    ``points`` (n, 3): in the frame of the sensor, m; ``pose`` (4, 4): from there to the world, m.
    """
    chosen = points[is_ground & (np.hypot(points[:, 0], points[:, 1]) <= _REACH_M)]
    turned = np.einsum("nj,ij->ni", chosen.astype(np.float64), pose[:3, :3])
    at = np.floor((turned[:, :2] + pose[:2, 3]) / _SQUARE_M).astype(np.int64)
    square, place, count = np.unique(at[:, 0] * _SIDE + at[:, 1], return_inverse=True, return_counts=True)
    east, north, z = (
        (np.bincount(place, turned[:, axis], len(square)) / count).astype(np.float32) for axis in range(3)
    )
    return GroundHeights(square, east, north, z, float(pose[2, 3]))


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


def turned_in_plan(places: Floats, turn: float) -> Floats:
    """Return places (n, 2) turned about the origin, ``turn`` rad counter-clockwise."""
    cosine, sine = math.cos(turn), math.sin(turn)
    return np.stack([cosine * places[:, 0] - sine * places[:, 1], sine * places[:, 0] + cosine * places[:, 1]], axis=1)


def moved_heights(heights: GroundHeights, place: Floats, correction: Floats) -> GroundHeights:
    """Return the ground heights of a frame whose sensor, at ``place`` (2,), was corrected in plan."""
    side = turned_in_plan(np.stack([heights.east, heights.north], axis=1).astype(np.float64), correction[2])
    at = np.floor((side + place + correction[:2]) / _SQUARE_M).astype(np.int64)
    square, first = np.unique(at[:, 0] * _SIDE + at[:, 1], return_index=True)
    east, north = side[first].T.astype(np.float32)
    return replace(heights, square=square, east=east, north=north, z=heights.z[first])


def standing_objects(points: NDArray[np.float32], is_ground: NDArray[np.bool_], pose: Floats) -> NDArray[np.float32]:
    """Return where objects stand around the sensor, (n, 3) along the axes of the world, m: one point of each column.

    ``points``, ``pose``: as of `ground_heights`.
    """
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
    stands = stands[:: max(1, len(stands) // _MOST_OBJECTS)]
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


def frame_pairs(poses: Floats) -> list[tuple[int, int]]:
    """Return the frames of ``poses`` (frames, 4, 4) that are compared, a later with an earlier one each, in order."""
    place, pairs = poses[:, :2, 3], []
    path = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(place, axis=0), axis=1))]
    for later in range(1, len(poses)):
        away = np.linalg.norm(place[:later] - place[later], axis=1)
        apart = np.flatnonzero((away >= _APART_M[0]) & (away <= _APART_M[1]))
        floor = np.abs(poses[:later, 2, 3] - poses[later, 2, 3]) < _FLOOR_M
        again = np.flatnonzero((path[later] - path[:later] > _PATH_M) & (away <= _APART_M[1]) & floor)
        again = again[np.argsort(away[again], kind="stable")]
        before = apart[-1:].tolist() or [max(0, later - _BEFORE)]
        pairs += [(later, each) for each in sorted({later - 1, *before, *again[:1].tolist()})]
    return pairs


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
    weight: Floats = field(default_factory=lambda: np.zeros((3, 3)))
    """(3, 3) inverse of the covariance of ``move``, m, and ``turn``, rad."""

    @property
    def is_enough(self) -> bool:
        """True if enough objects are found for any conclusion."""
        return self.objects >= _LEAST_OBJECTS and self.best >= _LEAST_BEST

    def is_displaced(self, share: float) -> bool:
        """Return True if at the poses less than a share of what is found at the best place is found, not by chance."""
        by_chance = 3.0 * np.sqrt(self.best / max(1, self.objects))
        return bool(self.is_enough and self.found < min(share * self.best, self.best - by_chance))


class ObjectMatcher:
    """Looks for the objects of frames among those of another, at moves by up to 2.25 m and turns by up to 4 degrees."""

    def __init__(self) -> None:
        angle = np.radians(np.arange(-_TURNS, _TURNS + 1.0))
        self._turns = np.column_stack([np.cos(angle), np.sin(angle)])
        self._drawn = np.zeros((_CELLS, _CELLS), np.uint8)
        self._found = np.zeros((len(angle), 2 * _MOVES + 1, 2 * _MOVES + 1), np.int32)

    def fit(self, objects: NDArray[np.float32], middle: Floats, others: NDArray[np.float32]) -> ObjectFit:
        """Match objects (n, 3) of a later frame, whose sensor is at ``middle`` (2,) from the earlier one, to others."""
        from scipy.spatial import KDTree

        self._drawn[:], self._found[:] = 0, 0
        loops.draw_objects(others, _CELL_M, self._drawn)
        near = objects[np.linalg.norm(objects[:, :2] + middle, axis=1) < _REACH_M]
        loops.match_objects(near, middle, self._turns, _CELL_M, self._drawn, self._found)
        full, here, most = 4.0 * max(1, len(near)), int(self._found[_TURNS, _MOVES, _MOVES]), int(self._found.max())
        found = ObjectFit(len(near), here / full, most / full)
        if not found.is_enough:
            return found
        turn, up, right = (int(each) for each in np.unravel_index(self._found.argmax(), self._found.shape))
        best = np.array([_CELL_M * (right - _MOVES), _CELL_M * (up - _MOVES), math.radians(turn - _TURNS)])
        places, tree = near[:, :2].astype(np.float64), KDTree(others[:, :2].astype(np.float64))
        edges = _edges(tree)
        tried = [_lay_on(places, middle, tree, edges, start) for start in (np.zeros(3), best)]
        (x, y, angle), weight, _ = min(tried, key=lambda each: each[2])
        return replace(found, move=(float(x), float(y)), turn=math.degrees(angle), weight=weight)


def _edges(tree: "KDTree") -> Floats:
    """Return for each object the inverse covariance (2, 2) of where another one on the same edge or post is, 1/m2."""
    places = np.asarray(tree.data)
    away, near = tree.query(places, k=_NEAR_OBJECTS, distance_upper_bound=_AROUND_M)
    there = np.isfinite(away)
    number = there.sum(axis=1)
    offset = np.where(there[..., None], places[np.where(there, near, 0)] - places[:, None], 0.0)
    offset = np.where(there[..., None], offset - (offset.sum(axis=1) / number[:, None])[:, None], 0.0)
    spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", offset, offset) / number[:, None, None])
    spread = np.maximum(spread, _OBJECT_M**2)
    weight = 1.0 / spread
    weight[spread[:, 1] > _EDGE * spread[:, 0], 1] = 0.0
    weight[number == 1] = 1.0 / (2.0 * _OBJECT_M) ** 2
    inverse: Floats = np.einsum("nik,nk,njk->nij", axes, weight, axes)
    return inverse


def _lay_on(objects: Floats, way: Floats, tree: "KDTree", edges: Floats, start: Floats) -> tuple[Floats, Floats, float]:
    """Return the move of objects (n, 2) onto those of a tree, with their `_edges`, its weight and what is left.

    ``way`` (2,): to the sensor of the objects, m; ``start``, and the move: m, m and rad. What is left is twice the
    negative logarithm of its likelihood; of several moves, that with the least is the best.
    """
    move, others, usual = start.copy(), np.asarray(tree.data), np.diag(1.0 / np.square(_LOOSE))
    normal, left = np.zeros((3, 3)), 0.0
    for reach in _STEPS_M:
        turned = turned_in_plan(objects, move[2])
        away, near = tree.query(turned + way + move[:2], distance_upper_bound=reach)
        there = np.isfinite(away)
        x, y = turned[there].T
        rest = turned[there] + way + move[:2] - others[near[there]]
        weight = edges[near[there]]
        error = np.einsum("ni,nij,nj->n", rest, weight, rest)
        lost = math.log1p((reach / _OBJECT_M) ** 2 / 4.0) * (len(objects) - len(x))
        left = 4.0 * (lost + float(np.log1p(error / 4.0).sum())) / _ALIKE + float(move @ usual @ move)
        weight /= (1.0 + error / 4.0)[:, None, None]
        sides = np.zeros((len(x), 2, 3))
        sides[:, 0, 0] = sides[:, 1, 1] = 1.0
        sides[:, 0, 2], sides[:, 1, 2] = -y, x
        normal = np.einsum("nki,nkl,nlj->ij", sides, weight, sides)
        right = np.einsum("nki,nkl,nl->i", sides, weight, rest)
        move -= np.linalg.solve(normal + usual, right + usual @ move)  # to the pose, where objects show nothing
    return move, normal / _ALIKE, left


PlanPair: TypeAlias = tuple[int, int, Floats, ObjectFit]
"""A later and an earlier frame, the way to the later sensor (2,), m, and how it fits."""


def _left_between(pair: PlanPair, corrections: Floats) -> tuple[Floats, Floats]:
    """Return what is left of the move and the turn of a pair with corrections (3,), and the way corrected (2,)."""
    later, earlier, way, fit = pair
    fitting = turned_in_plan((way + fit.move)[None], corrections[earlier, 2])[0]
    plan = fitting - way - (corrections[later] - corrections[earlier])[:2]
    return np.append(plan, math.radians(fit.turn) - corrections[later, 2] + corrections[earlier, 2]), fitting


def correct_in_plan(pairs: list[PlanPair], count: int) -> Floats:
    """Return the corrections in plan (count, 3) of all frames: m along the axes of the world, and rad about its sensor.

    Found by steps of Gauss and Newton. They are zeros where no frame says anything of another.
    """
    from scipy.sparse import csc_matrix
    from scipy.sparse.linalg import splu

    corrections: Floats = np.zeros((count, 3))
    usual, inside = 1.0 / np.square(_LOOSE), np.arange(3)
    for _ in range(_PLAN_ROUNDS):
        right = -usual * corrections
        blocks = [(each, each, np.diag(usual)) for each in range(count)]
        for pair in pairs:
            later, earlier, _, fit = pair
            left, fitting = _left_between(pair, corrections)
            before = np.eye(3)  # what a correction of the earlier frame moves at the later sensor
            before[:2, 2] = -fitting[1], fitting[0]
            from_earlier = before.T @ fit.weight
            right[later] += fit.weight @ left
            right[earlier] -= from_earlier @ left
            blocks += [(later, later, fit.weight), (later, earlier, -fit.weight @ before)]
            blocks += [(earlier, later, -from_earlier), (earlier, earlier, from_earlier @ before)]
        rows, columns = (3 * np.array([each[axis] for each in blocks])[:, None, None] for axis in (0, 1))
        at = np.broadcast_arrays(rows + inside[:, None], columns + inside)
        values = np.array([each[2] for each in blocks])
        normal = csc_matrix((values.ravel(), tuple(each.ravel() for each in at)), shape=(3 * count, 3 * count))
        corrections = corrections + splu(normal).solve(right.ravel()).reshape(count, 3)
    return corrections


def misfit_in_plan(pairs: list[PlanPair], corrections: Floats) -> float:
    """Return the median distance in plan between the objects of two frames with corrections (frames, 3), m; or NaN."""
    left = [math.hypot(*_left_between(pair, corrections)[0][:2]) for pair in pairs if pair[3].is_enough]
    return float(np.median(left)) if left else float("nan")


def height_between(later: GroundHeights, earlier: GroundHeights, shift: Floats | None = None) -> float:
    """Return by how much the later frame has the same ground higher, m; NaN if they share too little.

    ``shift`` (2, 3): corrections of both, as of `Alignment`.
    """
    _, *rows = np.intersect1d(later.square, earlier.square, assume_unique=True, return_indices=True)
    if len(rows[0]) < _LEAST_SQUARES:
        return float("nan")
    z = [frame.z[row].astype(np.float64) + frame.up for frame, row in zip((later, earlier), rows, strict=True)]
    if shift is not None:
        for number, (frame, row, by) in enumerate(zip((later, earlier), rows, shift, strict=True)):
            z[number] += by[0] + by[1] * frame.east[row] + by[2] * frame.north[row]
    return float(np.median(z[0] - z[1]))
