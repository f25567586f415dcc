"""The noise of a survey, from the pairs of points of many thin tiles, and what the neighbours of a tile tell about it.

A thin tile holds too few close pairs of points to tell their noise from its ground, but the scanner is the same in all
tiles of a block. Two points close together differ by twice the noise variance and by some share of the tile's own
relief (gravel, grass, a slope in the small): over the tiles of a block the mean square of close differences is a line
over twice the variance of the tile, and the noise is where this line meets the diagonal. Each tile counts by
the precision of its differences, so smooth ground decides and rough ground hardly matters.

Ground is alike from one tile to the next; how much is measured in the block itself, as what neighbours differ by beyond
the errors of both. A tile moves from its own prediction towards the mean of its eight neighbours by the share of its
own error in the whole, so well surveyed tiles hardly move. A tile that stands out (a kerb, a boulder) stays: the
differences have the long tails of Student's distribution. p_fail rises with C_r where neighbours are rougher, and is
left alone where they are smoother: no neighbour makes a tile passable.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bumpymap.rating.ride.correction import Prediction

__all__ = ["PooledNoise", "pool_noise", "pull_to_neighbours"]

Floats = NDArray[np.float64]
_FREEDOM = 4.0
_LEAST_VARIANCE = 0.02
"""Of ln C_r between neighbours: even ground differs by 14 % from tile to tile."""
_UNKNOWN_VARIANCE = 1.0
_LEAST_NEIGHBOURS = 12
_MOST_RISE = 3.0
_LEAST_WEIGHT = 1e-12
_SIDES = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1))


def pull_to_neighbours(found: Prediction, own_weight: Floats, fail_growth: float) -> Prediction:
    """Combine the prediction of each tile with those of its eight neighbours.

    Parameters
    ----------
    found : Prediction
        Arrays (rows, cols) with a ring of one tile; NaN where a tile is unknown.
    own_weight : array (rows, cols)
        0: as the errors tell; 1: a tile that does not move.
    fail_growth : float
        Growth of the logit of p_fail per ln C_r.

    Returns
    -------
    Prediction
        Arrays without the ring.
    """
    variance = (0.5 * (found.below + found.above)) ** 2
    between = _variance_between(found.log_c_r, variance)
    middle, sure, unlike = _mean_of_neighbours(found.log_c_r, 1.0 / (variance + between))
    own = Prediction(*(values[1:-1, 1:-1] for values in (found.log_c_r, found.below, found.above, found.p_fail)))
    error = variance[1:-1, 1:-1]
    prior = between * np.maximum(unlike, 1.0) + 1.0 / np.maximum(sure, 1e-9)
    away = (own.log_c_r - middle) ** 2 / (prior + error)
    prior = prior * (_FREEDOM + away) / (_FREEDOM + 1.0)
    moved = np.where(sure > 0, (1.0 - own_weight[1:-1, 1:-1]) * error / (prior + error), 0.0)
    narrower = np.sqrt(1.0 - moved)
    by = moved * (np.where(sure > 0, middle, 0.0) - own.log_c_r)
    odds = own.p_fail / np.maximum(1.0 - own.p_fail, _LEAST_WEIGHT) * np.exp(fail_growth * np.clip(by, 0.0, _MOST_RISE))
    return replace(
        own,
        log_c_r=own.log_c_r + by,
        p_fail=np.where(by > 0, odds / (1.0 + odds), own.p_fail),
        below=own.below * narrower,
        above=own.above * narrower,
    )


def _variance_between(log_c_r: Floats, variance: Floats) -> float:
    """Return the variance of ln C_r of a tile about its neighbours, without the errors of the predictions."""
    pairs = []
    for near, far in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
        excess = (log_c_r[near] - log_c_r[far]) ** 2 - variance[near] - variance[far]
        pairs.append(excess[np.isfinite(excess)])
    known = np.concatenate(pairs)
    if len(known) < _LEAST_NEIGHBOURS:
        return _UNKNOWN_VARIANCE
    return max(0.5 * float(known.mean()), _LEAST_VARIANCE)


def _mean_of_neighbours(log_c_r: Floats, weight: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the weighted mean over the eight neighbours, the sum of their weights, and how unlike they are.

    The sum is 0 where none is known. Unlike is their variance over what is expected of it.
    """
    known = np.where(np.isfinite(log_c_r), weight, 0.0)
    value = np.nan_to_num(log_c_r)
    rows, cols = log_c_r.shape
    total, squares, weights, number = np.zeros((4, rows - 2, cols - 2))
    for up, right in _SIDES:
        window = np.s_[1 + up : rows - 1 + up, 1 + right : cols - 1 + right]
        total += known[window] * value[window]
        squares += known[window] * value[window] ** 2
        weights += known[window]
        number += known[window] > 0
    mean = total / np.maximum(weights, 1e-9)
    unlike = (squares - weights * mean**2) / np.maximum(number - 1.0, 1.0)
    return mean, weights, unlike


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
