"""Compiled loops over the sectors of a scan: each one's plane, spread and heightmap, in one pass through its points.

Nothing here allocates: scratch arrays come from the caller. Sums run in the order of the scan's points, so the same
scan gives the same bits.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import NO_PLANE, Plane
from bumpymap.scan._place_kernels import CellPoints
from bumpytiles import helper, kernel

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int32]

_SAMPLE = 128
"""Points that RANSAC scores candidates on, in equal steps through the sector's points."""
_MOST_CANDIDATES = 200
"""Planes that RANSAC draws at most."""
_MISS_PROBABILITY = 1e-4
"""Accepted probability that no candidate was drawn from inliers alone."""
_LEAST_AREA = 2e-3
"""Twice the least area that a candidate's three points must span, m^2."""
_STEEPEST = 0.2
"""A plane whose upward normal is less than this (steeper than 78 degrees) is a wall: only the mean height comes off."""
_LINE = 2e-3
"""Product of the two horizontal spreads over the square of their sum: less is one scan line, bent as the sector is."""


class SectorInputs(NamedTuple):
    """The ground of a scan on the polar grid."""

    is_ground: Annotated[NDArray[np.bool_], 1]
    """(points,) by cell: the others do not count."""
    cells: Annotated[NDArray[np.int64], 1]
    """(sectors,) cells to measure, each with ground; their numbers seed RANSAC."""
    threshold: float
    """RANSAC inlier distance, m."""


class SectorMeasures(NamedTuple):
    """Results, filled in place."""

    scalars: Annotated[Floats, 2]
    """(sectors, 4) variance of z [m^2], residual [m] (NaN where the points span no plane), coverage, distance of the
    origin below the principal plane [m]; below the points' mean, where they lie on one line: they tell no tilt."""
    normal: Annotated[Singles, 2]
    """(sectors, 3) principal normal; zeros where the points lie on a line."""
    heights: Annotated[Singles, 3]
    """(sectors, pixels, pixels) mean z above the plane that RANSAC found, holes filled, m."""


class SectorScratch(NamedTuple):
    """Scratch, see `sector_scratch`."""

    xyz: Annotated[Floats, 2]
    """(3, most points of a sector + 1) centred coordinates."""
    pixel: Annotated[Integers, 1]
    """(most points of a sector + 1,) of the same points."""
    sample: Annotated[Singles, 2]
    """(3, ``_SAMPLE``) points that score candidates."""
    sums: Annotated[Floats, 2]
    """(2, pixels^2) count and sum of heights, by pixel."""
    holes: Annotated[Integers, 1]
    """(pixels^2,) empty pixels that are filled next."""
    values: Annotated[Singles, 1]
    """(pixels^2,) what fills them."""
    padded: Annotated[Singles, 2]
    """(2, (pixels + 2)^2) zeros at the margin: heights, and 1 where they are known."""
    rows: Annotated[NDArray[np.uint64], 2]
    """(2, pixels + 2) zeros in the first and the last: bits of the pixels of a row that are known, and of the next."""


def sector_scratch(xyz: Floats, pixel: Integers, pixels: int) -> SectorScratch:
    """Make scratch for sectors of fewer points than ``xyz`` (3, points) and ``pixel`` (points,) hold."""
    return SectorScratch(
        xyz,
        pixel,
        np.empty((3, _SAMPLE), np.float32),
        np.empty((2, pixels * pixels)),
        np.empty(pixels * pixels, np.int32),
        np.empty(pixels * pixels, np.float32),
        np.zeros((2, (pixels + 2) ** 2), np.float32),
        np.zeros((2, pixels + 2), np.uint64),
    )


@helper
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


@helper
def _principal_plane(x: Floats, y: Floats, z: Floats, near: Plane, reach: float) -> tuple[Plane, bool]:
    """Plane of the least perpendicular spread of the points within ``reach`` of a plane; zeros where there is none.

    Returns also whether these points lie on one line, seen from above, if they are centred.
    """
    a, b, c, d = near
    n = sx = sy = sz = xx = xy = xz = yy = yz = zz = 0.0
    for i in range(len(x)):
        u, v, w = x[i], y[i], z[i]
        counts = 1.0 if abs(a * u + b * v + c * w + d) <= reach else 0.0  # no branch, for it could not be foreseen
        p, q, r = counts * u, counts * v, counts * w
        n += counts
        sx += p
        sy += q
        sz += r
        xx += p * u
        xy += p * v
        xz += p * w
        yy += q * v
        yz += q * w
        zz += r * w
    if n < 3.0:
        return NO_PLANE, False
    mx, my, mz = sx / n, sy / n, sz / n
    a, b, c = _least_axis(xx - sx * mx, xy - sx * my, xz - sx * mz, yy - sy * my, yz - sy * mz, zz - sz * mz)
    return (a, b, c, -(a * mx + b * my + c * mz)), xx * yy - xy * xy < _LINE * (xx + yy) * (xx + yy)


