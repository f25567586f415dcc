"""Compiled kernels: narrow objects with steep sides in heightmaps (`find_standing`); how points differ, pair by pair.

Pixels say little about a tile with a few points; its pairs of points say more: the mean square of their difference over
their distance is the structure function of the ground, plus twice the noise variance at every distance.
"""

import math
from functools import cache
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.patches._heightmap_kernels import relief_of, set_all, set_map, shift
from bumpymap.patches._measure_kernels import PointsByTile, stray_bounds
from bumpytiles import helper, kernel, order_free, pixels_from

Floats = NDArray[np.float64]
LAGS = 5
"""Groups of distances."""
PAIR_MEASURES = 5 + 2 * LAGS
"""Measures of a tile."""


class PairSettings(NamedTuple):
    """Settings of `measure_pairs`."""

    tile_size: float
    """m."""
    gap: float
    """Least gap that makes a point a stray, m."""
    limit: Annotated[NDArray[np.int64], 1]
    """(tiles,) points of a tile that are used: the first ones, which are a random sample of all."""
    reach: Annotated[Floats, 1]
    """(LAGS,) upper end of each group, as a square, m^2, increasing."""


class PairScratch(NamedTuple):
    """Scratch, see `pair_scratch`."""

    points: Annotated[Floats, 2]
    """(3, most points that are used) place [m] and height above the plane [m]."""
    ends: Annotated[Floats, 2]
    """(2, most strays on one side + 1)."""


def pair_scratch(most_points: int, most_strays: int) -> PairScratch:
    """Make scratch for tiles of which at most so many points are used."""
    return PairScratch(np.empty((3, max(most_points, 1))), np.empty((2, most_strays + 1)))


@helper
def _take_plane_off(x: Floats, y: Floats, h: Floats) -> tuple[float, float]:
    """Take the least-squares plane off heights in place; returns its slopes (tangents), NaN where there is none."""
    n = len(x)
    sx = sy = sz = 0.0
    for i in range(n):
        sx += x[i]
        sy += y[i]
        sz += h[i]
    mx, my, mz = sx / n, sy / n, sz / n
    xx = xy = yy = xz = yz = 0.0
    for i in range(n):
        u, v, w = x[i] - mx, y[i] - my, h[i] - mz
        xx += u * u
        xy += u * v
        yy += v * v
        xz += u * w
        yz += v * w
    det = xx * yy - xy * xy
    if det <= 1e-6 * xx * yy:
        return np.nan, np.nan
    a, b = (xz * yy - yz * xy) / det, (yz * xx - xz * xy) / det
    for i in range(n):
        h[i] -= mz + a * (x[i] - mx) + b * (y[i] - my)
    return a, b


@helper
def _drop_strays(x: Floats, y: Floats, h: Floats, gap: float, ends: Floats) -> int:
    """Move the points that are no strays to the front; returns their number."""
    low, high, strays = stray_bounds(h, gap, ends.shape[1] - 1, ends)
    if strays == 0:
        return len(h)
    n = 0
    for i in range(len(h)):
        if low <= h[i] <= high:
            x[n], y[n], h[n] = x[i], y[i], h[i]
            n += 1
    return n


@helper
def _share_of_parts(seen: int) -> float:
    """Share of nine parts of a tile, a bit each, that hold a point; 0 if four that form a square hold none."""
    total = 0
    for k in range(9):
        total += (seen >> k) & 1
    for corner in (0, 1, 3, 4):
        if seen & (27 << corner) == 0:
            return 0.0
    return total / 9.0


@helper
def _seen_share(x: Floats, y: Floats, side: float) -> float:
    """Share of the nine squares of a third of the side that hold a point; 0 if four that form a square hold none."""
    seen = 0
    for i in range(len(x)):
        c = min(int(pixels_from(0.0, x[i], side, 3)), 2)
        r = min(int(pixels_from(0.0, y[i], side, 3)), 2)
        seen |= 1 << (3 * r + c)
    return _share_of_parts(seen)


