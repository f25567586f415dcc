"""Thin the passable tiles of a map to a graph: one node in each square of tiles, joined to its neighbours."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from bumpymap.layers.export.line_cost import line_cost

__all__ = ["Lattice", "default_spacing", "make_lattice", "thin_tiles"]

_NEIGHBOURS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Squares to the east, south, south-east, south-west; the others are these, seen from the other side."""


@dataclass(frozen=True, slots=True)
class Lattice:
    """A connected graph of tiles."""

    row: NDArray[np.int64]
    """(n,) row of each node's tile in the window, from the north."""
    col: NDArray[np.int64]
    """(n,) column, from the west."""
    first: NDArray[np.int64]
    """(m,) number of the node at one end of each edge."""
    second: NDArray[np.int64]
    """(m,) at the other end."""
    cost: NDArray[np.float64]
    """(m,) cost of the straight line between them, in sides of a tile; the same in both directions."""
    left_out: int
    """Nodes that were left out, since they are not connected with the largest part."""


def thin_tiles(
    is_open: NDArray[np.bool_], every: int, origin: tuple[int, int]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Choose one open tile in each square of ``every`` x ``every`` tiles: that nearest to the middle of the square.

    Parameters
    ----------
    is_open : bool (rows, cols)
    every : int
        Side of the squares, tiles.
    origin : (int, int)
        Position of the array's first row and column among the squares: crops of one map share their nodes.

    Returns
    -------
    row, col : int64 (n,)
    square : int64 (n, 2)
        Row and column of the square.
    """
    row, col = np.nonzero(is_open)
    place = np.stack([row + origin[0], col + origin[1]], axis=1)
    square = place // every
    off = place - square * every - (every - 1) / 2.0
    order = np.lexsort((col, row, (off**2).sum(axis=1), square[:, 1], square[:, 0]))
    square = square[order]
    new = np.ones(len(order), np.bool_)
    new[1:] = (square[1:] != square[:-1]).any(axis=1)
    return row[order][new], col[order][new], square[new]


def make_lattice(factor: NDArray[np.floating], every: int, origin: tuple[int, int]) -> Lattice:
    """Make the graph: nodes from `thin_tiles`, edges where a straight line crosses only open tiles.

    Only the largest connected part is kept: from each of its nodes there is a way to every other.

    Parameters
    ----------
    factor : float (rows, cols)
        Cost per unit of length; inf where closed.
    every, origin
        See `thin_tiles`.
    """
    row, col, square = thin_tiles(np.isfinite(factor), every, origin)
    nodes = np.stack([row, col], axis=1)
    first, second = _pairs(square)
    cost = line_cost(factor, nodes[first], nodes[second])
    usable = np.isfinite(cost)
    first, second, cost = first[usable], second[usable], cost[usable]
    graph = coo_array((np.ones(len(first)), (first, second)), shape=(len(nodes), len(nodes)))
    _, part = connected_components(graph, directed=False)
    kept = part == np.bincount(part, minlength=1).argmax()
    number = np.cumsum(kept) - 1
    inside = kept[first]
    return Lattice(
        row[kept],
        col[kept],
        number[first[inside]].astype(np.int64),
        number[second[inside]].astype(np.int64),
        cost[inside],
        left_out=int(len(nodes) - kept.sum()),
    )


def _pairs(square: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the numbers of nodes in neighbouring squares."""
    place = square - square.min(axis=0) + 1 if len(square) else square
    rows, cols = (place.max(axis=0) + 2).tolist() if len(square) else (2, 2)
    number = np.full((rows, cols), -1, np.int64)
    number[place[:, 0], place[:, 1]] = np.arange(len(place))
    first, second = [], []
    for down, right in _NEIGHBOURS:
        other = number[place[:, 0] + down, place[:, 1] + right]
        first.append(np.flatnonzero(other >= 0))
        second.append(other[other >= 0])
    return np.concatenate(first), np.concatenate(second)


def default_spacing(is_open: NDArray[np.bool_], most: int, origin: tuple[int, int]) -> int:
    """Return the smallest side of squares that gives at most ``most`` nodes."""
    every = max(1, math.ceil(math.sqrt(np.count_nonzero(is_open) / most)))
    while len(thin_tiles(is_open, every, origin)[0]) > most:
        every += 1
    return every