@helper
def _next_random(state: np.uint64) -> tuple[np.uint64, np.uint64]:
    """One step of splitmix64: the new state and 64 mixed bits."""
    state = state + np.uint64(0x9E3779B97F4A7C15)
    z = state
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return state, z ^ (z >> np.uint64(31))


@helper
def _three_below(bits: np.uint64, n: int) -> tuple[int, int, int]:
    """Turn 63 random bits into three numbers from 0 to n - 1."""
    mask, width, size = np.uint64(0x1FFFFF), np.uint64(21), np.uint64(n)
    i = ((bits & mask) * size) >> width
    j = (((bits >> width) & mask) * size) >> width
    k = (((bits >> np.uint64(42)) & mask) * size) >> width
    return np.int64(i), np.int64(j), np.int64(k)  # type: ignore[return-value]


@helper
def _count_near(sample: Singles, n: int, plane: tuple[np.float32, ...], reach: np.float32) -> np.int32:
    """Count the first n points of the sample with ``|a x + b y + c z + d| <= reach``."""
    x, y, z = sample[0, :n], sample[1, :n], sample[2, :n]
    a, b, c, d = plane
    hits = np.int32(0)
    for i in range(n):
        hits = np.int32(hits + np.int32(abs(a * x[i] + b * y[i] + c * z[i] + d) <= reach))
    return hits


@helper
def _best_candidate(
    x: Floats, y: Floats, z: Floats, sample: Singles, threshold: float, seed: np.uint64, most: int
) -> Plane:
    """Return the plane through three of the points that has the most of the sample near it; zeros where none has any.

    Single precision is enough to count: coordinates start amid the points, so it errs by 1e-7 of a tile's side.

    Parameters
    ----------
    x, y, z : (n,) float64
        Points to draw from, centred, m.
    sample : (3, room) float32
        Points to score on; the first ``min(n, room)`` are there.
    threshold : float
        Distance of an inlier, m.
    most : int
        Candidates at most.
    """
    n = min(len(x), sample.shape[1])
    best, plane = np.int32(0), NO_PLANE
    state, needed, drawn = seed, most, 0
    while drawn < needed:
        drawn += 1
        state, bits = _next_random(state)
        i, j, k = _three_below(bits, len(x))
        ux, uy, uz = x[j] - x[i], y[j] - y[i], z[j] - z[i]
        vx, vy, vz = x[k] - x[i], y[k] - y[i], z[k] - z[i]
        a, b, c = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = math.sqrt(a * a + b * b + c * c)
        if length < _LEAST_AREA:
            continue
        length = -length if c < 0.0 else length
        a, b, c = a / length, b / length, c / length
        d = -(a * x[i] + b * y[i] + c * z[i])
        singles = np.float32(a), np.float32(b), np.float32(c), np.float32(d)
        hits = _count_near(sample, n, singles, np.float32(threshold))
        if hits > best:
            best, plane = hits, (a, b, c, d)
            clean = (hits / n) ** 3  # chance that all three of a draw are inliers
            if clean >= 1.0 - 1e-9:
                break
            needed = min(most, 1 + int(math.log(_MISS_PROBABILITY) / math.log(1.0 - clean)))
    return plane


@helper
def ransac_plane(x: Floats, y: Floats, z: Floats, threshold: float, seed: np.uint64, sample: Singles) -> Plane:
    """Plane by RANSAC (Fischler and Bolles 1981), then twice the principal plane of its inliers.

    Points must be centred. Zeros where the points span no plane.
    """
    count = len(x)
    n = min(count, _SAMPLE)
    for i in range(n):
        k = i * count // n
        sample[0, i], sample[1, i], sample[2, i] = x[k], y[k], z[k]
    plane = _best_candidate(x, y, z, sample, threshold, seed, _MOST_CANDIDATES)
    found = plane[0] != 0.0 or plane[1] != 0.0 or plane[2] != 0.0
    for _ in range(2):
        fitted, _ = _principal_plane(x, y, z, plane, threshold if found else np.inf)
        if fitted[0] == 0.0 and fitted[1] == 0.0 and fitted[2] == 0.0:
            break
        plane = fitted
    return plane


@helper
def _centre_points(
    points: CellPoints, is_ground: Annotated[NDArray[np.bool_], 1], cell: int, scratch: SectorScratch
) -> tuple[int, Plane]:
    """Write the coordinates of the ground points of a cell minus their mean.

    Returns their number, the mean, and the variance of z.
    """
    xyz, n = scratch.xyz, 0
    for i in range(points.starts[cell], points.starts[cell + 1]):
        xyz[0, n], xyz[1, n], xyz[2, n] = points.xyz[0, i], points.xyz[1, i], points.xyz[2, i]
        scratch.pixel[n] = points.pixel[i]
        n += 1 if is_ground[i] else 0
    mx = my = mz = square = 0.0
    for i in range(n):
        mx += xyz[0, i]
        my += xyz[1, i]
        mz += xyz[2, i]
    mx, my, mz = mx / n, my / n, mz / n
    for i in range(n):
        xyz[0, i] -= mx
        xyz[1, i] -= my
        xyz[2, i] -= mz
        square += xyz[2, i] * xyz[2, i]
    return n, (mx, my, mz, square / n)


