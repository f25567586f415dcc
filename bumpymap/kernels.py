"""Compiled kernels: one tile's points in, one tile's numbers out.

Points of a tile come in a canonical order (see ``bumpytiles.split``), so plain sums are reproducible, and the first k
points are a random sample. Scalars and small arrays only; the loop over tiles is ``measure_tiles`` at the end.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["detrend", "fill_holes", "fit_plane_to_points", "measure_tiles", "moments", "ransac_plane", "stray_bounds"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Counts = NDArray[np.int32]
Indices = NDArray[np.int64]
Plane = tuple[float, float, float, float]
"""Unit normal (a, b, c) and d of a x + b y + c z + d = 0."""


def _compiled(function: Callable[..., Any]) -> Any:
    """Compile once and keep the result beside the module or in the user's cache; without either, in every run."""
    try:
        return njit(cache=True, nogil=True)(function)
    except RuntimeError:  # nowhere to write: a read-only installation and no home
        return njit(nogil=True)(function)


_SCORED = 256
"""Points that score a RANSAC candidate; the random order makes the first ones a fair sample."""
_MAX_CANDIDATES = 400
_MISS_PROBABILITY = 1e-4
"""Accepted probability that no candidate was drawn from inliers alone."""
_MIN_TRIANGLE = 1e-3
"""A candidate's three points must span at least this area, m^2."""
_NOTHING = 1e-6
"""Relief below this is rounding, not ground, m."""


@_compiled
def moments(z: Floats) -> tuple[float, float]:
    """Mean and population variance, two passes about the first value (m, m^2)."""
    n = len(z)
    shift = z[0]
    total = 0.0
    for i in range(n):
        total += z[i] - shift
    mean = total / n
    squares = 0.0
    for i in range(n):
        d = z[i] - shift - mean
        squares += d * d
    return shift + mean, squares / n


@_compiled
def _next_random(state: np.uint64) -> tuple[np.uint64, np.uint64]:
    """One step of splitmix64: the new state and 64 mixed bits."""
    state = state + np.uint64(0x9E3779B97F4A7C15)
    z = state
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return state, z ^ (z >> np.uint64(31))


@_compiled
def fit_plane_to_points(x: Floats, y: Floats, z: Floats, use: Mask) -> Plane:
    """Least-squares plane through the points where ``use``: unit normal (upward) and offset d of n . p + d = 0.

    Regression along the axis whose 2 x 2 minor of the scatter matrix is the largest, so that steep planes are fitted
    as well as level ones. Returns a zero normal where the points lie on a line.
    """
    n = 0
    mx = my = mz = 0.0
    for i in range(len(x)):
        if use[i]:
            n += 1
            mx += x[i]
            my += y[i]
            mz += z[i]
    if n < 3:
        return 0.0, 0.0, 0.0, 0.0
    mx /= n
    my /= n
    mz /= n
    xx = xy = xz = yy = yz = zz = 0.0
    for i in range(len(x)):
        if use[i]:
            dx, dy, dz = x[i] - mx, y[i] - my, z[i] - mz
            xx += dx * dx
            xy += dx * dy
            xz += dx * dz
            yy += dy * dy
            yz += dy * dz
            zz += dz * dz
    minor_z = xx * yy - xy * xy
    minor_y = xx * zz - xz * xz
    minor_x = yy * zz - yz * yz
    if minor_z >= minor_y and minor_z >= minor_x:
        a, b, c = xy * yz - xz * yy, xy * xz - yz * xx, minor_z
    elif minor_y >= minor_x:
        a, b, c = xz * yz - xy * zz, minor_y, xy * xz - yz * xx
    else:
        a, b, c = minor_x, xz * yz - xy * zz, xy * yz - xz * yy
    length = math.sqrt(a * a + b * b + c * c)
    scatter = xx + yy + zz
    if length <= 1e-12 * scatter * scatter:
        return 0.0, 0.0, 0.0, 0.0
    if c < 0.0:
        length = -length
    a, b, c = a / length, b / length, c / length
    return a, b, c, -(a * mx + b * my + c * mz)


