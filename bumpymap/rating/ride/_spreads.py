"""The noise of a patch from the spread of the heights inside its pixels: helpers of compiled loops."""

import numpy as np
from numpy.typing import NDArray

from bumpytiles import helper

__all__ = ["pixel_noise", "point_noise"]

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int32]

_LEAST_FREEDOM = 10.0
"""Points beyond one a pixel, that many at least, or the noise of a tile cannot be told."""
_MOST_NOISE = 0.01
"""Variance, m^2. Points that scatter by more than 0.1 m inside a pixel are leaves over ground, or blocks: a scanner is
better than that. What is beyond stays in the ground."""
_FILLED = 0.4
"""Noise variance of a pixel that was filled, over that of one that was seen: a mean of some neighbours."""


@helper
def _split(values: Floats, weights: Floats, first: int, last: int, pivot: float, with_equal: bool) -> tuple[int, float]:
    """Bring what is below the pivot, or equal to it if asked, to the front of a part.

    Returns where the rest begins, and the weight of what is before it.
    """
    at, total = first, 0.0
    for i in range(first, last):
        value, weight = values[i], weights[i]
        values[i], weights[i] = values[at], weights[at]
        values[at], weights[at] = value, weight
        low = (value < pivot) | (with_equal & (value == pivot))
        at += low
        total += weight if low else 0.0
    return at, total


@helper
def _weighted_median(values: Floats, weights: Floats, n: int, half: float) -> float:
    """Return the first of n values in order at which the sum of the weights, integers, reaches ``half``.

    The order of the values is changed.
    """
    first, last, below = 0, n, 0.0
    while True:
        a, b, c = values[first], values[(first + last) // 2], values[last - 1]
        pivot = max(min(a, b), min(max(a, b), c))
        at, lower = _split(values, weights, first, last, pivot, False)
        if below + lower >= half:
            last = at
            continue
        first, equal = _split(values, weights, at, last, pivot, True)
        below += lower + equal
        if below >= half or equal == 0.0:  # nothing equals NaN
            return float(pivot)


@helper
def point_noise(count: Integers, variance: Singles, values: Floats, weights: Floats) -> float:
    """Noise variance of a single point, m^2; NaN where too few pixels hold two points.

    The median of the pixels' own variances, each as often as it has degrees of freedom: an edge inside some pixels
    does not move it. A median of chi-square numbers is too low by (1 - 2 / (9 k))^3.
    """
    size = count.shape[0]
    n = 0
    total = squares = 0.0
    for r in range(size):
        for c in range(size):
            if count[r, c] > 1:
                weight = np.float64(count[r, c] - 1)
                values[n] = variance[r, c] * (weight + 1.0) / weight
                weights[n] = weight
                total += weight
                squares += weight * weight
                n += 1
    if total < _LEAST_FREEDOM:
        return np.nan
    median = _weighted_median(values, weights, n, 0.5 * total)
    noise: float = min(median / (1.0 - 2.0 * total / (9.0 * squares)) ** 3, _MOST_NOISE)
    return noise


@helper
def pixel_noise(count: Integers, point: float) -> float:
    """Mean noise variance of the pixels' heights, m^2."""
    size = count.shape[0]
    seen, total = 0, 0.0
    for r in range(size):
        for c in range(size):
            if count[r, c] > 0:
                seen += 1
                total += point / count[r, c]
    if seen == 0:
        return np.nan
    filled = size * size - seen
    mean: float = (total + filled * _FILLED * total / seen) / (size * size)
    return mean
