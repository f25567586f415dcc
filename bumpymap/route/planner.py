"""Plan ways over a map: costs of its tiles by window, the search, steering past obstacles, and what a way costs.

A map may be too large to hold, so a window grows until no way outside of it can be cheaper. The search reads a window
around the straight line. It settles every tile from which the goal might be reached for less than the best way inside
costs: what leads to the tile, plus the straight line from there at the least cost of the map. A way that leaves the
window must leave it from a tile at its edge (as near to it as the longest move). So if no such tile has been settled,
the way is the cheapest of the whole map; if one has, the window grows on that side.

Tiles tell that a vehicle gets through, pixels where. A way is cut into sections between points at which the vehicle
fits; each section on which it does not fit throughout is searched again on the pixels around it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Barred, UsageError
from bumpymap.route.ground import CostGround, WornTiles, sample_line, window_around
from bumpymap.route.measure import MeasuredWay, measure_way, way_cost
from bumpymap.route.places import on_grid, overlap, place_in_window
from bumpymap.route.search import BYTES_PER_TILE, REACH, Found, Point, Way, seek, settle_point, tight_way
from bumpymap.route.straighten import as_cost
from bumpytiles import TileWindow

__all__ = ["Planner", "plan_way", "steer_clear"]

_LEAST_PAD = 16
"""Tiles around start and goal at least, and by which a window grows at least."""
_PAD_SHARE = 0.125
"""Tiles around start and goal, as a share of their distance."""
_GROWTH = 0.25
"""A window grows by this share of its longer side, on each side that needs it."""


def plan_way(
    load: Callable[[TileWindow], NDArray[np.floating]],
    extent: TileWindow,
    start: Point,
    goal: Point,
    *,
    margin: float = 0.0,
    memory_tiles: int,
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
    start, goal = settle_point(start), settle_point(goal)
    if not all(0 <= r < extent.rows and 0 <= c < extent.cols for r, c in (start, goal)):
        return None
    ends = np.floor([start, goal]).astype(np.int64)
    line = TileWindow.around(extent.col + ends[:, 1], extent.row + extent.rows - 1 - ends[:, 0])
    pad = max(_LEAST_PAD, math.ceil(_PAD_SHARE * math.dist(start, goal)))
    window = _grown(line, [True] * 4, pad, extent, memory_tiles)
    while True:
        cost = as_cost(load(window))
        if cost.shape != (window.rows, window.cols):
            raise ValueError(f"load gave {cost.shape} costs for {window}; it must give rows x cols of the window")
        top, left = extent.row + extent.rows - window.row - window.rows, window.col - extent.col
        here, there = ((row - top, col - left) for row, col in (start, goal))
        found = seek(cost, here, there, margin, math.inf if window == extent else 1.0)
        sides = _open_sides(found, window, extent)
        if not any(sides):
            break
        pad = max(_LEAST_PAD, int(_GROWTH * max(window.rows, window.cols)))
        window = _grown(window, sides, pad, extent, memory_tiles)
    if found.line is None:
        return None
    way = tight_way(found, margin)
    return way._replace(line=way.line + np.array([top, left], np.float64))


def _open_sides(found: Found, window: TileWindow, extent: TileWindow) -> list[bool]:
    """Say at which sides (north, west, south, east) a cheaper way might leave the window."""
    settled = found.settled
    goes_on = (
        window.row + window.rows < extent.row + extent.rows,
        window.col > extent.col,
        window.row > extent.row,
        window.col + window.cols < extent.col + extent.cols,
    )
    edges = settled[:REACH], settled[:, :REACH], settled[-REACH:], settled[:, -REACH:]
    return [beyond and bool(edge.any()) for beyond, edge in zip(goes_on, edges, strict=True)]


def _grown(window: TileWindow, sides: list[bool], pad: int, extent: TileWindow, memory_tiles: int) -> TileWindow:
    """Grow a window by ``pad`` tiles on some sides, within the map, by fewer where memory does not allow them."""
    while True:
        north, west, south, east = (pad if side else 0 for side in sides)
        wider = TileWindow(
            window.col - west, window.row - south, window.cols + west + east, window.rows + north + south
        )
        grown = overlap(wider, extent)
        tiles = grown.rows * grown.cols
        if tiles <= memory_tiles:
            return grown
        if pad <= _LEAST_PAD:
            break
        pad = max(pad // 2, _LEAST_PAD)
    raise UsageError(
        f"the search for this way needs a window of {tiles} tiles or more, "
        f"{tiles * BYTES_PER_TILE / 1e9:.2f} GB of memory; allowed are {memory_tiles} tiles, "
        f"{memory_tiles * BYTES_PER_TILE / 1e9:.2f} GB. Allow more memory, or set via points that cut the way into "
        "shorter ones"
    )


Floats = NDArray[np.float64]

_SECTION_TILES = 24
"""Usual length of a section."""
_LONGEST_TILES = 96
"""A longer section is not searched."""
_AROUND_TILES = 5
"""How far beside a section a way round obstacles is searched."""


def steer_clear(ground: CostGround, line: Floats) -> Floats | None:
    """Return a line near a given one on which the vehicle fits throughout; None if there is none.

    ``ground``: the map, with costs; ``line`` (m, 2): easting and northing of the corners, m. Returns (k, 2): between
    the same ends.
    """
    grid = ground.site.grid
    points, step = sample_line(line, grid)
    if step == 0.0:
        return line
    cuts = _cuts(ground.clear_at(points), _SECTION_TILES * grid.tile_size / step, len(points))
    parts = [line[:1]]
    for first, last in pairwise(cuts):
        part = _between(line, points, first, last, step)
        if (last - first) * step > _LONGEST_TILES * grid.tile_size:
            steered = part if ground.is_clear(part) else None
        else:
            steered = _steered(ground, part)
        if steered is None:
            return None
        parts.append(steered[1:])
    return np.concatenate(parts)


def _steered(ground: CostGround, section: Floats) -> Floats | None:
    """Return a section of a line, (n, 2), if it has room on all sides, or the cheapest way near it; None if none is."""
    window = window_around(ground.site, section, _AROUND_TILES)
    cost = ground.on_pixels(window)
    if ground.is_clear_in(window, cost, section, with_room=True):
        return section
    steered = ground.way_on_pixels(ground.with_room(cost), section[[0, -1]], window)
    if steered is None and ground.is_clear_in(window, cost, section):
        return section
    return steered


def _cuts(is_clear: NDArray[np.bool_], apart: float, count: int) -> list[int]:
    """Return the numbers of points at which a line is cut: the ends, and clear points about so many apart."""
    cuts, clear = [0], np.flatnonzero(is_clear)
    while count - 1 - cuts[-1] > 1.5 * apart:
        wanted = cuts[-1] + apart
        ahead = clear[clear > cuts[-1] + 0.5 * apart]
        if not len(ahead):
            break
        cut = int(ahead[np.abs(ahead - wanted).argmin()])
        if cut >= count - 1:
            break
        cuts.append(cut)
    return [*cuts, count - 1]


def _between(line: Floats, points: Floats, first: int, last: int, step: float) -> Floats:
    """Return the part of a line between two of its points; the ends of the line are points 0 and the last."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    start, stop = (0.0 if first == 0 else first * step), (along[-1] if last == len(points) - 1 else last * step)
    inner = line[(along > start) & (along < stop)]
    ends = [line[0] if first == 0 else points[first], line[-1] if last == len(points) - 1 else points[last]]
    return np.concatenate([ends[:1], inner, ends[1:]])


