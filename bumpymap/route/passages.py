"""Search over the areas of tiles: ways through tiles that obstacles split, which a search over tiles does not know.

passage.tif numbers the areas of each tile in which the middle of the vehicle can move. They are the nodes of a graph;
where pixels of two areas touch across the border of their tiles is an arc. So there is a path in the graph exactly
where there is a way on pixels. Nodes that are two or three arcs apart are joined straight as well, so that a path is
not as long as the steps of a staircase. The way is then searched on the pixels of all tiles that lie on a path which
costs little more than the cheapest.
"""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse import csgraph

from bumpymap.core import Floats, slope_cost
from bumpymap.route.ground import CostGround, points_along, window_around
from bumpymap.route.places import on_grid
from bumpytiles import TileWindow

_PAD_TILES, _PAD_SHARE = 24, 0.25
"""Tiles around start and goal that are read first: at least, and as a share of their distance (chosen)."""
_DEARER = 1.06
"""Cost of paths whose nodes are searched on pixels, as a multiple of the best (chosen)."""
_SECTION_TILES, _AROUND_TILES = 96, 12
"""Longest path that is searched at once, and margin around a section of a longer one, tiles (chosen)."""
_TINY = 1e-9
"""Least cost of an arc: sparse graphs take 0 for none."""
BYTES_PER_TILE = 7000
"""Memory that the graph takes."""


class AreaGraph(NamedTuple):
    """The areas of the tiles of a window; n nodes."""

    node: NDArray[np.int32]
    """(rows, pixels, cols, pixels) the node of each pixel, -1 where closed."""
    tile: NDArray[np.int64]
    """(n,) the tile of a node, counted row by row."""
    middle: Floats
    """(n, 2) the mean place of its pixels, tiles south and east of the window's corner."""
    arcs: sparse.csr_array
    """(n, n) cost from node to node, in tiles."""


def first_pad(ground: CostGround, start: Floats, goal: Floats) -> int:
    """Return how many tiles around two points, easting and northing [m], are looked at first."""
    return max(_PAD_TILES, math.ceil(_PAD_SHARE * math.dist(start, goal) / ground.site.grid.tile_size))


