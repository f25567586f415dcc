"""Compiled kernel: the points of tiles in, measurements of tiles out.

Points of a tile come in a canonical order (see ``bumpytiles.split``), and the first k are a random sample of them. Each
tile is centred, its plane is found (`plane`), points far from all others are set aside (`strays`), the rest fall into
pixels, and the plane comes off these (`heightmap`). Long sums run in lanes (`lanes`). Nothing here allocates: scratch
arrays come from the caller.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Plane
from bumpymap.patches.kernels.heightmap import heightmap, pixel_index, pixel_sums, relief_of, remove_plane
from bumpymap.patches.kernels.lanes import (
    LANES,
    centre,
    extremes,
    set_all,
    set_map,
    shift,
    sum_of_sizes,
    sum_of_squares,
)
from bumpymap.patches.kernels.plane import SAMPLE, SUMS, is_plane, ransac_plane
from bumpymap.patches.kernels.strays import stray_bounds
from bumpytiles import helper, kernel

__all__ = [
    "MeasureScratch",
    "MeasureSettings",
    "PointsByTile",
    "TileMeasures",
    "measure_scratch",
    "measure_tiles",
]

Floats = NDArray[np.float64]
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
    """What is filled."""

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
            distance[i] = a * x[i] + b * y[i] + c * z[i] + d
        out[3] = sum_of_sizes(distance, scratch.lanes) / n
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
    scalars[2] = sum_of_squares(z, scratch.lanes) / n
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
