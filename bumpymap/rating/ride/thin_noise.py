"""The noise of a survey, from the pairs of points of many thin tiles.

A thin tile holds too few close pairs of points to tell their noise from its ground, but the scanner is the same in all
tiles of a block. Two points close together differ by twice the noise variance and by some share of the tile's own
relief (gravel, grass, a slope in the small): over the tiles of a block the mean square of close differences is a line
over twice the variance of the tile, and the noise is where this line meets the diagonal. Each tile counts by
the precision of its differences, so smooth ground decides and rough ground hardly matters.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["PooledNoise", "pool_noise"]

Floats = NDArray[np.float64]
_ROUNDS = 30
_LEAST_PAIRS = 10.0
_UNKNOWN_M = 0.02
"""Noise that is assumed, with an error as large, where too few pairs are close."""
_MOST_NOISE_M = 0.1
"""As in the noise of a heightmap: what is beyond is leaves or blocks, and stays in the ground."""
_MOST_SHARE = 0.9
_TINY = 1e-10


@dataclass(frozen=True, slots=True)
class PooledNoise:
    """Standard deviation of the height of a point, m."""

    middle: float
    low: float
    """One standard error lower."""
    high: float
    """One standard error higher."""


def pool_noise(close_sum: Floats, close_pairs: Floats, variance: Floats) -> PooledNoise:
    """Estimate the noise that n tiles share.

    Parameters
    ----------
    close_sum : array (n,)
        Sum of the squared height differences of the close pairs of each tile, m^2; NaN for tiles without.
    close_pairs : array (n,)
        Number of these pairs.
    variance : array (n,)
        Variance of the points about the tile's plane, m^2.
    """
    known = (close_pairs > 0) & np.isfinite(close_sum) & (variance > _TINY)
    pairs, twice = close_pairs[known], 2.0 * variance[known]
    if pairs.sum() < _LEAST_PAIRS:
        return PooledNoise(_UNKNOWN_M, 0.0, 2.0 * _UNKNOWN_M)
    squares = close_sum[known] / pairs
    floor, share = float(np.quantile(squares, 0.1)), 0.3
    error = floor
    for _ in range(_ROUNDS):
        weight = pairs / np.maximum(floor + share * twice, _TINY) ** 2
        base, across, error = _weighted_line(weight, twice, squares)
        floor, share = 0.5 * (floor + base), 0.5 * (share + across)
    grown = 2.0 * (1.0 - min(share, _MOST_SHARE))
    found, error = floor / grown, error / grown
    low, middle, high = (
        float(min(np.sqrt(max(value, 0.0)), _MOST_NOISE_M)) for value in (found - error, found, found + error)
    )
    return PooledNoise(middle, low, high)


def _weighted_line(weight: Floats, x: Floats, y: Floats) -> tuple[float, float, float]:
    """Return intercept and slope of a line through (x, y), both at least 0, and the intercept's standard error.

    The error is that of means of squared normal numbers, of which each has the variance 2 / weight.
    """
    wx = weight * x
    n, sx, sxx = float(weight.sum()), float(wx.sum()), float((wx * x).sum())
    sy, sxy = float((weight * y).sum()), float((wx * y).sum())
    det = n * sxx - sx * sx
    if det <= 1e-9 * n * sxx:
        return sy / n, 0.0, float(np.sqrt(2.0 / n))
    base, across = (sy * sxx - sxy * sx) / det, (sxy * n - sx * sy) / det
    if base < 0:
        base, across = 0.0, sxy / sxx
    elif across < 0:
        base, across = sy / n, 0.0
    return base, across, float(np.sqrt(2.0 * sxx / det))
