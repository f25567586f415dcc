"""A window turned into the frame in which it is searched, start and goal in that frame, and the search itself.

A search prefers one of several ways that cost the same, or nearly so, by the order in which it looks at tiles, and a
local search ends where it began. So every search runs in the same frame: from the end in the cheaper tile to the other,
southwards more than eastwards, and never northwards or westwards. (Ends in one row, one column or on one diagonal leave
two such frames, mirror images of each other: there, ways by moves still cost the same on a mirrored map, and pulled
ways nearly so.)
"""

import math
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from bumpymap.route._line_kernels import connect
from bumpymap.route._moves import REACH, move_tables
from bumpymap.route._search_kernels import NEW, NOT_REACHED, Ground, Reached, Seeds, mark_crowded, search
from bumpymap.route.straighten import is_clear, line_cost, wide_margin

__all__ = ["BYTES_PER_TILE", "MOST_TILES", "Point", "RingedWindow", "SearchFrame", "is_open", "settle_point"]

Floats = NDArray[np.float64]
Point = tuple[float, float]
"""Field coordinates (r, c)."""
Number = TypeVar("Number", bound=np.generic)

_QUANTUM = 2.0**-30


def settle_point(point: Point) -> Point:
    """Round a point to within 1e-9 tiles, to a place inside its tile.

    Turned and shifted coordinates are exact then, and no point is on a border, where it would change its tile.
    """
    if not (math.isfinite(point[0]) and math.isfinite(point[1])):
        raise ValueError(f"{point} is no point: field coordinates are two finite numbers")
    r, c = (_settled(x) for x in point)
    return r, c


def _settled(x: float) -> float:
    """Round one coordinate."""
    tile = math.floor(x)
    return tile + min(max(round((x - tile) / _QUANTUM), 1), round(1 / _QUANTUM) - 1) * _QUANTUM


def is_open(cost: NDArray[np.float32], point: Point) -> bool:
    """Say whether a point lies in an open tile of a window."""
    row, col = math.floor(point[0]), math.floor(point[1])
    inside = 0 <= row < cost.shape[0] and 0 <= col < cost.shape[1]
    return inside and bool(cost[row, col] < math.inf)


class SearchFrame(NamedTuple):
    """What is done to a window, in this order, and to the ends of a way."""

    back: bool
    """Whether the search runs from goal to start."""
    flip_rows: bool
    flip_cols: bool
    transpose: bool

    @classmethod
    def of(cls, cost: NDArray[np.float32], start: Point, goal: Point) -> "SearchFrame":
        """Choose the frame for a start and a goal in the window."""
        back = _rank(cost, start) > _rank(cost, goal)
        down, right = (goal[0] - start[0], goal[1] - start[1]) if not back else (start[0] - goal[0], start[1] - goal[1])
        return cls(back, down < 0.0, right < 0.0, abs(down) < abs(right))

    def turn(self, values: NDArray[Number]) -> NDArray[Number]:
        """Turn an array (rows, cols); a view."""
        turned = values[:: -1 if self.flip_rows else 1, :: -1 if self.flip_cols else 1]
        return turned.T if self.transpose else turned

    def turn_back(self, values: NDArray[Number]) -> NDArray[Number]:
        """Undo `turn`; a view."""
        turned = values.T if self.transpose else values
        return turned[:: -1 if self.flip_rows else 1, :: -1 if self.flip_cols else 1]

    def ends(self, shape: tuple[int, ...], start: Point, goal: Point) -> tuple[Point, Point]:
        """Turn start and goal in a window of ``shape``, and put them in order."""
        (r0, c0), (r1, c1) = (self._place(shape, point) for point in ((goal, start) if self.back else (start, goal)))
        return (r0, c0), (r1, c1)

    def _place(self, shape: tuple[int, ...], point: Point) -> Point:
        r = shape[0] - point[0] if self.flip_rows else point[0]
        c = shape[1] - point[1] if self.flip_cols else point[1]
        return (c, r) if self.transpose else (r, c)

    def line_back(self, shape: tuple[int, ...], line: Floats) -> Floats:
        """Turn a line (n, 2) back to a window of ``shape``, from its start to its goal."""
        line = line[:: -1 if self.back else 1, :: -1 if self.transpose else 1].copy()
        for axis, flipped in enumerate((self.flip_rows, self.flip_cols)):
            if flipped:
                line[:, axis] = shape[axis] - line[:, axis]
        return line


