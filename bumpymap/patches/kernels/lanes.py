"""Sums and extremes of long arrays, fast and with the same bits on every machine.

A processor adds eight numbers as fast as one, but only where the compiler may choose the order of the sum, and then the
bits would depend on the processor. So the order is chosen here: a long sum runs in ``LANES`` partial sums side by side,
point i in lane ``i % LANES``, and the lanes are added at the end. Minima and maxima do not depend on an order at all.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpytiles import helper, order_free

__all__ = ["LANES", "centre", "extremes", "set_all", "set_map", "shift", "sum_of_sizes", "sum_of_squares"]

Floats = NDArray[np.float64]

LANES = 64
"""Partial sums side by side."""
_FIRST = 256
"""Points whose mean is near enough to that of all."""


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
def _total(lanes: Floats) -> float:
    total = 0.0
    for k in range(LANES):
        total += lanes[k]
    return total


@helper
def _sum_from(values: Floats, shift: float, lanes: Floats) -> float:
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
    return _total(lanes)


@helper
def sum_of_squares(values: Floats, lanes: Floats) -> float:
    """Sum of squares."""
    n = len(values)
    for k in range(LANES):
        lanes[k] = 0.0
    whole = n // LANES * LANES
    for start in range(0, whole, LANES):
        part = values[start : start + LANES]
        for k in range(LANES):
            lanes[k] += part[k] * part[k]
    for i in range(whole, n):
        lanes[i - whole] += values[i] * values[i]
    return _total(lanes)


@helper
def sum_of_sizes(values: Floats, lanes: Floats) -> float:
    """Sum of absolute values."""
    n = len(values)
    for k in range(LANES):
        lanes[k] = 0.0
    whole = n // LANES * LANES
    for start in range(0, whole, LANES):
        part = values[start : start + LANES]
        for k in range(LANES):
            lanes[k] += abs(part[k])
    for i in range(whole, n):
        lanes[i - whole] += abs(values[i])
    return _total(lanes)


@helper
def centre(values: Floats, lanes: Floats, out: Floats) -> float:
    """Write ``values`` minus their mean; returns the mean. The sum starts at the first value and so keeps its bits."""
    mean: float = values[0] + _sum_from(values, values[0], lanes) / len(values)
    for i in range(len(values)):
        out[i] = values[i] - mean
    return mean


@helper
def shift(values: Floats, out: Floats) -> None:
    """Write ``values`` minus the mean of the first of them: close to their own, for any number is as good."""
    n = min(len(values), _FIRST)
    total = 0.0
    for i in range(n):
        total += values[i] - values[0]
    origin = values[0] + total / n
    for i in range(len(values)):
        out[i] = values[i] - origin


@order_free
def extremes(values: Floats) -> tuple[float, float]:
    """Least and greatest of at least one value, none of them NaN."""
    low, high = values[0], values[0]
    for i in range(len(values)):
        low, high = min(low, values[i]), max(high, values[i])
    return low, high
