"""Compiled kernel: how the heights of a tile's points differ, pair by pair, by the distance between the points.

Pixels say little about a tile with a few points; its pairs of points say more: the mean square of their difference over
their distance is the structure function of the ground, plus twice the noise variance at every distance.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.patches.kernels.lanes import set_all
from bumpymap.patches.kernels.measure import PointsByTile
from bumpymap.patches.kernels.strays import stray_bounds
from bumpytiles import helper, kernel

__all__ = ["LAGS", "PAIR_MEASURES", "PairScratch", "PairSettings", "measure_pairs", "pair_scratch"]

Floats = NDArray[np.float64]
LAGS = 5
"""Groups of distances."""
PAIR_MEASURES = 5 + 2 * LAGS
"""Measures of a tile."""


class PairSettings(NamedTuple):
    """What is measured."""

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
def _seen_share(x: Floats, y: Floats, side: float) -> float:
    """Share of the nine squares of a third of the side that hold a point; 0 if four that form a square hold none."""
    seen = 0
    for i in range(len(x)):
        c = min(max(int(3.0 * x[i] / side), 0), 2)
        r = min(max(int(3.0 * y[i] / side), 0), 2)
        seen |= 1 << (3 * r + c)
    total = 0
    for k in range(9):
        total += (seen >> k) & 1
    for corner in (0, 1, 3, 4):
        if seen & (27 << corner) == 0:
            return 0.0
    return total / 9.0


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
        for i in range(n):
            scratch.points[0, i] = points.easting[first + i] - west
            scratch.points[1, i] = points.northing[first + i] - south
            scratch.points[2, i] = points.upward[first + i] - level
        x, y, h = scratch.points[0, :n], scratch.points[1, :n], scratch.points[2, :n]
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
