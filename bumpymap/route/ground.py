"""The ground of a map as a route sees it: what a metre costs on each tile, and on each pixel where the vehicle fits."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    CLOSED_IN_PART,
    CROSSING_UNKNOWN,
    OBSTACLE,
    OPEN_THROUGH,
    Barred,
    Floats,
    TileField,
    corners_join,
)
from bumpymap.layers import STEP_LINE, MapReader, tiles_in
from bumpymap.route.places import in_window, on_grid
from bumpymap.route.search import (
    BYTES_PER_TILE,
    BYTES_PER_TILE_BY_SLOPE,
    Costs,
    find_way,
    is_clear,
)
from bumpymap.route.settings import CostSettings
from bumpytiles import Grid, TileWindow

_STRIP = 256
"""Rows of costs that are computed at once, so that the float64 arrays in between stay small."""
PIXEL_MARGIN = 0.2
"""Distance of lines from closed pixels, pixels: half the vehicle's width is then free beside every point of a line."""
LEAST_SAVING_M = 0.003
"""Least saving of a corner of a line on pixels, m of level ground (chosen)."""
_MOST_MARGIN = 0.45
"""Largest margin of a search over tiles, tiles (chosen): wider vehicles keep to the middle of corridors of one tile."""
_ROOM_M, _NARROW = 0.6, 0.5
"""Distance from closed pixels, m, in which a metre is dearer, and by what share beside them (chosen): a vehicle swings
out by some decimetres at the corners of a way, so the way keeps off where that costs little."""
_TIGHT_M = 0.46
"""Distance from closed pixels, m, within which a turn is tight: there a Warthog that turns on the spot touches."""
TOUCHING = 100.0
"""Cost of a metre on which the vehicle touches an obstacle, as a multiple of the ground's (chosen)."""
_STRETCH_TILES, _MOST_POINTS = 32, 8192
"""Longest stretch of a line whose window is read at once, tiles, and most points of it (chosen)."""
_STEP = 0.5
"""Distance of the points of a line that are examined, pixels."""