def _rank(cost: NDArray[np.float32], point: Point) -> tuple[float, ...]:
    """Return what tells two ends apart: the same on turned maps, but for the last two numbers."""
    row, col = math.floor(point[0]), math.floor(point[1])
    r, c = abs(point[0] - row - 0.5), abs(point[1] - col - 0.5)
    return float(cost[row, col]), max(r, c), min(r, c), *point


BYTES_PER_TILE = 36
"""Memory that a search takes at most: the costs that it is given, with and without the ring, and the arrays below."""
MOST_TILES = 2_000_000_000
"""Tiles of a window, which the search numbers with 32 bits; the ring takes the rest."""


@dataclass(frozen=True, slots=True)
class RingedWindow:
    """A window as the search takes it: with a ring of closed tiles."""

    cost: NDArray[np.float32]
    """(rows + 2 * REACH, cols + 2 * REACH)."""
    margin: float
    least: float
    """Least cost; 1 if all is closed."""

    @classmethod
    def of(cls, cost: NDArray[np.float32], margin: float) -> "RingedWindow":
        """Set a ring around costs; raises ValueError where one is below 1 or NaN."""
        least = float(cost.min(initial=math.inf))
        if not least >= 1.0:
            raise ValueError(f"the least cost is {least}; every cost must be a number of at least 1, or infinite")
        ringed = np.full((cost.shape[0] + 2 * REACH, cost.shape[1] + 2 * REACH), np.inf, np.float32)
        ringed[REACH:-REACH, REACH:-REACH] = cost
        return cls(ringed, wide_margin(margin), least if least < math.inf else 1.0)

    def inner(self, values: NDArray[Number]) -> NDArray[Number]:
        """Return values of the flattened window without the ring."""
        return values.reshape(self.cost.shape)[REACH:-REACH, REACH:-REACH]

    def seeds(self, start: Point, goal: Point | None) -> Seeds:
        """Connect start and goal with the middles of tiles around them."""
        first = self._connect(start)
        row, col = np.nonzero(first < math.inf)
        tile = (row + math.floor(start[0])) * self.cost.shape[1] + col + math.floor(start[1])
        if goal is None:
            return Seeds(tile, first[row, col], np.full_like(first, math.inf), math.inf)
        return Seeds(tile, first[row, col], self._connect(goal), self.straight_cost(start, goal))

    def _connect(self, point: Point) -> Floats:
        """Costs straight from a point to the middles of tiles around it; infinite if it lies in a closed tile."""
        out = np.full((2 * REACH + 1, 2 * REACH + 1), math.inf)
        r, c = point[0] + REACH, point[1] + REACH
        if is_open(self.cost, (r, c)):
            connect(self.cost, r, c, self.margin, out)
        return out

    def straight_cost(self, start: Point, goal: Point) -> float:
        """Cost of the straight line; infinite if it is not clear."""
        line = np.array([start, goal], np.float64) + REACH
        return line_cost(self.cost, line) if is_clear(self.cost, line, self.margin) else math.inf

    def search(self, seeds: Seeds, goal: Point, bound: float) -> Reached:
        """Run the search; ``bound`` as in `Ground`."""
        crowded = np.ones(self.cost.shape, np.uint8)
        mark_crowded(self.cost, REACH, np.zeros(self.cost.shape[1], np.int64), crowded)
        width, count = self.cost.shape[1], self.cost.size
        ground = Ground(self.cost.ravel(), crowded.ravel(), width, goal[0] + REACH, goal[1] + REACH, self.least, bound)
        reached = Reached(
            np.full(count, math.inf),
            np.full(count, NOT_REACHED, np.uint8),
            np.full(count, NEW, np.int32),
            np.empty(count, np.int32),
            np.empty(count),
            np.zeros(1, np.int64),
            np.zeros(1),
        )
        search(ground, move_tables(width, self.margin), seeds, reached)
        return reached
