"""Compiled kernel: the points of tiles in, measurements of tiles out.

Points of a tile come in a canonical order (see ``bumpytiles.grouping``), and the first k are a random sample of them.
They are taken from the middle of the tile and its lowest point, so a tile that lies elsewhere has the same bits. Its
planes are found (``_plane_kernels``): slope, strays and spread are those of the robust plane, which needs no draw, the
residual that of RANSAC. Points far from all others are set aside (`strays`), the rest fall into pixels, and the plane
comes off these (`heightmap`). Long sums run in lanes (`lanes`). Nothing here allocates: scratch arrays come from the
caller.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Plane
from bumpymap.patches._heightmap_kernels import (
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
from bumpymap.patches._plane_kernels import TilePlaneScratch, is_plane, ransac_plane, robust_plane
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
    """(tiles,) tile indices."""
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
        ends=np.empty((2, most_strays + 1)),
        sums=np.empty((4, pixels * pixels + 1)),
        level=np.empty((pixels, pixels)),
    )


@helper
def _planes_of_tile(
    n: int, settings: MeasureSettings, scratch: MeasureScratch, planes: TilePlaneScratch, out: Floats
) -> Plane:
    """Find the planes of n centred points; fill residual and slope of a tile's scalars.

    Returns the robust plane, and fills the distances to it; heights where there is none.
    """
    x, y, z, distance = scratch.points[0, :n], scratch.points[1, :n], scratch.points[2, :n], scratch.points[3, :n]
    robust = robust_plane(x, y, z, planes)
    if not is_plane(robust):
        for i in range(n):
            distance[i] = z[i]
        return robust
    a, b, c, d = ransac_plane(x, y, z, robust, settings.threshold, planes)
    for i in range(n):
        distance[i] = abs(a * x[i] + b * y[i] + c * z[i] + d)
    out[3] = sum_from(distance, 0.0, planes.lanes) / n
    a, b, c, d = robust
    for i in range(n):
        distance[i] = a * x[i] + b * y[i] + c * z[i] + d
    out[4] = math.degrees(math.acos(min(1.0, c)))
    return robust


@helper
def _measure_tile(
    t: int,
    points: PointsByTile,
    settings: MeasureSettings,
    out: TileMeasures,
    scratch: MeasureScratch,
    planes: TilePlaneScratch,
) -> None:
    """Measure a tile that has points."""
    first, last = points.starts[t], points.starts[t + 1]
    n, size, side = last - first, scratch.level.shape[0], settings.tile_size
    scalars, pixel, lanes = out.scalars[t], scratch.pixel, planes.lanes
    x, y, z, distance = scratch.points[0, :n], scratch.points[1, :n], scratch.points[2, :n], scratch.points[3, :n]
    west, south = points.col[t] * side, points.row[t] * side
    pixel_index(points.easting[first:last], points.northing[first:last], west, south, side, size, pixel)
    shift(points.easting[first:last], west, side / 2.0, x)
    shift(points.northing[first:last], south, side / 2.0, y)
    scalars[0], scalars[1] = extremes(points.upward[first:last])
    shift(points.upward[first:last], scalars[0], 0.0, distance)
    mean = scalars[0] + centre(distance, lanes, z)
    for i in range(n):
        distance[i] = z[i] * z[i]
    scalars[2] = sum_from(distance, 0.0, lanes) / n
    plane = _planes_of_tile(n, settings, scratch, planes, scalars)
    low, high, strays = stray_bounds(distance, settings.gap, scratch.ends.shape[1] - 1, scratch.ends)
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
def measure_tiles(
    points: PointsByTile,
    settings: MeasureSettings,
    out: TileMeasures,
    scratch: MeasureScratch,
    planes: TilePlaneScratch,
) -> None:
    """Measure every tile that has points; the others get NaN, and no points."""
    for t in range(len(points.col)):
        set_all(out.scalars[t], np.nan)
        if points.starts[t] < points.starts[t + 1]:
            _measure_tile(t, points, settings, out, scratch, planes)
            continue
        set_map(out.heights[t], np.nan)
        set_map(out.variance[t], np.nan)
        set_map(out.relief[t], np.nan)
        set_map(out.pixel_count[t], 0)
