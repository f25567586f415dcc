"""Compiled kernels: the points of tiles in, measurements of tiles out.

Points of a tile come in a canonical order (see ``bumpytiles.split``), and the first k are a random sample of them.

How the loops stay fast and exact at once. A processor adds eight numbers as fast as one, but only where the compiler
may choose the order of the sum, and then the bits would depend on the processor. So the order is chosen here: a long
sum runs in ``LANES`` partial sums side by side, point i in lane ``i % LANES``, and the lanes are added at the end.
Minima and maxima do not depend on an order at all. Nothing here allocates: scratch arrays come from the caller.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpytiles import entry, inner, order_free

__all__ = ["LANES", "SAMPLE", "SUMS", "detrend", "fill_holes", "measure_tiles", "stray_bounds"]

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int32]
Indices = NDArray[np.int64]
Plane = tuple[float, float, float, float]
"""Unit normal (a, b, c) and d of a x + b y + c z + d = 0; all zero where there is none."""

LANES = 64
"""Partial sums side by side."""
SUMS = 10
"""Sums that a plane fit needs at once."""
SAMPLE = 256
"""Points that RANSAC draws from and scores candidates on; the random order makes the first ones a fair sample."""
_MAX_CANDIDATES = 400
_MISS_PROBABILITY = 1e-4
"""Accepted probability that no candidate was drawn from inliers alone."""
_MIN_TRIANGLE = 1e-3
"""A candidate's three points must span at least this area, m^2."""
_NOTHING = 1e-6
"""Relief below this is rounding, not ground, m."""
_NO_PLANE: Plane = (0.0, 0.0, 0.0, 0.0)
_STEEPEST = 0.2
"""A plane whose upward normal is less than this (steeper than 78 degrees) is a wall, not the slope of the ground."""


@inner
def _set(values: Any, value: float) -> None:
    """Write one number everywhere; ``values[:] = value`` would bring the code of its error messages along."""
    for i in range(len(values)):
        values[i] = value


@inner
def _set_map(pixels: Any, value: float) -> None:
    for r in range(pixels.shape[0]):
        for c in range(pixels.shape[1]):
            pixels[r, c] = value


@inner
def _total(lanes: Floats) -> float:
    total = 0.0
    for k in range(LANES):
        total += lanes[k]
    return total


@inner
def _sum_from(values: Floats, shift: float, lanes: Floats) -> float:
    """Sum of ``values - shift``."""
    n = len(values)
    for k in range(LANES):
        lanes[k] = 0.0
    whole = n // LANES * LANES
    for start in range(0, whole, LANES):
        part = values[start : start + LANES]
        for k in range(LANES):
            lanes[k] += part[k] - shift
    for i in range(whole, n):
        lanes[i - whole] += values[i] - shift
    return _total(lanes)


@inner
def _sum_of_squares(values: Floats, lanes: Floats) -> float:
    n = len(values)
    for k in range(LANES):
        lanes[k] = 0.0
    whole = n // LANES * LANES
    for start in range(0, whole, LANES):
        part = values[start : start + LANES]
        for k in range(LANES):
            lanes[k] += part[k] * part[k]
    for i in range(whole, n):
        lanes[i - whole] += values[i] * values[i]
    return _total(lanes)


@inner
def _sum_of_sizes(values: Floats, lanes: Floats) -> float:
    """Sum of absolute values."""
    n = len(values)
    for k in range(LANES):
        lanes[k] = 0.0
    whole = n // LANES * LANES
    for start in range(0, whole, LANES):
        part = values[start : start + LANES]
        for k in range(LANES):
            lanes[k] += abs(part[k])
    for i in range(whole, n):
        lanes[i - whole] += abs(values[i])
    return _total(lanes)


@inner
def _centre(values: Floats, lanes: Floats, out: Floats) -> float:
    """Write ``values`` minus their mean; returns the mean. The sum starts at the first value and so keeps its bits."""
    mean: float = values[0] + _sum_from(values, values[0], lanes) / len(values)
    for i in range(len(values)):
        out[i] = values[i] - mean
    return mean


