"""The cheapest way between two points of a window, and what every tile costs to reach.

The search goes from middle to middle of tiles by the 48 moves of `MOVES`, each the exact integral of the cost over the
tiles that it crosses, clear of closed ones. Start and goal lie anywhere in their tiles and see the middles around them
straight; if they see each other, the straight line competes. `pull_tight` then pulls the way tight. See
`bumpymap.route.straighten` for field coordinates, closed tiles and margins.

There and back cost the same to the last bit, and so do ways on turned maps, as a rule; see `SearchFrame`. Moves decide
on which side of closed tiles a way passes; where both sides cost nearly the same, the way may be the dearer by a
percent or two.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.route._moves import MOVES, REACH
from bumpymap.route._search_kernels import BETWEEN_OBSTACLES, FROM_START, NOT_REACHED, SETTLED, walk_back
from bumpymap.route._window import Point, RingedWindow, SearchFrame, is_open, settle_point
from bumpymap.route.straighten import LEAST_SAVING, as_cost, line_cost, off_borders, pull_tight, thin_out, wide_margin

__all__ = [
    "BETWEEN_OBSTACLES",
    "FROM_START",
    "NOT_REACHED",
    "Found",
    "Way",
    "find_way",
    "follow_back",
    "seek",
    "spread",
    "tight_way",
]

Floats = NDArray[np.float64]

_AROUND = 8
"""Tiles around a line by moves within which it is pulled tight."""


@dataclass(frozen=True, slots=True)
class Way:
    """A way between two points."""

    line: Floats
    """(n, 2) field coordinates of its corners; it begins and ends within 1e-9 tiles of start and goal."""
    cost: float
    """Exact integral of the cost along it, in tiles."""
    graph_cost: float
    """The same of the way by moves from which it was pulled tight; never less."""


@dataclass(frozen=True, slots=True)
class Found:
    """What a search leaves."""

    line: Floats | None
    """(n, 2) the cheapest way by moves, in the frame; None if there is none."""
    cost: float
    """Its cost; infinite if there is none."""
    settled: NDArray[np.bool_]
    """(rows, cols) tiles from which the goal might be reached for less by a way that leaves the window."""
    frame: SearchFrame
    ground: NDArray[np.float32]
    """Costs of the window, in the frame."""


def find_way(
    cost: NDArray[np.floating], start: Point, goal: Point, *, margin: float = 0.0, least_saving: float = LEAST_SAVING
) -> Way | None:
    """Find the cheapest way.

    Parameters
    ----------
    cost : array (rows, cols) float32
        Cost per length, at least 1; infinite where closed.
    start, goal : (float, float)
        Field coordinates.
    margin : float
        Distance to closed tiles that the way keeps, tiles; at least 0 and below 0.5.
    least_saving : float
        Corners that save less are left out, tiles.

    Returns
    -------
    Way or None
        None if there is no way, or start or goal lie in a closed tile or outside the window.

    Raises
    ------
    ValueError
        A cost below 1 or NaN, a margin or coordinates out of range.
    """
    found = seek(as_cost(cost), start, goal, margin)
    return None if found.line is None else tight_way(found, margin, least_saving)


def tight_way(found: Found, margin: float, least_saving: float = LEAST_SAVING) -> Way:
    """Pull a way that has been found tight."""
    if found.line is None:
        raise ValueError("no way has been found")
    near, corner = _cut_out(found.ground, found.line)
    line = thin_out(near, pull_tight(near, found.line - corner, wide_margin(margin)), margin, least_saving)
    line = off_borders(near, line, margin)
    pulled = line_cost(near, line)
    return Way(found.frame.line_back(found.settled.shape, line + corner), pulled, found.cost)


def _cut_out(cost: NDArray[np.float32], line: Floats) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Return the costs around a line, and the row and column of the first.

    What comes of them depends on the line's place on the map then, and not on the window that it was found in: rounding
    errors are those of the same numbers.
    """
    low = np.floor(line.min(axis=0)).astype(np.int64) - _AROUND
    high = np.floor(line.max(axis=0)).astype(np.int64) + _AROUND + 1
    near = np.full(high - low, np.inf, np.float32)
    first, last = np.maximum(low, 0), np.minimum(high, cost.shape)
    rows, cols = (slice(a, b) for a, b in zip(first - low, last - low, strict=True))
    near[rows, cols] = cost[first[0] : last[0], first[1] : last[1]]
    return near, low


def seek(cost: NDArray[np.float32], start: Point, goal: Point, margin: float, bound: float = math.inf) -> Found:
    """Find the cheapest way by moves.

    ``bound`` is what no tile costs less than, those outside the window included, if ways may leave it.
    """
    start, goal = settle_point(start), settle_point(goal)
    if not (is_open(cost, start) and is_open(cost, goal)):
        return Found(None, math.inf, np.zeros(cost.shape, np.bool_), SearchFrame(False, False, False, False), cost)
    frame = SearchFrame.of(cost, start, goal)
    ground = frame.turn(cost)
    first, last = frame.ends(cost.shape, start, goal)
    window = RingedWindow.of(ground, margin)
    reached = window.search(window.seeds(first, last), last, min(window.least, bound))
    settled, best = frame.turn_back(window.inner(reached.place) == SETTLED), float(reached.best[0])
    if not best < math.inf:
        return Found(None, best, settled, frame, ground)
    line = np.array([first, last])
    if reached.last[0] >= 0:
        row, col = divmod(int(reached.last[0]), window.cost.shape[1])
        path = follow_back(window.inner(reached.back), row - REACH, col - REACH)
        line = np.concatenate([line[:1], path[::-1], line[1:]])
    return Found(line, best, settled, frame, ground)


def spread(cost: NDArray[np.floating], start: Point, *, margin: float = 0.0) -> tuple[Floats, NDArray[np.uint8]]:
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
        The move of `MOVES` that led there; `FROM_START` if straight from the start, `NOT_REACHED` if there is no way
        (none leads anywhere from a closed tile).

    Raises
    ------
    ValueError
        As `find_way`.
    """
    window = RingedWindow.of(as_cost(cost), margin)
    reached = window.search(window.seeds(settle_point(start), None), (0.0, 0.0), 0.0)
    g, back = reached.g, reached.back
    del reached  # before copies are made
    return np.ascontiguousarray(window.inner(g)), np.ascontiguousarray(window.inner(back))


def follow_back(back: NDArray[np.uint8], row: int, col: int) -> Floats:
    """Follow the moves from a tile back to the start.

    Parameters
    ----------
    back : array (rows, cols) uint8
        From `spread`, or of a `Reach`.
    row, col : int
        A tile that has been reached.

    Returns
    -------
    array (n, 2) float64
        Field coordinates of the middles of its tiles, the given one first; the start itself is not among them. Moves
        that follow each other in one direction are one.

    Raises
    ------
    ValueError
        There is no way to the tile, or it leads between obstacles, where there are no moves.
    """
    if back[row, col] == NOT_REACHED:
        raise ValueError(f"there is no way to the tile in row {row}, column {col}")
    if back[row, col] == BETWEEN_OBSTACLES:
        raise ValueError(f"the way to the tile in row {row}, column {col} leads between obstacles: plan it as a route")
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
    return path[kept].astype(np.float64) + 0.5