@_compiled
def _mark_inliers(x: Floats, y: Floats, z: Floats, plane: Plane, threshold: float, inlier: Mask) -> int:
    a, b, c, d = plane
    count = 0
    for i in range(len(x)):
        inlier[i] = abs(a * x[i] + b * y[i] + c * z[i] + d) <= threshold
        count += inlier[i]
    return count


@_compiled
def _best_candidate(x: Floats, y: Floats, z: Floats, threshold: float, seed: np.uint64) -> Plane:
    """Return the plane through three of the points that has the most of the scored points near it."""
    n = len(x)
    scored = min(n, _SCORED)
    best, plane = 0, (0.0, 0.0, 0.0, 0.0)
    state = seed
    needed, drawn = _MAX_CANDIDATES, 0
    while drawn < needed:
        drawn += 1
        state, r = _next_random(state)
        i = np.int64(r % np.uint64(n))
        state, r = _next_random(state)
        j = np.int64(r % np.uint64(n))
        state, r = _next_random(state)
        k = np.int64(r % np.uint64(n))
        ux, uy, uz = x[j] - x[i], y[j] - y[i], z[j] - z[i]
        vx, vy, vz = x[k] - x[i], y[k] - y[i], z[k] - z[i]
        a, b, c = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = math.sqrt(a * a + b * b + c * c)
        if length < 2.0 * _MIN_TRIANGLE:
            continue
        if c < 0.0:
            length = -length
        a, b, c = a / length, b / length, c / length
        d = -(a * x[i] + b * y[i] + c * z[i])
        hits = 0
        for p in range(scored):
            hits += abs(a * x[p] + b * y[p] + c * z[p] + d) <= threshold
        if hits > best:
            best, plane = hits, (a, b, c, d)
            clean = (hits / scored) ** 3
            if clean >= 1.0 - 1e-9:
                break
            needed = min(_MAX_CANDIDATES, 1 + int(math.log(_MISS_PROBABILITY) / math.log(1.0 - clean)))
    return plane


@_compiled
def ransac_plane(x: Floats, y: Floats, z: Floats, threshold: float, seed: np.uint64) -> Plane:
    """Plane of a tile by RANSAC (Fischler and Bolles 1981), then twice a least-squares fit to its inliers.

    Candidates are drawn with a generator seeded by the tile, scored on a random sample, and drawing stops when a
    better one has become improbable. Returns (a, b, c, d), a zero normal where the points span no plane.
    """
    plane = _best_candidate(x, y, z, threshold, seed)
    inlier = np.ones(len(x), np.bool_)
    if plane[0] == 0.0 and plane[1] == 0.0 and plane[2] == 0.0:
        return fit_plane_to_points(x, y, z, inlier)
    for _ in range(2):
        if _mark_inliers(x, y, z, plane, threshold, inlier) < 3:
            return plane
        fitted = fit_plane_to_points(x, y, z, inlier)
        if fitted[0] == 0.0 and fitted[1] == 0.0 and fitted[2] == 0.0:
            return plane
        plane = fitted
    return plane


@_compiled
def stray_bounds(distance: Floats, gap: float, most: int) -> tuple[float, float, int]:
    """Split off stray points: at most ``most`` on one side of a tile, cut off from all others by a wide gap.

    The gap must be wider than ``gap`` metres and wider than the spread of everything that stays: a rock or a tree has
    points at all its heights, a bird or a multipath echo has not.

    Returns
    -------
    low, high : float
        Points with ``low <= distance <= high`` stay (m).
    strays : int
        Number of points outside.
    """
    n = len(distance)
    if n < 2 * most + 2:
        return -np.inf, np.inf, 0
    width = most + 1
    top = np.full(width, -np.inf)
    bottom = np.full(width, np.inf)
    for i in range(n):
        d = distance[i]
        if d > top[width - 1]:
            k = width - 1
            while k > 0 and top[k - 1] < d:
                top[k] = top[k - 1]
                k -= 1
            top[k] = d
        if d < bottom[width - 1]:
            k = width - 1
            while k > 0 and bottom[k - 1] > d:
                bottom[k] = bottom[k - 1]
                k -= 1
            bottom[k] = d
    # Try the removal of t points above and b below; take the largest that leaves both cuts wide enough.
    best_t = best_b = 0
    for total in range(2 * most, 0, -1):
        for t in range(max(0, total - most), min(most, total) + 1):
            b = total - t
            need = max(gap, top[t] - bottom[b])
            if (t == 0 or top[t - 1] - top[t] > need) and (b == 0 or bottom[b] - bottom[b - 1] > need):
                best_t, best_b = t, b
                break
        if best_t + best_b > 0:
            break
    low = bottom[best_b] if best_b > 0 else -np.inf
    high = top[best_t] if best_t > 0 else np.inf
    return low, high, best_t + best_b


