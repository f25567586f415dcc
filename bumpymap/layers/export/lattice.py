"""Thin the passable tiles of a map to a graph: one node in each square of open tiles of about the same cost.

Squares have 1, 3, 9 or 27 tiles on a side, so that the middle of each is the middle of a tile, and lie in one another
without remainder. Open ground of even cost gets large squares; along everything closed or dearer they shrink to single
tiles. The straight line between the middles of two squares that share a side stays inside the two: it crosses that side
within the smaller square. So thinning never cuts off ground that can be reached.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from bumpymap.layers.export.line_cost import line_cost

__all__ = ["SQUARES", "Lattice", "Squares", "make_lattice", "make_squares"]

SQUARES = (1, 3, 9, 27)
"""Sides of squares, tiles."""
_ALIKE = 1.5
"""Largest ratio of the costs of tiles in one square: ways still bend around dearer ground."""
_NEIGHBOURS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Tiles to the east, south, south-east, south-west; the others are these, seen from the other side."""


@dataclass(frozen=True, slots=True)
class Squares:
    """Open tiles, divided into squares."""

    row: NDArray[np.int64]
    """(n,) row of each square's middle tile in the window, from the north."""
    col: NDArray[np.int64]
    """(n,) column, from the west."""
    side: NDArray[np.int64]
    """(n,) side, tiles."""
    number: NDArray[np.int64]
    """(rows, cols) number of the square that each tile lies in; -1 where closed."""


@dataclass(frozen=True, slots=True)
class Lattice:
    """A connected graph of squares."""

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
    tiles_left_out: int
    """Open tiles that are not connected with the largest part, and were left out."""


def make_squares(factor: NDArray[np.floating], largest: int, origin: tuple[int, int]) -> Squares:
    """Divide the open tiles into the largest squares of open tiles of about the same cost.

    Parameters
    ----------
    factor : float (rows, cols)
        Cost per unit of length; inf where closed.
    largest : int
        Largest side, one of ``SQUARES``.
    origin : (int, int)
        Position of the array's first row and column in the grid of squares: crops of one map share their squares.
    """
    before = origin[0] % largest, origin[1] % largest
    after = tuple(-(first + size) % largest for first, size in zip(before, factor.shape, strict=True))
    padded = np.pad(factor, tuple(zip(before, after, strict=True)), constant_values=np.inf)
    side = _sides(padded, largest)
    row, col = np.indices(padded.shape)
    middle = (row // side * side + side // 2) * padded.shape[1] + col // side * side + side // 2
    is_open = np.isfinite(padded)
    node = np.flatnonzero((middle == row * padded.shape[1] + col) & is_open)
    numbers = np.full(padded.size, -1, np.int64)
    numbers[node] = np.arange(len(node))
    rows, cols = factor.shape
    inside = np.where(is_open, numbers[middle], -1)[before[0] : before[0] + rows, before[1] : before[1] + cols]
    return Squares(row.ravel()[node] - before[0], col.ravel()[node] - before[1], side.ravel()[node], inside)


def _sides(factor: NDArray[np.floating], largest: int) -> NDArray[np.int64]:
    """Return the side of the square that each tile lies in; 1 where closed."""
    side = np.ones(factor.shape, np.int64)
    low, high = factor, factor
    for size in SQUARES[1 : SQUARES.index(largest) + 1]:
        rows, cols = low.shape[0] // 3, low.shape[1] // 3
        low = low.reshape(rows, 3, cols, 3).min(axis=(1, 3))
        high = high.reshape(rows, 3, cols, 3).max(axis=(1, 3))
        alike = np.isfinite(high) & (high <= _ALIKE * low)
        side[np.repeat(np.repeat(alike, size, axis=0), size, axis=1)] = size
    return side


def make_lattice(factor: NDArray[np.floating], squares: Squares) -> Lattice:
    """Make the graph: nodes in the middle of squares, edges where a straight line crosses only open tiles.

    Only the connected part with most tiles is kept: from each of its nodes there is a way to every other.

    Parameters
    ----------
    factor : float (rows, cols)
        Cost per unit of length; inf where closed.
    squares : Squares
        From `make_squares`.
    """
    nodes = np.stack([squares.row, squares.col], axis=1)
    count = len(nodes)
    first, second = _pairs(squares.number, count)
    cost = line_cost(factor, nodes[first], nodes[second])
    usable = np.isfinite(cost)
    first, second, cost = first[usable], second[usable], cost[usable]
    graph = coo_array((np.ones(len(first)), (first, second)), shape=(count, count))
    _, part = connected_components(graph, directed=False)
    kept = part == np.bincount(part, weights=squares.side**2, minlength=1).argmax()
    number = np.cumsum(kept) - 1
    inside = kept[first]
    return Lattice(
        nodes[kept, 0],
        nodes[kept, 1],
        number[first[inside]],
        number[second[inside]],
        cost[inside],
        tiles_left_out=int((squares.side[~kept] ** 2).sum()),
    )


def _pairs(number: NDArray[np.int64], count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the numbers of squares that touch, each pair once, in order."""
    rows, cols = number.shape
    found = [np.empty(0, np.int64)]
    for down, right in _NEIGHBOURS:
        one = number[: rows - down, max(0, -right) : cols - max(0, right)]
        other = number[down:, max(0, right) : cols - max(0, -right)]
        touch = (one != other) & (one >= 0) & (other >= 0)
        pair = np.sort(np.stack([one[touch], other[touch]]), axis=0)
        found.append(np.unique(pair[0] * count + pair[1]))
    first, second = np.divmod(np.unique(np.concatenate(found)), max(count, 1))
    return first, second
