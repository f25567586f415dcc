"""Whether the ground of a tile has changed, from two heightmaps of it.

Two surveys of one place never hit the same points, so their heightmaps differ by noise: little on asphalt, decimetres
in scrub. How much is read off the tile's own differences, pixel by pixel:

- Height: the differences are cut off at 1.5 times their usual size, so that no shrub decides. z_height is their mean
  over its standard error, Student's t, as the value of a normal distribution with the same probability.
- Shape: noise of one pixel says nothing about the next, while a rut or a heap covers many. z_shape adds up products of
  differences of pixels one and two apart, taken about their mean, over the root of the sum of their squares.

Both are standard normal if differences are independent and as often up as down, whatever their size in each pixel: no
model of the noise is needed. What both surveys share, such as an offset, is taken off before.
"""

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtr

__all__ = ["LEAST_CELLS", "GroundChange", "coarsen", "compare_heights"]

Floats = NDArray[np.float64]

LEAST_CELLS = 16
"""Fewest pixels that both surveys have seen, for a tile to be compared."""
_CUT = 1.5
"""Where differences are cut off, in standard deviations."""
_FLOOR_M = 1e-3
"""Least standard deviation of the differences, m: heights are stored to a millimetre."""
_NORMAL_MAD = 1.4826
_EXACT, _MOST_T = 1e-9, 100.0
"""Differences that are all alike leave no error: their t is limited."""
_LAGS = ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0))
"""Pairs of pixels of z_shape: rows and columns between them."""


@dataclass(frozen=True, slots=True)
class GroundChange:
    """What differs between the heightmaps of tiles; NaN where too few pixels are seen in both."""

    d_height: Floats
    """(n,) mean difference of the heights, m."""
    z_height: Floats
    """(n,) evidence for another height; standard normal without a change."""
    z_shape: Floats
    """(n,) evidence for another shape, large if there is one; standard normal without a change."""


def coarsen(heights: NDArray[np.floating], factor: int) -> Floats:
    """Return means over squares of ``factor`` x ``factor`` pixels, (n, p, p) -> (n, p / factor, p / factor).

    NaN where a square has no height.
    """
    n, side, _ = heights.shape
    parts = heights.astype(np.float64).reshape(n, side // factor, factor, side // factor, factor)
    count = np.isfinite(parts).sum(axis=(2, 4))
    with np.errstate(invalid="ignore"):
        return np.asarray(np.nansum(parts, axis=(2, 4)) / np.where(count > 0, count, np.nan))


def compare_heights(difference: Floats) -> GroundChange:
    """Compare the heightmaps of tiles.

    Parameters
    ----------
    difference : array (n, p, p)
        Later minus earlier height of each pixel, m, the common offset taken off; NaN where one has none.
    """
    count = np.isfinite(difference).sum(axis=(1, 2))
    enough = count >= LEAST_CELLS
    values = np.where(enough[:, None, None], difference, np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # tiles without a value
        mean = np.nanmean(values, axis=(1, 2))
        middle = np.nanmedian(values, axis=(1, 2))[:, None, None]
        level, form = _cut_off(values), _cut_off(values - middle)
        form -= np.nanmean(form, axis=(1, 2))[:, None, None]
    sums = np.nansum(level, axis=(1, 2)), np.nansum(level * level, axis=(1, 2))
    height, shape = _student(_ratio(*sums), count), _ratio(*_products(form))
    return GroundChange(*(np.where(enough, found, np.nan) for found in (mean, height, shape)))


def _cut_off(values: Floats) -> Floats:
    """Divide by the standard deviation, from the median of the sizes, and cut off what is larger than ``_CUT``."""
    spread = _NORMAL_MAD * np.nanmedian(np.abs(values), axis=(1, 2))[:, None, None]
    return np.clip(values / np.maximum(spread, _FLOOR_M), -_CUT, _CUT)


def _products(form: Floats) -> tuple[Floats, Floats]:
    """Return the sums of the products of all pairs of pixels, and of their squares."""
    side = form.shape[1]
    total, square = np.zeros(len(form)), np.zeros(len(form))
    for down, right in _LAGS:
        first = form[:, down:, max(right, 0) : side + min(right, 0)]
        second = form[:, : side - down, max(-right, 0) : side - max(right, 0)]
        product = first * second
        total += np.nansum(product, axis=(1, 2))
        square += np.nansum(product * product, axis=(1, 2))
    return total, square


def _student(ratio: Floats, count: NDArray[np.int64]) -> Floats:
    """Return the normal equivalent of Student's t, which follows from sum over root of the sum of squares."""
    n = np.maximum(count, 2)
    t = np.minimum(np.abs(ratio) * np.sqrt((n - 1) / np.maximum(n - ratio**2, _EXACT * n)), _MOST_T)
    return np.asarray(-np.sign(ratio) * ndtri(stdtr(n - 1, -t)))


def _ratio(total: Floats, square: Floats) -> Floats:
    """Return sum over root of the sum of squares; 0 where nothing differs."""
    return np.asarray(total / np.sqrt(np.where(square > 0.0, square, 1.0)))