@_compiled
def detrend(heights: Floats, out: Floats) -> bool:
    """Write ``heights`` minus their least-squares plane over the known pixels (NaN stays NaN) to ``out``, m.

    Returns False where the known pixels do not span a plane.
    """
    size = heights.shape[0]
    n = 0
    mx = my = mz = 0.0
    for r in range(size):
        for c in range(size):
            if not math.isnan(heights[r, c]):
                n += 1
                mx += c
                my += r
                mz += heights[r, c]
    if n < 3:
        return False
    mx /= n
    my /= n
    mz /= n
    xx = xy = yy = xz = yz = 0.0
    for r in range(size):
        for c in range(size):
            h = heights[r, c]
            if not math.isnan(h):
                dx, dy, dz = c - mx, r - my, h - mz
                xx += dx * dx
                xy += dx * dy
                yy += dy * dy
                xz += dx * dz
                yz += dy * dz
    det = xx * yy - xy * xy
    if det <= 1e-9 * xx * yy:
        return False
    a, b = (xz * yy - yz * xy) / det, (yz * xx - xz * xy) / det
    for r in range(size):
        for c in range(size):
            out[r, c] = heights[r, c] - mz - a * (c - mx) - b * (r - my)
    return True


@_compiled
def fill_holes(heights: Floats, depth: int) -> int:
    """Fill NaN pixels in place with the mean of their known 8 neighbours, from the rim inwards, ``depth`` rings deep.

    Returns the number of pixels still unknown.
    """
    size = heights.shape[0]
    source = heights.copy()
    missing = 0
    for r in range(size):
        for c in range(size):
            missing += math.isnan(heights[r, c])
    for _ in range(depth):
        if missing == 0:
            break
        for r in range(size):
            for c in range(size):
                if not math.isnan(source[r, c]):
                    continue
                total, known = 0.0, 0
                for nr in range(max(0, r - 1), min(size, r + 2)):
                    for nc in range(max(0, c - 1), min(size, c + 2)):
                        if not math.isnan(source[nr, nc]):
                            total += source[nr, nc]
                            known += 1
                if known > 0:
                    heights[r, c] = total / known
                    missing -= 1
        source[:] = heights
    return missing


@_compiled
def _heightmap(
    x: Floats, y: Floats, z: Floats, keep: Mask, tile_size: float, mean: Floats, variance: Floats, count: Counts
) -> int:
    """Mean, population variance and number of the kept points in each pixel; north row first, NaN where none fell."""
    size = mean.shape[0]
    shift = 0.0
    for i in range(len(z)):
        if keep[i]:
            shift = z[i]
            break
    mean[:] = 0.0
    variance[:] = 0.0
    count[:] = 0
    for i in range(len(x)):
        if keep[i]:
            c = min(size - 1, int(size * x[i] / tile_size))
            r = size - 1 - min(size - 1, int(size * y[i] / tile_size))
            d = z[i] - shift
            count[r, c] += 1
            mean[r, c] += d
            variance[r, c] += d * d
    known = 0
    for r in range(size):
        for c in range(size):
            n = count[r, c]
            if n == 0:
                mean[r, c] = np.nan
                variance[r, c] = np.nan
                continue
            known += 1
            m = mean[r, c] / n
            variance[r, c] = max(0.0, variance[r, c] / n - m * m)
            mean[r, c] = shift + m
    return known