@helper
def _pair_sums(x: Floats, y: Floats, h: Floats, reach: Floats, out: Floats) -> None:
    """Sum of squared differences and number of pairs, by group of distances."""
    for i in range(len(x)):
        for j in range(i):
            u, v, w = x[i] - x[j], y[i] - y[j], h[i] - h[j]
            far = u * u + v * v
            group = 0
            for k in range(LAGS):
                group += far >= reach[k]
            near, group = group < LAGS, min(group, LAGS - 1)  # no branch, for it could not be foreseen
            out[group] += w * w if near else 0.0
            out[LAGS + group] += 1.0 if near else 0.0


@kernel
def measure_pairs(
    points: PointsByTile, settings: PairSettings, out: Annotated[Floats, 2], scratch: PairScratch
) -> None:
    """Measure the pairs of every tile.

    ``out`` (tiles, PAIR_MEASURES) is filled: points used; share of the tile's nine parts that hold one; standard
    deviation about the plane [m]; mean absolute distance from it over that; slope of the plane (tangent); sums of the
    squared differences [m^2]; numbers of pairs. NaN where the points span no plane.
    """
    side = settings.tile_size
    for t in range(len(points.col)):
        first = points.starts[t]
        n = min(points.starts[t + 1] - first, settings.limit[t])
        set_all(out[t], np.nan)
        if n < 4:
            continue
        west, south, level = points.col[t] * side, points.row[t] * side, points.upward[first]
        x, y, h = scratch.points[0, :n], scratch.points[1, :n], scratch.points[2, :n]
        shift(points.easting[first : first + n], west, 0.0, x)
        shift(points.northing[first : first + n], south, 0.0, y)
        shift(points.upward[first : first + n], level, 0.0, h)
        east, north = _take_plane_off(x, y, h)
        kept = _drop_strays(x, y, h, settings.gap, scratch.ends)
        if kept < n:
            n = kept
            x, y, h = x[:n], y[:n], h[:n]
            more_east, more_north = _take_plane_off(x, y, h)
            east, north = east + more_east, north + more_north
        if math.isnan(east):
            continue
        squares = sizes = 0.0
        for i in range(n):
            squares += h[i] * h[i]
            sizes += abs(h[i])
        spread = math.sqrt(squares / max(n - 3, 1))
        out[t, 0], out[t, 1], out[t, 2] = n, _seen_share(x, y, side), spread
        out[t, 3] = sizes / n / spread if spread > 0.0 else 0.0
        out[t, 4] = math.sqrt(east * east + north * north)
        set_all(out[t, 5:], 0.0)
        _pair_sums(x, y, h, settings.reach, out[t, 5:])


Singles = NDArray[np.float32]
Bytes = NDArray[np.uint8]
Integers = NDArray[np.int32]

_FOOT_PIXELS = 8
"""Known pixels around one among which the foot of its side is looked for, at least: in thin surveys they lie apart."""
FARTHEST_FOOT = 4
"""Farthest of them, px."""


_SIDE, _TALL, _LEVEL = 1, 2, 4
"""Marks of raised pixels: on a side, far above what lies beneath, and level with ground, which are not tall."""
_LEVEL_SHARE = 0.5
"""If more of the raised pixels are so, nothing stands there: they are the rim of a narrow ditch, between pixels in it.
"""
_TALLER = 2.5
"""They are so many times as far above it as a side drops: 0.5 m for a belly 0.25 m above the ground."""
_SUMS = 10
"""Sums of the heights of a tile, see `_fill_sums`."""
_COUNTS = 5
"""Numbers of pixels in the window around one: raised, on a side, tall, tall on a side, level."""


