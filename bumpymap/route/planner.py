"""Plan ways over a map: costs of its tiles by window, the search, steering past obstacles, and what a way costs.

A map may be too large to hold, so a window grows until no way outside of it can be cheaper. The search reads a window
around the straight line. It settles every tile from which the goal might be reached for less than the best way inside
costs: what leads to the tile, plus the straight line from there at the least cost of the map. A way that leaves the
window must leave it from a tile at its edge (as near to it as the longest move). So if no such tile has been settled,
the way is the cheapest of the whole map; if one has, the window grows on that side.

Tiles tell that a vehicle gets through, pixels where. A way is cut into sections between points at which the vehicle
fits; each section on which it does not fit throughout is searched again on the pixels around it.
"""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Barred, TileField, UsageError
from bumpymap.layers import RouteMap, tiles_in, tiles_within
from bumpymap.route.ground import PIXEL_MARGIN, CostGround, TileChoice, WornTiles, cost_of, window_around
from bumpymap.route.measure import MeasuredWay, measure_way, way_cost
from bumpymap.route.passages import LEAST_SAVING_M, way_over_areas
from bumpymap.route.places import place_in_window
from bumpymap.route.search import BYTES_PER_TILE, REACH, Found, Point, Way, find_way, seek, settle_point, tight_way
from bumpymap.route.settings import CostSettings
from bumpymap.route.straighten import as_cost
from bumpytiles import Grid, TileWindow

__all__ = ["PlannedWay", "Planner", "plan_way", "sample_line", "steer_clear"]

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


Floats = NDArray[np.float64]

_SECTION_TILES = 24
"""Usual length of a section."""
_LONGEST_TILES = 96
"""A longer section is not searched."""
_AROUND_TILES = 5
"""How far beside a section a way round obstacles is searched."""
_STEP = 0.5
"""Distance of the points of a line that are examined, in pixels."""


def steer_clear(ground: CostGround, line: Floats) -> Floats | None:
    """Return a line near a given one on which the vehicle fits throughout; None if there is none.

    Parameters
    ----------
    ground : CostGround
        The map, with costs.
    line : array (m, 2)
        Easting and northing of the corners, m.

    Returns
    -------
    array (k, 2) or None
        Between the same ends.
    """
    grid = ground.site.grid
    points, step = sample_line(line, grid)
    if step == 0.0:
        return line
    cuts = _cuts(ground.clear_at(points), _SECTION_TILES * grid.tile_size / step, len(points))
    parts = [line[:1]]
    for first, last in pairwise(cuts):
        part = _between(line, points, first, last, step)
        if not ground.is_clear(part, with_room=True):
            too_long = (last - first) * step > _LONGEST_TILES * grid.tile_size
            steered = None if too_long else _search(ground, part)
            if steered is None and not ground.is_clear(part):
                return None
            part = part if steered is None else steered
        parts.append(part[1:])
    return np.concatenate(parts)


def sample_line(line: Floats, grid: Grid) -> tuple[Floats, float]:
    """Return points in the middle of even parts of a line, half a pixel apart, and the length of a part, m."""
    parts = np.hypot(*np.diff(line, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(parts)])
    count = max(1, int(np.ceil(along[-1] / (_STEP * grid.pixel_size))))
    moving = np.concatenate([[True], parts > 0])
    distance = (np.arange(count) + 0.5) * (along[-1] / count)
    points = np.column_stack([np.interp(distance, along[moving], line[moving, axis]) for axis in (0, 1)])
    return points, float(along[-1] / count)


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


def _search(ground: CostGround, part: Floats) -> Floats | None:
    """Search a section on pixels; None if there is no way."""
    window = window_around(ground.site, part, _AROUND_TILES)
    start, goal = ((float(row), float(col)) for row, col in ground.in_window(part[[0, -1]], window))
    saving = LEAST_SAVING_M / ground.site.grid.pixel_size
    found = find_way(ground.with_room(ground.on_pixels(window)), start, goal, margin=PIXEL_MARGIN, least_saving=saving)
    if found is None:
        return None
    line = ground.on_grid(found.line, window)
    line[0], line[-1] = part[0], part[-1]
    return line


