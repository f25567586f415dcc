"""Connected areas of equal tiles in a cell of the map, and sums over each, compiled.

Union-find over the pixels themselves: the root of an area is its first pixel in reading order (north row first, west
first), so areas get their numbers in that order whatever their shape, and no second sorting is needed. Sums are made
one tile after the other: the same tiles in the same order give the same bits.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["add_up", "label"]


def _compiled(function: Callable[..., Any]) -> Any:
    """Compile once and keep the result beside the module or in the user's cache; without either, in every run."""
    try:
        return njit(cache=True, nogil=True)(function)
    except RuntimeError:  # nowhere to write: a read-only installation and no home
        return njit(nogil=True)(function)


def label(keys: NDArray[np.uint8]) -> tuple[NDArray[np.int32], NDArray[np.int64], NDArray[np.int64]]:
    """Give a number to each of the 4-connected areas of equal key, from 1, in the order of their first pixels.

    Parameters
    ----------
    keys : array (rows, cols) uint8
        0 belongs to no area.

    Returns
    -------
    labels : array (rows, cols) int32
        Number of the area of each pixel; 0 where the key is 0.
    first, last : arrays (m,) int64
        First and last pixel of each area, as positions in ``keys.ravel()``.
    """
    labels = np.zeros(keys.shape, dtype=np.int32)
    count = _number(keys, labels)
    first, last = np.full(count, -1, dtype=np.int64), np.zeros(count, dtype=np.int64)
    _find_ends(labels.ravel(), first, last)
    return labels, first, last


@_compiled
def _root(parent: NDArray[np.int32], pixel: int) -> int:
    """Find the first pixel of an area; paths are halved on the way."""
    while parent[pixel] != pixel:
        parent[pixel] = parent[parent[pixel]]
        pixel = parent[pixel]
    return pixel


@_compiled
def _join(parent: NDArray[np.int32], one: int, other: int) -> None:
    """Make two areas one; the earlier root stays."""
    one, other = _root(parent, one), _root(parent, other)
    if one < other:
        parent[other] = one
    else:
        parent[one] = other


@_compiled
def _number(keys: NDArray[np.uint8], labels: NDArray[np.int32]) -> int:
    """Fill ``labels``; return how many areas there are."""
    rows, cols = keys.shape
    parent = np.arange(rows * cols, dtype=np.int32)
    for row in range(rows):
        for col in range(cols):
            key = keys[row, col]
            if key == 0:
                continue
            if col > 0 and keys[row, col - 1] == key:
                _join(parent, row * cols + col - 1, row * cols + col)
            if row > 0 and keys[row - 1, col] == key:
                _join(parent, (row - 1) * cols + col, row * cols + col)
    count = 0
    for row in range(rows):
        for col in range(cols):
            if keys[row, col] == 0:
                continue
            root = _root(parent, row * cols + col)
            if root == row * cols + col:
                count += 1
                labels[row, col] = count
            else:
                labels[row, col] = labels[root // cols, root % cols]
    return count


@_compiled
def _find_ends(labels: NDArray[np.int32], first: NDArray[np.int64], last: NDArray[np.int64]) -> None:
    """Fill what `label` returns of each area."""
    for pixel in range(len(labels)):
        area = labels[pixel] - 1
        if area >= 0:
            last[area] = pixel
            if first[area] < 0:
                first[area] = pixel


@_compiled
def add_up(area: NDArray[np.int32], values: NDArray[np.float32], total: NDArray[np.float64]) -> None:
    """Add (n,) values to the (m,) totals of their areas, one after the other."""
    for n in range(len(area)):
        total[area[n]] += values[n]
