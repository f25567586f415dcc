"""Compiled: points of a moving sensor, turned to where they are seen from one place."""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from bumpytiles import kernel

__all__ = ["move_points"]


@kernel
def move_points(
    points: Annotated[NDArray[np.float32], 2],
    time: Annotated[NDArray[np.float32], 1],
    transforms: Annotated[NDArray[np.float64], 3],
    start: np.float64,
    step: np.float64,
    moved: Annotated[NDArray[np.float32], 2],
) -> None:
    """Move each point by the transform at its time.

    Parameters
    ----------
    points : (n, 3) float32
    time : (n,) float32
        s; from ``start`` to ``start + (k - 1) * step``.
    transforms : (k, 3, 4) float64
        At times ``start``, ``start + step`` and so on; in between, points are interpolated along a line.
    start, step : float
        s
    moved : (n, 3) float32
        Output.
    """
    last = transforms.shape[0] - 2
    for i in range(points.shape[0]):
        place = (np.float64(time[i]) - start) / step
        k = min(max(int(place), 0), last)
        share = place - k
        for row in range(3):
            first = transforms[k, row, 3]
            second = transforms[k + 1, row, 3]
            for column in range(3):
                value = np.float64(points[i, column])
                first += transforms[k, row, column] * value
                second += transforms[k + 1, row, column] * value
            moved[i, row] = np.float32(first + share * (second - first))
