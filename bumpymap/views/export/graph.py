"""A graph of ways for the route server of Nav2 (nav2_route), as GeoJSON in the local frame.

Its nodes are the free areas of tiles, of pixels that hang together and in which the middle of the vehicle can be: so no
edge leads through a wall, wherever in its tile the wall stands. Pixels hang together by their sides and, where
`bumpymap.core.corners_join` says so, by their corners; so areas of tiles that lie diagonally may touch. Tiles that are
free on all pixels and cost about the same share a node, one in each square of 1, 3, 9 or 27 tiles on a side; squares
lie in one another without remainder.

All edges are straight lines over free pixels. The line between the middles of two squares that share a side stays
inside the two: it crosses that side within the smaller square. Where the line between two areas that touch is not free,
the edge gets bends, which are nodes of their own. So two areas are joined in the graph exactly where they touch, and
thinning never cuts off ground that can be reached.

Where the map knows the ride by heading, or slopes cost, each direction of an edge has its own cost: the integral of
what a metre costs in this direction. An edge in a direction that is barred is left out.
"""

import json
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from bumpymap.core import (
    AXES_DEG,
    OPEN_THROUGH,
    BadInputError,
    DirectionSettings,
    atomic,
    axes_along,
    between_axes,
    by_mean,
    corners_join,
    slope_cost,
)
from bumpymap.views.export.area import FRAME, ExportArea, by_pixel
from bumpymap.views.export.settings import ExportSettings, NodeSquare
from bumpytiles import TileWindow

_CHUNK, _PART = 4_000_000, 4096
"""Crossings of lines with borders of cells that are held at once, and lines."""


Along = Callable[[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]], NDArray[np.float64]]
"""Gives the factor on rows and columns of cells, (n, k) each, along lines of so many rows and columns, (n, 2)."""