_ROOM_M = 0.1
"""Room between vehicle and ground that is closed to it, m, as between vehicle and obstacle."""
_NEAR_TILES = 8
"""Tiles around a way in which obstacles make it worth while to look for another one between them."""
_MOST_MARGIN = 0.45
"""Of a tile: wider vehicles keep to the middle of corridors of one tile."""


@dataclass(frozen=True, slots=True)
class PlannedWay:
    """A way through all stops."""

    line: Floats
    """(m, 2) easting and northing of its corners, m."""
    measured: MeasuredWay

    def shared(self, other: "PlannedWay") -> float:
        """Return the share of this way's tiles that the other crosses too, or passes beside."""
        own = np.unique(self.measured.tiles, axis=0)
        beside = np.stack(np.meshgrid((-1, 0, 1), (-1, 0, 1)), axis=-1).reshape(-1, 2)
        near = (other.measured.tiles[:, None] + beside).reshape(-1, 2)
        _both, count = np.unique(np.concatenate([own, np.unique(near, axis=0)]), axis=0, return_counts=True)
        return int((count > 1).sum()) / len(own)


@dataclass(frozen=True, slots=True)
class Planner:
    """Plans ways over one map.

    Parameters
    ----------
    site : RouteMap
        The map.
    settings : CostSettings
        What makes ground dear.
    memory_tiles : int
        Most tiles of a window that the search may hold.
    avoid, only : polygons, optional
        From `bumpymap.layers.read_areas`.
    """

    site: RouteMap
    settings: CostSettings
    memory_tiles: int
    avoid: Any = None
    only: Any = None
    _legs: dict[tuple[float, ...], Floats | None] = field(default_factory=dict, init=False, repr=False)

    @property
    def risk(self) -> float:
        """Weight of the hazard, m."""
        return self.site.rule.fail_weight if self.settings.risk is None else self.settings.risk

    @property
    def reach_m(self) -> float:
        """Distance that a way keeps from obstacles, m: half the vehicle's width and 0.1 m."""
        return 0.5 * self.site.vehicle.width_m + _ROOM_M

    @property
    def margin(self) -> float:
        """Distance that a way keeps from closed tiles, in tiles: the same, or less if the tiles are small."""
        return min(self.reach_m / self.site.grid.tile_size, _MOST_MARGIN)

    @property
    def bands(self) -> tuple[str, ...]:
        """What of the map the cost depends on, besides what bars tiles."""
        obstacle = () if self.settings.unknown is None else ("obstacle",)
        return ("c_r_high" if self.settings.robust else "c_r", "p_fail", *obstacle)

    @property
    def has_areas(self) -> bool:
        """Whether there are areas to avoid, or to stay in."""
        return self.avoid is not None or self.only is not None

    def cost(self, tiles: TileField, risk: float | None = None, *, through: bool = False) -> NDArray[np.float32]:
        """Return the cost per metre of each tile of a window, inf where closed; ``through`` as in `cost_of`."""
        return cost_of(
            tiles,
            risk_m=self.risk if risk is None else risk,
            robust=self.settings.robust,
            unknown_cost=self.settings.unknown,
            choice=self._choice(tiles.window),
            through=through,
        )

    def _choice(self, window: TileWindow) -> TileChoice | None:
        """Return the tiles of a window that the areas of the settings close."""
        if not self.has_areas:
            return None
        grid = self.site.grid
        return TileChoice(
            None if self.avoid is None else tiles_in(self.avoid, window, grid),
            None if self.only is None else tiles_within(self.only, window, grid),
        )

    def load(self, window: TileWindow) -> NDArray[np.float32]:
        """Read the cost per metre of each tile of a window, inf where closed for what reads tiles alone."""
        return CostGround(self).on_tiles(window, through=False)

    def way(self, stops: Floats, risk: float | None = None, worn: WornTiles | None = None) -> PlannedWay | None:
        """Plan the cheapest way through stops in their order; None if there is none.

        Parameters
        ----------
        stops : array (k, 2)
            Easting and northing, m, at least two.
        risk : float, optional
            Weight of the hazard for this way, m; what it costs is told with the settings' own.
        worn : WornTiles, optional
            Tiles that are dearer for this way.
        """
        legs = []
        for start, goal in itertools.pairwise(stops):
            leg = self._leg(start, goal, risk, worn)
            if leg is None:
                return None
            legs.append(leg)
        line = np.concatenate([legs[0][:1], *(leg[1:] for leg in legs)])
        ground = CostGround(self)
        touched = self._touched_m(line) if self.settings.through_obstacles else 0.0
        tight = ground.tight_turns_deg(line)
        measured = measure_way(self.site, line, stops, ground.of_field, obstacle_m=touched, tight_turns_deg=tight)
        if touched > 0.0:
            profile = measured.profile
            clear = ground.clear_at(np.column_stack([profile.easting, profile.northing]))
            measured = replace(measured, profile=replace(profile, obstacle=~clear))
        return PlannedWay(line, measured)

    def leg_cost(self, start: Floats, goal: Floats) -> float:
        """Return the cost of the cheapest way between two points, m; inf if there is none."""
        line = self._leg(start, goal, None, None)
        return np.inf if line is None else way_cost(self.site, line, CostGround(self).of_field)

    def _leg(self, start: Floats, goal: Floats, risk: float | None, worn: WornTiles | None) -> Floats | None:
        """Return the cheapest line between two points; without worn tiles, it is kept for the next question."""
        if tuple(goal) < tuple(start):  # there and back are the same line
            back = self._leg(goal, start, risk, worn)
            return None if back is None else back[::-1]
        if worn is not None:
            return self._clear_line(start, goal, risk, worn)
        key = (*start, *goal, self.risk if risk is None else risk)
        if key not in self._legs:
            self._legs[key] = self._clear_line(start, goal, risk, None)
        return self._legs[key]

    def _clear_line(self, start: Floats, goal: Floats, risk: float | None, worn: WornTiles | None) -> Floats | None:
        """Return the cheapest line on which the vehicle fits throughout; None if there is none.

        The cheapest way over whole tiles is steered past obstacles on pixels. Where obstacles close tiles nearby, or
        there is no such way, the areas of tiles are searched as well, and the cheaper of both is returned.
        """
        ground = CostGround(self, risk, worn)
        over_tiles = self._tile_line(ground, start, goal)
        steered = None if over_tiles is None else steer_clear(ground, over_tiles)
        if steered is not None and not self._may_pass_between(steered):
            return steered
        lines = [line for line in (steered, way_over_areas(ground, start, goal)) if line is not None]
        if not lines and self.settings.through_obstacles:
            touching = replace(ground, touching=True)
            over_tiles = self._tile_line(touching, start, goal)
            return None if over_tiles is None else steer_clear(touching, over_tiles)
        return min(lines, key=partial(way_cost, self.site, cost_of=ground.of_field), default=None)

    def _touched_m(self, line: Floats) -> float:
        """Return the length of a line on which the vehicle touches obstacles, m."""
        points, step = sample_line(line, self.site.grid)
        return float((~CostGround(self).clear_at(points)).sum()) * step

    def _may_pass_between(self, line: Floats) -> bool:
        """Return whether obstacles close tiles near a line."""
        barred = self.site.read(window_around(self.site, line, _NEAR_TILES), ()).barred
        return bool(np.isin(barred, (Barred.OBSTACLE, Barred.SPLIT)).any())

    def _tile_line(self, ground: CostGround, start: Floats, goal: Floats) -> Floats | None:
        """Return the cheapest line over whole tiles, (m, 2) easting and northing, m."""
        window = self.site.window
        ends = (self.place(point, window) for point in (start, goal))
        load = partial(ground.on_tiles, through=False)
        found = plan_way(load, window, *ends, margin=self.margin, memory_tiles=self.memory_tiles)
        if found is None:
            return None
        east, north = window.col + found.line[:, 1], window.row + window.rows - found.line[:, 0]
        line = np.column_stack([east, north]) * self.site.grid.tile_size
        line[0], line[-1] = start, goal
        return line

    def line(self, start: Floats, goal: Floats) -> Floats | None:
        """Plan the cheapest line between two points, (m, 2) easting and northing, m; None if there is none."""
        return self._leg(start, goal, None, None)

    def at(self, place: Floats, window: TileWindow) -> Floats:
        """Convert rows from the north edge and columns from the west edge of a window to easting and northing, m."""
        return np.array([window.col + place[1], window.row + window.rows - place[0]]) * self.site.grid.tile_size

    def place(self, point: Floats, window: TileWindow) -> tuple[float, float]:
        """Convert easting and northing [m] to rows from the north edge and columns from the west edge of a window."""
        return place_in_window(point, self.site.grid, window)