@inner
def _shift(values: Floats, out: Floats) -> None:
    """Write ``values`` minus the mean of the first of them: close to their own, for any number is as good."""
    n = min(len(values), SAMPLE)
    total = 0.0
    for i in range(n):
        total += values[i] - values[0]
    origin = values[0] + total / n
    for i in range(len(values)):
        out[i] = values[i] - origin


@order_free
def _extremes(values: Floats) -> tuple[float, float]:
    """Least and greatest of at least one value, none of them NaN."""
    low, high = values[0], values[0]
    for i in range(len(values)):
        low, high = min(low, values[i]), max(high, values[i])
    return low, high


@inner
def _next_random(state: np.uint64) -> tuple[np.uint64, np.uint64]:
    """One step of splitmix64: the new state and 64 mixed bits."""
    state = state + np.uint64(0x9E3779B97F4A7C15)
    z = state
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return state, z ^ (z >> np.uint64(31))


@inner
def _three_below(bits: np.uint64, n: int) -> tuple[int, int, int]:
    """Turn 63 random bits into three numbers from 0 to n - 1 (n at most ``SAMPLE``)."""
    mask, width, size = np.uint64(0x1FFFFF), np.uint64(21), np.uint64(n)
    i = ((bits & mask) * size) >> width
    j = (((bits >> width) & mask) * size) >> width
    k = (((bits >> np.uint64(42)) & mask) * size) >> width
    return np.int64(i), np.int64(j), np.int64(k)  # type: ignore[return-value]


@inner
def _hits(
    x: Singles, y: Singles, z: Singles, a: np.float32, b: np.float32, c: np.float32, d: np.float32, reach: np.float32
) -> np.int32:
    """Count the points with ``|a x + b y + c z + d| <= reach``."""
    hits = np.int32(0)
    for i in range(len(x)):
        hits = np.int32(hits + np.int32(abs(a * x[i] + b * y[i] + c * z[i] + d) <= reach))
    return hits


@inner
def _best_candidate(x: Floats, y: Floats, z: Floats, threshold: float, seed: np.uint64, sample: Singles) -> Plane:
    """Return the plane through three points of the sample that has the most of the sample near it.

    Single precision is enough to count: coordinates start amid the points, so it errs by 1e-7 of a tile's side.
    Normals stay unnormalised; the threshold is multiplied by their length instead.
    """
    n = min(len(x), SAMPLE)
    for i in range(n):
        sample[0, i], sample[1, i], sample[2, i] = x[i], y[i], z[i]
    sample_x, sample_y, sample_z = sample[0, :n], sample[1, :n], sample[2, :n]
    best, plane = np.int32(0), _NO_PLANE
    state = seed
    needed, drawn = _MAX_CANDIDATES, 0
    while drawn < needed:
        drawn += 1
        state, bits = _next_random(state)
        i, j, k = _three_below(bits, n)
        ux, uy, uz = x[j] - x[i], y[j] - y[i], z[j] - z[i]
        vx, vy, vz = x[k] - x[i], y[k] - y[i], z[k] - z[i]
        a, b, c = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = math.sqrt(a * a + b * b + c * c)
        if length < 2.0 * _MIN_TRIANGLE:
            continue
        d = -(a * x[i] + b * y[i] + c * z[i])
        fa, fb, fc, fd, reach = (
            np.float32(a),
            np.float32(b),
            np.float32(c),
            np.float32(d),
            np.float32(threshold * length),
        )
        hits = _hits(sample_x, sample_y, sample_z, fa, fb, fc, fd, reach)
        if hits > best:
            best = hits
            if c < 0.0:
                length = -length
            plane = (a / length, b / length, c / length, d / length)
            clean = (hits / n) ** 3
            if clean >= 1.0 - 1e-9:
                break
            needed = min(_MAX_CANDIDATES, 1 + int(math.log(_MISS_PROBABILITY) / math.log(1.0 - clean)))
    return plane


