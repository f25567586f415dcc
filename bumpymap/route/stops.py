"""The points that a way must pass: read, placed on the map, moved off closed ground where that is allowed."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BARRED_TEXT, NO_TILE, BadInputError, Barred, TileField
from bumpymap.layers import RouteMap, read_points
from bumpymap.route.ground import CostGround
from bumpymap.route.places import GridPoint, parse_point, place_in_window, place_point
from bumpymap.route.planner import Planner
from bumpymap.route.reach import window_within
from bumpymap.route.settings import RouteConfig
from bumpytiles import TileWindow

__all__ = ["NearestPoint", "Stops", "find_stops", "nearest_usable", "place_text", "usable_point"]

_MARGIN = 0.25
"""Default distance of a found point from the sides of its tile, in tiles."""
_ALWAYS_M = 1.0
"""A point that is no farther from where the vehicle fits is moved there without being asked, m."""
_FIRST_REACH = 8
"""Cells around a point that are examined first."""


@dataclass(frozen=True, slots=True)
class NearestPoint:
    """A point in an open tile."""

    row: float
    """Distance south of the window's north edge, in tiles."""
    col: float
    """Distance east of its west edge, in tiles."""
    distance: float
    """From the given point, in tiles; 0 if that lies in an open tile itself."""


def nearest_usable(
    is_open: NDArray[np.bool_], row: float, col: float, *, margin: float = _MARGIN
) -> NearestPoint | None:
    """Return the nearest point in an open tile, at least ``margin`` from the sides of that tile.

    A point that lies in an open tile is returned as it is. Of points equally near, the northernmost tile counts, then
    the westernmost.

    Parameters
    ----------
    is_open : bool (rows, cols)
        Tiles that can be used.
    row, col : float
        The point, in tiles south and east of the window's north-west corner; it may lie outside the window.
    margin : float
        From 0 to 0.5, tiles.

    Returns
    -------
    NearestPoint or None
        None if no tile is open.
    """
    rows, cols = is_open.shape
    i, j = math.floor(row), math.floor(col)
    if 0 <= i < rows and 0 <= j < cols and is_open[i, j]:
        return NearestPoint(row, col, 0.0)
    reach = _FIRST_REACH + int(max(0, -i, i - rows + 1, -j, j - cols + 1))
    while True:
        top, left = max(i - reach, 0), max(j - reach, 0)
        found = _nearest(is_open[top : i + reach + 1, left : j + reach + 1], row - top, col - left, margin)
        is_all = top == 0 and left == 0 and i + reach + 1 >= rows and j + reach + 1 >= cols
        # A tile beyond what was examined is at least ``reach`` away.
        if found is not None and (is_all or found.distance <= reach):
            return NearestPoint(found.row + top, found.col + left, found.distance)
        if is_all:
            return None
        reach *= 2


def _nearest(is_open: NDArray[np.bool_], row: float, col: float, margin: float) -> NearestPoint | None:
    """Return the nearest point in any open tile of a small window."""
    north, west = np.nonzero(is_open)
    if not len(north):
        return None
    rows = np.clip(row, north + margin, north + 1.0 - margin)
    cols = np.clip(col, west + margin, west + 1.0 - margin)
    distance = np.hypot(rows - row, cols - col)
    nearest = int(distance.argmin())
    return NearestPoint(float(rows[nearest]), float(cols[nearest]), float(distance[nearest]))


def usable_point(
    route_map: RouteMap,
    field: TileField,
    cost: NDArray[np.float32],
    point: GridPoint,
    *,
    name: str = "the start",
    snap_m: float = 0.0,
    margin: float = _MARGIN,
) -> GridPoint:
    """Return a point itself if the vehicle can stand there, else the nearest where it can, if that is near enough.

    Parameters
    ----------
    route_map : RouteMap
    field : TileField
        A window around the point.
    cost : float32 (rows * k, cols * k)
        Of the cells of that window, k along each side of a tile, infinite where closed.
    point : GridPoint
    name : str
        How a message calls the point.
    snap_m : float
        Greatest distance to a point that is taken in the place of the given one, m. Up to 1 m is always taken.
    margin : float
        Distance of that point from the sides of its cell, cells.

    Raises
    ------
    BadInputError
        The cell is closed, and nothing can be used within ``snap_m``: why, and where the nearest usable point is.
    """
    window, cells = field.window, len(cost) // field.window.rows
    size = field.grid.tile_size / cells
    row, col = (cells * at for at in place_in_window(point, field.grid, window))
    found = nearest_usable(np.isfinite(cost), row, col, margin=margin)
    if found is not None and found.distance == 0.0:
        return point
    near = None
    if found is not None:
        west, north = window.col * field.grid.tile_size, (window.row + window.rows) * field.grid.tile_size
        near = GridPoint(west + found.col * size, north - found.row * size)
        if found.distance * size <= max(snap_m, _ALWAYS_M):
            return near
    raise BadInputError(
        f"{name} lies on {_closed_by(field, row / cells, col / cells)}. {_remedy(route_map, point, near, window)}"
    )


