"""Compiled loops over the sectors of a scan: each one's plane, spread and heightmap, in one pass through its points.

Nothing here allocates: scratch arrays come from the caller. Sums run in the order of the scan's points, so the same
scan gives the same bits.
"""

import math

import numpy as np
from numpy.typing import NDArray

from bumpytiles import entry, inner

__all__ = ["SAMPLE", "measure_sectors"]

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int32]
Plane = tuple[float, float, float, float]
"""Unit normal (a, b, c), upward, and d of a x + b y + c z + d = 0."""

SAMPLE = 128
"""Points that RANSAC scores candidates on, in equal steps through the sector's points."""
_MAX_CANDIDATES = 200
_MISS_PROBABILITY = 1e-4
"""Accepted probability that no candidate was drawn from inliers alone."""
_MIN_LENGTH = 2e-3
"""Twice the least area that a candidate's three points must span, m^2."""
_STEEPEST = 0.2
"""A plane whose upward normal is less than this (steeper than 78 degrees) is a wall: only the mean height comes off."""
_LINE = 2e-3
"""Product of the two horizontal spreads over the square of their sum: less is one scan line, bent as the sector is."""


@inner
def _least_axis(xx: float, xy: float, xz: float, yy: float, yz: float, zz: float) -> tuple[float, float, float]:
    """Find the unit eigenvector of the smallest eigenvalue of a scatter matrix, upward; zeros where none stands out.

    From below, Newton's steps on the characteristic polynomial climb to the smallest root and never pass it.
    """
    trace = xx + yy + zz
    if not trace > 0.0:
        return 0.0, 0.0, 0.0
    minors = xx * yy - xy * xy + xx * zz - xz * xz + yy * zz - yz * yz
    det = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    root = 0.0
    for _ in range(60):
        value = det - root * (minors - root * (trace - root))
        slope = minors - root * (2.0 * trace - 3.0 * root)
        if slope <= 0.0:
            break
        step = value / slope
        root += step
        if abs(step) <= 1e-14 * trace:
            break
    xx, yy, zz = xx - root, yy - root, zz - root
    # The eigenvector is upright on all rows; the longest product of two of them is the surest.
    ax, ay, az = xy * yz - xz * yy, xz * xy - xx * yz, xx * yy - xy * xy
    bx, by, bz = xy * zz - xz * yz, xz * xz - xx * zz, xx * yz - xy * xz
    cx, cy, cz = yy * zz - yz * yz, yz * xz - xy * zz, xy * yz - yy * xz
    a, b, c = ax * ax + ay * ay + az * az, bx * bx + by * by + bz * bz, cx * cx + cy * cy + cz * cz
    if b > a and b >= c:
        ax, ay, az, a = bx, by, bz, b
    elif c > a:
        ax, ay, az, a = cx, cy, cz, c
    length = math.sqrt(a)
    if length <= 1e-12 * trace * trace:
        return 0.0, 0.0, 0.0
    if az < 0.0:
        length = -length
    return ax / length, ay / length, az / length


@inner
def _principal_plane(x: Floats, y: Floats, z: Floats, near: Plane, reach: float) -> Plane:
    """Plane of the least perpendicular spread of the points within ``reach`` of a plane; zeros where there is none."""
    a, b, c, d = near
    n = sx = sy = sz = xx = xy = xz = yy = yz = zz = 0.0
    for i in range(len(x)):
        if abs(a * x[i] + b * y[i] + c * z[i] + d) <= reach:
            n += 1.0
            sx += x[i]
            sy += y[i]
            sz += z[i]
            xx += x[i] * x[i]
            xy += x[i] * y[i]
            xz += x[i] * z[i]
            yy += y[i] * y[i]
            yz += y[i] * z[i]
            zz += z[i] * z[i]
    if n < 3.0:
        return 0.0, 0.0, 0.0, 0.0
    mx, my, mz = sx / n, sy / n, sz / n
    a, b, c = _least_axis(xx - sx * mx, xy - sx * my, xz - sx * mz, yy - sy * my, yz - sy * mz, zz - sz * mz)
    return a, b, c, -(a * mx + b * my + c * mz)


