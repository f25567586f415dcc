"""Compiled kernel: the points of tiles in, measurements of tiles out.

Points of a tile come in a canonical order (see ``bumpytiles.grouping``), and the first k are a random sample of them.
Each tile is centred, its plane is found (RANSAC, then least squares on its inliers), points far from all others are set
aside (`strays`), the rest fall into pixels, and the plane comes off these (`heightmap`). Long sums run in lanes
(`lanes`). Nothing here allocates: scratch arrays come from the caller.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import NO_PLANE, Plane, best_candidate
from bumpymap.patches._heightmap_kernels import (
    LANES,
    centre,
    extremes,
    heightmap,
    pixel_index,
    pixel_sums,
    relief_of,
    remove_plane,
    set_all,
    set_map,
    shift,
    sum_from,
)
from bumpytiles import helper, kernel

Floats = NDArray[np.float64]


@helper
def _no_strays(distance: Floats, low: float, high: float, gap: float, most: int) -> bool:
    """Return whether ``stray_bounds`` plainly finds none (low and high are the extremes of the distances).

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


@helper
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
    least, greatest = extremes(distance)
    if _no_strays(distance, least, greatest, gap, most):
        return -np.inf, np.inf, 0
    top, bottom = ends[0], ends[1]
    set_all(top, -np.inf)
    set_all(bottom, np.inf)
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


Singles = NDArray[np.float32]

SUMS = 10
"""Sums that a plane fit needs at once."""
SAMPLE = 256
"""Points that RANSAC draws from and scores candidates on; the random order makes the first ones a fair sample."""
_MOST_CANDIDATES = 400


@helper
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


@helper
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
        return NO_PLANE
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
        return NO_PLANE
    if c < 0.0:
        length = -length
    a, b, c = a / length, b / length, c / length
    return a, b, c, -(a * mx + b * my + c * mz)


@helper
def is_plane(plane: Plane) -> bool:
    """Return whether it is one."""
    return plane[0] != 0.0 or plane[1] != 0.0 or plane[2] != 0.0


@helper
def ransac_plane(
    x: Floats, y: Floats, z: Floats, threshold: float, seed: np.uint64, sample: Singles, lanes: Floats
) -> Plane:
    """Plane of a tile by RANSAC (Fischler and Bolles 1981), then twice a least-squares fit to its inliers.

    Candidates are drawn from a random sample with a generator seeded by the tile, and scored on it. Coordinates are
    centred. Returns zeros where the points span no plane.
    """
    n = min(len(x), SAMPLE)
    for i in range(n):
        sample[0, i], sample[1, i], sample[2, i] = x[i], y[i], z[i]
    plane = best_candidate(x[:n], y[:n], z[:n], sample, threshold, seed, _MOST_CANDIDATES, False)
    if not is_plane(plane):
        return fit_plane(x, y, z, plane, np.inf, lanes)
    for _ in range(2):
        fitted = fit_plane(x, y, z, plane, threshold, lanes)
        if not is_plane(fitted):
            return plane
        plane = fitted
    return plane


Integers = NDArray[np.int32]
Indices = Annotated[NDArray[np.int64], 1]


class PointsByTile(NamedTuple):
    """Points, tile by tile."""

    starts: Indices
    """(tiles + 1,) where each tile's points begin."""
    easting: Annotated[Floats, 1]
    """(points,) m, as the two that follow."""
    northing: Annotated[Floats, 1]
    upward: Annotated[Floats, 1]
    col: Indices
    """(tiles,) tile indices; they seed RANSAC."""
    row: Indices


class MeasureSettings(NamedTuple):
    """Thresholds."""

    tile_size: float
    """m."""
    threshold: float
    """RANSAC inlier distance, m."""
    gap: float
    """Least gap that makes a point a stray, m."""
    depth: int
    """Deepest hole that is filled, px."""


class TileMeasures(NamedTuple):
    """Arrays that are filled."""

    scalars: Annotated[Floats, 2]
    """(tiles, 9) z_min, z_max, z_variance, residual, slope, z_range, coverage, relief, strays. NaN where a tile has no
    points or no plane."""
    heights: Annotated[Singles, 3]
    """(tiles, pixels, pixels) mean height, m."""
    variance: Annotated[Singles, 3]
    """The same shape: variance inside the pixel about the tile's plane, m^2."""
    relief: Annotated[Singles, 3]
    """The same shape: relief map, m."""
    pixel_count: Annotated[Integers, 3]
    """The same shape: points."""