_NEAR_TILES = 8
"""Tiles around a way in which obstacles make it worth while to look for another one between them."""


@dataclass(frozen=True, slots=True)
class Planner:
    """Plans ways over one map, and keeps the lines between stops."""

    ground: CostGround
    _legs: dict[tuple[float, ...], Floats | None] = field(default_factory=dict, init=False, repr=False)

    def way(self, stops: Floats, risk: float | None = None, worn: WornTiles | None = None) -> MeasuredWay | None:
        """Plan the cheapest way through stops in their order; None if there is none.

        ``stops`` (k, 2): easting and northing, m, at least two; ``risk``: weight of the hazard for this way, m; what it
        costs is told with the settings' own; ``worn``: tiles that are dearer for this way.
        """
        legs = []
        for start, goal in pairwise(stops):
            leg = self.line(start, goal, risk, worn)
            if leg is None:
                return None
            legs.append(leg)
        line = np.concatenate([legs[0][:1], *(leg[1:] for leg in legs)])
        return measure_way(self.ground, line, stops)

    def leg_cost(self, start: Floats, goal: Floats) -> float:
        """Return the cost of the cheapest way between two points, m; inf if there is none."""
        line = self.line(start, goal)
        return np.inf if line is None else way_cost(self.ground, line)

    def line(
        self, start: Floats, goal: Floats, risk: float | None = None, worn: WornTiles | None = None
    ) -> Floats | None:
        """Return the cheapest line between two points, (m, 2) easting and northing, m; None if there is none.

        ``risk``, ``worn`` as in `way`. Without worn tiles, the line is kept for the next question.
        """
        if tuple(goal) < tuple(start):  # there and back are the same line
            back = self.line(goal, start, risk, worn)
            return None if back is None else back[::-1]
        if worn is not None:
            return self._clear_line(start, goal, risk, worn)
        key = (*start, *goal, self.ground.risk_m if risk is None else risk)
        if key not in self._legs:
            self._legs[key] = self._clear_line(start, goal, risk, None)
        return self._legs[key]

    def _clear_line(self, start: Floats, goal: Floats, risk: float | None, worn: WornTiles | None) -> Floats | None:
        """Return the cheapest line on which the vehicle fits throughout; None if there is none.

        The cheapest way over whole tiles is steered past obstacles on pixels. Where obstacles close tiles nearby, or
        there is no such way, the areas of tiles are searched as well, and the cheaper of both is returned.
        """
        ground = replace(self.ground, risk=risk, worn=worn)
        over_tiles = _tile_line(ground, start, goal)
        steered = None if over_tiles is None else steer_clear(ground, over_tiles)
        if steered is not None:
            barred = ground.site.read(window_around(ground.site, steered, _NEAR_TILES), ()).barred
            if not np.isin(barred, (Barred.OBSTACLE, Barred.SPLIT)).any():
                return steered
        from bumpymap.route.passages import way_over_areas  # with SciPy's graphs, slow to load

        lines = [line for line in (steered, way_over_areas(ground, start, goal)) if line is not None]
        if not lines and ground.settings.through_obstacles:
            touching = replace(ground, touching=True)
            over_tiles = _tile_line(touching, start, goal)
            return None if over_tiles is None else steer_clear(touching, over_tiles)
        return min(lines, key=partial(way_cost, ground), default=None)


def _tile_line(ground: CostGround, start: Floats, goal: Floats) -> Floats | None:
    """Return the cheapest line over whole tiles, (m, 2) easting and northing, m."""
    grid, window = ground.site.grid, ground.site.window
    ends = (place_in_window(point, grid, window) for point in (start, goal))
    load = partial(ground.on_tiles, through=False)
    found = plan_way(load, window, *ends, margin=ground.margin, memory_tiles=ground.memory_tiles)
    if found is None:
        return None
    line = on_grid(found.line, grid, window)
    line[0], line[-1] = start, goal
    return line