@inner
def _next_random(state: np.uint64) -> tuple[np.uint64, np.uint64]:
    """One step of splitmix64: the new state and 64 mixed bits."""
    state = state + np.uint64(0x9E3779B97F4A7C15)
    z = state
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return state, z ^ (z >> np.uint64(31))


@inner
def _below(bits: np.uint64, place: int, n: int) -> int:
    """Turn the ``place``-th 21 bits into a number from 0 to n - 1."""
    part = (bits >> np.uint64(21 * place)) & np.uint64(0x1FFFFF)
    return int((part * np.uint64(n)) >> np.uint64(21))


@inner
def _hits(
    sample: Singles, n: int, a: np.float32, b: np.float32, c: np.float32, d: np.float32, reach: np.float32
) -> int:
    """Count the points of the sample within ``reach`` of a plane; single precision is enough to count."""
    x, y, z = sample[0, :n], sample[1, :n], sample[2, :n]
    hits = np.int32(0)
    for i in range(n):
        hits = np.int32(hits + np.int32(abs(a * x[i] + b * y[i] + c * z[i] + d) <= reach))
    return int(hits)


@inner
def ransac_plane(x: Floats, y: Floats, z: Floats, threshold: float, seed: np.uint64, sample: Singles) -> Plane:
    """Plane by RANSAC (Fischler and Bolles 1981), then twice the principal plane of its inliers.

    Points must be centred. Drawing stops when a better candidate has become improbable. Zeros where the points span
    no plane.
    """
    count = len(x)
    n = min(count, SAMPLE)
    for i in range(n):
        k = i * count // n
        sample[0, i], sample[1, i], sample[2, i] = x[k], y[k], z[k]
    best, plane = 0, (0.0, 0.0, 0.0, 0.0)
    state, needed, drawn = seed, _MAX_CANDIDATES, 0
    while drawn < needed:
        drawn += 1
        state, bits = _next_random(state)
        i, j, k = _below(bits, 0, count), _below(bits, 1, count), _below(bits, 2, count)
        ux, uy, uz = x[j] - x[i], y[j] - y[i], z[j] - z[i]
        vx, vy, vz = x[k] - x[i], y[k] - y[i], z[k] - z[i]
        a, b, c = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = math.sqrt(a * a + b * b + c * c)
        if length < _MIN_LENGTH:
            continue
        if c < 0.0:
            length = -length
        a, b, c = a / length, b / length, c / length
        d = -(a * x[i] + b * y[i] + c * z[i])
        hits = _hits(sample, n, np.float32(a), np.float32(b), np.float32(c), np.float32(d), np.float32(threshold))
        if hits > best:
            best, plane = hits, (a, b, c, d)
            clean = (hits / n) ** 3  # chance that all three of a draw are inliers
            if clean >= 1.0 - 1e-9:
                break
            needed = min(_MAX_CANDIDATES, 1 + int(math.log(_MISS_PROBABILITY) / math.log(1.0 - clean)))
    for _ in range(2):
        fitted = _principal_plane(x, y, z, plane, threshold if best > 0 else np.inf)
        if fitted[0] == 0.0 and fitted[1] == 0.0 and fitted[2] == 0.0:
            break
        plane = fitted
    return plane


