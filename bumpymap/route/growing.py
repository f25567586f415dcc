"""Ways over maps that are too large to hold: a window grows until no way outside of it can be cheaper.

The search reads a window around the straight line. It settles every tile from which the goal might be reached for less
than the best way inside costs: what leads to the tile, plus the straight line from there at the least cost of the map.
A way that leaves the window must leave it from a tile at its edge (as near to it as the longest move). So if no such
tile has been settled, the way is the cheapest of the whole map; if one has, the window grows on that side.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import UsageError
from bumpymap.route._moves import REACH
from bumpymap.route._window import BYTES_PER_TILE, Point, settle_point
from bumpymap.route.search import Found, Way, seek, tight_way
from bumpymap.route.straighten import as_cost
from bumpytiles import TileWindow

__all__ = ["plan_way"]

_LEAST_PAD = 16
"""Tiles around start and goal at least, and by which a window grows at least."""
_PAD_SHARE = 0.125
"""Tiles around start and goal, as a share of their distance."""
_GROWTH = 0.25
"""A window grows by this share of its longer side, on each side that needs it."""


class _Box(NamedTuple):
    """A rectangle of tiles of the map, in rows from its north and columns from its west; half-open."""

    top: int
    left: int
    bottom: int
    right: int

    @property
    def tiles(self) -> int:
        return (self.bottom - self.top) * (self.right - self.left)

    def grown(self, pads: "tuple[int, int, int, int]", extent: TileWindow) -> "_Box":
        """Grow by so many tiles at the top, left, bottom and right, within the map."""
        up, left, down, right = pads
        return _Box(
            max(self.top - up, 0),
            max(self.left - left, 0),
            min(self.bottom + down, extent.rows),
            min(self.right + right, extent.cols),
        )

    def window(self, extent: TileWindow) -> TileWindow:
        """Return the box as a window of the grid."""
        row = extent.row + extent.rows - self.bottom
        return TileWindow(extent.col + self.left, row, self.right - self.left, self.bottom - self.top)


def plan_way(
    load: Callable[[TileWindow], NDArray[np.floating]],
    extent: TileWindow,
    start: Point,
    goal: Point,
    *,
    margin: float = 0.0,
    memory_tiles: int,
    least: float = 1.0,
) -> Way | None:
    """Find the cheapest way over a map of which only a window is read.

    Parameters
    ----------
    load : callable
        Gives the costs (rows, cols), north row first, of a window within the extent; see `find_way`.
    extent : TileWindow
        The whole map.
    start, goal : (float, float)
        Field coordinates of the extent: tiles from its north edge southwards, from its west edge eastwards.
    margin : float
        Distance to closed tiles that the way keeps, tiles; at least 0 and below 0.5.
    memory_tiles : int
        Tiles that a window may have at most.
    least : float
        No tile of the map costs less; at least 1. The nearer to the truth, the smaller the window that proves a way.

    Returns
    -------
    Way or None
        In field coordinates of the extent; its ``graph_cost`` is that of a search over the whole map. None if there is
        no way, or start or goal lie in a closed tile or outside the extent.

    Raises
    ------
    UsageError
        The window would need more tiles than ``memory_tiles``.
    ValueError
        As `find_way`.
    """
    if not least >= 1.0:
        raise ValueError(f"least is {least}; it must be at least 1")
    start, goal = settle_point(start), settle_point(goal)
    if not all(0 <= r < extent.rows and 0 <= c < extent.cols for r, c in (start, goal)):
        return None
    box = _first_box(start, goal, extent, memory_tiles)
    while True:
        window = box.window(extent)
        cost = as_cost(load(window))
        if cost.shape != (window.rows, window.cols):
            raise ValueError(f"load gave {cost.shape} costs for {window}; it must give rows x cols of the window")
        corner = (box.top, box.left)
        found = seek(cost, _shift(start, corner), _shift(goal, corner), margin, least)
        sides = _open_sides(found, box, extent)
        if not any(sides):
            break
        box = _grow(box, sides, extent, memory_tiles)
    if found.line is None:
        return None
    way = tight_way(found, margin)
    return Way(way.line + np.array(corner, np.float64), way.cost, way.graph_cost)


def _shift(point: Point, corner: tuple[int, int]) -> Point:
    """Turn field coordinates of the map into those of a window."""
    return point[0] - corner[0], point[1] - corner[1]


def _open_sides(found: Found, box: _Box, extent: TileWindow) -> list[bool]:
    """Say at which sides (top, left, bottom, right) a cheaper way might leave the window."""
    settled = found.settled
    goes_on = box.top > 0, box.left > 0, box.bottom < extent.rows, box.right < extent.cols
    edges = settled[:REACH], settled[:, :REACH], settled[-REACH:], settled[:, -REACH:]
    return [beyond and bool(edge.any()) for beyond, edge in zip(goes_on, edges, strict=True)]


def _first_box(start: Point, goal: Point, extent: TileWindow, memory_tiles: int) -> _Box:
    """Return the box of the straight line with as much around it as memory allows."""
    rows, cols = sorted((int(start[0]), int(goal[0]))), sorted((int(start[1]), int(goal[1])))
    line = _Box(rows[0], cols[0], rows[1] + 1, cols[1] + 1)
    pad = max(_LEAST_PAD, math.ceil(_PAD_SHARE * math.dist(start, goal)))
    return _fitting(line, [True] * 4, pad, extent, memory_tiles)


def _grow(box: _Box, sides: list[bool], extent: TileWindow, memory_tiles: int) -> _Box:
    """Grow a box on some sides."""
    pad = max(_LEAST_PAD, int(_GROWTH * max(box.bottom - box.top, box.right - box.left)))
    return _fitting(box, sides, pad, extent, memory_tiles)


def _fitting(box: _Box, sides: list[bool], pad: int, extent: TileWindow, memory_tiles: int) -> _Box:
    """Grow a box by ``pad`` tiles on some sides, by fewer where memory does not allow them."""
    while True:
        up, left, down, right = (pad if side else 0 for side in sides)
        grown = box.grown((up, left, down, right), extent)
        if grown.tiles <= memory_tiles:
            return grown
        if pad <= _LEAST_PAD:
            break
        pad = max(pad // 2, _LEAST_PAD)
    raise UsageError(
        f"the search for this way needs a window of {grown.tiles} tiles or more, "
        f"{grown.tiles * BYTES_PER_TILE / 1e9:.2f} GB of memory; allowed are {memory_tiles} tiles, "
        f"{memory_tiles * BYTES_PER_TILE / 1e9:.2f} GB. Allow more memory, or set via points that cut the way into "
        "shorter ones"
    )
