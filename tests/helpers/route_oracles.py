"""What ways must be: graphs of scipy, closed forms, and distances of lines to squares by shapely."""

from functools import cache
from itertools import pairwise

import numpy as np
import shapely
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from bumpymap.route.search import Costs


def smooth_field(rng, shape, *, most=8.0, width=2, closed=0.0):
    """Costs from 1 to ``most``, smoothed over ``width`` tiles; the dearest share is closed."""
    cost = rng.random(shape)
    for axis in (0, 1):
        for _ in range(width):
            cost = (cost + np.roll(cost, 1, axis)) / 2
    cost = (cost - cost.min()) / (cost.max() - cost.min())
    limit = np.quantile(cost, 1.0 - closed)
    return np.where(cost > limit, np.inf, 1.0 + (most - 1.0) * cost).astype(np.float32)


def by_heading(rng, cost):
    """The same field with a cost of its own along each axis."""
    return np.maximum(cost[..., None] * rng.uniform(0.5, 2.0, (*cost.shape, 8)), 1.0).astype(np.float32)


def with_slope(rng, cost, steepest=0.25):
    """The same field with slopes of up to a half or so."""
    gradient = rng.normal(0.0, 0.15, (*cost.shape[:2], 2)).astype(np.float32)
    return Costs(cost if cost.ndim == 3 else cost[..., None], gradient, 6.0, 2.0, 3.0, steepest)


def crossed(row, col):
    """(tile, share) of a move by brute force: the share of it in each tile, from cuts at all borders, ends included."""
    cuts = {0.0, 1.0}
    for delta in (row, col):
        cuts |= {(k + 0.5) / abs(delta) for k in range(abs(delta))}
    cuts = sorted(cuts)
    return [
        ((int(np.floor(0.5 + row * (a + b) / 2)), int(np.floor(0.5 + col * (a + b) / 2))), b - a)
        for a, b in pairwise(cuts)
        if b - a > 1e-12
    ]


@cache
def near_tiles(row, col, margin):
    """Tiles whose squares are nearer than a margin to a move."""
    line = shapely.LineString([(0.5, 0.5), (col + 0.5, row + 0.5)])
    r, c = np.mgrid[-5:6, -5:6]
    near = shapely.distance(line, shapely.box(c, r, c + 1, r + 1)) < max(margin, 1e-6) - 1e-9
    return np.column_stack([r[near], c[near]])


def along(cost, row, col):
    """Costs of tiles in a direction: (rows, cols, 8) between two axes, by tangents; and what slopes add to them."""
    if isinstance(cost, tuple):
        south, east = np.moveaxis(cost.gradient.astype(np.float64), -1, 0)
        off, steep = np.arctan2(row, col) - np.arctan2(south, east), np.hypot(south, east)
        rise, across = steep * np.cos(off), steep * np.abs(np.sin(off))
        more = np.where(rise > 0.0, cost.climb, -cost.descent) * rise + cost.side * across
        return along(cost.tiles, row, col) + np.where(across > cost.steepest, np.inf, more)
    if cost.ndim == 2 or cost.shape[2] == 1:
        return cost.reshape(cost.shape[:2])
    azimuth = np.degrees(np.arctan2(col, -row)) % 180.0
    lower, main = np.floor(azimuth / 22.5 + 1e-9), 90.0 * np.round(azimuth / 90.0)
    first, here, last = np.tan(np.radians(np.array([22.5 * lower, azimuth, 22.5 * (lower + 1)]) - main))
    low, high = (cost[..., int(axis) % 8].astype(np.float64) for axis in (lower, lower + 1))
    share = (here - first) / (last - first)
    return low if share == 0.0 else low * (1.0 - share) + high * share


def move_graph(cost, moves, margin):
    """All moves of a window as a sparse graph; a move is there if no closed square is nearer than the margin."""
    is_open = np.isfinite(along(cost.tiles if isinstance(cost, tuple) else cost, 1, 0))
    rows, cols = is_open.shape
    ring, closed = np.full((rows + 10, cols + 10), np.inf), np.pad(~is_open, 5, constant_values=True)
    starts, ends, weights = [], [], []
    i, j = np.nonzero(is_open)
    for row, col in moves.tolist():
        ring[5:-5, 5:-5] = along(cost, row, col)
        total = np.hypot(row, col) * sum(share * ring[i + r + 5, j + c + 5] for (r, c), share in crossed(row, col))
        for r, c in near_tiles(row, col, margin):
            total[closed[i + r + 5, j + c + 5]] = np.inf
        kept = np.isfinite(total)
        starts.append((i * cols + j)[kept])
        ends.append(((i + row) * cols + j + col)[kept])
        weights.append(total[kept])
    pairs = np.concatenate(starts), np.concatenate(ends)
    return csr_array((np.concatenate(weights), pairs), shape=(rows * cols, rows * cols))


def reach_by_graph(cost, moves, margin, tile):
    """(rows, cols) cost from the middle of a tile to all others."""
    rows, cols = (cost.tiles if isinstance(cost, tuple) else cost).shape[:2]
    return dijkstra(move_graph(cost, moves, margin), indices=tile[0] * cols + tile[1]).reshape(rows, cols)


def gap_to_closed(cost, line):
    """Least distance of a line to closed tiles of the window."""
    path, (row, col) = shapely.LineString(np.asarray(line)[:, ::-1]), np.nonzero(~np.isfinite(cost))
    return float(shapely.distance(path, shapely.box(col, row, col + 1, row + 1)).min(initial=np.inf))


def cheapest_on_pixels(cost, start, goal, pixel):
    """Cost [m] of the cheapest path over pixels in eight directions; inf if there is none.

    A move past a corner needs the pixels beside it to be free.
    """
    rows, cols = cost.shape
    free, number = np.isfinite(cost), np.arange(cost.size).reshape(cost.shape)
    parts = []
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = np.s_[: rows - down, max(0, -right) : cols - max(0, right)]
        there = np.s_[down:, max(0, right) : cols + min(0, right)]
        corners = np.s_[: rows - down, max(0, right) : cols + min(0, right)], np.s_[down:, here[1].start : here[1].stop]
        kept = free[here] & free[there] & free[corners[0]] & free[corners[1]]
        length = np.hypot(down, right) * pixel
        parts.append((number[here][kept], number[there][kept], length * 0.5 * (cost[here][kept] + cost[there][kept])))
    first, last, weight = (np.concatenate(each) for each in zip(*parts, strict=True))
    graph = csr_array((weight.astype(np.float64), (first, last)), (cost.size,) * 2)
    return dijkstra(graph, directed=False, indices=number[tuple(start)])[number[tuple(goal)]]
