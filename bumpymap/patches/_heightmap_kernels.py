"""From the points of a tile to its pixels: heights, their spread, and relief; sums of long arrays with the same bits.

A processor adds eight numbers as fast as one, but only where the compiler may choose the order of the sum, and then the
bits would depend on the processor. So the order is chosen here: a long sum runs in ``LANES`` partial sums side by side,
point i in lane ``i % LANES``, and the lanes are added at the end. Minima and maxima do not depend on an order at all.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Plane, fill_holes
from bumpytiles import PER_METRE, helper, order_free, pixels_from

Floats = NDArray[np.float64]

LANES = 64
"""Partial sums side by side."""


@helper
def set_all(values: Any, value: float) -> None:
    """Write one number everywhere; ``values[:] = value`` would bring the code of its error messages along."""
    for i in range(len(values)):
        values[i] = value


@helper
def set_map(pixels: Any, value: float) -> None:
    """Write one number into every pixel."""
    for r in range(pixels.shape[0]):
        for c in range(pixels.shape[1]):
            pixels[r, c] = value


@helper
def sum_from(values: Floats, shift: float, lanes: Floats) -> float:
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
    total = 0.0
    for k in range(LANES):
        total += lanes[k]
    return total


@helper
def centre(values: Floats, lanes: Floats, out: Floats) -> float:
    """Write ``values`` minus their mean; returns the mean. The sum starts at the first value and so keeps its bits."""
    mean: float = values[0] + sum_from(values, values[0], lanes) / len(values)
    for i in range(len(values)):
        out[i] = values[i] - mean
    return mean


@helper
def shift(values: Floats, start: float, middle: float, out: Floats) -> None:
    """Write ``values`` as seen from ``start + middle``, by whole steps: the same bits wherever the start is."""
    steps = np.rint(middle * PER_METRE)
    for i in range(len(values)):
        out[i] = (np.rint((values[i] - start) * PER_METRE) - steps) / PER_METRE


@order_free
def extremes(values: Floats) -> tuple[float, float]:
    """Least and greatest of at least one value, none of them NaN."""
    low, high = values[0], values[0]
    for i in range(len(values)):
        low, high = min(low, values[i]), max(high, values[i])
    return low, high


Singles = NDArray[np.float32]
Integers = NDArray[np.int32]

_NOTHING = 1e-6
"""Relief below this is rounding, not ground, m."""
_STEEPEST = 0.2
"""A plane whose upward normal is less than this (steeper than 78 degrees) is a wall, not the slope of the ground."""


@helper
def detrend(heights: Floats) -> bool:
    """Take the least-squares plane over the known pixels off ``heights`` [m] in place; NaN stays NaN.

    Returns False, and changes nothing, where the known pixels do not span a plane.
    """
    rows, cols = heights.shape
    middle, centre = 0.5 * (rows - 1), 0.5 * (cols - 1)
    n = sx = sy = sz = xx = xy = yy = xz = yz = 0.0
    for r in range(rows):
        row_n = row_x = row_z = row_xx = row_xz = 0.0
        for c in range(cols):
            h = heights[r, c]
            known = h == h  # noqa: PLR0124 - false for NaN; a test without a branch
            x = c - centre if known else 0.0
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
    for r in range(rows):
        level = mz + b * (r - middle - my)
        for c in range(cols):
            heights[r, c] -= level + a * (c - centre - mx)
    return True


@helper
def pixel_index(
    easting: Floats, northing: Floats, west: float, south: float, tile_size: float, size: int, out: Integers
) -> None:
    """Write each point's pixel, ``row * size + column`` with the north row first; floor(size * offset / tile_size)."""
    last, width = np.int32(size - 1), np.int32(size)
    for i in range(len(easting)):
        c = min(last, np.int32(pixels_from(west, easting[i], tile_size, size)))
        r = min(last, np.int32(pixels_from(south, northing[i], tile_size, size)))
        out[i] = np.int32((last - r) * width + c)


@helper
def pixel_sums(pixel: Integers, x: Floats, y: Floats, z: Floats, plane: Plane, sums: Floats) -> None:
    """Count, sum of z, of squared heights above the plane, of the plane's height, by pixel: the rows of ``sums``."""
    set_map(sums, 0.0)
    a, b, c, _ = plane
    east, north = (-a / c, -b / c) if c > _STEEPEST else (0.0, 0.0)
    for i in range(len(pixel)):
        k = pixel[i]
        slope = east * x[i] + north * y[i]
        sums[0, k] += 1.0
        sums[1, k] += z[i]
        sums[2, k] += (z[i] - slope) * (z[i] - slope)
        sums[3, k] += slope


@helper
def remove_plane(sums: Floats, level: Floats) -> None:
    """Take the plane off the pixels' heights where their points are.

    On a slope the mean of some points is not the height of the pixel's middle: where they fell by chance, the slope
    would look rough.
    """
    size = level.shape[0]
    for r in range(size):
        for c in range(size):
            level[r, c] -= sums[3, r * size + c] / sums[0, r * size + c]


@helper
def heightmap(
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


@helper
def relief_of(level: Floats, depth: int, complete: bool, holes: Integers, values: Floats, relief: Singles) -> float:
    """Plane-removed, hole-filled heights into ``relief``; returns their range, NaN where holes are too deep.

    ``level`` is changed. Filled holes move the plane, so it is taken off once more.
    """
    if not detrend(level) or (not complete and (fill_holes(level, depth, holes, values) > 0)):
        set_map(relief, np.nan)
        return np.nan
    if not complete:
        detrend(level)
    low, high = np.inf, -np.inf
    for r in range(level.shape[0]):
        least, greatest = extremes(level[r])
        low, high = min(low, least), max(high, greatest)
    if high - low < _NOTHING:
        set_map(relief, 0.0)
        return 0.0
    for r in range(level.shape[0]):
        for c in range(level.shape[1]):
            relief[r, c] = np.float32(level[r, c])
    return high - low