class StandingLimits(NamedTuple):
    """Sizes of objects; heights are as single precision has them, like the heights that they are compared with."""

    width: float
    """Radius of the disc that touches the surface beneath objects, px."""
    foot: float
    """Farthest from a side to its foot, px; more where too few pixels so close are known."""
    raised: float
    """Pixels so high above that surface are those of objects, m."""
    drop: float
    """Drop at a side, m."""
    least: float
    """Pixels of objects that are lower are left out, m."""
    share: float
    """Share of the raised pixels around one that lie on sides, at least."""
    around: int
    """Farthest of these along a row or column, px."""
    pixels: int
    """Pixels along a side of a tile."""


class StandingScratch(NamedTuple):
    """Scratch, see `standing_scratch`."""

    sums: Annotated[NDArray[np.float64], 3]
    """(tile rows, tile columns, 10) sums of the heights of a tile."""
    corners: Annotated[Floats, 2]
    """(tile rows + 1, tile columns + 1) smooth heights at the corners of tiles, m."""
    level: Annotated[Singles, 2]
    """(rows, cols) heights above a smooth surface, m."""
    above: Annotated[Singles, 2]
    """The same shape: heights, later above what lies beneath objects, m; infinite where nothing is known."""
    low: Annotated[Singles, 2]
    """The same shape: lowest height within the disc."""
    beneath: Annotated[Singles, 2]
    """The same shape: depth of the surface beneath objects."""
    line: Annotated[Singles, 1]
    """(cols + 2 * reach,) a row of pixels, infinite at both ends."""
    lowest: Annotated[Singles, 1]
    """(cols,) the lowest of that row within some pixels of each."""
    raised: Annotated[NDArray[np.bool_], 2]
    """(rows, cols) pixels that are high enough."""
    sides: Annotated[Bytes, 2]
    """The same shape: their marks."""
    counts: Annotated[Integers, 2]
    """(cols, _COUNTS) of each column, in the rows around one."""
    offsets: Annotated[Integers, 2]
    """(n, 3) of the pixels around one, the nearest first: rows, columns, their squared distance; not changed."""