@inner
def _inlier_sums(x: Floats, y: Floats, z: Floats, plane: Plane, threshold: float, lanes: Floats) -> None:
    """Sum 1, x, y, z, xx, xy, xz, yy, yz, zz over the points within ``threshold`` of a plane: ten rows of lanes."""
    a, b, c, d = plane
    n = len(x)
    for k in range(SUMS * LANES):
        lanes[k] = 0.0
    for start in range(0, n, LANES):
        stop = min(n, start + LANES)
        bx, by, bz = x[start:stop], y[start:stop], z[start:stop]
        for k in range(stop - start):
            px, py, pz = bx[k], by[k], bz[k]
            w = 1.0 if abs(a * px + b * py + c * pz + d) <= threshold else 0.0
            wx, wy, wz = w * px, w * py, w * pz
            lanes[k] += w
            lanes[LANES + k] += wx
            lanes[2 * LANES + k] += wy
            lanes[3 * LANES + k] += wz
            lanes[4 * LANES + k] += wx * px
            lanes[5 * LANES + k] += wx * py
            lanes[6 * LANES + k] += wx * pz
            lanes[7 * LANES + k] += wy * py
            lanes[8 * LANES + k] += wy * pz
            lanes[9 * LANES + k] += wz * pz


@inner
def fit_plane(
    x: Floats, y: Floats, z: Floats, near: Plane, threshold: float, lanes: Floats
) -> tuple[float, float, float, float]:
    """Least-squares plane through the points within ``threshold`` of the plane ``near``, its normal upward.

    Regression along the axis whose 2 x 2 minor of the scatter matrix is the largest, so that steep planes are fitted
    as well as level ones. Coordinates must be centred near zero. Returns zeros where fewer than three points are near
    or they lie on a line.
    """
    _inlier_sums(x, y, z, near, threshold, lanes)
    n = sx = sy = sz = xx = xy = xz = yy = yz = zz = 0.0
    for k in range(LANES):
        n += lanes[k]
        sx += lanes[LANES + k]
        sy += lanes[2 * LANES + k]
        sz += lanes[3 * LANES + k]
        xx += lanes[4 * LANES + k]
        xy += lanes[5 * LANES + k]
        xz += lanes[6 * LANES + k]
        yy += lanes[7 * LANES + k]
        yz += lanes[8 * LANES + k]
        zz += lanes[9 * LANES + k]
    if n < 3.0:
        return _NO_PLANE
    mx, my, mz = sx / n, sy / n, sz / n
    xx, xy, xz = xx - sx * mx, xy - sx * my, xz - sx * mz
    yy, yz, zz = yy - sy * my, yz - sy * mz, zz - sz * mz
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
        return _NO_PLANE
    if c < 0.0:
        length = -length
    a, b, c = a / length, b / length, c / length
    return a, b, c, -(a * mx + b * my + c * mz)


@inner
def _is_plane(plane: Plane) -> bool:
    return plane[0] != 0.0 or plane[1] != 0.0 or plane[2] != 0.0


@inner
def ransac_plane(
    x: Floats, y: Floats, z: Floats, threshold: float, seed: np.uint64, sample: Singles, lanes: Floats
) -> Plane:
    """Plane of a tile by RANSAC (Fischler and Bolles 1981), then twice a least-squares fit to its inliers.

    Candidates are drawn with a generator seeded by the tile, scored on a random sample, and drawing stops when a
    better one has become improbable. Coordinates are centred. Returns zeros where the points span no plane.
    """
    plane = _best_candidate(x, y, z, threshold, seed, sample)
    if not _is_plane(plane):
        return fit_plane(x, y, z, plane, np.inf, lanes)
    for _ in range(2):
        fitted = fit_plane(x, y, z, plane, threshold, lanes)
        if not _is_plane(fitted):
            return plane
        plane = fitted
    return plane