def line_cost(
    factor: NDArray[np.floating],
    start: NDArray[np.integer],
    stop: NDArray[np.integer],
    *,
    corners: bool = False,
    along: Along | None = None,
) -> NDArray[np.float64]:
    """Integrate a factor along straight lines from cell centre to cell centre.

    A line that touches a corner of cells needs all four cells around it to be open, so none slips between two closed
    cells. Lines between centres never run along a border.

    Parameters
    ----------
    factor : float (rows, cols)
        Cost per unit of length; inf where closed.
    start, stop : int (n, 2)
        Row and column of the cells.
    corners : bool
        Lines at 45 degrees, which go from corner to corner, may slip between two closed cells.
    along : callable, optional
        Gives the factor by direction.

    Returns
    -------
    float64 (n,)
        In sides of a cell; inf where a line meets a closed cell.
    """
    cost = np.empty(len(start))
    spans = np.abs(stop - start).max(axis=1, initial=0)
    order = np.argsort(spans, kind="stable")
    first = 0
    while first < len(order):  # the longest line of a part sets how much memory it takes
        step = max(1, _CHUNK // (2 * int(spans[order[min(first + _PART, len(order)) - 1]]) + 2))
        part = order[first : first + min(step, _PART)]
        cost[part] = _integrate(factor, start[part], stop[part], corners, along)
        first += len(part)
    return cost


def _integrate(
    factor: NDArray[np.floating],
    start: NDArray[np.integer],
    stop: NDArray[np.integer],
    corners: bool,
    along: Along | None,
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
    if corners:
        corner &= (np.abs(move[:, 0]) != np.abs(move[:, 1]))[:, None]
    line, number = np.nonzero(corner)
    row, col = (np.rint(axis[line, number]).astype(np.int64) for axis in place)
    around = [factor[row - up, col - left] for up in (0, 1) for left in (0, 1)]
    length = np.hypot(move[:, 0], move[:, 1])[:, None] * piece
    row, col = (
        np.minimum(np.floor(axis).astype(np.int64), size - 1) for axis, size in zip(place, factor.shape, strict=True)
    )
    # One by one, so that the zeros that fill short lines change no bit.
    each = factor[row, col] if along is None else along(row, col, move)
    cost = np.cumsum(np.where(length > 0.0, each, 0.0) * length, axis=1)[:, -1]
    cost[line[~np.isfinite(np.stack(around)).all(axis=0)]] = np.inf
    return cost


def _crossings(move: NDArray[np.integer]) -> NDArray[np.float64]:
    """Return the shares of the lines at which they cross borders along one axis, (n, most); 1 fills the rest."""
    count = np.abs(move)[:, None]
    number = np.arange(int(count.max(initial=0)))
    with np.errstate(divide="ignore"):
        return np.asarray(np.where(number < count, (number + 0.5) / count, 1.0))


SQUARES: tuple[NodeSquare, ...] = get_args(NodeSquare)
"""Sides of squares, tiles."""
_ALIKE = 1.5
"""Largest ratio of the costs of tiles in one square: ways still bend around dearer ground."""
_NEIGHBOURS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Tiles to the east, south, south-east, south-west; the others are these, seen from the other side."""
_STEPS = ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, -1), (-1, 1))
"""From a pixel to those at its sides, then to those at its corners."""


@dataclass(frozen=True, slots=True)
class Directions:
    """Costs of a metre on the tiles of a window by its direction."""

    settings: DirectionSettings
    pixels: int
    """Pixels along a side of a tile."""
    by_axis: NDArray[np.floating]
    """(rows, cols, axes) cost per unit of length, of one axis or along those of ``AXES_DEG``."""
    gradient: NDArray[np.float32] | None
    """(rows, cols, 2) rise per length southwards and eastwards; None if slopes cost nothing."""

    def along(
        self, row: NDArray[np.int64], col: NDArray[np.int64], move: NDArray[np.int64]
    ) -> NDArray[np.float64]:  # fmt: skip
        """Return the factor on pixels along lines; see `Along`. It is infinite where the direction is barred."""
        at = row // self.pixels, col // self.pixels
        *axes, share = axes_along(self.by_axis.shape[2], *move.T)
        first, second = (self.by_axis[(*at, axis[:, None])] for axis in axes)
        factor = between_axes(first, second, share[:, None])
        if self.gradient is not None:
            down, right = (np.broadcast_to(part[:, None], row.shape).ravel() for part in move.T)
            more, barred = slope_cost(self.settings, self.gradient[at].reshape(-1, 2), down, right)
            factor += np.where(barred, np.inf, more).reshape(row.shape)
        return np.asarray(factor, np.float64)

    def costs(self, start: NDArray[np.int64], stop: NDArray[np.int64]) -> NDArray[np.float64]:
        """Integrate the cost along straight lines between middles of pixels over free ground, (n, 2) of the window."""
        rows, cols, _ = self.by_axis.shape
        free = np.broadcast_to(1.0, (rows * self.pixels, cols * self.pixels))
        return line_cost(free, start, stop, along=self.along)

    def dearest(self, factor: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the factor of tiles, (rows, cols), in their dearest direction: tiles of a square are alike in it."""
        if self.gradient is None:
            return factor
        steep, weights = np.hypot(*np.moveaxis(self.gradient, 2, 0)), self.settings
        most = factor + max(weights.climb, weights.descent, weights.side_slope) * steep
        return np.asarray(np.where(steep > weights.steepest, _BARRING * most, most), np.float64)


_BARRING = 100.0
"""Tiles on which directions are barred share no square with others: they are told as so many times dearer."""


@dataclass(frozen=True, slots=True)
class FreeGround:
    """The tiles of a window, what a metre costs on them, and on which of their pixels the vehicle can be."""

    factor: NDArray[np.float64]
    """(rows, cols) cost per unit of length, north row first; inf where closed."""
    pixels: int
    """Pixels along a side of a tile."""
    read: Callable[[slice, slice], NDArray[np.bool_]]
    """Gives the free pixels of some rows and columns of tiles, (rows * pixels, cols * pixels)."""
    joins_corners: bool = False
    """True if the vehicle can go from one free pixel to another that touches it at a corner alone."""
    directions: Directions | None = None
    """Cost by direction; None: alike in all."""

    def costs(self, rows: slice, cols: slice) -> NDArray[np.float32]:
        """Return the cost of each pixel of some rows and columns of tiles; inf where closed."""
        out = by_pixel(self.factor[rows, cols].astype(np.float32), self.pixels)
        out[~self.read(rows, cols)] = np.inf
        return out

    def line_costs(self, start: NDArray[np.int64], stop: NDArray[np.int64]) -> NDArray[np.float64]:
        """Integrate the cost along straight lines between middles of pixels, (n, 2) of the window; see `line_cost`."""
        cost = np.full(len(start), np.inf)
        rows, cols = self.factor.shape
        top, bottom = np.minimum(start, stop)[:, 0] // self.pixels, np.maximum(start, stop)[:, 0] // self.pixels
        height = max(_LEAST_ROWS, _STRIP_PIXELS // (cols * self.pixels**2))
        for first in range(0, rows, height):
            lines = np.flatnonzero((top >= first) & (top < first + height))
            if len(lines):
                factor = self.costs(slice(first, int(bottom[lines].max()) + 1), slice(0, cols))
                corner = np.array([first * self.pixels, 0])
                ends = start[lines] - corner, stop[lines] - corner
                cost[lines] = line_cost(factor, *ends, corners=self.joins_corners)
        return cost


_LEAST_ROWS, _STRIP_PIXELS = 32, 4_000_000
"""Pixels that are read at once, but at least so many rows of tiles."""


@dataclass(frozen=True, slots=True)
class _Areas:
    """Free areas: pixels of a tile that hang together; those that fill their tile are full."""

    tile: NDArray[np.int64]
    """(n, 2) row and column of the tile."""
    size: NDArray[np.int64]
    """(n,) pixels."""
    place: NDArray[np.int64]
    """(n, 2) row and column of the pixel that is nearest to the middle of the area."""
    pair: NDArray[np.int64]
    """(m, 2) areas that touch, in order, each pair once; not those that are both full and lie side by side."""
    contact: NDArray[np.int64]
    """(m, 2, 2) row and column of a pixel of both, side by side in the middle of where they touch, or at a corner."""

    @classmethod
    def of(cls, ground: FreeGround) -> "_Areas":
        """Find the areas strip by strip; they are sorted by tile."""
        rows, cols = ground.factor.shape
        pixels, height = ground.pixels, max(1, _STRIP_PIXELS // (cols * ground.pixels**2))
        corners, parts, contacts, count = ground.joins_corners, [], [], 0
        above = np.full((0, cols, pixels), -1, np.int64)
        for top in range(0, rows, height):
            lines = slice(top, min(top + height, rows))
            node, part = _areas_of(ground, lines, count)
            parts.append(part)
            count += len(part[0])
            west, east = (node[:, :, :-1, -1], node[:, :, 1:, 0])
            sides = (side.transpose(0, 2, 1).reshape(-1, pixels) for side in (west, east))
            *both, border, here, there = _touching(*sides, corners=corners).T
            row, col = divmod(border, max(cols - 1, 1))
            row, col = (top + row) * pixels, (col + 1) * pixels
            contacts.append(np.column_stack([*both, row + here, col - 1, row + there, col]))
            north = np.concatenate([above, node[:-1, -1]])
            south = node[len(node) - len(north) :, 0]
            sides = (side.reshape(-1, cols * pixels) for side in (north, south))
            *both, border, here, there = _touching(*sides, corners=corners).T
            row = (lines.stop - len(north) + border) * pixels
            contacts.append(np.column_stack([*both, row - 1, here, row, there]))
            above = node[-1:, -1]
        tile, size, place = (np.concatenate(columns) for columns in zip(*parts, strict=True))
        found = np.concatenate(contacts)
        order = np.lexsort((np.arange(count), tile[:, 1], tile[:, 0]))
        rank = np.argsort(order)
        pair = rank[found[:, :2]]
        contact = found[:, 2:].reshape(-1, 2, 2)
        swapped = pair[:, 0] > pair[:, 1]
        pair[swapped], contact[swapped] = pair[swapped, ::-1], contact[swapped, ::-1]
        tile, size, place = tile[order], size[order], place[order]
        is_diagonal = (contact[:, 0] != contact[:, 1]).all(axis=1)
        kept = np.flatnonzero((size[pair] < pixels**2).any(axis=1) | is_diagonal)
        kept = kept[np.lexsort((pair[kept, 1], pair[kept, 0]))]
        return cls(tile, size, place, pair[kept], contact[kept])


def _areas_of(ground: FreeGround, lines: slice, count: int) -> tuple[NDArray[np.int64], tuple[NDArray[np.int64], ...]]:
    """Find the areas of some rows of tiles, and number them from ``count`` on.

    Returns the area of each pixel (rows, pixels, cols, pixels), -1 where closed, and of each area row and column of its
    tile, its pixels, and row and column of its place.
    """
    rows, cols, pixels = lines.stop - lines.start, ground.factor.shape[1], ground.pixels
    free = np.isfinite(ground.costs(lines, slice(0, cols)))
    apart = np.zeros((rows, pixels + 1, cols, pixels + 1), np.bool_)  # closed lines keep the areas of tiles apart
    apart[:, :-1, :, :-1] = free.reshape(rows, pixels, cols, pixels)
    together = ndimage.generate_binary_structure(2, 2 if ground.joins_corners else 1)
    labels, found = ndimage.label(apart.reshape(rows * (pixels + 1), cols * (pixels + 1)), together)
    node = labels.reshape(apart.shape)[:, :-1, :, :-1].astype(np.int64) - 1
    number = node[node >= 0]
    at = np.argwhere(node >= 0)
    tile = np.empty((found, 2), np.int64)
    tile[number] = at[:, [0, 2]]
    place = at[:, [0, 2]] * pixels + at[:, [1, 3]]
    size = np.bincount(number, minlength=found)
    middle = np.stack([np.bincount(number, place[:, axis], found) / size for axis in (0, 1)], axis=1)
    off = np.square(place - middle[number]).sum(axis=1)
    order = np.lexsort((off, number))
    nearest = order[np.diff(number[order], prepend=-1) > 0]
    node[node >= 0] += count
    corner = np.array([lines.start, 0])
    return node, (tile + corner, size, place[nearest] + corner * pixels)


def _touching(first: NDArray[np.int64], other: NDArray[np.int64], *, corners: bool) -> NDArray[np.int64]:
    """Return the areas that touch over borders between tiles, and where, each pair once.

    ``first``, ``other`` (borders, n): areas of the pixels on both sides of borders, -1 where closed. Areas touch by
    sides of pixels, and with ``corners`` also where the pixels beside a corner are closed. Returns (m, 5): both areas,
    the border, and the place along it of a pixel of each; by sides, in the middle of where they touch.
    """
    one, two = first >= 0, other >= 0
    parts = [(one & two, 0, 0)]
    if corners:
        parts.append((one[:, :-1] & two[:, 1:] & ~one[:, 1:] & ~two[:, :-1], 0, 1))
        parts.append((one[:, 1:] & two[:, :-1] & ~one[:, :-1] & ~two[:, 1:], 1, 0))
    found = []
    for touches, off_first, off_other in parts:
        border, along = np.nonzero(touches)
        here, there = along + off_first, along + off_other
        found.append(np.column_stack([first[border, here], other[border, there], border, here, there]))
    at = np.concatenate(found)
    is_corner = at[:, 3] != at[:, 4]
    order = np.lexsort((is_corner, at[:, 1], at[:, 0]))
    at, is_corner = at[order], is_corner[order]
    starts = np.flatnonzero((np.diff(at[:, :2], axis=0, prepend=-1) != 0).any(axis=1))
    if not len(starts):
        return at
    by_sides = np.add.reduceat(~is_corner, starts, dtype=np.int64)
    middle: NDArray[np.int64] = at[starts + by_sides // 2]
    return middle


@dataclass(frozen=True, slots=True)
class Lattice:
    """A connected graph of squares, areas and bends."""

    row: NDArray[np.int64]
    """(n,) row of each node's pixel in the window, from the north."""
    col: NDArray[np.int64]
    """(n,) column, from the west."""
    side: NDArray[np.int64]
    """(n,) side of its square, tiles; 0 for other nodes."""
    size: NDArray[np.int64]
    """(n,) pixels of its square or area; 0 for a bend."""
    first: NDArray[np.int64]
    """(m,) number of the node at one end of each edge."""
    second: NDArray[np.int64]
    """(m,) at the other end."""
    cost: NDArray[np.float64]
    """(m,) cost of the straight line from the first to the second, in sides of a pixel."""
    back: NDArray[np.float64]
    """(m,) the same from the second to the first."""
    tiles_left_out: int
    """Free ground that is not connected with the largest part and was left out, in tiles."""


def _squares(
    factor: NDArray[np.floating], largest: int, origin: tuple[int, int]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Divide the open tiles into the largest squares of open tiles of about the same cost.

    Returns row and column of the middle tile of each (n, 2), its side in tiles (n,), and the number of the square that
    each tile lies in, -1 where closed; ``factor`` and ``origin`` as in `thin`.
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
    place = np.column_stack([row.ravel()[node] - before[0], col.ravel()[node] - before[1]])
    return place, side.ravel()[node], inside


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


@dataclass(frozen=True, slots=True)
class _Nodes:
    """Squares of full tiles, then the other areas."""

    areas: _Areas
    side: NDArray[np.int64]
    """(squares,) side of each square, tiles."""
    number: NDArray[np.int64]
    """(rows, cols) number of the square that each tile lies in; -1 where there is none."""
    place: NDArray[np.int64]
    """(n, 2) row and column of the node's pixel."""
    size: NDArray[np.int64]
    """(n,) pixels."""
    of_area: NDArray[np.int64]
    """The node of each area."""

    @classmethod
    def of(cls, ground: FreeGround, areas: _Areas, largest: int, origin: tuple[int, int]) -> "_Nodes":
        pixels = ground.pixels
        is_full = areas.size == pixels**2
        factor = np.full(ground.factor.shape, np.inf)
        at = tuple(areas.tile[is_full].T)
        factor[at] = (ground.factor if ground.directions is None else ground.directions.dearest(ground.factor))[at]
        tile, side, number = _squares(factor, largest, origin)
        middle = tile * pixels + (pixels - 1) // 2
        of_area = np.empty(len(is_full), np.int64)
        of_area[is_full] = number[at]
        of_area[~is_full] = len(middle) + np.arange((~is_full).sum())
        size = np.concatenate([side**2 * pixels**2, areas.size[~is_full]])
        return cls(areas, side, number, np.concatenate([middle, areas.place[~is_full]]), size, of_area)


def join(ground: FreeGround, nodes: _Nodes) -> Lattice:
    """Join nodes, from `thin`, by edges where a straight line crosses only free pixels.

    Lines in barred directions are left out. Only the connected part with most ground is kept: from each of its nodes
    there is a way to every other.
    """
    count, squares = len(nodes.place), len(nodes.side)
    pair = nodes.of_area[nodes.areas.pair]
    touching, at = np.unique(np.sort(pair, axis=1), axis=0, return_index=True)
    beside = _others(_pairs(nodes.number, squares), touching)
    near = _two_apart(np.concatenate([touching, beside]), nodes, 2 * ground.pixels)
    wanted = np.concatenate([touching, beside, near])
    cost = ground.line_costs(nodes.place[wanted[:, 0]], nodes.place[wanted[:, 1]])
    place, ends, costs = [nodes.place], [wanted[np.isfinite(cost)]], [cost[np.isfinite(cost)]]
    detours = _Detours(ground, nodes)
    for contact in at[np.isinf(cost[: len(touching)])].tolist():
        bends, part = detours.find(contact)
        numbers = np.concatenate([pair[contact, :1], count + np.arange(len(bends)), pair[contact, 1:]])
        count += len(bends)
        place.append(bends)
        ends.append(np.column_stack([numbers[:-1], numbers[1:]]))
        costs.append(part)
    places, joined, cost = np.concatenate(place), np.concatenate(ends), np.concatenate(costs)
    both = np.stack([cost, cost], axis=1)
    if ground.directions is not None:
        lines = places[joined]
        both = np.stack([ground.directions.costs(lines[:, 0], lines[:, 1])] * 2, axis=1)
        if not ground.directions.settings.same_back:
            both[:, 1] = ground.directions.costs(lines[:, 1], lines[:, 0])
        joined, both = joined[np.isfinite(both[:, 0])], both[np.isfinite(both[:, 0])]  # barred there, barred back
    return _largest_part(places, nodes, joined, both, ground.pixels)


def _two_apart(joined: NDArray[np.int64], nodes: _Nodes, limit_px: int) -> NDArray[np.int64]:
    """Return the pairs of small nodes, not both squares, that touch a third, less than ``limit_px`` pixels apart."""
    count, squares = len(nodes.place), len(nodes.side)
    small = np.append(nodes.side == 1, np.ones(count - squares, np.bool_))
    ends = joined[small[joined].all(axis=1)]
    one = coo_array((np.ones(len(ends)), ends.T), shape=(count, count)).tocsr()
    one += one.T
    first, second = (one @ one).tocoo().coords
    kept = (first < second) & (second >= squares)
    first, second = first[kept], second[kept]
    apart = np.abs(nodes.place[first] - nodes.place[second]).max(axis=1, initial=0)
    found: NDArray[np.int64] = np.column_stack([first, second])[apart < limit_px].astype(np.int64)
    return _others(found, np.sort(joined, axis=1))


def _others(pairs: NDArray[np.int64], known: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the pairs, (n, 2), that are not among those known."""
    count = 1 + max(pairs.max(initial=0), known.max(initial=0))
    new: NDArray[np.int64] = pairs[~np.isin(pairs @ (count, 1), known @ (count, 1))]
    return new


class _Detours:
    """Lines with bends between areas that touch where the straight line is not free."""

    def __init__(self, ground: FreeGround, nodes: _Nodes) -> None:
        self._ground, self._nodes = ground, nodes
        self._before: dict[int, dict[tuple[int, int], tuple[int, int]]] = {}

    def find(self, contact: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the bends of the line between two areas, (k, 2) row and column, and the costs of its k + 1 parts."""
        areas = self._nodes.areas
        ways = [self._way(area, place) for area, place in zip(areas.pair[contact], areas.contact[contact], strict=True)]
        line = np.array([*ways[0], *ways[1][::-1]])
        pixels = self._ground.pixels
        corner, end = line.min(axis=0) // pixels, line.max(axis=0) // pixels + 1
        factor = self._ground.costs(slice(int(corner[0]), int(end[0])), slice(int(corner[1]), int(end[1])))
        cells, at, kept, costs = line - corner * pixels, 0, [0], []
        while at < len(cells) - 1:
            start = np.broadcast_to(cells[at], cells[at + 1 :].shape)
            ahead = line_cost(factor, start, cells[at + 1 :], corners=self._ground.joins_corners)
            farthest = int(np.flatnonzero(np.isfinite(ahead))[-1])
            costs.append(float(ahead[farthest]))
            at += farthest + 1
            kept.append(at)
        return line[kept[1:-1]], np.array(costs)

    def _way(self, area: int, end: NDArray[np.int64]) -> list[tuple[int, int]]:
        """Return pixels from the node of an area to one of its pixels: the corners of a line over free pixels."""
        nodes, at = self._nodes, (int(end[0]), int(end[1]))
        node = int(nodes.of_area[area])
        if node < len(nodes.side):  # in a square all lines are free
            return [tuple(nodes.place[node].tolist()), at]
        if area not in self._before:
            self._before[area] = self._walk(nodes.areas.tile[area], tuple(nodes.place[node].tolist()))
        way = [at]
        while (ahead := self._before[area][way[-1]]) != way[-1]:
            way.append(ahead)
        return way[::-1]

    def _walk(self, tile: NDArray[np.int64], start: tuple[int, int]) -> dict[tuple[int, int], tuple[int, int]]:
        """Return, of each pixel of an area, the one before it on a way of fewest steps from ``start``."""
        row, col = (int(x) for x in tile)
        top, left = row * self._ground.pixels, col * self._ground.pixels
        free = np.isfinite(self._ground.costs(slice(row, row + 1), slice(col, col + 1)))
        before, waiting = {start: start}, deque([start])
        while waiting:
            here = waiting.popleft()
            for down, right in _STEPS[: 8 if self._ground.joins_corners else 4]:
                i, j = here[0] + down, here[1] + right
                inside = 0 <= i - top < len(free) and 0 <= j - left < len(free)
                if inside and (i, j) not in before and free[i - top, j - left]:
                    before[i, j] = here
                    waiting.append((i, j))
        return before


def _largest_part(
    place: NDArray[np.int64], nodes: _Nodes, ends: NDArray[np.int64], both: NDArray[np.float64], pixels: int
) -> Lattice:
    """Leave out what is not connected with the largest part; ``both`` (m, 2) are costs there and back."""
    count, bends = len(place), len(place) - len(nodes.size)
    size = np.append(nodes.size, np.zeros(bends, np.int64))
    side = np.append(nodes.side, np.zeros(count - len(nodes.side), np.int64))
    graph = coo_array((np.ones(len(ends)), ends.T), shape=(count, count))
    _, part = connected_components(graph, directed=False)
    kept = part == np.bincount(part, weights=size, minlength=1).argmax()
    number = np.cumsum(kept) - 1
    inside = kept[ends[:, 0]]
    first, second = number[ends[inside]].T
    return Lattice(
        place[kept, 0],
        place[kept, 1],
        side[kept],
        size[kept],
        first,
        second,
        both[inside, 0],
        both[inside, 1],
        tiles_left_out=round(float(size[~kept].sum()) / pixels**2),
    )


def _pairs(number: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Return the numbers of squares that touch, (n, 2), each pair once, in order."""
    rows, cols = number.shape
    found = [np.empty(0, np.int64)]
    for down, right in _NEIGHBOURS:
        one = number[: rows - down, max(0, -right) : cols - max(0, right)]
        other = number[down:, max(0, right) : cols - max(0, -right)]
        touch = (one != other) & (one >= 0) & (other >= 0)
        pair = np.sort(np.stack([one[touch], other[touch]]), axis=0)
        found.append(np.unique(pair[0] * count + pair[1]))
    return np.column_stack(np.divmod(np.unique(np.concatenate(found)), max(count, 1)))


_MAX_TILES = 9_000_000
"""Most tiles that are thinned at once."""
_USUAL_NODES, _MAX_NODES = 5_000, 100_000


def make_graph(area: ExportArea, settings: ExportSettings) -> tuple[Lattice, int]:
    """Thin the free ground of an area to a graph; return it, and the side of its largest squares, tiles.

    Parameters
    ----------
    area : ExportArea
        With one cell a tile.
    settings : ExportSettings
        ``every``: side of the largest squares that hold one node each, one of ``SQUARES``; if None, the smallest that
        gives at most 5,000 nodes, or 27. And what direction costs.

    Raises
    ------
    BadInputError
        The area is too large, holds no two free areas that are connected, or gives too many nodes.
    """
    window, route_map = area.window, area.route_map
    if window.cols * window.rows > _MAX_TILES:
        raise BadInputError(
            f"the area has {window.cols * window.rows:,} tiles; a graph is made of {_MAX_TILES:,} at most. "
            "Crop it with `around` and `radius`"
        )
    factor, by_heading = np.empty(area.shape), settings.direction and route_map.has_headings
    by_axis = np.empty((*area.shape, len(AXES_DEG)), np.float32) if by_heading else factor[..., None]
    for part, lines in area.strips():
        field = route_map.read(part, ("c_r", "p_fail"))
        hazard = field.rule.hazard(field.p_fail)
        cost = field.rule.cost(field.c_r.astype(np.float64), hazard)
        factor[lines] = np.where(np.isin(field.barred, OPEN_THROUGH) & np.isfinite(cost), cost, np.inf)
        if by_heading:
            c_r = field.c_r[..., None] * by_mean(route_map.headings(part), field.c_r)
            by_axis[lines] = field.rule.cost(c_r, hazard[..., None])
    gradient = route_map.gradient(window) if settings.knows_slope else None
    directions = Directions(settings, route_map.grid.pixels, by_axis, gradient)
    origin = (-(window.row + window.rows), window.col)  # both grow along the array: squares keep their place on Earth
    with route_map.kept_open():
        vehicle, grid, is_directed = route_map.vehicle, route_map.grid, by_heading or settings.knows_slope
        corners = corners_join(vehicle.width_m, vehicle.reach_m, grid.pixel_size)
        free = partial(_free_pixels, area)
        ground = FreeGround(factor, grid.pixels, free, corners, directions if is_directed else None)
        every, nodes = thin(ground, settings.every, origin)
        if len(nodes.place) > _MAX_NODES:
            larger = f"Pass a larger one, up to {SQUARES[-1]}, or crop" if every < SQUARES[-1] else "Crop"
            raise BadInputError(
                f"the graph would have {len(nodes.place):,} nodes with `every={every}`; it may have {_MAX_NODES:,}. "
                f"{larger} the area with `around` and `radius`"
            )
        lattice = join(ground, nodes)
    if not len(lattice.cost):
        raise BadInputError(
            f"no two nodes are connected: {len(nodes.place)} of the area, with `every={every}`. Choose another area, "
            "or pass a smaller `every`"
        )
    return lattice, every


def _free_pixels(area: ExportArea, rows: slice, cols: slice) -> NDArray[np.bool_]:
    """Read where the middle of the vehicle can be in some rows and columns of tiles of an area."""
    window = area.window
    south = window.row + window.rows - rows.stop
    part = TileWindow(window.col + cols.start, south, cols.stop - cols.start, rows.stop - rows.start)
    return area.route_map.passage(part)


def thin(ground: FreeGround, every: int | None, origin: tuple[int, int]) -> tuple[int, _Nodes]:
    """Place nodes in the squares and areas of some ground; return the side of the largest square, and the nodes.

    Parameters
    ----------
    ground : FreeGround
    every : int, optional
        As ``settings.every`` of `make_graph`.
    origin : (int, int)
        Position of the first row and column of tiles in the grid of squares: crops of one map share their squares.
    """
    areas = _Areas.of(ground)
    for side in SQUARES if every is None else (every,):
        nodes = _Nodes.of(ground, areas, side, origin)
        if len(nodes.place) <= _USUAL_NODES:
            break
    return side, nodes


def write_graph(folder: Path, area: ExportArea, lattice: Lattice, every: int) -> dict[str, Any]:
    """Write graph.geojson, and return what the sidecar file says of it."""
    with atomic(folder / "graph.geojson") as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        file.write('{"type":"FeatureCollection","name":"bumpymap","features":[\n')
        for number, feature in enumerate(_features(area, lattice)):
            file.write((",\n" if number else "") + json.dumps(feature, separators=(",", ":"), allow_nan=False))
        file.write("\n]}\n")
    nodes, edges = len(lattice.row), 2 * len(lattice.cost)
    return {
        "graph": {
            "nodes": nodes,
            "edges": edges,
            "bends": int((lattice.size == 0).sum()),
            "tiles_left_out": lattice.tiles_left_out,
            "largest_square": every,
            "cost": "m of smooth, safe ground",
        }
    }


def _features(area: ExportArea, lattice: Lattice) -> Iterator[dict[str, Any]]:
    """Yield nodes, then edges in both directions; no two features share an id.

    The cost is not overridable: with scorers of its own, such as that of distance, the server would not look at it.
    """
    size, bounds = area.route_map.grid.pixel_size, area.bounds
    x = (bounds.west + (lattice.col + 0.5) * size).tolist()
    y = (bounds.north - (lattice.row + 0.5) * size).tolist()
    sizes = zip(lattice.side.tolist(), lattice.size.tolist(), strict=True)
    for number, (place, (side, pixels)) in enumerate(zip(zip(x, y, strict=True), sizes, strict=True)):
        geometry = {"type": "Point", "coordinates": place}
        about = {"kind": "square" if side else "area" if pixels else "bend", "tiles": side, "pixels": pixels}
        properties = {"id": number, "frame": FRAME, "metadata": about}
        yield {"type": "Feature", "properties": properties, "geometry": geometry}
    costs = np.stack([lattice.cost, lattice.back], axis=1) * size
    number = len(x)
    for first, second, both in zip(lattice.first.tolist(), lattice.second.tolist(), costs.tolist(), strict=True):
        for start, end, cost in zip((first, second), (second, first), both, strict=True):
            properties = {"id": number, "startid": start, "endid": end, "cost": cost, "overridable": False}
            line = [[[x[start], y[start]], [x[end], y[end]]]]
            geometry = {"type": "MultiLineString", "coordinates": line}
            yield {"type": "Feature", "properties": properties, "geometry": geometry}
            number += 1
