"""Sums in the square around each pixel."""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

__all__ = ["box_sum"]

_Number = TypeVar("_Number", np.int64, np.float64)


def box_sum(values: NDArray[_Number], half: int) -> NDArray[_Number]:
    """Return the sum in the square of ``2 * half + 1`` pixels around each pixel, (rows, cols) as ``values``."""
    for axis in (0, 1):
        pad = [(half + 1, half) if other == axis else (0, 0) for other in (0, 1)]
        total = np.cumsum(np.pad(values, pad), axis=axis)
        size = values.shape[axis]
        upper, lower = (np.take(total, np.arange(size) + at, axis=axis) for at in (2 * half + 1, 0))
        values = upper - lower
    return values