@inner
def _no_strays(distance: Floats, low: float, high: float, gap: float, most: int) -> bool:
    """Whether it is plain that ``stray_bounds`` finds none (low and high are the extremes of the distances).

    The gap beside a stray is wider than ``gap`` and than the spread of all that stays. So what stays reaches neither
    from the lowest third of the range into the highest, nor from one end of the range into the third at the other
    end; one of the outer thirds then holds strays alone, at most ``most``.
    """
    if high - low <= gap:
        return True
    third = (high - low) / 3.0
    above = below = 0
    for i in range(len(distance)):
        above += distance[i] > high - third
        below += distance[i] < low + third
    return above > most and below > most


@inner
def stray_bounds(distance: Floats, gap: float, most: int, ends: Floats) -> tuple[float, float, int]:
    """Split off stray points: at most ``most`` on one side of a tile, cut off from all others by a wide gap.

    The gap must be wider than ``gap`` metres and wider than the spread of everything that stays: a rock or a tree has
    points at all its heights, a bird or a multipath echo has not. ``ends`` is scratch, (2, most + 1).

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
    least, greatest = _extremes(distance)
    if _no_strays(distance, least, greatest, gap, most):
        return -np.inf, np.inf, 0
    top, bottom = ends[0], ends[1]
    _set(top, -np.inf)
    _set(bottom, np.inf)
    for i in range(n):
        d = distance[i]
        if d > top[most]:
            k = most
            while k > 0 and top[k - 1] < d:
                top[k] = top[k - 1]
                k -= 1
            top[k] = d
        if d < bottom[most]:
            k = most
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


@inner
def detrend(heights: Floats) -> bool:
    """Take the least-squares plane over the known pixels off ``heights`` [m] in place; NaN stays NaN.

    Returns False, and changes nothing, where the known pixels do not span a plane.
    """
    size = heights.shape[0]
    middle = 0.5 * (size - 1)
    n = sx = sy = sz = xx = xy = yy = xz = yz = 0.0
    for r in range(size):
        row_n = row_x = row_z = row_xx = row_xz = 0.0
        for c in range(size):
            h = heights[r, c]
            known = h == h  # noqa: PLR0124 - false for NaN; a test without a branch
            x = c - middle if known else 0.0
            h = h if known else 0.0
            row_n += 1.0 if known else 0.0
            row_x += x
            row_z += h
            row_xx += x * x
            row_xz += x * h
        y = r - middle
        n, sx, sy, sz = n + row_n, sx + row_x, sy + y * row_n, sz + row_z
        xx, xy, yy = xx + row_xx, xy + y * row_x, yy + y * y * row_n
        xz, yz = xz + row_xz, yz + y * row_z
    if n < 3.0:
        return False
    mx, my, mz = sx / n, sy / n, sz / n
    xx, xy, yy = xx - sx * mx, xy - sx * my, yy - sy * my
    xz, yz = xz - mx * sz, yz - my * sz
    det = xx * yy - xy * xy
    if det <= 1e-9 * xx * yy:
        return False
    a, b = (xz * yy - yz * xy) / det, (yz * xx - xz * xy) / det
    for r in range(size):
        level = mz + b * (r - middle - my)
        for c in range(size):
            heights[r, c] -= level + a * (c - middle - mx)
    return True


@inner
def _fill(heights: Floats, depth: int, holes: Integers, values: Floats) -> int:
    """``fill_holes`` with scratch of one number a pixel: places of the holes, and what fills them."""
    size = heights.shape[0]
    missing = 0
    for r in range(size):
        for c in range(size):
            if math.isnan(heights[r, c]):
                holes[missing] = r * size + c
                missing += 1
    for _ in range(depth):
        if missing == 0:
            break
        for k in range(missing):
            row, col = holes[k] // size, holes[k] % size
            total, known = 0.0, 0
            for r in range(max(0, row - 1), min(size, row + 2)):
                for c in range(max(0, col - 1), min(size, col + 2)):
                    h = heights[r, c]
                    total += h if h == h else 0.0  # noqa: PLR0124 - no branch, for it could not be foreseen
                    known += h == h  # noqa: PLR0124
            values[k] = total / known if known > 0 else np.nan
        left = 0
        for k in range(missing):
            heights[holes[k] // size, holes[k] % size] = values[k]
            if math.isnan(values[k]):
                holes[left] = holes[k]
                left += 1
        missing = left
    return missing


@inner
def fill_holes(heights: Floats, depth: int) -> int:
    """Fill NaN pixels in place with the mean of their known 8 neighbours, from the rim inwards, ``depth`` rings deep.

    Returns the number of pixels still unknown.
    """
    return _fill(heights, depth, np.empty(heights.size, np.int32), np.empty(heights.size))


@inner
def _pixel_index(
    easting: Floats, northing: Floats, west: float, south: float, tile_size: float, size: int, out: Integers
) -> None:
    """Write each point's pixel, ``row * size + column`` with the north row first; floor(size * offset / tile_size)."""
    last, width = np.int32(size - 1), np.int32(size)
    for i in range(len(easting)):
        c = min(last, np.int32(size * (easting[i] - west) / tile_size))
        r = min(last, np.int32(size * (northing[i] - south) / tile_size))
        out[i] = np.int32((last - r) * width + c)


