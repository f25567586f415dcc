"""Cost of straight lines between the centres of tiles: the exact integral over every tile that a line crosses."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["line_cost"]

_CHUNK = 4_000_000
"""Crossings of lines with borders of tiles that are held at once."""


def line_cost(
    factor: NDArray[np.floating], start: NDArray[np.integer], stop: NDArray[np.integer]
) -> NDArray[np.float64]:
    """Integrate a factor along straight lines from tile centre to tile centre.

    A line that touches a corner of tiles needs all four tiles around it to be open, so none slips between two closed
    tiles. Lines between centres never run along a border.

    Parameters
    ----------
    factor : float (rows, cols)
        Cost per unit of length; inf where closed.
    start, stop : int (n, 2)
        Row and column of the tiles.

    Returns
    -------
    float64 (n,)
        In sides of a tile; inf where a line meets a closed tile.
    """
    cost = np.empty(len(start))
    if not len(start):
        return cost
    longest = int(np.abs(stop - start).max())
    step = max(1, _CHUNK // (2 * longest + 2))
    for first in range(0, len(start), step):
        part = slice(first, first + step)
        cost[part] = _integrate(factor, start[part], stop[part])
    return cost


def _integrate(
    factor: NDArray[np.floating], start: NDArray[np.integer], stop: NDArray[np.integer]
) -> NDArray[np.float64]:
    """Cut each line where it crosses a border, as share of its length, and sum up its pieces.

    Equal shares of a row's and a column's border are equal fractions, so they round to the same number: a corner is a
    piece of length 0, exactly.
    """
    move = stop - start
    cuts = np.sort(np.concatenate([_crossings(move[:, 0]), _crossings(move[:, 1])], axis=1), axis=1)
    shares = np.concatenate([np.zeros((len(cuts), 1)), cuts, np.ones((len(cuts), 1))], axis=1)
    piece = np.diff(shares, axis=1)
    middle = shares[:, :-1] + 0.5 * piece
    place = [start[:, axis, None] + 0.5 + move[:, axis, None] * middle for axis in (0, 1)]
    corner = (piece == 0.0) & (middle < 1.0)
    line, number = np.nonzero(corner)
    row, col = (np.rint(axis[line, number]).astype(np.int64) for axis in place)
    around = [factor[row - up, col - left] for up in (0, 1) for left in (0, 1)]
    length = np.hypot(move[:, 0], move[:, 1])[:, None] * piece
    row, col = (
        np.minimum(np.floor(axis).astype(np.int64), size - 1) for axis, size in zip(place, factor.shape, strict=True)
    )
    # One by one, so that the zeros that fill short lines change no bit.
    cost = np.cumsum(np.where(length > 0.0, factor[row, col], 0.0) * length, axis=1)[:, -1]
    cost[line[~np.isfinite(np.stack(around)).all(axis=0)]] = np.inf
    return cost


def _crossings(move: NDArray[np.integer]) -> NDArray[np.float64]:
    """Return the shares of the lines at which they cross borders along one axis, (n, most); 1 fills the rest."""
    count = np.abs(move)[:, None]
    number = np.arange(int(count.max(initial=0)))
    with np.errstate(divide="ignore"):
        return np.asarray(np.where(number < count, (number + 0.5) / count, 1.0))