class MeasureScratch(NamedTuple):
    """Scratch, see `measure_scratch`."""

    points: Annotated[Floats, 2]
    """(4, most points of a tile) centred coordinates and distances to the plane."""
    pixel: Annotated[Integers, 1]
    """(most points of a tile, at least pixels^2) pixel of each point; later the places of holes."""
    sample: Annotated[Singles, 2]
    """(3, ``SAMPLE``) points that score RANSAC candidates."""
    lanes: Annotated[Floats, 1]
    """(``SUMS * LANES``,) partial sums."""
    ends: Annotated[Floats, 2]
    """(2, most strays on one side + 1) highest and lowest distances."""
    sums: Annotated[Floats, 2]
    """(4, pixels^2 + 1) sums by pixel; the last column takes the strays."""
    level: Annotated[Floats, 2]
    """(pixels, pixels) heights about the tile's mean."""


def measure_scratch(most_points: int, pixels: int, most_strays: int) -> MeasureScratch:
    """Make scratch for tiles of at most so many points, and strays on one side."""
    return MeasureScratch(
        points=np.empty((4, most_points)),
        pixel=np.empty(max(most_points, pixels * pixels), np.int32),
        sample=np.empty((3, SAMPLE), np.float32),
        lanes=np.empty(SUMS * LANES),
        ends=np.empty((2, most_strays + 1)),
        sums=np.empty((4, pixels * pixels + 1)),
        level=np.empty((pixels, pixels)),
    )


@helper
def _plane_of_tile(n: int, seed: np.uint64, settings: MeasureSettings, scratch: MeasureScratch, out: Floats) -> Plane:
    """Find the plane of n centred points and their distances to it; fill residual and slope of a tile's scalars."""
    x, y, z, distance = scratch.points[0, :n], scratch.points[1, :n], scratch.points[2, :n], scratch.points[3, :n]
    plane = ransac_plane(x, y, z, settings.threshold, seed, scratch.sample, scratch.lanes)
    if is_plane(plane):
        a, b, c, d = plane
        for i in range(n):
            distance[i] = abs(a * x[i] + b * y[i] + c * z[i] + d)
        out[3] = sum_from(distance, 0.0, scratch.lanes) / n
        for i in range(n):
            distance[i] = a * x[i] + b * y[i] + c * z[i] + d
        out[4] = math.degrees(math.acos(min(1.0, c)))
    else:
        for i in range(n):
            distance[i] = z[i]
    return plane


@helper
def _measure_tile(
    t: int, points: PointsByTile, settings: MeasureSettings, out: TileMeasures, scratch: MeasureScratch
) -> None:
    """Measure a tile that has points."""
    first, last = points.starts[t], points.starts[t + 1]
    n, size = last - first, scratch.level.shape[0]
    scalars, pixel = out.scalars[t], scratch.pixel
    x, y, z, distance = scratch.points[0, :n], scratch.points[1, :n], scratch.points[2, :n], scratch.points[3, :n]
    shift(points.easting[first:last], x)
    shift(points.northing[first:last], y)
    mean = centre(points.upward[first:last], scratch.lanes, z)
    scalars[0], scalars[1] = extremes(points.upward[first:last])
    for i in range(n):
        distance[i] = z[i] * z[i]
    scalars[2] = sum_from(distance, 0.0, scratch.lanes) / n
    seed = (np.uint64(points.col[t]) << np.uint64(32)) ^ np.uint64(points.row[t])
    plane = _plane_of_tile(n, seed, settings, scratch, scalars)
    low, high, strays = stray_bounds(distance, settings.gap, scratch.ends.shape[1] - 1, scratch.ends)
    side = settings.tile_size
    west, south = points.col[t] * side, points.row[t] * side
    pixel_index(points.easting[first:last], points.northing[first:last], west, south, side, size, pixel)
    if strays > 0:
        for i in range(n):
            if not low <= distance[i] <= high:
                pixel[i] = size * size
    pixel_sums(pixel[:n], x, y, z, plane, scratch.sums)
    known, scalars[5] = heightmap(
        scratch.sums, mean, scratch.level, out.heights[t], out.variance[t], out.pixel_count[t]
    )
    remove_plane(scratch.sums, scratch.level)
    scalars[6] = known / (size * size)
    scalars[7] = relief_of(scratch.level, settings.depth, known == size * size, pixel, scratch.sums[1], out.relief[t])
    scalars[8] = strays


@kernel
def measure_tiles(points: PointsByTile, settings: MeasureSettings, out: TileMeasures, scratch: MeasureScratch) -> None:
    """Measure every tile that has points; the others get NaN, and no points."""
    for t in range(len(points.col)):
        set_all(out.scalars[t], np.nan)
        if points.starts[t] < points.starts[t + 1]:
            _measure_tile(t, points, settings, out, scratch)
            continue
        set_map(out.heights[t], np.nan)
        set_map(out.variance[t], np.nan)
        set_map(out.relief[t], np.nan)
        set_map(out.pixel_count[t], 0)