@_compiled
def _relief(heights: Floats, depth: int, flat_map: Floats) -> float:
    """Plane-removed, hole-filled heights into ``flat_map``; returns their range, NaN where holes are too deep."""
    work = np.empty_like(heights)
    if not detrend(heights, work) or fill_holes(work, depth) > 0:
        flat_map[:] = np.nan
        return np.nan
    filled = np.empty_like(heights)
    detrend(work, filled)
    low, high = filled[0, 0], filled[0, 0]
    for r in range(filled.shape[0]):
        for c in range(filled.shape[1]):
            low = min(low, filled[r, c])
            high = max(high, filled[r, c])
    if high - low < _NOTHING:
        flat_map[:] = 0.0
        return 0.0
    flat_map[:] = filled
    return high - low


@_compiled
def _measure_tile(
    x: Floats,
    y: Floats,
    z: Floats,
    tile_size: float,
    threshold: float,
    seed: np.uint64,
    gap: float,
    most: int,
    depth: int,
    scalars: Floats,
    maps: Floats,
    count: Counts,
) -> None:
    """Measure one tile. ``scalars`` takes z_min, z_max, z_variance, residual, slope, z_range, coverage, relief, strays.

    ``x`` and ``y`` [m] are offsets from the tile's south-west corner. ``maps`` takes heights, variance and relief map.
    """
    n = len(x)
    mean, variance = moments(z)
    scalars[0] = z.min()
    scalars[1] = z.max()
    scalars[2] = variance
    level = z - mean
    a, b, c, d = ransac_plane(x, y, level, threshold, seed)
    distance = np.empty(n)
    if a == 0.0 and b == 0.0 and c == 0.0:
        distance[:] = level
    else:
        total = 0.0
        for i in range(n):
            distance[i] = a * x[i] + b * y[i] + c * level[i] + d
            total += abs(distance[i])
        scalars[3] = total / n
        scalars[4] = math.degrees(math.acos(min(1.0, c)))
    low, high, strays = stray_bounds(distance, gap, most)
    keep = (distance >= low) & (distance <= high)
    known = _heightmap(x, y, z, keep, tile_size, maps[0], maps[1], count)
    scalars[5] = np.nanmax(maps[0]) - np.nanmin(maps[0])
    scalars[6] = known / count.size
    scalars[7] = _relief(maps[0], depth, maps[2])
    scalars[8] = strays


@_compiled
def measure_tiles(
    starts: Indices,
    easting: Floats,
    northing: Floats,
    upward: Floats,
    col: Indices,
    row: Indices,
    tile_size: float,
    threshold: float,
    gap: float,
    most: int,
    depth: int,
    scalars: Floats,
    maps: Floats,
    count: Counts,
) -> None:
    """Measure every tile that has points.

    Parameters
    ----------
    starts : (tiles + 1,) int64
        Where each tile's points begin.
    easting, northing, upward : (points,) float64
        m.
    col, row : (tiles,) int64
        Tile indices; they seed RANSAC.
    tile_size, threshold, gap : float
        Side of a tile, RANSAC inlier distance, least gap that makes a point a stray, m.
    most, depth : int
        Most strays on one side; deepest hole that is filled, px.
    scalars : (tiles, 9) float64
        Filled; see ``_measure_tile``. NaN where a tile has no points or no plane.
    maps : (tiles, 3, pixels, pixels) float64
        Filled: heights, variance inside the pixel, relief map.
    count : (tiles, pixels, pixels) int32
        Filled: points in each pixel.
    """
    scalars[:] = np.nan
    maps[:] = np.nan
    count[:] = 0
    for t in range(len(col)):
        first, last = starts[t], starts[t + 1]
        if first == last:
            continue
        x = easting[first:last] - col[t] * tile_size
        y = northing[first:last] - row[t] * tile_size
        seed = (np.uint64(col[t]) << np.uint64(32)) ^ np.uint64(row[t])
        _measure_tile(
            x, y, upward[first:last], tile_size, threshold, seed, gap, most, depth, scalars[t], maps[t], count[t]
        )