@helper
def _sum_by_pixel(x: Floats, y: Floats, z: Floats, plane: Plane, scratch: SectorScratch) -> float:
    """Sum the heights above a plane by pixel; returns the mean distance of the points from it."""
    a, b, c, d = plane
    east, north, level = (-a / c, -b / c, -d / c) if c > _STEEPEST else (0.0, 0.0, 0.0)
    sums = scratch.sums
    for k in range(sums.shape[1]):
        sums[0, k] = sums[1, k] = 0.0
    total = 0.0
    for i in range(len(x)):
        k = scratch.pixel[i]
        total += abs(a * x[i] + b * y[i] + c * z[i] + d)
        sums[0, k] += 1.0
        sums[1, k] += z[i] - east * x[i] - north * y[i] - level
    return total / len(x)


@helper
def _heights_of(heights: Singles, scratch: SectorScratch) -> float:
    """Write the mean height of every pixel, holes filled; returns the share of pixels with points.

    Holes are filled as `bumpymap.core.fill_holes` does, to the same bits, but in images with a margin of a pixel, where
    all neighbours exist, and by bits of their rows, of 64 pixels at most: only those beside known pixels are looked at.
    """
    size = heights.shape[0]
    wide, one = size + 2, np.uint64(1)
    every = np.uint64(0xFFFFFFFFFFFFFFFF) >> np.uint64(64 - size)
    height, known, rows = scratch.padded[0], scratch.padded[1], scratch.rows
    held = 0
    for r in range(size):
        bits = np.uint64(0)
        for q in range(size):
            count, p = scratch.sums[0, r * size + q], (r + 1) * wide + q + 1
            height[p] = known[p] = np.float32(0.0)
            if count > 0.0:
                height[p], known[p] = np.float32(scratch.sums[1, r * size + q] / count), np.float32(1.0)
                bits |= one << np.uint64(q)
                held += 1
        rows[0, r + 1] = bits
    missing = size * size - held if held > 0 else 0
    while missing > 0:
        filled = 0
        for r in range(1, size + 1):
            bits = rows[0, r - 1] | rows[0, r] | rows[0, r + 1]
            bits = (bits | (bits << one) | (bits >> one)) & (rows[0, r] ^ every)
            rows[1, r] = bits
            p = r * wide
            while bits != np.uint64(0):
                p += 1
                if bits & one != np.uint64(0):
                    up, down = p - wide, p + wide
                    total = height[up - 1] + height[up] + height[up + 1] + height[p - 1] + height[p + 1]
                    total += height[down - 1]
                    total += height[down]
                    total += height[down + 1]
                    count = known[up - 1] + known[up] + known[up + 1] + known[p - 1] + known[p + 1]
                    count += known[down - 1] + known[down] + known[down + 1]
                    scratch.holes[filled], scratch.values[filled] = p, total / count
                    filled += 1
                bits >>= one
        for r in range(1, size + 1):
            rows[0, r] |= rows[1, r]
        for k in range(filled):
            height[scratch.holes[k]], known[scratch.holes[k]] = scratch.values[k], np.float32(1.0)
        missing -= filled
    for r in range(size):
        for q in range(size):
            heights[r, q] = height[(r + 1) * wide + q + 1]
    return held / (size * size)


@kernel
def measure_sectors(points: CellPoints, inputs: SectorInputs, out: SectorMeasures, scratch: SectorScratch) -> None:
    """Measure every sector that is listed."""
    for s in range(len(inputs.cells)):
        cell = inputs.cells[s]
        n, (mx, my, mz, out.scalars[s, 0]) = _centre_points(points, inputs.is_ground, cell, scratch)
        x, y, z = scratch.xyz[0, :n], scratch.xyz[1, :n], scratch.xyz[2, :n]
        (a, b, c, _), is_line = _principal_plane(x, y, z, NO_PLANE, np.inf)
        out.normal[s, 0], out.normal[s, 1], out.normal[s, 2] = a, b, c
        out.scalars[s, 3] = mz if is_line else a * mx + b * my + c * mz
        plane = ransac_plane(x, y, z, inputs.threshold, np.uint64(cell), scratch.sample)
        residual = _sum_by_pixel(x, y, z, plane, scratch)
        found = plane[0] != 0.0 or plane[1] != 0.0 or plane[2] != 0.0
        out.scalars[s, 1] = residual if found else np.nan
        out.scalars[s, 2] = _heights_of(out.heights[s], scratch)
