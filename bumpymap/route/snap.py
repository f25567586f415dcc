"""A start or goal on ground that is closed: the nearest point that can be used, and a message that names it."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BARRED_TEXT, NO_TILE, BadInputError, Barred, TileField
from bumpymap.layers import RouteMap
from bumpymap.route.places import GridPoint, place_in_window
from bumpytiles import TileWindow

__all__ = ["NearestPoint", "nearest_usable", "place_text", "usable_point"]

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
