"""Plan ways over a map: costs of its tiles by window, the search, steering past obstacles; or say why there is none.

A map may be too large to hold, so a window grows until no way outside of it can be cheaper. The search reads a window
around the straight line. It settles every tile from which the goal might be reached for less than the best way inside
costs: what leads to the tile, plus the straight line from there at the least cost of the map. A way that leaves the
window must leave it from a tile at its edge (as near to it as the longest move). So if no such tile has been settled,
the way is the cheapest of the whole map; if one has, the window grows on that side.

Tiles tell that a vehicle gets through, pixels where. A way is cut into sections between points at which the vehicle
fits; each section on which it does not fit throughout is searched again on the pixels around it.

Where there is no way, the widest opening is named, or the place where both sides come closest.
"""

import math
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BARRED_TEXT, CLOSED_IN_PART, OBSTACLE, Barred, Floats, UsageError, density_for
from bumpymap.layers import STEP_LINE
from bumpymap.route.ground import PIXEL_MARGIN, CostGround, sample_line, window_around
from bumpymap.route.measure import MeasuredWay, measure_way, way_cost
from bumpymap.route.places import on_grid, place_in_window
from bumpymap.route.search import REACH, Found, find_way, seek, settle_point, spread, tight_way
from bumpymap.route.stops import place_text
from bumpymap.views import area
from bumpytiles import TileWindow

_LEAST_PAD, _PAD_SHARE = 16, 0.125
"""Margin around start and goal: at least, tiles, by which a window grows at least too, and as a share of their distance
(chosen)."""
_GROWTH = 0.25
"""Growth of a window as a share of its longer side, on each side that needs it (chosen)."""


def tile_line(ground: CostGround, start: Floats, goal: Floats) -> Floats | None:
    """Return the cheapest line over whole tiles; None if there is none, or an end lies in a closed tile or off the map.

    ``ground``: the map, with costs; ``start``, ``goal`` (2,): easting and northing, m. Returns (m, 2) m. Raises
    UsageError: the window would need more tiles than memory allows.
    """
    grid, extent = ground.site.grid, ground.site.window
    first, last = (settle_point(place_in_window(point, grid, extent)) for point in (start, goal))
    ends = np.floor([first, last]).astype(np.int64)
    if (ends < 0).any() or (ends >= (extent.rows, extent.cols)).any():
        return None
    window = TileWindow.around(extent.col + ends[:, 1], extent.row + extent.rows - 1 - ends[:, 0])
    sides, pad = [True] * 4, max(_LEAST_PAD, math.ceil(_PAD_SHARE * math.dist(first, last)))
    while any(sides):
        window = _grown(window, sides, pad, extent, ground)
        top, left = extent.row + extent.rows - window.row - window.rows, window.col - extent.col
        here, there = ((row - top, col - left) for row, col in (first, last))
        cost = ground.on_tiles(window, through=False)
        found = seek(ground.with_slope(cost, window), here, there, ground.margin, math.inf if window == extent else 1.0)
        sides, pad = _open_sides(found, window, extent), max(_LEAST_PAD, int(_GROWTH * max(window.rows, window.cols)))
    if found.line is None:
        return None
    line = on_grid(tight_way(found, ground.margin) + np.array([top, left], np.float64), grid, extent)
    line[0], line[-1] = start, goal
    return line


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