def _closed_by(field: TileField, row: float, col: float) -> str:
    """Say what closes the tile at a point."""
    rows, cols = field.barred.shape
    i, j = math.floor(row), math.floor(col)
    code = int(field.barred[i, j]) if 0 <= i < rows and 0 <= j < cols else NO_TILE
    if code == NO_TILE:
        return "a tile without points, of which nothing is known"
    if code in {Barred.NO, Barred.SPLIT}:
        return (
            "ground that is closed: the vehicle does not fit beside an obstacle or other closed ground, or `avoid` or "
            "`only` closes it"
        )
    if code == Barred.UNKNOWN:
        return "unknown ground; `unknown=COST` lets a way cross unknown ground at that cost per metre"
    return f"a tile that is not passable ({BARRED_TEXT[Barred(code)]})"


def _remedy(route_map: RouteMap, point: GridPoint, near: GridPoint | None, window: TileWindow) -> str:
    """Say where the nearest usable point is and how to take it."""
    if near is None:
        width, height = (side * route_map.grid.tile_size for side in (window.cols, window.rows))
        return f"No tile in the {width:,.0f} m x {height:,.0f} m around it can be used: choose another point"
    distance = math.dist(point, near)
    return (
        f"The nearest point that can be used is {distance:.1f} m away, at {place_text(route_map, near)}: give that "
        f"one, or `snap={math.ceil(distance)}` to take it"
    )


def place_text(route_map: RouteMap, point: "GridPoint | NDArray[np.float64]") -> str:
    """Write a point (easting, northing, m) as an option of the command takes it."""
    if route_map.has_crs:
        longitude, latitude = route_map.to_lonlat(float(point[0]), float(point[1]))
        return f"{longitude:.7f},{latitude:.7f} (longitude, latitude)"
    x, y = route_map.to_crs(float(point[0]), float(point[1]))
    return f"crs:{x:.2f},{y:.2f}"


_NEAR_M, _LOOK_M = 30.0, 150.0
"""How far from a point ground that can be used is looked for: first, and for a message, m."""


@dataclass(frozen=True, slots=True)
class Stops:
    """Start, points to pass and goal."""

    points: NDArray[np.float64]
    """(k, 2) easting and northing, m, on ground that can be used."""
    names: tuple[str, ...]
    """(k,) how a message calls each of them."""
    notes: tuple[str, ...]
    """What was moved."""

    def in_order(self, order: Sequence[int]) -> "Stops":
        """Return some of the stops, in another order; a stop may be there twice."""
        return replace(self, points=self.points[list(order)], names=tuple(self.names[at] for at in order))


def find_stops(planner: Planner, config: RouteConfig, compared: Path | None = None) -> Stops:
    """Return the points that the settings name.

    Parameters
    ----------
    planner : Planner
    config : RouteConfig
    compared : Path, optional
        The layers if they are those of another vehicle, which messages then name.

    Raises
    ------
    BadInputError
        A point does not lie on the map, or on ground that cannot be used.
    """
    vehicle = planner.site.vehicle.name
    where, of = ("", "") if compared is None else (f"in {compared} ({vehicle}), ", f"{vehicle}: ")
    named = _named(planner, config)
    points = [_usable(planner, where + name, point, config.snap) for name, point in named]
    names, notes = [], []
    for (name, point), used in zip(named, points, strict=True):
        if used == point:
            names.append(name)
            continue
        moved = f"moved by {math.dist(point, used):.1f} m"
        names.append(f"{name} ({moved})")
        notes.append(f"{of}{name} was {moved} to ground that can be used")
    return Stops(np.array(points), tuple(names), tuple(notes))


def _named(planner: Planner, config: RouteConfig) -> list[tuple[str, GridPoint]]:
    """Return the points by name."""
    site = planner.site
    if config.points is not None:
        found = read_points(config.points)
        if len(found) < 2:
            raise BadInputError(f"{config.points} holds one point; a way needs at least a start and a goal")
        names = [f"point {point.name} of {config.points}" for point in found]
        return [
            (name, place_point(point.x, point.y, site, point.system, name=name, beyond_m=config.snap))
            for name, point in zip(names, found, strict=True)
        ]
    texts = [("start", config.start), *(("point to pass", via) for via in config.via), ("goal", config.goal)]
    return [
        (f"the {name} {text}", parse_point(text, site, beyond_m=config.snap))
        for name, text in texts
        if text is not None
    ]


def _usable(planner: Planner, name: str, point: GridPoint, snap_m: float) -> GridPoint:
    """Return a point, or the nearest pixel on which the vehicle fits. Raises BadInputError if that is too far."""
    site, size = planner.site, planner.site.grid.tile_size
    cells, margin = site.grid.pixels, 0.5
    reach, most = (math.ceil(metres / size) + 1 for metres in (_NEAR_M, max(snap_m, _LOOK_M)))
    while True:
        window = window_within(site.window, np.array(point) / size, reach)
        cost = CostGround(planner).on_pixels(window)
        place = (cells * at for at in place_in_window(point, site.grid, window))
        found = nearest_usable(np.isfinite(cost), *place, margin=margin)
        too_many = 4 * window.cols * window.rows * cells**2 > planner.memory_tiles
        # What lies outside the window is at least ``reach`` away.
        if (
            (found is not None and found.distance <= reach * cells)
            or reach >= most
            or window == site.window
            or too_many
        ):
            break
        reach = min(2 * reach, most)
    field = site.read(window, planner.bands)
    return usable_point(site, field, cost, point, name=name, snap_m=snap_m, margin=margin)