@inner
def _pixel_sums(pixel: Integers, x: Floats, y: Floats, z: Floats, plane: Plane, sums: Floats) -> None:
    """Count, sum of z, of squared heights above the plane, of the plane's height, by pixel: the rows of ``sums``."""
    _set_map(sums, 0.0)
    a, b, c, _ = plane
    east, north = (-a / c, -b / c) if c > _STEEPEST else (0.0, 0.0)
    for i in range(len(pixel)):
        k = pixel[i]
        slope = east * x[i] + north * y[i]
        sums[0, k] += 1.0
        sums[1, k] += z[i]
        sums[2, k] += (z[i] - slope) * (z[i] - slope)
        sums[3, k] += slope


@inner
def _take_plane_off(sums: Floats, level: Floats) -> None:
    """Take the plane off the pixels' heights where their points are.

    On a slope the mean of some points is not the height of the pixel's middle: where they fell by chance, the slope
    would look rough.
    """
    size = level.shape[0]
    for r in range(size):
        for c in range(size):
            level[r, c] -= sums[3, r * size + c] / sums[0, r * size + c]


@inner
def _heightmap(
    sums: Floats, mean: float, level: Floats, heights: Singles, variance: Singles, count: Integers
) -> tuple[int, float]:
    """Mean, population variance about the plane and number of the points in each pixel; NaN where none fell.

    ``level`` takes the heights above ``mean`` in double precision. Returns the known pixels and their range, m.
    """
    size = level.shape[0]
    known, low, high = 0, np.inf, -np.inf
    for r in range(size):
        for c in range(size):
            k = r * size + c
            n = sums[0, k]
            m = sums[1, k] / n  # 0 / 0: NaN, and so are those that follow from it
            above = m - sums[3, k] / n
            v = sums[2, k] / n - above * above
            level[r, c] = m
            count[r, c] = np.int32(n)
            heights[r, c] = np.float32(mean + m)
            variance[r, c] = np.float32(0.0 if v < 0.0 else v)  # noqa: FURB136 - NaN stays
            known += n > 0.0
            low = m if m < low else low  # noqa: FURB136 - NaN does not count
            high = m if m > high else high  # noqa: FURB136
    return known, high - low


@inner
def _relief(level: Floats, depth: int, complete: bool, holes: Integers, values: Floats, relief: Singles) -> float:
    """Plane-removed, hole-filled heights into ``relief``; returns their range, NaN where holes are too deep.

    ``level`` is changed. Filled holes move the plane, so it is taken off once more.
    """
    if not detrend(level) or (not complete and (_fill(level, depth, holes, values) > 0)):
        _set_map(relief, np.nan)
        return np.nan
    if not complete:
        detrend(level)
    low, high = np.inf, -np.inf
    for r in range(level.shape[0]):
        least, greatest = _extremes(level[r])
        low, high = min(low, least), max(high, greatest)
    if high - low < _NOTHING:
        _set_map(relief, 0.0)
        return 0.0
    for r in range(level.shape[0]):
        for c in range(level.shape[1]):
            relief[r, c] = np.float32(level[r, c])
    return high - low