@inner
def _fill(heights: Singles, holes: Integers, values: Singles) -> None:
    """Fill NaN pixels in place with the mean of their known 8 neighbours, from the rim inwards."""
    size, missing = heights.shape[0], 0
    for r in range(size):
        for c in range(size):
            if math.isnan(heights[r, c]):
                holes[missing] = np.int32(r * size + c)
                missing += 1
    while missing > 0:
        for k in range(missing):
            row, column = holes[k] // size, holes[k] % size
            total, known = np.float32(0.0), np.float32(0.0)
            for r in range(max(0, row - 1), min(size, row + 2)):
                for c in range(max(0, column - 1), min(size, column + 2)):
                    h = heights[r, c]
                    if h == h:  # noqa: PLR0124 - false for NaN
                        total += h
                        known += np.float32(1.0)
            values[k] = total / known
        left = 0
        for k in range(missing):
            heights[holes[k] // size, holes[k] % size] = values[k]
            if math.isnan(values[k]):
                holes[left] = holes[k]
                left += 1
        missing = left


@entry("f4:2 i4:1 i4:1 i8:1 i8:1 f8 f8:2 f4:2 f4:3 f8:2 f4:2 f8:2 i4:1 f4:1")
def measure_sectors(
    points: Singles,
    pixel: Integers,
    order: Integers,
    starts: NDArray[np.int64],
    cells: NDArray[np.int64],
    threshold: float,
    scalars: Floats,
    normal: Singles,
    heights: Singles,
    xyz: Floats,
    sample: Singles,
    sums: Floats,
    holes: Integers,
    values: Singles,
) -> None:
    """Measure every sector that is listed; each has points.

    Parameters
    ----------
    points, pixel, order, starts
        As ``place_points`` and ``sort_points`` give them.
    cells : (sectors,) int64
        Cells to measure; their numbers seed RANSAC.
    threshold : float
        RANSAC inlier distance, m.
    scalars : (sectors, 4) float64
        Filled: variance of z [m^2], residual [m] (NaN where the points span no plane), coverage, distance of the
        origin below the principal plane [m]; below the points' mean, where they lie on one line: they tell no tilt.
    normal : (sectors, 3) float32
        Filled: principal normal; zeros where the points lie on a line.
    heights : (sectors, pixels, pixels) float32
        Filled: mean z above the plane that RANSAC found, holes filled, m.
    xyz : (3, most points of a sector) float64
        Scratch, as are all that follow: centred coordinates.
    sample : (3, ``SAMPLE``) float32
        Points that score candidates.
    sums : (2, pixels^2) float64
        Count and sum of heights, by pixel.
    holes, values : (pixels^2,) int32, float32
        Empty pixels and what fills them.
    """
    size = heights.shape[1]
    for s in range(len(cells)):
        first = starts[cells[s]]
        n = starts[cells[s] + 1] - first
        x, y, z = xyz[0, :n], xyz[1, :n], xyz[2, :n]
        mx = my = mz = 0.0
        for i in range(n):
            p = order[first + i]
            x[i], y[i], z[i] = points[p, 0], points[p, 1], points[p, 2]
            mx += x[i]
            my += y[i]
            mz += z[i]
        mx, my, mz = mx / n, my / n, mz / n
        square = xx = xy = yy = 0.0
        for i in range(n):
            x[i] -= mx
            y[i] -= my
            z[i] -= mz
            square += z[i] * z[i]
            xx += x[i] * x[i]
            xy += x[i] * y[i]
            yy += y[i] * y[i]
        scalars[s, 0] = square / n
        a, b, c, d = _principal_plane(x, y, z, (0.0, 0.0, 0.0, 0.0), np.inf)
        normal[s, 0], normal[s, 1], normal[s, 2] = a, b, c
        on_a_line = xx * yy - xy * xy < _LINE * (xx + yy) * (xx + yy)
        scalars[s, 3] = mz if on_a_line else a * mx + b * my + c * mz
        a, b, c, d = ransac_plane(x, y, z, threshold, np.uint64(cells[s]), sample)
        east, north, level = (-a / c, -b / c, -d / c) if c > _STEEPEST else (0.0, 0.0, 0.0)
        for k in range(size * size):
            sums[0, k] = sums[1, k] = 0.0
        total = 0.0
        for i in range(n):
            k = pixel[order[first + i]]
            total += abs(a * x[i] + b * y[i] + c * z[i] + d)
            sums[0, k] += 1.0
            sums[1, k] += z[i] - east * x[i] - north * y[i] - level
        scalars[s, 1] = total / n if a != 0.0 or b != 0.0 or c != 0.0 else np.nan
        known = 0
        for r in range(size):
            for q in range(size):
                count = sums[0, r * size + q]
                known += count > 0.0
                heights[s, r, q] = sums[1, r * size + q] / count if count > 0.0 else np.nan
        scalars[s, 2] = known / (size * size)
        if known < size * size:
            _fill(heights[s], holes, values)
