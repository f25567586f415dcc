"""Steer a way past obstacles: where it would touch one, it is planned again on the pixels of obstacle.tif.

Tiles tell that a vehicle gets through, pixels where. A way is cut into sections between points that are clear of
obstacles; each section that touches one is searched again on the pixels around it, of which those are closed that
lie nearer to an obstacle or a closed tile than the vehicle may come.
"""

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, distance_transform_edt

from bumpymap.core import OBSTACLE, Barred
from bumpymap.layers import RouteMap
from bumpymap.route.obstacles import sample_line, touches_along
from bumpymap.route.search import find_way
from bumpytiles import TileWindow

__all__ = ["steer_clear"]

Floats = NDArray[np.float64]
Load = Callable[[TileWindow], NDArray[np.float32]]
"""Gives the cost per metre of each tile of a window, infinite where closed."""

_SECTION_TILES = 24
"""Usual length of a section."""
_LONGEST_TILES = 96
"""A longer section without a point that is clear is left as it is."""
_AROUND_TILES = 5
"""How far beside a section a way round obstacles is searched."""
_ROUNDING = 1e-9
"""By how much distances between pixels may be shorter, m."""
_SAVING_M = 0.003
"""What a corner saves at least, m of level ground."""


def steer_clear(site: RouteMap, line: Floats, load: Load, reach: float) -> Floats:
    """Return a line that keeps ``reach`` from obstacles where that is possible nearby.

    Parameters
    ----------
    site : RouteMap
        The map.
    line : array (m, 2)
        Easting and northing of the corners, m; clear of closed tiles.
    load : callable
        Gives the costs of a window of tiles.
    reach : float
        From the line to the middle of a pixel with an obstacle, m.

    Returns
    -------
    array (k, 2)
        Between the same ends. Sections for which no way was found are those of the given line.
    """
    points, step = sample_line(line, site.grid)
    touches = touches_along(site, points, reach).near
    if not touches.any() or step == 0.0:
        return line
    size = site.grid.tile_size
    cuts = _cuts(~touches, _SECTION_TILES * size / step, len(points))
    parts = [line[:1]]
    for first, last in pairwise(cuts):
        part = _between(line, points, first, last, step)
        if touches[first : last + 1].any() and (last - first) * step <= _LONGEST_TILES * size:
            steered = _search(site, part, load, reach)
            part = part if steered is None else steered
        parts.append(part[1:])
    return np.concatenate(parts)


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


def _search(site: RouteMap, part: Floats, load: Load, reach: float) -> Floats | None:
    """Search a section on pixels; None if there is no way."""
    grid = site.grid
    window = _window(site, part)
    cost = load(window)
    by_obstacles = site.read(window, ()).barred == Barred.OBSTACLE
    tiles, beside = (np.repeat(np.repeat(each, grid.pixels, 0), grid.pixels, 1) for each in (cost, by_obstacles))
    # Of a tile that obstacles close, the vehicle may overlap what is free.
    closed, stones = np.isinf(tiles) & ~beside, site.objects(window) == OBSTACLE
    pixel = grid.pixel_size
    room = np.minimum(_gap(closed) * pixel - reach, _gap(stones) * pixel - (reach - 0.5 * pixel))
    north = (window.row + window.rows) * grid.tile_size
    west = window.col * grid.tile_size
    places = np.column_stack([north - part[:, 1], part[:, 0] - west]) / grid.pixel_size
    blocked = room < -_ROUNDING
    for row, col in places[[0, -1]]:  # the vehicle stands there, whatever is beside it, and gets no nearer to that
        blocked &= ~_leads_away(room, row, col, reach / pixel) | closed | stones
    start, goal = ((float(row), float(col)) for row, col in places[[0, -1]])
    open_cost = np.where(blocked, np.float32(np.inf), tiles)
    found = find_way(open_cost, start, goal, least_saving=_SAVING_M / grid.pixel_size)
    if found is None:
        return None
    line = np.column_stack([west + found.line[:, 1] * grid.pixel_size, north - found.line[:, 0] * grid.pixel_size])
    line[0], line[-1] = part[0], part[-1]
    return line


def _gap(marked: NDArray[np.bool_]) -> Floats:
    """Return the distance of each pixel, a full square, to the nearest marked one, in pixels; 0 if they touch."""
    if not marked.any():
        return np.full(marked.shape, np.inf)
    gap: Floats = distance_transform_edt(~binary_dilation(marked, np.ones((3, 3), np.bool_)))
    return gap


def _leads_away(room: Floats, row: float, col: float, reach: float) -> NDArray[np.bool_]:
    """Return the pixels within reach of a point that have as much room as the pixel that it lies in."""
    near = np.zeros(room.shape, np.bool_)
    top, left = max(math.floor(row - reach), 0), max(math.floor(col - reach), 0)
    part = slice(top, math.ceil(row + reach) + 1), slice(left, math.ceil(col + reach) + 1)
    rows, cols = np.indices(room[part].shape)
    near[part] = np.hypot(rows + top + 0.5 - row, cols + left + 0.5 - col) <= reach
    near &= room >= room[math.floor(row), math.floor(col)]
    return near


def _window(site: RouteMap, part: Floats) -> TileWindow:
    """Return the tiles around a section."""
    inner = TileWindow.around(site.grid.index(part[:, 0]), site.grid.index(part[:, 1]))
    ring = _AROUND_TILES
    return TileWindow(inner.col - ring, inner.row - ring, inner.cols + 2 * ring, inner.rows + 2 * ring)