@entry(
    "i8:1 f8:1 f8:1 f8:1 i8:1 i8:1 f8 f8 f8 i8 f8:2 f4:3 f4:3 f4:3 i4:3 f8:2 i4:1 f4:2 f8:1 f8:2 f8:2 f8:2",
)
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
    depth: int,
    scalars: Floats,
    heights: Singles,
    variance: Singles,
    relief: Singles,
    count: Integers,
    points: Floats,
    pixel: Integers,
    sample: Singles,
    lanes: Floats,
    ends: Floats,
    sums: Floats,
    level: Floats,
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
    depth : int
        Deepest hole that is filled, px.
    scalars : (tiles, 9) float64
        Filled: z_min, z_max, z_variance, residual, slope, z_range, coverage, relief, strays. NaN where a tile has no
        points or no plane.
    heights, variance, relief : (tiles, pixels, pixels) float32
        Filled: mean height, variance inside the pixel about the tile's plane, relief map.
    count : (tiles, pixels, pixels) int32
        Filled: points in each pixel.
    points : (4, most points of a tile) float64
        Scratch, as are all that follow: centred coordinates and distances to the plane.
    pixel : (most points of a tile, at least pixels^2) int32
        Pixel of each point; later the places of holes.
    sample : (3, ``SAMPLE``) float32
        Points that score RANSAC candidates.
    lanes : (``SUMS * LANES``,) float64
        Partial sums.
    ends : (2, most strays on one side + 1) float64
        Highest and lowest distances.
    sums : (4, pixels^2 + 1) float64
        Sums by pixel; the last column takes the strays.
    level : (pixels, pixels) float64
        Heights about the tile's mean.
    """
    size, most = level.shape[0], ends.shape[1] - 1
    for t in range(len(col)):
        first, last = starts[t], starts[t + 1]
        _set(scalars[t], np.nan)
        if first == last:
            _set_map(heights[t], np.nan)
            _set_map(variance[t], np.nan)
            _set_map(relief[t], np.nan)
            _set_map(count[t], 0)
            continue
        n = last - first
        x, y, z, distance = points[0, :n], points[1, :n], points[2, :n], points[3, :n]
        _shift(easting[first:last], x)
        _shift(northing[first:last], y)
        mean = _centre(upward[first:last], lanes, z)
        scalars[t, 0], scalars[t, 1] = _extremes(upward[first:last])
        scalars[t, 2] = _sum_of_squares(z, lanes) / n
        seed = (np.uint64(col[t]) << np.uint64(32)) ^ np.uint64(row[t])
        plane = ransac_plane(x, y, z, threshold, seed, sample, lanes)
        if _is_plane(plane):
            a, b, c, d = plane
            for i in range(n):
                distance[i] = a * x[i] + b * y[i] + c * z[i] + d
            scalars[t, 3] = _sum_of_sizes(distance, lanes) / n
            scalars[t, 4] = math.degrees(math.acos(min(1.0, c)))
        else:
            for i in range(n):
                distance[i] = z[i]
        low, high, strays = stray_bounds(distance, gap, most, ends)
        west, south = col[t] * tile_size, row[t] * tile_size
        _pixel_index(easting[first:last], northing[first:last], west, south, tile_size, size, pixel)
        if strays > 0:
            for i in range(n):
                if not low <= distance[i] <= high:
                    pixel[i] = size * size
        _pixel_sums(pixel[:n], x, y, z, plane, sums)
        known, scalars[t, 5] = _heightmap(sums, mean, level, heights[t], variance[t], count[t])
        _take_plane_off(sums, level)
        scalars[t, 6] = known / (size * size)
        scalars[t, 7] = _relief(level, depth, known == size * size, pixel, sums[1], relief[t])
        scalars[t, 8] = strays