def way_over_areas(ground: CostGround, start: Floats, goal: Floats) -> Floats | None:
    """Find the cheapest way on pixels between two points; None if there is none, or the graph needs too much memory.

    ``ground``: the map, with costs; ``start``, ``goal`` (2,): easting and northing, m. Returns (m, 2): easting and
    northing of the corners, m.
    """
    ends = np.array([start, goal])
    pad = first_pad(ground, start, goal)
    while True:
        window = ground.site.window.overlap(window_around(ground.site, ends, pad))
        if window.rows * window.cols * BYTES_PER_TILE > ground.memory_bytes:
            return None
        graph = _graph(ground, window)
        found = _search(graph, *(_node_at(ground, graph, window, end) for end in ends))
        if window == ground.site.window:
            break
        if found is not None:
            row, col = np.divmod(graph.tile[found[1]], window.cols)
            if row.min() > 0 and col.min() > 0 and row.max() < window.rows - 1 and col.max() < window.cols - 1:
                break
        pad *= 2
    if found is None:
        return None
    path, near = found
    corridor = np.zeros(window.rows * window.cols, np.bool_)
    corridor[graph.tile[near]] = True
    corridor = ndimage.binary_dilation(corridor.reshape(window.rows, window.cols), np.ones((3, 3), np.bool_))
    cuts = range(_SECTION_TILES, len(path) - _SECTION_TILES // 2, _SECTION_TILES)
    points = [start, *(_point_in(ground, graph, window, path[at]) for at in cuts), goal]
    line = _on_pixels(ground, points, window, corridor)
    if line is None or len(points) == 2:
        return line
    # The points between sections lie anywhere in their tiles: a way between the middles of sections is free of them.
    again = _on_pixels(ground, [start, *_middles(line, points), goal], window, corridor)
    return again if again is not None else line


def _graph(ground: CostGround, window: TileWindow) -> AreaGraph:
    pixels, (rows, cols) = ground.site.grid.pixels, (window.rows, window.cols)
    apart = np.zeros((rows, pixels + 1, cols, pixels + 1), np.bool_)  # closed lines keep the areas of tiles apart
    apart[:, :-1, :, :-1] = np.isfinite(ground.on_pixels(window)).reshape(rows, pixels, cols, pixels)
    found = np.empty((rows * (pixels + 1), cols * (pixels + 1)), np.int32)
    together = ndimage.generate_binary_structure(2, 2 if ground.joins_corners else 1)
    count = int(ndimage.label(apart.reshape(found.shape), together, output=found))
    node = np.ascontiguousarray(found.reshape(apart.shape)[:, :-1, :, :-1]) - np.int32(1)
    size = np.maximum(np.bincount(node.ravel() + 1, minlength=count + 1)[1:], 1)
    at = [
        np.bincount(node.ravel() + 1, np.broadcast_to(part, node.shape).ravel(), count + 1)[1:] / size
        for part in (
            np.arange(rows)[:, None, None, None] + (np.arange(pixels)[:, None, None] + 0.5) / pixels,
            np.arange(cols)[:, None] + (np.arange(pixels) + 0.5) / pixels,
        )
    ]
    tile = np.floor(at[0]).astype(np.int64) * cols + np.floor(at[1]).astype(np.int64)
    west, east = (part.reshape(rows * pixels, -1) for part in (node[:, :, :-1, -1], node[:, :, 1:, 0]))
    north, south = (part.reshape(rows - 1, -1).T for part in (node[:-1, -1], node[1:, 0]))
    across, along = (_contacts(*sides, count, corners=ground.joins_corners) for sides in ((west, east), (north, south)))
    two = across @ along + along @ across
    joined = sparse.coo_array(across + along + two + across @ two + along @ two)
    a, b = joined.coords
    kept = a != b
    a, b = a[kept], b[kept]
    middle = np.column_stack(at)
    cost, step = ground.on_tiles(window).ravel()[tile].astype(np.float64), (middle[b] - middle[a]).T
    each = cost[a] + cost[b]
    if ground.settings.knows_slope:
        gradient = ground.site.gradient(window).reshape(-1, 2)[tile]
        for end in (a, b):
            more, barred = slope_cost(ground.settings, gradient[end], *step)
            each += np.where(barred, np.inf, more)
    weight = np.hypot(*step) * 0.5 * each
    kept = np.isfinite(weight)
    a, b, weight = a[kept], b[kept], weight[kept]
    return AreaGraph(node, tile, middle, sparse.csr_array((np.maximum(weight, _TINY), (a, b)), joined.shape))


def _contacts(
    first: NDArray[np.int32], other: NDArray[np.int32], count: int, *, corners: bool
) -> sparse.csr_array:  # fmt: skip
    """Return which nodes touch across the borders of tiles, (n, n); with ``corners``, where pixels touch at them alone.

    ``first`` and ``other`` are the nodes of the pixels on both sides, (pixels along the borders, borders).
    """
    one, beyond = first >= 0, other >= 0
    found = [(one & beyond, first, other)]
    if corners:
        found.append((one[:-1] & beyond[1:] & ~one[1:] & ~beyond[:-1], first[:-1], other[1:]))
        found.append((one[1:] & beyond[:-1] & ~one[:-1] & ~beyond[1:], first[1:], other[:-1]))
    pairs = np.unique(np.concatenate([here[at].astype(np.int64) * count + there[at] for at, here, there in found]))
    a, b = np.divmod(pairs, max(count, 1))
    ones = np.ones(2 * len(pairs), np.float32)
    return sparse.csr_array((ones, (np.concatenate([a, b]), np.concatenate([b, a]))), (count, count))


def _node_at(ground: CostGround, graph: AreaGraph, window: TileWindow, point: Floats) -> int:
    """Return the node in which a point lies; -1 in closed pixels."""
    rows, pixels, cols, _ = graph.node.shape
    row, col = (math.floor(x) for x in ground.in_window(point[None], window)[0])
    if not (0 <= row < rows * pixels and 0 <= col < cols * pixels):
        return -1
    return int(graph.node[row // pixels, row % pixels, col // pixels, col % pixels])


def _search(graph: AreaGraph, start: int, goal: int) -> tuple[list[int], NDArray[np.int64]] | None:
    """Return the nodes of the cheapest path, and those on paths that cost little more; None if there is no path."""
    if start < 0 or goal < 0:
        return None
    spent, before = csgraph.dijkstra(graph.arcs, indices=start, return_predecessors=True)
    if not np.isfinite(spent[goal]):
        return None
    left = csgraph.dijkstra(graph.arcs.T, indices=goal, limit=_DEARER * spent[goal] + 1.0)
    path = [goal]
    while path[-1] != start:
        path.append(int(before[path[-1]]))
    near = np.flatnonzero(spent + left <= _DEARER * spent[goal] + 1.0)
    return path[::-1], np.union1d(near, path)


def _point_in(ground: CostGround, graph: AreaGraph, window: TileWindow, node: int) -> Floats:
    """Return the middle of the pixel of a node that is nearest to the middle of the node, easting and northing, m."""
    _, pixels, cols, _ = graph.node.shape
    row, col = divmod(int(graph.tile[node]), cols)
    places = np.argwhere(graph.node[row, :, col, :] == node)
    nearest = places[np.square(places - places.mean(axis=0)).sum(axis=1).argmin()]
    places = (nearest + 0.5 + np.array([row, col]) * pixels)[None] / pixels
    return np.asarray(on_grid(places, ground.site.grid, window)[0])


def _on_pixels(
    ground: CostGround, points: list[Floats], window: TileWindow, corridor: NDArray[np.bool_]
) -> Floats | None:  # fmt: skip
    """Return the cheapest line through points on the pixels of a corridor of tiles, piece by piece."""
    parts = [np.array([points[0]])]
    lone = len(points) == 2
    for ends in pairwise(points):
        if lone:
            rows, cols = np.nonzero(corridor)
            part = TileWindow.around(window.col + cols, window.row + window.rows - 1 - rows)
        else:
            part = window.overlap(window_around(ground.site, np.array(ends), _AROUND_TILES))
        cost = ground.with_room(ground.on_pixels(part))
        top, left = window.row + window.rows - part.row - part.rows, part.col - window.col
        kept = corridor[top : top + part.rows, left : left + part.cols]
        pixels = ground.site.grid.pixels
        cost[~np.repeat(np.repeat(kept, pixels, 0), pixels, 1)] = np.inf
        line = ground.way_on_pixels(cost, np.array(ends), part)
        if line is None and ground.joins_corners:
            line = _over_corners(ground, cost, np.array(ends), part)
        if line is None:
            return None
        parts.append(line[1:])
    return np.concatenate(parts)


def _over_corners(ground: CostGround, cost: NDArray[np.float32], ends: Floats, window: TileWindow) -> Floats | None:
    """Return a line between two points, (2, 2), over corners at which alone free pixels touch; None if there is none.

    ``cost`` is that of the pixels of a window. The cheapest path over pixels tells which corners; between these, from
    the middles of the pixels beside them, lines are searched like any other.
    """
    from skimage.graph import route_through_array  # slow to load, and seldom needed

    places = np.floor(ground.in_window(ends, window)).astype(np.int64)
    is_free = np.isfinite(cost)
    if (places < 0).any() or (places >= is_free.shape).any() or not is_free[tuple(places.T)].all():
        return None
    try:
        pixels = np.array(route_through_array(cost, *places.tolist())[0])
    except ValueError:  # there is no path
        return None
    piece = ndimage.label(is_free)[0][tuple(pixels.T)]
    cuts = np.flatnonzero(np.diff(piece))
    corners = on_grid((pixels + 0.5) / ground.site.grid.pixels, ground.site.grid, window)
    stops = [ends[0], *(corners[at] for cut in cuts for at in (cut, cut + 1)), ends[1]]
    line = [ends[:1]]
    for number_of, part in enumerate(pairwise(stops)):
        found = np.array(part) if number_of % 2 else ground.way_on_pixels(cost, np.array(part), window)
        if found is None:
            return None
        line.append(found[1:])
    return np.concatenate(line)


def _middles(line: Floats, points: list[Floats]) -> list[Floats]:
    """Return the points half way along the parts of a line between the points that it was searched between."""
    at = [int(np.flatnonzero((line == point).all(axis=1))[0]) for point in points]
    parts = [line[first : last + 1] for first, last in pairwise(at)]
    return [points_along(part, 0.5 * np.hypot(*np.diff(part, axis=0).T).cumsum()[-1:])[0] for part in parts]
