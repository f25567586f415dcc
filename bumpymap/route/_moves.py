"""The moves of a search: from the middle of a tile straight to the middle of another, near one.

Between neighbouring directions of the 48 lie at most 14 degrees, so that a way over even ground made of them is at most
0.75 % too long (the 8 moves of many least-cost tools: 8.2 %); `pull_tight` takes that off.
"""

from functools import cache
from math import gcd

import numpy as np
from numpy.typing import NDArray

from bumpymap.route._line_kernels import find_near
from bumpymap.route._search_kernels import MoveTables
from bumpymap.route.straighten import trace

__all__ = ["MOVES", "REACH", "move_tables"]

REACH = 4
"""Tiles that a move goes at most, along each axis."""
MOVES: NDArray[np.int64] = np.array(
    [(row, col) for row in range(-REACH, REACH + 1) for col in range(-REACH, REACH + 1) if gcd(row, col) == 1]
)
"""(48, 2) tiles southwards and eastwards of each move; the number of a move is its row here."""


@cache
def _pieces() -> tuple[list[NDArray[np.int64]], list[NDArray[np.float64]], NDArray[np.float64]]:
    """Trace every move: tiles between its ends, (n, 2) from where it starts, the length in each, and in the ends."""
    open_ground = np.ones((2 * REACH + 1, 2 * REACH + 1), np.float32)
    middle = REACH + 0.5
    traced = [trace(open_ground, np.array([[middle, middle], middle + move])) for move in MOVES]
    # First and last piece are as long as each other, and in tables of their own.
    tiles = [np.column_stack([each.row, each.col])[1:-1] - REACH for each in traced]
    return tiles, [each.length[1:-1] for each in traced], np.array([each.length[0] for each in traced])


def move_tables(width: int, margin: float) -> MoveTables:
    """Make the tables of the moves for a window.

    Parameters
    ----------
    width : int
        Columns of the window, flattened row by row.
    margin : float
        Distance that a way keeps from closed tiles, tiles.

    Returns
    -------
    MoveTables
    """
    tiles, lengths, end = _pieces()
    near = np.empty((len(MOVES), 2 * REACH + 1, 2 * REACH + 1), np.bool_)
    find_near(np.vstack([np.zeros((1, 2)), MOVES]) + REACH + 0.5, margin, near)
    _, row, col = np.nonzero(near)
    flat = np.array([width, 1])
    return MoveTables(
        step=MOVES @ flat,
        length=np.sqrt((MOVES.astype(np.float64) ** 2).sum(axis=1)),
        end=end,
        first_piece=_starts([len(each) for each in lengths]),
        piece=np.concatenate(tiles) @ flat,
        piece_length=np.concatenate(lengths),
        first_near=_starts(near.sum(axis=(1, 2))),
        near=(np.column_stack([row, col]) - REACH) @ flat,
    )


def _starts(counts: "list[int] | NDArray[np.int64]") -> NDArray[np.int64]:
    """Where each list starts when all are set one behind the other, and where the last ends."""
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
