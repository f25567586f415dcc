"""Helpers that kernels of surveys and scans share: planes, the filling of holes."""

import math

import numpy as np
from numpy.typing import NDArray

from bumpytiles import helper

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int32]
Plane = tuple[float, float, float, float]
"""Unit normal (a, b, c), upward, and d of a x + b y + c z + d = 0; all zero where there is none."""

NO_PLANE: Plane = (0.0, 0.0, 0.0, 0.0)
"""Of points that span none: its normal is zero."""


@helper
def fill_holes(heights: Floats | Singles, depth: int, holes: Integers, values: Floats | Singles) -> int:
    """Fill NaN pixels in place with the mean of their known 8 neighbours, from the rim inwards, ``depth`` rings deep.

    Scratch of one number a pixel: places of the holes, and what fills them. Sums run in the precision of the heights.
    Returns the number of pixels still unknown.
    """
    size = heights.shape[0]
    zero, one = heights.dtype.type(0.0), heights.dtype.type(1.0)
    missing = 0
    for r in range(size):
        for c in range(size):
            if math.isnan(heights[r, c]):
                holes[missing] = r * size + c
                missing += 1
    for _ in range(depth):
        if missing == 0:
            break
        for k in range(missing):
            row, col = holes[k] // size, holes[k] % size
            total, known = zero, zero
            for r in range(max(0, row - 1), min(size, row + 2)):
                for c in range(max(0, col - 1), min(size, col + 2)):
                    h = heights[r, c]
                    total += h if h == h else zero  # noqa: PLR0124 - no branch, for it could not be foreseen
                    known += one if h == h else zero  # noqa: PLR0124
            values[k] = total / known if known > zero else np.nan
        left = 0
        for k in range(missing):
            heights[holes[k] // size, holes[k] % size] = values[k]
            if math.isnan(values[k]):
                holes[left] = holes[k]
                left += 1
        missing = left
    return missing
