"""The points that a way must pass: read, placed on the map, moved off closed ground where that is allowed."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BARRED_TEXT, CROSSING_UNKNOWN, NO_TILE, OPEN_THROUGH, BadInputError, Barred, TileField
from bumpymap.layers import MapReader, read_points
from bumpymap.route.ground import CostGround
from bumpymap.route.places import GridPoint, parse_point, place_in_window, place_point, window_within
from bumpymap.route.settings import RouteConfig

_ALWAYS_M = 1.0
"""Distance up to which a point is moved to where the vehicle fits without being asked, m (chosen)."""


def _nearest(is_open: NDArray[np.bool_], row: float, col: float) -> tuple[float, float, float] | None:
    """Return the nearest place on open pixels, and how far it is: the middle of a pixel, if the given one is closed.

    Of pixels equally near, the northernmost counts, then the westernmost; None if none is open.
    """
    i, j = math.floor(row), math.floor(col)
    if 0 <= i < is_open.shape[0] and 0 <= j < is_open.shape[1] and is_open[i, j]:
        return row, col, 0.0
    rows, cols = np.nonzero(is_open)
    if not len(rows):
        return None
    apart = np.hypot(rows + 0.5 - row, cols + 0.5 - col)
    at = int(apart.argmin())
    return float(rows[at]) + 0.5, float(cols[at]) + 0.5, float(apart[at])


def _closed_by(field: TileField, row: float, col: float, seen_width: float | None) -> str:
    rows, cols = field.barred.shape
    i, j = math.floor(row), math.floor(col)
    code = int(field.barred[i, j]) if 0 <= i < rows and 0 <= j < cols else NO_TILE
    if code == NO_TILE:
        return "a tile without points, of which nothing is known"
    if seen_width is not None and code in OPEN_THROUGH and not field.smallest_object[i, j] <= seen_width:
        return f"ground where objects of {seen_width:g} m would not be seen, which `seen_width` closes"
    if code in {Barred.NO, Barred.SPLIT}:
        return (
            "ground that is closed: the vehicle does not fit beside an obstacle or other closed ground, or `avoid` or "
            "`only` closes it"
        )
    if code in CROSSING_UNKNOWN:
        return f"{BARRED_TEXT[Barred(code)]}; `unknown=COST` lets a way cross unknown ground at that cost per metre"
    return f"a tile that is not passable ({BARRED_TEXT[Barred(code)]})"


def place_text(route_map: MapReader, point: "GridPoint | NDArray[np.float64]") -> str:
    """Write a point (easting, northing, m) as an option of the command takes it."""
    if route_map.has_crs:
        longitude, latitude = route_map.to_lonlat(float(point[0]), float(point[1]))
        return f"{longitude:.7f},{latitude:.7f} (longitude, latitude)"
    x, y = route_map.to_crs(float(point[0]), float(point[1]))
    return f"crs:{x:.2f},{y:.2f}"


_NEAR_M, _LOOK_M = 30.0, 150.0
"""Distance from a point up to which ground that can be used is searched: first, and for a message, m (chosen)."""


@dataclass(frozen=True, slots=True)
class Stops:
    """Start, points to pass and goal."""

    points: NDArray[np.float64]
    """(k, 2) easting and northing, m, on ground that can be used."""
    names: tuple[str, ...]
    """(k,) how a message calls each of them."""
    notes: tuple[str, ...]
    """Remarks on points that were moved."""

    def in_order(self, order: Sequence[int]) -> "Stops":
        """Return some of the stops, in another order; a stop may be there twice."""
        return replace(self, points=self.points[list(order)], names=tuple(self.names[at] for at in order))


def find_stops(ground: CostGround, config: RouteConfig) -> Stops:
    """Return the points that the settings name. Raises BadInputError: one is off the map, or on ground of no use."""
    named = _named(ground.site, config)
    points = [usable_point(ground, name, point, config.snap) for name, point in named]
    names, notes = [], []
    for (name, point), used in zip(named, points, strict=True):
        if used == point:
            names.append(name)
            continue
        moved = f"moved by {math.dist(point, used):.1f} m"
        names.append(f"{name} ({moved})")
        notes.append(f"{name} was {moved} to ground that can be used")
    return Stops(np.array(points), tuple(names), tuple(notes))


def _named(site: MapReader, config: RouteConfig) -> list[tuple[str, GridPoint]]:
    if config.points is not None:
        found = read_points(config.points)
        if len(found) < 2:
            raise BadInputError(f"{config.points} holds one point; a way needs at least a start and a goal")
        named = [(f"point {point.name} of {config.points}", point) for point in found]
        return [
            (name, place_point(point.x, point.y, site, point.system, name=name, beyond_m=config.snap))
            for name, point in named
        ]
    texts = [("start", config.start), *(("point to pass", via) for via in config.via), ("goal", config.goal)]
    return [
        (f"the {name} {text}", parse_point(text, site, beyond_m=config.snap))
        for name, text in texts
        if text is not None
    ]


def usable_point(ground: CostGround, name: str, point: GridPoint, snap_m: float) -> GridPoint:
    """Return a point, or the nearest pixel on which the vehicle fits. Raises BadInputError if that is too far."""
    site, grid = ground.site, ground.site.grid
    size, cells = grid.tile_size, grid.pixels
    reach, farthest = (math.ceil(metres / size) + 1 for metres in (_NEAR_M, max(snap_m, _LOOK_M)))
    while True:
        window = window_within(site.window, np.array(point) / size, reach)
        row, col = (cells * at for at in place_in_window(point, grid, window))
        found = _nearest(np.isfinite(ground.on_pixels(window)), row, col)
        # What lies outside the window is at least ``reach`` away.
        is_nearest = found is not None and found[2] <= reach * cells
        too_many = 4 * window.cols * window.rows * cells**2 > ground.memory_tiles
        if is_nearest or reach >= farthest or window == site.window or too_many:
            break
        reach = min(2 * reach, farthest)
    width, height = (side * size for side in (window.cols, window.rows))
    remedy = f"No tile in the {width:,.0f} m x {height:,.0f} m around it can be used: choose another point"
    if found is not None:
        south, east, apart = found
        if apart == 0.0:
            return point
        near = GridPoint(
            window.col * size + east * grid.pixel_size, (window.row + window.rows) * size - south * grid.pixel_size
        )
        if apart * grid.pixel_size <= max(snap_m, _ALWAYS_M):
            return near
        distance = math.dist(point, near)
        remedy = (
            f"The nearest point that can be used is {distance:.1f} m away, at {place_text(site, near)}: give that one, "
            f"or `snap={math.ceil(distance)}` to take it"
        )
    why = _closed_by(site.read(window, ground.bands), row / cells, col / cells, ground.settings.seen_width)
    raise BadInputError(f"{name} lies on {why}. {remedy}")
