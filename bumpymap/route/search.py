"""The cheapest way between two points of a window, and what every tile costs to reach.

The search goes from middle to middle of tiles by the 48 moves of `MOVES`, each the exact integral of the cost over the
tiles that it crosses, clear of closed ones. Start and goal lie anywhere in their tiles and see the middles around them
straight; if they see each other, the straight line competes. `straighten` then pulls the way tight. See
`bumpymap.route.line` for field coordinates, closed tiles and margins.

A way is planned from the end whose coordinates come first, and turned round if need be: there and back cost the same.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.route._line_kernels import connect
from bumpymap.route._moves import MOVES, REACH, move_tables
from bumpymap.route._search_kernels import (
    FROM_START,
    NOT_REACHED,
    Ground,
    Reached,
    Seeds,
    mark_crowded,
    search,
    walk_back,
)
from bumpymap.route.line import as_cost, as_margin, is_clear, line_cost
from bumpymap.route.straighten import straighten

__all__ = ["BYTES_PER_TILE", "FROM_START", "NOT_REACHED", "Found", "Way", "find_way", "follow_back", "seek", "spread"]

Floats = NDArray[np.float64]
Point = tuple[float, float]
"""Field coordinates (r, c)."""

BYTES_PER_TILE = 34
"""Memory that a search takes at most, the costs that it is given included; all arrays below together."""
_NEW = -1
_SETTLED = -2


@dataclass(frozen=True, slots=True)
class Way:
    """A way between two points."""

    line: Floats
    """(n, 2) field coordinates of its corners, start and goal included."""
    cost: float
    """Exact integral of the cost along it, in tiles."""
    graph_cost: float
    """The same of the way by moves from which it was pulled tight; never less."""


@dataclass(frozen=True, slots=True)
class Found:
    """What a search leaves."""

    line: Floats | None
    """(n, 2) the cheapest way by moves; None if there is none."""
    cost: float
    """Its cost; infinite if there is none."""
    settled: NDArray[np.bool_]
    """(rows, cols) tiles from which the goal could have been reached for less by a way outside the window."""


def find_way(cost: NDArray[np.floating], start: Point, goal: Point, *, margin: float = 0.0) -> Way | None:
    """Find the cheapest way.

    Parameters
    ----------
    cost : array (rows, cols) float32
        Cost per length, at least 1; infinite where closed.
    start, goal : (float, float)
        Field coordinates.
    margin : float
        Distance to closed tiles that the way keeps, tiles; at least 0 and below 0.5.

    Returns
    -------
    Way or None
        None if there is no way, or start or goal lie in a closed tile or outside the window.

    Raises
    ------
    ValueError
        A cost below 1 or NaN, a margin or coordinates out of range.
    """
    cost = as_cost(cost)
    first, last = sorted((start, goal))
    found = seek(cost, first, last, margin)
    if found.line is None:
        return None
    line = straighten(cost, found.line, margin)
    pulled = line_cost(cost, line)
    return Way(line if first == start else line[::-1].copy(), pulled, found.cost)


def seek(cost: NDArray[np.float32], start: Point, goal: Point, margin: float, bound: float | None = None) -> Found:
    """Find the cheapest way by moves; nothing on the way costs less than ``bound``, which the window tells if None."""
    window = _Window.of(cost, margin)
    straight = np.array([start, goal], np.float64)
    seen = is_clear(cost, straight, margin)
    seeds = window.seeds(start, goal, line_cost(cost, straight) if seen else math.inf)
    reached = window.search(seeds, goal, window.least if bound is None else bound)
    settled = window.inner(reached.place) == _SETTLED
    if not reached.best[0] < math.inf:
        return Found(None, math.inf, settled)
    if reached.last[0] < 0:
        return Found(straight, float(reached.best[0]), settled)
    row, col = divmod(int(reached.last[0]), window.cost.shape[1])
    path = follow_back(window.inner(reached.back), row - REACH, col - REACH)
    line = np.concatenate([straight[:1], path[::-1], straight[1:]])
    return Found(line, float(reached.best[0]), settled)


def spread(
    cost: NDArray[np.floating], start: Point, *, margin: float = 0.0
) -> tuple[Floats, NDArray[np.uint8]]:
    """Find what every tile costs to reach.

    Parameters
    ----------
    cost : array (rows, cols) float32
        Cost per length, at least 1; infinite where closed.
    start : (float, float)
        Field coordinates.
    margin : float
        Distance to closed tiles that ways keep, tiles; at least 0 and below 0.5.

    Returns
    -------
    reach : array (rows, cols) float64
        Cost of the cheapest way by moves to the middle of each tile, in tiles; infinite if there is none.
    back : array (rows, cols) uint8
        The move of `MOVES` that led there; `FROM_START` if straight from the start, `NOT_REACHED` if there is no way.

    Raises
    ------
    ValueError
        As `find_way`.
    """
    window = _Window.of(as_cost(cost), margin)
    reached = window.search(window.seeds(start, None, math.inf), (0.0, 0.0), 0.0)
    return window.inner(reached.g), window.inner(reached.back)


def follow_back(back: NDArray[np.uint8], row: int, col: int) -> Floats:
    """Follow the moves from a tile back to the start.

    Parameters
    ----------
    back : array (rows, cols) uint8
        From `spread`.
    row, col : int
        A tile that has been reached.

    Returns
    -------
    array (n, 2) float64
        Field coordinates of the middles of its tiles, the given one first; the start itself is not among them. Moves
        that follow each other in one direction are one.
    """
    if back[row, col] == NOT_REACHED:
        raise ValueError(f"there is no way to the tile in row {row}, column {col}")
    back, count = np.ascontiguousarray(back), np.zeros(1, np.int64)
    path = np.empty((sum(back.shape), 2), np.int64)
    walk_back(back, MOVES, row, col, path, count)
    if count[0] > len(path):
        path = np.empty((int(count[0]), 2), np.int64)
        walk_back(back, MOVES, row, col, path, count)
    path = path[: count[0]]
    move = back[path[:, 0], path[:, 1]]
    kept = np.ones(len(path), np.bool_)
    kept[1:-1] = move[1:-1] != move[:-2]
    return path[kept] + 0.5


@dataclass(frozen=True, slots=True)
class _Window:
    """A window as the search takes it: with a ring of closed tiles."""

    cost: NDArray[np.float32]
    """(rows + 2 * REACH, cols + 2 * REACH)."""
    margin: float
    least: float
    """Least cost; 1 if all is closed."""

    @classmethod
    def of(cls, cost: NDArray[np.float32], margin: float) -> "_Window":
        least = float(cost.min(initial=math.inf))
        if not least >= 1.0:
            raise ValueError(f"the least cost is {least}; every cost must be a number of at least 1, or infinite")
        ringed = np.full((cost.shape[0] + 2 * REACH, cost.shape[1] + 2 * REACH), np.inf, np.float32)
        ringed[REACH:-REACH, REACH:-REACH] = cost
        return cls(ringed, as_margin(margin), least if least < math.inf else 1.0)

    def inner(self, values: NDArray[np.generic]) -> NDArray[np.generic]:
        """Return values of the flattened window without the ring."""
        return values.reshape(self.cost.shape)[REACH:-REACH, REACH:-REACH]

    def seeds(self, start: Point, goal: Point | None, straight: float) -> Seeds:
        """Connect start and goal with the middles of tiles around them."""
        first = self._connect(start)
        row, col = np.nonzero(first < math.inf)
        tile = (row + math.floor(start[0])) * self.cost.shape[1] + col + math.floor(start[1])
        exits = np.full_like(first, math.inf) if goal is None else self._connect(goal)
        return Seeds(tile, first[row, col], exits, straight)

    def _connect(self, point: Point) -> Floats:
        """Costs straight from a point to the middles of tiles around it; infinite if it lies in a closed tile."""
        out = np.full((2 * REACH + 1, 2 * REACH + 1), math.inf)
        r, c = point[0] + REACH, point[1] + REACH
        if not (math.isfinite(r) and math.isfinite(c)):
            raise ValueError(f"{point} is no point: field coordinates are two finite numbers")
        row, col = math.floor(r), math.floor(c)
        if 0 <= row < self.cost.shape[0] and 0 <= col < self.cost.shape[1] and self.cost[row, col] < math.inf:
            connect(self.cost, r, c, self.margin, out)
        return out

    def search(self, seeds: Seeds, goal: Point, bound: float) -> Reached:
        """Run the search."""
        crowded = np.ones(self.cost.shape, np.uint8)
        mark_crowded(self.cost, REACH, np.zeros(self.cost.shape[1], np.int64), crowded)
        width, count = self.cost.shape[1], self.cost.size
        ground = Ground(
            self.cost.ravel(), crowded.ravel(), width, goal[0] + REACH, goal[1] + REACH, self.least, bound
        )
        reached = Reached(
            np.full(count, math.inf),
            np.full(count, NOT_REACHED, np.uint8),
            np.full(count, _NEW, np.int32),
            np.empty(count, np.int32),
            np.empty(count),
            np.zeros(1, np.int64),
            np.zeros(1),
        )
        search(ground, move_tables(width, self.margin), seeds, reached)
        return reached