def _grown(window: TileWindow, sides: list[bool], pad: int, extent: TileWindow, ground: CostGround) -> TileWindow:
    """Grow a window by ``pad`` tiles on some sides, within the map, by fewer where memory does not allow them."""
    memory_tiles, tile_gb = ground.memory_tiles, ground.bytes_per_tile / 1e9
    while True:
        north, west, south, east = (pad if side else 0 for side in sides)
        wider = TileWindow(
            window.col - west, window.row - south, window.cols + west + east, window.rows + north + south
        )
        grown = extent.overlap(wider)
        tiles = grown.rows * grown.cols
        if tiles <= memory_tiles:
            return grown
        if pad <= _LEAST_PAD:
            break
        pad = max(pad // 2, _LEAST_PAD)
    raise UsageError(
        f"the search for this way needs a window of {tiles} tiles or more, "
        f"{tiles * tile_gb:.2f} GB of memory; allowed are {memory_tiles} tiles, "
        f"{memory_tiles * tile_gb:.2f} GB. Allow more memory, or set via points that cut the way into "
        "shorter ones"
    )


_SECTION_TILES, _LONGEST_TILES, _AROUND_TILES = 24, 96, 5
"""Usual length of a section, the longest that is searched, and distance beside it up to which a way round obstacles is
searched, tiles (chosen)."""


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
    """Return the numbers of points at which a line is cut: the ends, and clear points about ``apart`` of them apart."""
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
"""Tiles around a way in which obstacles make it worth while to search another one between them (chosen)."""


@dataclass(frozen=True, slots=True)
class Planner:
    """Plans ways over one map, and keeps the lines between stops."""

    ground: CostGround
    _legs: dict[tuple[float, ...], Floats | None] = field(default_factory=dict, init=False, repr=False)

    def way(self, stops: Floats) -> MeasuredWay | None:
        """Plan the cheapest way through stops in their order; None if there is none.

        ``stops`` (k, 2): easting and northing, m, at least two.
        """
        legs = []
        for start, goal in pairwise(stops):
            leg = self.line(start, goal)
            if leg is None:
                return None
            legs.append(leg)
        line = np.concatenate([legs[0][:1], *(leg[1:] for leg in legs)])
        return measure_way(self.ground, line, stops)

    def leg_cost(self, start: Floats, goal: Floats) -> float:
        """Return the cost of the cheapest way between two points, m; inf if there is none."""
        line = self.line(start, goal)
        return np.inf if line is None else way_cost(self.ground, line)

    def line(self, start: Floats, goal: Floats) -> Floats | None:
        """Return the cheapest line between two points, (m, 2) easting and northing, m; None if there is none.

        It is kept for the next question.
        """
        if tuple(goal) < tuple(start) and self.ground.settings.same_back:
            back = self.line(goal, start)
            return None if back is None else back[::-1]
        key = (*start, *goal)
        if key not in self._legs:
            self._legs[key] = self._clear_line(start, goal)
        return self._legs[key]

    def _clear_line(self, start: Floats, goal: Floats) -> Floats | None:
        """Return the cheapest line on which the vehicle fits throughout; None if there is none.

        The cheapest way over whole tiles is steered past obstacles on pixels. Where obstacles close tiles nearby, or
        there is no such way, the areas of tiles are searched as well, and the cheaper of both is returned.
        """
        ground = self.ground
        over_tiles = tile_line(ground, start, goal)
        steered = None if over_tiles is None else steer_clear(ground, over_tiles)
        if steered is not None:
            barred = ground.site.read(window_around(ground.site, steered, _NEAR_TILES), ()).barred
            if not np.isin(barred, CLOSED_IN_PART).any():
                return steered
        from bumpymap.route.passages import way_over_areas  # with SciPy's graphs, slow to load

        lines = [line for line in (steered, way_over_areas(ground, start, goal)) if line is not None]
        if not lines and ground.settings.through_obstacles:
            touching = replace(ground, touching=True)
            over_tiles = tile_line(touching, start, goal)
            return None if over_tiles is None else steer_clear(touching, over_tiles)
        return min(lines, key=partial(way_cost, ground), default=None)


_LEAST_OPENING, _TOO_NARROW = 1.5, 100.0
"""Least distance from what closes an opening, pixels: what is narrower is a gap between points. And cost of a pixel in
which the vehicle does not fit, so that a line leads through few of them (chosen)."""


def what_closes(ground: CostGround, start: Floats, goal: Floats) -> str:
    """Say where the widest opening between two points [m] is; without one, where the two sides come closest.

    Empty if memory does not allow to look for either. If the limit of slopes across is to blame, that is said instead.
    """
    from scipy import ndimage  # slow to load

    if why := _barred_by_setting(ground, start, goal):
        return why
    needed, found = 2.0 * ground.site.vehicle.reach_m, widest_opening(ground, start, goal)
    if found is not None and found[1] < needed:
        place, width = found
        return (
            f"The widest opening between them is at {place_text(ground.site, place)}, about {width:.1f} m wide; the "
            f"vehicle needs {needed:.1f} m. "
        )
    site, window, grid = ground.site, ground.site.window, ground.site.grid
    if window.cols * window.rows > ground.memory_tiles:
        return ""
    ends = [place_in_window(end, grid, window) for end in (start, goal)]
    for through in (False, True):  # a point between obstacles lies in a tile that is closed as a whole
        cost = ground.on_tiles(window, through=through)
        first, second = (np.isfinite(spread(cost, end, ground.margin)) for end in ends)
        if first.any() and second.any():
            break
    else:
        return ""
    if (first & second).any():
        return f"The obstacles between them leave no opening as wide as the vehicle needs, {needed:.1f} m. "
    apart, (rows, cols) = ndimage.distance_transform_edt(~second, return_indices=True)
    row, col = np.unravel_index(np.where(first, apart, np.inf).argmin(), first.shape)
    closest = np.array([[row, col], [rows[row, col], cols[row, col]]]) + 0.5
    middle = on_grid(closest.mean(axis=0)[None], grid, window)[0]
    code = int(site.read(TileWindow.around(*grid.index(middle)[:, None]), ()).barred[0, 0])
    why = BARRED_TEXT[Barred(code)] if code in BARRED_TEXT and code != Barred.NO else "no passable ground"
    return (
        f"Both sides come closest at {place_text(site, middle)}, {math.dist(*closest) * grid.tile_size:.0f} m from "
        f"tile to tile, where there is: {why}. "
    )


def name_zones(ground: CostGround, start: Floats, goal: Floats) -> str:
    """Say in which zones two points [m] lie; empty if they lie in one, if it is not known, or memory does not allow."""
    site, window = ground.site, ground.site.window
    zones = [site.zone_at(end) for end in (start, goal)]
    if 0 in zones or zones[0] == zones[1] or window.cols * window.rows > ground.memory_tiles:
        return ""
    found = site.values(window, ("zone",))
    open_zones, tile_m2 = found["zone"][found["barred"] == Barred.NO], site.grid.tile_size**2
    first, second = (f"{area(tile_m2 * np.count_nonzero(open_zones == zone))} (zone {zone})" for zone in zones)
    return f"They lie on pieces of ground that nothing joins: of {first} and of {second}. "


def _barred_by_setting(ground: CostGround, start: Floats, goal: Floats) -> str:
    """Say which setting, and it alone, closes every way between two points; empty if none does."""
    settings, pixel_m = ground.settings, ground.site.grid.pixel_size
    if settings.side_limit is not None and _joined(ground, start, goal, side_limit=None):
        limit = f"{settings.side_limit:g} degrees"
        return f"Every way between them crosses slopes of more than {limit}: raise `side_limit` to find one. "
    if settings.seen_width is not None and _joined(ground, start, goal, seen_width=None):
        width, in_relief = settings.seen_width, not ground.site.manifest.get("ground_only")
        return (
            f"Every way between them crosses ground where objects of {width:g} m would not be seen: that takes "
            f"{density_for(width, pixel_m, in_relief=in_relief):,.0f} points/m2, evenly spread. Survey it again, or "
            "raise `seen_width`. "
        )
    return ""


def _joined(ground: CostGround, start: Floats, goal: Floats, **settings: Any) -> bool:
    """Return whether there is a way between two points with other settings."""
    other = replace(ground, settings=replace(ground.settings, **settings))
    return Planner(other).line(start, goal) is not None


def widest_opening(ground: CostGround, start: Floats, goal: Floats) -> tuple[Floats, float] | None:
    """Find the widest opening that is too narrow for the vehicle and joins two points that are not joined otherwise.

    ``start``, ``goal`` (2,): easting and northing, m; the vehicle fits there. Returns its narrowest point, (2,) easting
    and northing, and the width between the pixels that close it, m; None if all openings around the two points are
    narrower than 0.4 m (of pixels of 0.2 m), or memory does not allow to look for one.
    """
    from scipy import ndimage  # slow to load, as SciPy's graphs

    from bumpymap.route.passages import BYTES_PER_TILE, first_pad

    pad = first_pad(ground, start, goal)
    window = ground.site.window.overlap(window_around(ground.site, np.array([start, goal]), pad))
    if window.rows * window.cols * BYTES_PER_TILE > ground.memory_bytes:
        return None
    pixels, pixel = ground.site.grid.pixels, ground.site.grid.pixel_size
    closed = np.repeat(np.repeat(np.isinf(ground.on_tiles(window)), pixels, 0), pixels, 1)
    closed |= np.isin(ground.site.objects(window), (OBSTACLE, STEP_LINE))
    room = ndimage.distance_transform_edt(np.pad(~closed, 1))[1:-1, 1:-1]
    ends = [(float(row), float(col)) for row, col in ground.in_window(np.array([start, goal]), window)]
    first, last = ((math.floor(row), math.floor(col)) for row, col in ends)
    reach = min(room[first], room[last], ground.site.vehicle.reach_m / pixel)
    levels = np.unique(room[(room >= _LEAST_OPENING) & (room < reach)])
    for level in levels[::-1].tolist():
        pieces = ndimage.label(room >= level)[0]
        if pieces[first] == pieces[last]:
            break
    else:
        return None
    cost = np.where(room < reach, np.float32(_TOO_NARROW), np.float32(1.0))
    cost[room < level] = np.inf
    found = find_way(cost, *ends, margin=PIXEL_MARGIN)
    if found is None:
        return None
    steps = [np.linspace(a, b, 2 + math.ceil(2.0 * math.dist(a, b))) for a, b in pairwise(found)]
    places = np.floor(np.concatenate(steps)).astype(np.int64)
    narrowest = places[room[places[:, 0], places[:, 1]].argmin()]
    width = (2.0 * room[tuple(narrowest)] - 1.0) * pixel
    return on_grid((narrowest[None] + 0.5) / pixels, ground.site.grid, window)[0], float(width)