def standing_scratch(rows: int, cols: int, radius: float, pixels: int) -> StandingScratch:
    """Make scratch for a heightmap of tiles of so many pixels along a side, and a disc of a radius [px]."""
    maps = [np.empty((rows, cols), np.float32) for _ in range(4)]
    return StandingScratch(
        sums=np.empty((rows // pixels, cols // pixels, _SUMS)),
        corners=np.empty((rows // pixels + 1, cols // pixels + 1)),
        level=maps[0],
        above=maps[1],
        low=maps[2],
        beneath=maps[3],
        line=np.empty(cols + 2 * int(radius), np.float32),
        lowest=np.empty(cols, np.float32),
        raised=np.empty((rows, cols), np.bool_),
        sides=np.empty((rows, cols), np.uint8),
        counts=np.empty((cols, _COUNTS), np.int32),
        offsets=_offsets(),
    )


@cache
def _offsets() -> Integers:
    down, right = np.mgrid[-FARTHEST_FOOT : FARTHEST_FOOT + 1, -FARTHEST_FOOT : FARTHEST_FOOT + 1].reshape(2, -1)
    square = down * down + right * right
    order = np.lexsort((right, down, square))
    order = order[(square[order] > 0) & (square[order] <= FARTHEST_FOOT * FARTHEST_FOOT)]
    return np.stack([down, right, square], axis=1)[order].astype(np.int32)


@order_free
def _lower(values: Singles, out: Singles) -> None:
    """Lower numbers to those of another row."""
    for c in range(len(out)):
        out[c] = min(out[c], values[c])


@helper
def _lowest_on_disc(values: Singles, radius: float, scratch: StandingScratch, out: Singles) -> None:
    """Fill the lowest value within a disc around each pixel."""
    (rows, cols), reach, line, lowest = values.shape, int(radius), scratch.line, scratch.lowest
    set_map(out, np.inf)
    set_all(line, np.inf)
    for r in range(rows):
        for c in range(cols):
            line[reach + c] = lowest[c] = values[r, c]
        for half in range(reach + 1):  # half the width of the disc
            if half > 0:
                _lower(line[reach - half : reach - half + cols], lowest)
                _lower(line[reach + half : reach + half + cols], lowest)
            for down in range(max(-reach, -r), min(reach, rows - 1 - r) + 1):
                if half * half + down * down <= radius * radius < (half + 1) * (half + 1) + down * down:
                    _lower(lowest, out[r + down])


@helper
def _fill_sums(row: int, col: int, heights: Singles, pixels: int, out: Floats) -> None:
    """Fill the sums of a tile's known heights that a least-squares plane through several tiles needs.

    These are a height, the number of pixels, and the sums of x, y, z, xx, xy, yy, xz, yz: x and y [px] from the middle
    of the tile, z [m] from that height.
    """
    set_all(out, 0.0)
    for r in range(pixels):
        for c in range(pixels):
            height = heights[row * pixels + r, col * pixels + c]
            if math.isnan(height):
                continue
            out[0] = height if out[1] == 0.0 else out[0]
            x, y, z = c - 0.5 * (pixels - 1), r - 0.5 * (pixels - 1), height - out[0]
            out[1], out[2], out[3], out[4] = out[1] + 1.0, out[2] + x, out[3] + y, out[4] + z
            out[5], out[6], out[7] = out[5] + x * x, out[6] + x * y, out[7] + y * y
            out[8], out[9] = out[8] + x * z, out[9] + y * z


@helper
def _height_between(row: int, col: int, sums: NDArray[np.float64], pixels: int) -> float:
    """Return the height of the plane through four tiles at their common corner, north-west of one; NaN without any.

    It is their mean height if they span no plane.
    """
    base = n = sx = sy = sz = xx = xy = yy = xz = yz = 0.0
    for k in range(4):
        r, c = row - 1 + k // 2, col - 1 + k % 2
        if not (0 <= r < sums.shape[0] and 0 <= c < sums.shape[1]) or sums[r, c, 1] == 0.0:
            continue
        own = sums[r, c]
        base = own[0] if n == 0.0 else base
        x, y, z, m = pixels * (c - col + 0.5), pixels * (r - row + 0.5), own[0] - base, own[1]
        n, sx, sy, sz = n + m, sx + own[2] + m * x, sy + own[3] + m * y, sz + own[4] + m * z
        xx += own[5] + 2.0 * x * own[2] + m * x * x
        yy += own[7] + 2.0 * y * own[3] + m * y * y
        xy += own[6] + x * own[3] + y * own[2] + m * x * y
        xz += own[8] + x * own[4] + z * own[2] + m * x * z
        yz += own[9] + y * own[4] + z * own[3] + m * y * z
    if n == 0.0:
        return np.nan
    mx, my, mz = sx / n, sy / n, sz / n
    xx, xy, yy, xz, yz = xx - sx * mx, xy - sx * my, yy - sy * my, xz - sx * mz, yz - sy * mz
    det = xx * yy - xy * xy
    if det <= 1e-6 * xx * yy:
        return base + mz
    return base + mz - mx * (xz * yy - yz * xy) / det - my * (yz * xx - xz * xy) / det


@helper
def _fill_level(heights: Singles, pixels: int, scratch: StandingScratch) -> None:
    """Fill how far pixels are above a smooth surface: straight lines between its heights at the corners of tiles.

    These are those of planes, through the four tiles around each: pixels beside one another differ by no slope.
    """
    level, sums, corners = scratch.level, scratch.sums, scratch.corners
    for row in range(sums.shape[0]):
        for col in range(sums.shape[1]):
            _fill_sums(row, col, heights, pixels, sums[row, col])
    for row in range(corners.shape[0]):
        for col in range(corners.shape[1]):
            corners[row, col] = _height_between(row, col, sums, pixels)
    for r in range(level.shape[0]):
        row, south = r // pixels, (r % pixels + 0.5) / pixels
        for c in range(level.shape[1]):
            col, east = c // pixels, (c % pixels + 0.5) / pixels
            north_side = corners[row, col] + east * (corners[row, col + 1] - corners[row, col])
            south_side = corners[row + 1, col] + east * (corners[row + 1, col + 1] - corners[row + 1, col])
            level[r, c] = heights[r, c] - (north_side + south * (south_side - north_side))


@helper
def _fill_above(heights: Singles, radius: float, scratch: StandingScratch) -> None:
    """Fill how far each pixel is above the surface that a disc can touch from below: a morphological opening.

    Its heights are some of those that are given, so the ground around has no part in their rounding.
    """
    above, low, beneath = scratch.above, scratch.low, scratch.beneath
    rows, cols = heights.shape
    for r in range(rows):
        for c in range(cols):
            above[r, c] = np.inf if math.isnan(heights[r, c]) else heights[r, c]
    _lowest_on_disc(above, radius, scratch, low)
    for r in range(rows):
        for c in range(cols):
            low[r, c] = -low[r, c] if low[r, c] < np.inf else np.inf
    _lowest_on_disc(low, radius, scratch, beneath)  # upside down, for the highest
    for r in range(rows):
        for c in range(cols):
            above[r, c] += beneath[r, c]


@helper
def _is_side(r: int, c: int, limits: StandingLimits, scratch: StandingScratch) -> bool:
    """Return whether a pixel lies far above one within ``foot``, or as steeply above one of the nearest known ones."""
    level, offsets = scratch.level, scratch.offsets
    known, last = 0, 0
    for k in range(len(offsets)):
        square = offsets[k, 2]
        if square > limits.foot * limits.foot and square > last and known >= _FOOT_PIXELS:
            return False
        last = square
        row, col = r + offsets[k, 0], c + offsets[k, 1]
        if 0 <= row < level.shape[0] and 0 <= col < level.shape[1] and not math.isnan(level[row, col]):
            known += 1
            if level[r, c] - level[row, col] > limits.drop * max(1.0, math.sqrt(square) / limits.foot):
                return True
    return False


@helper
def _is_level(r: int, c: int, drop: float, scratch: StandingScratch) -> bool:
    """Return whether ground that is not raised lies beside a raised pixel, and hardly below it."""
    level = scratch.level
    for row in range(max(r - 1, 0), min(r + 2, level.shape[0])):
        for col in range(max(c - 1, 0), min(c + 2, level.shape[1])):
            if not scratch.raised[row, col] and level[row, col] > level[r, c] - 0.5 * drop:
                return True
    return False


@helper
def _add_row(r: int, sign: int, scratch: StandingScratch) -> None:
    """Add a row of pixels to the counts of the columns, or take it from them."""
    raised, sides, counts = scratch.raised, scratch.sides, scratch.counts
    for c in range(len(counts)):
        if raised[r, c]:
            mark = sides[r, c]
            counts[c, 0] += sign
            counts[c, 1] += sign * (mark & _SIDE)
            counts[c, 2] += sign * ((mark & _TALL) > 0)
            counts[c, 3] += sign * (mark == _SIDE + _TALL)
            counts[c, 4] += sign * ((mark & _LEVEL) > 0)


@helper
def _mark_row(r: int, limits: StandingLimits, scratch: StandingScratch, marks: NDArray[np.bool_]) -> None:
    """Mark the pixels of objects in a row: of the raised ones around enough are sides, or of the tall ones."""
    raised, sides, counts, around, cols = scratch.raised, scratch.sides, scratch.counts, limits.around, marks.shape[1]
    size = steep = tall = steep_tall = level = 0
    for last in range(cols + around):
        if last < cols:
            size, steep, tall = size + counts[last, 0], steep + counts[last, 1], tall + counts[last, 2]
            steep_tall, level = steep_tall + counts[last, 3], level + counts[last, 4]
        first = last - 2 * around - 1
        if first >= 0:
            size, steep, tall = size - counts[first, 0], steep - counts[first, 1], tall - counts[first, 2]
            steep_tall, level = steep_tall - counts[first, 3], level - counts[first, 4]
        c = last - around
        if c < 0:
            continue
        stands = steep > limits.share * size and level <= _LEVEL_SHARE * size
        stands |= (sides[r, c] & _TALL) > 0 and steep_tall > limits.share * tall
        marks[r, c] = raised[r, c] and stands and scratch.above[r, c] >= limits.least


@kernel
def mark_standing(
    heights: Annotated[Singles, 2],
    limits: StandingLimits,
    scratch: StandingScratch,
    marks: Annotated[NDArray[np.bool_], 2],
) -> None:
    """Mark the pixels of objects."""
    rows, cols = heights.shape
    above, raised, sides, counts = scratch.above, scratch.raised, scratch.sides, scratch.counts
    _fill_above(heights, limits.width, scratch)
    found = False
    for r in range(rows):
        for c in range(cols):
            raised[r, c] = limits.raised < above[r, c] < np.inf
            found |= raised[r, c]
            marks[r, c] = False
    if not found:
        return
    _fill_level(heights, limits.pixels, scratch)
    for r in range(rows):
        for c in range(cols):
            if raised[r, c]:
                sides[r, c] = _SIDE if _is_side(r, c, limits, scratch) else 0
                if _is_level(r, c, limits.drop, scratch):
                    sides[r, c] += _LEVEL
                elif above[r, c] > _TALLER * limits.drop:
                    sides[r, c] += _TALL
    for c in range(cols):
        for k in range(_COUNTS):
            counts[c, k] = 0
    for last in range(rows + limits.around):
        if last < rows:
            _add_row(last, 1, scratch)
        if last > 2 * limits.around:
            _add_row(last - 2 * limits.around - 1, -1, scratch)
        if last >= limits.around:
            _mark_row(last - limits.around, limits, scratch, marks)


class BareSettings(NamedTuple):
    """When a tile can be rated without what stands on it."""

    pixel: float
    """Side of a pixel, m."""
    depth: int
    """Deepest hole that is filled, px."""
    min_coverage: float
    """Least share of the pixels with a point of the ground."""
    min_points: int
    """Least number of such points."""
    thin_points: int
    """The same for a tile that is rated from its points."""
    thin_seen: float
    """Least share of its nine parts that hold one."""


class BareTiles(NamedTuple):
    """Tiles, changed to what is left of them without what stands on them; those that cannot be rated so stay."""

    standing: Annotated[NDArray[np.bool_], 3]
    """(n, pixels, pixels) pixels of what stands on the ground."""
    heights: Annotated[Singles, 3]
    """The same shape: mean height of the points in each pixel, m; NaN where there are none."""
    held: Annotated[NDArray[np.int32], 3]
    """The same shape: points of each pixel; 0 in objects afterwards."""
    variance: Annotated[Singles, 3]
    """The same shape: variance of their heights, m^2; NaN in objects afterwards."""
    relief: Annotated[Singles, 3]
    """The same shape: relief map, m; NaN in tiles that cannot be rated from their heightmap."""
    scalars: Annotated[NDArray[np.float64], 2]
    """(n, 4) filled for tiles that are bare: points, coverage, relief [m], slope [degrees]."""
    is_bare: Annotated[NDArray[np.bool_], 1]
    """(n,) filled: whether the tile can be rated so."""


class BareScratch(NamedTuple):
    """Scratch, see `bare_scratch`."""

    level: Annotated[NDArray[np.float64], 2]
    """(pixels, pixels) heights, m."""
    relief: Annotated[Singles, 2]
    """The same shape: relief, m."""
    holes: Annotated[NDArray[np.int32], 1]
    """(pixels^2,)."""
    values: Annotated[NDArray[np.float64], 1]
    """(pixels^2,)."""


def bare_scratch(pixels: int) -> BareScratch:
    """Make scratch for tiles of so many pixels along a side."""
    flat = pixels * pixels
    return BareScratch(
        np.empty((pixels, pixels)), np.empty((pixels, pixels), np.float32), np.empty(flat, np.int32), np.empty(flat)
    )


@helper
def _slope_of(heights: NDArray[np.float64], pixel: float) -> float:
    """Angle of the least-squares plane through the known heights, degrees; NaN where they span none."""
    size = heights.shape[0]
    n = base = sx = sy = sz = xx = xy = yy = xz = yz = 0.0
    for r in range(size):
        for c in range(size):
            h = heights[r, c]
            if math.isnan(h):
                continue
            base = h if n == 0.0 else base
            x, y, z = c * pixel, r * pixel, h - base
            n, sx, sy, sz = n + 1.0, sx + x, sy + y, sz + z
            xx, xy, yy, xz, yz = xx + x * x, xy + x * y, yy + y * y, xz + x * z, yz + y * z
    if n < 3.0:
        return np.nan
    mx, my = sx / n, sy / n
    xx, xy, yy, xz, yz = xx - sx * mx, xy - sx * my, yy - sy * my, xz - sz * mx, yz - sz * my
    det = xx * yy - xy * xy
    if det <= 1e-9 * xx * yy:
        return np.nan
    east, south = (xz * yy - yz * xy) / det, (yz * xx - xz * xy) / det
    return math.degrees(math.acos(1.0 / math.sqrt(1.0 + east * east + south * south)))


@helper
def _count_left(t: int, tiles: BareTiles, scalars: NDArray[np.float64]) -> float:
    """Fill points and coverage of what is left of a tile; returns the share of its nine parts that hold a point.

    It is 0 if four parts that form a square hold none.
    """
    size = tiles.standing.shape[1]
    points = known = seen = 0
    for r in range(size):
        for c in range(size):
            if tiles.held[t, r, c] > 0 and not tiles.standing[t, r, c]:
                points += tiles.held[t, r, c]
                known += 1
                seen |= 1 << (3 * (3 * r // size) + 3 * c // size)
    scalars[0], scalars[1] = points, known / (size * size)
    return _share_of_parts(seen)


@helper
def _keep_left(t: int, tiles: BareTiles, settings: BareSettings, scratch: BareScratch) -> bool:
    """Take objects out of the relief of a tile; returns False, and changes nothing, where too little is left."""
    size, scalars = tiles.standing.shape[1], tiles.scalars[t]
    seen = _count_left(t, tiles, scalars)
    if math.isnan(tiles.relief[t, 0, 0]):
        return scalars[0] >= settings.thin_points and seen >= settings.thin_seen
    if scalars[0] < settings.min_points or scalars[1] < settings.min_coverage:
        return False
    for r in range(size):
        for c in range(size):
            is_left = tiles.held[t, r, c] > 0 and not tiles.standing[t, r, c]
            scratch.level[r, c] = tiles.relief[t, r, c] if is_left else np.nan
    scalars[2] = relief_of(scratch.level, settings.depth, False, scratch.holes, scratch.values, scratch.relief)
    if math.isnan(scalars[2]):
        return False
    for r in range(size):
        for c in range(size):
            tiles.relief[t, r, c] = scratch.relief[r, c]
    return True


@kernel
def leave_out_objects(tiles: BareTiles, settings: BareSettings, scratch: BareScratch) -> None:
    """Take what stands on tiles out of them."""
    size = tiles.standing.shape[1]
    for t in range(len(tiles.is_bare)):
        found = False
        for r in range(size):
            for c in range(size):
                found |= tiles.standing[t, r, c]
        tiles.is_bare[t] = found and _keep_left(t, tiles, settings, scratch)
        if tiles.is_bare[t]:
            for r in range(size):
                for c in range(size):
                    if tiles.standing[t, r, c]:
                        tiles.held[t, r, c] = 0
                        tiles.variance[t, r, c] = np.nan
                    scratch.level[r, c] = tiles.heights[t, r, c] if tiles.held[t, r, c] > 0 else np.nan
            tiles.scalars[t, 3] = _slope_of(scratch.level, settings.pixel)