@dataclass(frozen=True, slots=True)
class CostGround:
    """A map, what its ground costs one search, and where the vehicle fits."""

    site: MapReader
    settings: CostSettings
    """Settings of the cost."""
    memory_tiles: int
    """Most tiles of a window that a search may hold."""
    avoid: Any = None
    """Polygons from `bumpymap.layers.read_areas`, as ``only``; None: none."""
    only: Any = None
    touching: bool = False
    """Obstacles may be touched, at a hundred times the cost."""

    @property
    def risk_m(self) -> float:
        """Weight of the hazard by the settings, m."""
        if self.settings.risk is None:
            return self.site.rule.fail_weight if self.settings.by == "cost" else 0.0
        return self.settings.risk

    @property
    def joins_corners(self) -> bool:
        """True if it can go from one free pixel to another that touches it at a corner alone."""
        return corners_join(self.site.vehicle.width_m, self.site.vehicle.reach_m, self.site.grid.pixel_size)

    @property
    def margin(self) -> float:
        """Distance that it keeps from closed tiles, in tiles: the same, or less if the tiles are small."""
        return min(self.site.vehicle.reach_m / self.site.grid.tile_size, _MOST_MARGIN)

    @property
    def bands(self) -> tuple[str, ...]:
        """Bands of the map on which the cost depends, besides what bars tiles."""
        obstacle = () if self.settings.unknown is None else ("obstacle",)
        seen = () if self.settings.seen_width is None else ("smallest_object",)
        return ("c_r_high" if self.settings.robust else "c_r", "p_fail", *obstacle, *seen)

    @property
    def bytes_per_tile(self) -> int:
        """Memory that a search takes."""
        return BYTES_PER_TILE + (BYTES_PER_TILE_BY_SLOPE if self.settings.knows_slope else 0)

    @property
    def memory_bytes(self) -> int:
        """Memory that a search may use."""
        return self.memory_tiles * self.bytes_per_tile

    def with_slope(
        self, cost: NDArray[np.float32], window: TileWindow, *, barred: bool = True
    ) -> NDArray[np.float32] | Costs:  # fmt: skip
        """Add what slopes cost, if they do, to the costs of the tiles of a window, or of its pixels.

        The gradient is that of the plane of each tile; a tile without heights counts as level. With ``barred``, no way
        leads across a slope steeper than the limit.
        """
        settings = self.settings
        if not settings.knows_slope:
            return cost
        gradient, pixels = self.site.gradient(window), len(cost) // window.rows
        gradient = np.repeat(np.repeat(gradient, pixels, 0), pixels, 1) if pixels > 1 else gradient
        steepest = settings.steepest if barred else math.inf
        return Costs(cost, gradient, settings.climb, settings.descent, settings.side_slope, steepest)

    def on_tiles(self, window: TileWindow, *, through: bool = True) -> NDArray[np.float32]:
        """Return the cost per metre of each tile, (rows, cols), infinite where closed.

        Unless ``through``, tiles are closed that obstacles close for what reads tiles alone.
        """
        return self.of_field(self.site.read(window, self.bands), through=through)

    def of_field(self, tiles: TileField, *, through: bool = True) -> NDArray[np.float32]:
        """Return the same for tiles that have been read: ``1 + ride_weight c_r + risk hazard``, or that by time.

        Closed are tiles that are not passable, by their ground or, unless ``through``, by what obstacles leave of them,
        and those that areas or ``seen_width`` close. With the risk of the vehicle profile these are the values of
        cost.tif. Unknown tiles, which hold points but have no class, are closed unless the settings give their cost;
        even then, those in which an obstacle was seen. Tiles without points are closed in any case: around a survey
        there are as many of them as its bounding rectangle happens to hold, and inside it they are mostly water and
        shade, of which nothing at all is known. An unknown hazard counts as 0; a robust plan takes the upper end of the
        interval of c_r.
        """
        rule, settings = tiles.rule, self.settings
        weighed = replace(rule, fail_weight=self.risk_m)
        of_metre = weighed.cost if settings.by == "cost" else weighed.time_cost
        shaking = tiles.c_r_high if settings.robust else tiles.c_r
        cost = np.empty(tiles.barred.shape, np.float32)
        for start in range(0, len(cost), _STRIP):
            rows = slice(start, start + _STRIP)
            barred = tiles.barred[rows]
            factor = of_metre(shaking[rows].astype(np.float64), weighed.hazard(tiles.p_fail[rows]))
            is_open = np.isin(barred, OPEN_THROUGH) if through or self.touching else barred == Barred.NO
            cost[rows] = np.where(is_open & np.isfinite(factor), factor, np.inf)
            if settings.unknown is not None:
                cost[rows][np.isin(barred, CROSSING_UNKNOWN) & ~(tiles.obstacle[rows] > 0.0)] = settings.unknown
        if settings.seen_width is not None:
            cost[~(tiles.smallest_object <= settings.seen_width)] = np.inf
        if self.avoid is not None:
            cost[tiles_in(self.avoid, tiles.window, tiles.grid)] = np.inf
        if self.only is not None:
            cost[~tiles_in(self.only, tiles.window, tiles.grid, wholly=True)] = np.inf
        if self.touching and not through:
            cost[np.isin(tiles.barred, CLOSED_IN_PART)] *= TOUCHING
        return cost

    def slowness(self, tiles: TileField) -> Floats:
        """Return the time of a metre, (rows, cols) s/m: that of the cost at the top speed on unknown ground; or NaN."""
        slow, unknown = tiles.rule.slowness(tiles.c_r), (self.settings.unknown or math.nan) / tiles.rule.top_mps
        return np.where(np.isin(tiles.barred, CROSSING_UNKNOWN), unknown, slow)

    def on_pixels(self, window: TileWindow) -> NDArray[np.float32]:
        """Return the cost per metre on each pixel, (rows * pixels, cols * pixels); inf where the vehicle cannot be."""
        pixels = self.site.grid.pixels
        out = np.repeat(np.repeat(self.on_tiles(window), pixels, 0), pixels, 1)
        out[~self._free(window, np.isinf(out))] *= np.float32(TOUCHING if self.touching else np.inf)
        return out

    def with_room(self, cost: NDArray[np.float32]) -> NDArray[np.float32]:
        """Make pixels near closed ones dearer, so that a way keeps away from them where it can."""
        reach = self._room_pixels
        factor = 1 + np.float32(_NARROW) * np.linspace(1, 0, reach + 1, dtype=np.float32)
        return np.asarray(cost * factor[np.maximum(_steps_to_closed(cost, reach + 1) - 1, 0)])

    @property
    def _room_pixels(self) -> int:
        return max(1, round(_ROOM_M / self.site.grid.pixel_size))

    def _free(self, window: TileWindow, closed: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return where the middle of the vehicle can be; ``closed`` are pixels of closed tiles.

        passage.tif does not know what else is closed, nor that unknown ground may be crossed: then distances are
        measured.
        """
        crosses_unknown = self.settings.unknown is not None
        free = np.ones(closed.shape, np.bool_) if crosses_unknown else self.site.passage(window)
        reach = self.site.vehicle.reach_m / self.site.grid.pixel_size
        if crosses_unknown:
            free &= _apart(np.isin(self.site.objects(window), (OBSTACLE, STEP_LINE)), reach)
        closes_more = any(each is not None for each in (self.avoid, self.only, self.settings.seen_width))
        if crosses_unknown or closes_more:
            free &= _apart(closed, min(reach, self.margin * self.site.grid.pixels) + 0.5)
        return free

    def in_window(self, points: Floats, window: TileWindow) -> Floats:
        """Convert easting and northing [m], (n, 2), to rows and columns of pixels from the corner of a window."""
        return in_window(points, self.site.grid, window) * self.site.grid.pixels

    def way_on_pixels(self, cost: NDArray[np.float32], ends: Floats, window: TileWindow) -> Floats | None:
        """Find the cheapest line between two points, (2, 2) easting and northing [m], over the pixels of a window.

        ``cost`` is theirs, per metre. Returns the corners, (m, 2) m; None if there is no way.
        """
        grid = self.site.grid
        start, goal = ((float(row), float(col)) for row, col in self.in_window(ends, window))
        saving = LEAST_SAVING_M / grid.pixel_size
        found = find_way(self.with_slope(cost, window), start, goal, margin=PIXEL_MARGIN, least_saving=saving)
        if found is None:
            return None
        line = on_grid(found / grid.pixels, grid, window)
        line[0], line[-1] = ends
        return line

    def is_clear(self, line: Floats) -> bool:
        """Say whether the vehicle fits on all of a line, (n, 2) easting and northing [m]."""
        parts = stretches(line, _STRETCH_TILES * self.site.grid.tile_size)
        around = ((window_around(self.site, part, 1), part) for part in parts)
        return all(self.is_clear_in(window, self.on_pixels(window), part) for window, part in around)

    def is_clear_in(
        self, window: TileWindow, cost: NDArray[np.float32], line: Floats, *, with_room: bool = False
    ) -> bool:
        """Say the same of a line in a window with the ``cost`` of its pixels; with room, whether some is to spare."""
        if with_room:
            is_near = _steps_to_closed(cost, self._room_pixels + 1) <= self._room_pixels
            cost = np.where(is_near, np.float32(np.inf), cost)
        return is_clear(cost, self.in_window(line, window), PIXEL_MARGIN)

    def clear_at(self, points: Floats, reach: float = 0.0) -> NDArray[np.bool_]:
        """Say at which points along a line, (n, 2), no closed pixel is within ``reach`` [px] of their own."""
        clear = np.ones(len(points), np.bool_)
        pad = math.floor(reach)
        steps = np.arange(-pad, pad + 1)
        around = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        around = around[np.square(around).sum(axis=1) <= reach * reach] + pad
        first = 0
        while first < len(points):
            spans = np.maximum.accumulate(np.abs(points[first : first + _MOST_POINTS] - points[first]).max(axis=1))
            last = first + int(np.searchsorted(spans, _STRETCH_TILES * self.site.grid.tile_size, side="right"))
            window = window_around(self.site, points[first:last], 1)
            is_open = np.isfinite(self.on_pixels(window))
            if not is_open.all():
                near = np.floor(self.in_window(points[first:last], window)).astype(np.int64)[:, None] + around
                clear[first:last] = np.pad(is_open, pad, constant_values=True)[near[..., 0], near[..., 1]].all(axis=1)
            first = last
        return clear

    def tight_turns_deg(self, line: Floats) -> float:
        """Add the angles, degrees, by which a line, (n, 2) easting and northing [m], turns near closed pixels."""
        line = line[np.append(True, (np.diff(line, axis=0) != 0.0).any(axis=1))]
        heading = np.arctan2(*np.diff(line, axis=0).T)
        turn = np.abs((np.diff(heading) + np.pi) % (2.0 * np.pi) - np.pi)
        tight = ~self.clear_at(line[1:-1], _TIGHT_M / self.site.grid.pixel_size)
        return float(np.degrees(turn[tight].sum()))


def _steps_to_closed(cost: NDArray[np.float32], limit: int) -> NDArray[np.int32]:
    """Return how many pixels, along rows, columns and diagonals, each is from the nearest closed one.

    It is at most ``limit``. Beyond the window nothing is closed.
    """
    closed = np.isinf(cost)
    if not closed.any():
        return np.full(cost.shape, limit, np.int32)
    from scipy.ndimage import distance_transform_cdt

    return np.asarray(np.minimum(distance_transform_cdt(~closed, "chessboard"), limit))


def _apart(marked: NDArray[np.bool_], reach: float) -> NDArray[np.bool_]:
    """Return which pixels are at least ``reach`` [px] from every marked one, between their middles."""
    if not marked.any():
        return np.ones(marked.shape, np.bool_)
    from scipy.ndimage import distance_transform_edt

    return np.asarray(distance_transform_edt(~marked) >= reach)


def window_around(site: MapReader, line: Floats, ring: int) -> TileWindow:
    """Return the tiles that a line, (n, 2) easting and northing [m], spans, and a ring around them."""
    return TileWindow.around(*site.grid.index(line).T).grown(ring)


def stretches(line: Floats, longest: float) -> Iterator[Floats]:
    """Yield a line in parts, each at most ``longest`` in easting and northing; consecutive parts share a point."""
    counts = np.maximum(1, np.ceil(np.abs(np.diff(line, axis=0)).max(axis=1) / longest)).astype(np.int64)
    points, done = [line[:1]], 0
    for at in np.flatnonzero(counts > 1).tolist():
        start, stop, count = line[at], line[at + 1], counts[at]
        points += [line[done + 1 : at + 1], start + (stop - start) * (np.arange(1, count + 1) / count)[:, None]]
        points[-1][-1] = stop
        done = at + 1
    whole = np.concatenate([*points, line[done + 1 :]])
    first = 0
    while first + 1 < len(whole):
        ahead = whole[first : first + _MOST_POINTS]
        span = (np.maximum.accumulate(ahead) - np.minimum.accumulate(ahead)).max(axis=1)
        last = first + max(int(np.searchsorted(span, longest, side="right")) - 1, 1)
        yield whole[first : last + 1]
        first = last


def points_along(line: Floats, distance: Floats) -> Floats:
    """Return the points of a line, (n, 2), at distances from its start, (m, 2)."""
    step = np.hypot(*np.diff(line, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(step)])
    moving = np.concatenate([[True], step > 0])  # np.interp wants distances that increase
    return np.column_stack([np.interp(distance, along[moving], line[moving, axis]) for axis in (0, 1)])


def sample_line(line: Floats, grid: Grid) -> tuple[Floats, float]:
    """Return points in the middle of even parts of a line, half a pixel apart, and the length of a part, m."""
    length = np.cumsum(np.hypot(*np.diff(line, axis=0).T))[-1]
    count = max(1, int(np.ceil(length / (_STEP * grid.pixel_size))))
    return points_along(line, (np.arange(count) + 0.5) * (length / count)), float(length / count)
