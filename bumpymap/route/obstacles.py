"""Obstacles beside a way: where the vehicle would touch one, by the pixels of obstacle.tif.

A tile with an obstacle is passable if the vehicle can get through it somewhere. A way that is planned on tiles does not
know where, so it is checked against the pixels.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from bumpymap.core import OBSTACLE
from bumpymap.layers import RouteMap
from bumpytiles import Grid, TileWindow

__all__ = ["NearObstacles", "Touches", "find_near_obstacles", "sample_line", "touches_along"]

Floats = NDArray[np.float64]

_STRETCH_TILES = 32
"""Longest stretch that is looked at together, tiles: 512 x 512 pixels of 0.2 m."""
_STEP = 0.5
"""Distance of the points of a line that are examined, in pixels."""


@dataclass(frozen=True, slots=True)
class NearObstacles:
    """Obstacles that are nearer to a line than the vehicle may come."""

    tiles: NDArray[np.int64]
    """(n, 2) column and row of the tiles that hold them, each once."""
    length: float
    """Length of the line that is too near, m."""


@dataclass(frozen=True, slots=True)
class Touches:
    """Which points are too near to an obstacle."""

    near: NDArray[np.bool_]
    """(n,)."""
    tiles: NDArray[np.int64]
    """(k, 2) column and row of the tile of the nearest obstacle, of each point that is too near."""


def find_near_obstacles(site: RouteMap, line: Floats, reach: float) -> NearObstacles:
    """Find the obstacles that are nearer to a line than ``reach``.

    Parameters
    ----------
    site : RouteMap
        The map; `RouteMap.objects` is used.
    line : array (m, 2)
        Easting and northing of the corners, m.
    reach : float
        From the line to the middle of a pixel with an obstacle, m.
    """
    points, step = sample_line(line, site.grid)
    found = touches_along(site, points, reach)
    return NearObstacles(np.unique(found.tiles, axis=0), float(found.near.sum()) * step)


def sample_line(line: Floats, grid: Grid) -> tuple[Floats, float]:
    """Return points in the middle of even parts of a line, half a pixel apart, and the length of a part, m."""
    parts = np.hypot(*np.diff(line, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(parts)])
    count = max(1, int(np.ceil(along[-1] / (_STEP * grid.pixel_size))))
    moving = np.concatenate([[True], parts > 0])
    distance = (np.arange(count) + 0.5) * (along[-1] / count)
    points = np.column_stack([np.interp(distance, along[moving], line[moving, axis]) for axis in (0, 1)])
    return points, float(along[-1] / count)


def touches_along(site: RouteMap, points: Floats, reach: float) -> Touches:
    """Find which points of a line are nearer to an obstacle than ``reach``; see `find_near_obstacles`."""
    size = max(1, int(_STRETCH_TILES * site.grid.pixels / _STEP))
    found = [_of_stretch(site, points[first : first + size], reach) for first in range(0, len(points), size)]
    return Touches(np.concatenate([each.near for each in found]), np.concatenate([each.tiles for each in found]))


def _of_stretch(site: RouteMap, points: Floats, reach: float) -> Touches:
    """Look at some points in one window."""
    pixel = site.grid.pixel_size
    window = _window(site, points, reach)
    row, col = np.nonzero(site.objects(window) == OBSTACLE)
    if not len(row):
        return Touches(np.zeros(len(points), np.bool_), np.empty((0, 2), np.int64))
    north = (window.row + window.rows) * site.grid.tile_size
    easting, northing = (window.col * site.grid.pixels + col + 0.5) * pixel, north - (row + 0.5) * pixel
    # Sliding midpoints: pixels lie on a grid, on which medians split badly.
    tree = KDTree(np.column_stack([easting, northing]), balanced_tree=False, compact_nodes=False)
    distance, nearest = tree.query(points, distance_upper_bound=reach)
    near = distance < reach
    place = nearest[near]
    return Touches(near, np.column_stack([site.grid.index(easting[place]), site.grid.index(northing[place])]))


def _window(site: RouteMap, points: Floats, reach: float) -> TileWindow:
    """Return the tiles around points, with all that is within reach."""
    low, high = points.min(axis=0) - reach, points.max(axis=0) + reach
    col, row = site.grid.index(np.array([low[0], high[0]])), site.grid.index(np.array([low[1], high[1]]))
    return TileWindow.around(col, row)
