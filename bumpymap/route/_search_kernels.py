"""Compiled kernels: the cheapest ways over a window, from tile to tile.

A* with a heap of four children a node, in which a tile stands once and moves up when a cheaper way to it is found. The
window is flattened row by row and has a ring of closed tiles as wide as the longest move, so that no move has to look
where the window ends. Moves are many and most come too near to a closed tile, or lead to tiles that are settled or have
been reached for less than the move costs at least: all that is asked before the integral over its tiles. Closed tiles
around the start of a move are the bits of two numbers, as are the tiles that must be open for it.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.route._line_kernels import slope_cost
from bumpytiles import helper, kernel

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Tiles = NDArray[np.int32]
Bytes = NDArray[np.uint8]

FROM_START = 254
"""In place of a move: straight from the start."""
NOT_REACHED = 255
"""In place of a move: no way leads there."""
NEW, SETTLED = -1, -2
"""Values of ``Reached.place``: not met so far; its cost is final."""
REACH = 4
"""Tiles that a move goes at most, along each axis."""
_CHILDREN = 4
"""Children of a node of the heap."""


class MoveTables(NamedTuple):
    """The k moves from tile to tile of a flattened window; see `bumpymap.route.search`."""

    step: Annotated[Integers, 1]
    """(k,) from tile to tile."""
    length: Annotated[Floats, 1]
    """(k,) in tiles."""
    end: Annotated[Floats, 1]
    """(k,) length in the tile where it starts, and in the one where it ends, tiles."""
    first_piece: Annotated[Integers, 1]
    """(k + 1,) where a move's other pieces start in the next two."""
    piece: Annotated[Integers, 1]
    """From the tile where the move starts to one that it crosses."""
    piece_length: Annotated[Floats, 1]
    """Length in that tile, tiles."""
    axis: Annotated[Integers, 2]
    """(k, 2) the axes that it lies between."""
    share: Annotated[Floats, 1]
    """(k,) how far it is from the first of them to the second."""
    direction: Annotated[Floats, 2]
    """(k, 2) southwards and eastwards in a length of 1."""
    near_north: Annotated[Integers, 1]
    """(k,) tiles that must be open, those that it crosses included, as bits of the north half around the start."""
    near_south: Annotated[Integers, 1]
    """(k,) the same of the south half."""


class Ground(NamedTuple):
    """A flattened window with its ring."""

    cost: Annotated[NDArray[np.float32], 2]
    """(n, axes) per tile of length, see `bumpymap.route._line_kernels`; infinite where closed."""
    gradient: Annotated[NDArray[np.float32], 2]
    """(n, 2) what slopes add, if they do, as in `bumpymap.route._line_kernels.Costs`; so are the next four."""
    climb: float
    descent: float
    side: float
    steepest: float
    closed: Annotated[Bytes, 1]
    """A bit for each tile, from the least of a byte on: whether it is closed; one byte more than these take."""
    width: int
    """Columns."""
    goal_row: float
    goal_col: float
    """Field coordinates of the goal."""
    least: float
    """No tile costs less; at least 1."""
    bound: float
    """No tile on any way to the goal costs less, those outside the window included; 0 to search all around alike."""


class Seeds(NamedTuple):
    """How start and goal, which lie anywhere in their tiles, hang together with the middles of tiles."""

    tile: Annotated[Integers, 1]
    """(s,) tiles that the start sees."""
    cost: Annotated[Floats, 1]
    """(s,) straight to each."""
    exit_cost: Annotated[Floats, 2]
    """(m, m) straight from a tile to the goal; the goal's tile is in the middle."""
    best: float
    """Cost of a way that is known; infinite if none."""


class Reached(NamedTuple):
    """Arrays that the search fills; `place` and `back` come filled with `NEW` and `NOT_REACHED`, `g` with infinity."""

    g: Annotated[Floats, 1]
    """(n,) cost from the start."""
    back: Annotated[Bytes, 1]
    """(n,) the move that led there, or `FROM_START`."""
    place: Annotated[Tiles, 1]
    """(n,) place in the heap; below -1 if the cost is final."""
    heap: Annotated[Tiles, 1]
    """(n,) scratch."""
    key: Annotated[Floats, 1]
    """(n,) scratch."""
    last: Annotated[Integers, 1]
    """(1,) the tile from which the way goes straight to the goal; -1 if the known way is the best."""
    best: Annotated[Floats, 1]
    """(1,) cost of the best way."""


@helper
def _rise(reached: Reached, i: int, tile: int, key: float) -> None:
    """Put a tile at a place of the heap or above it."""
    while i > 0:
        above = (i - 1) // _CHILDREN
        if reached.key[above] <= key:
            break
        reached.key[i] = reached.key[above]
        reached.heap[i] = reached.heap[above]
        reached.place[reached.heap[i]] = i
        i = above
    reached.key[i] = key
    reached.heap[i] = tile
    reached.place[tile] = i


@helper
def _sink(reached: Reached, size: int, tile: int, key: float) -> None:
    """Put a tile at the top of the heap or below it."""
    i = 0
    while True:
        child = i * _CHILDREN + 1
        if child >= size:
            break
        least = child
        for other in range(child + 1, min(child + _CHILDREN, size)):
            if reached.key[other] < reached.key[least]:
                least = other
        if reached.key[least] >= key:
            break
        reached.key[i] = reached.key[least]
        reached.heap[i] = reached.heap[least]
        reached.place[reached.heap[i]] = i
        i = least
    reached.key[i] = key
    reached.heap[i] = tile
    reached.place[tile] = i


@helper
def _bound(ground: Ground, tile: int) -> float:
    """Return what a tile's middle is at least from the goal."""
    if ground.bound == 0.0:
        return 0.0
    row = tile // ground.width
    dr, dc = row + 0.5 - ground.goal_row, tile - row * ground.width + 0.5 - ground.goal_col
    return ground.bound * math.sqrt(dr * dr + dc * dc)


@helper
def _offer(ground: Ground, reached: Reached, tile: int, g: float, move: int, size: int) -> int:
    """Take a cheaper way to a tile, unless the goal is too far behind it; returns the size of the heap."""
    key = g + _bound(ground, tile)
    if key >= reached.best[0]:
        return size
    reached.g[tile] = g
    reached.back[tile] = move
    place = int(np.int64(reached.place[tile]))
    if place == NEW:
        _rise(reached, size, tile, key)
        return size + 1
    _rise(reached, place, tile, key)
    return size


@helper
def _closed_around(ground: Ground, tile: int, first: int, last: int) -> int:
    """Return which tiles are closed in some rows around a tile: nine bits a row, the first row's the highest."""
    found = np.int64(0)
    for row in range(first, last):
        at = tile + row * ground.width - REACH
        two = np.int64(ground.closed[at >> 3]) | np.int64(ground.closed[(at >> 3) + 1]) << 8
        found = found << (2 * REACH + 1) | (two >> (at & 7)) & ((1 << (2 * REACH + 1)) - 1)
    return int(found)


@helper
def _cost_of(ground: Ground, moves: MoveTables, k: int, tile: int) -> float:
    """Cost of an open tile in the direction of a move."""
    total, share = np.float64(ground.cost[tile, moves.axis[k, 0]]), moves.share[k]
    if share != 0.0:
        total += share * (np.float64(ground.cost[tile, moves.axis[k, 1]]) - total)
    if ground.gradient.shape[0] > 0:
        south, east = np.float64(ground.gradient[tile, 0]), np.float64(ground.gradient[tile, 1])
        down, right = moves.direction[k, 0], moves.direction[k, 1]
        total += slope_cost(south, east, down, right, ground.climb, ground.descent, ground.side, ground.steepest)
    return float(total)


@helper
def _move_cost(ground: Ground, moves: MoveTables, k: int, tile: int, limit: float) -> float:
    """Exact integral of the cost along a move; infinite if it cannot be below the limit."""
    total: float = moves.end[k] * _cost_of(ground, moves, k, tile)
    total += moves.end[k] * _cost_of(ground, moves, k, tile + moves.step[k])
    if total + (moves.length[k] - 2.0 * moves.end[k]) * ground.least >= limit:
        return math.inf
    for i in range(moves.first_piece[k], moves.first_piece[k + 1]):
        total += moves.piece_length[i] * _cost_of(ground, moves, k, tile + moves.piece[i])
    return total


@helper
def _try_exit(ground: Ground, seeds: Seeds, reached: Reached, tile: int) -> None:
    """See whether the goal is reached for less by going straight there from a tile."""
    half = seeds.exit_cost.shape[0] // 2
    row = tile // ground.width
    r = row - math.floor(ground.goal_row) + half
    c = tile - row * ground.width - math.floor(ground.goal_col) + half
    if 0 <= r <= 2 * half and 0 <= c <= 2 * half and reached.g[tile] + seeds.exit_cost[r, c] < reached.best[0]:
        reached.best[0] = reached.g[tile] + seeds.exit_cost[r, c]
        reached.last[0] = tile


@kernel
def search(ground: Ground, moves: MoveTables, seeds: Seeds, reached: Reached) -> None:
    """Settle tiles from the start on until no way that is open can be cheaper than the best to the goal."""
    size = 0
    reached.best[0], reached.last[0] = seeds.best, -1
    for i in range(seeds.tile.shape[0]):
        tile = int(seeds.tile[i])
        size = _offer(ground, reached, tile, seeds.cost[i], FROM_START, size)
    while size > 0 and reached.key[0] < reached.best[0]:
        tile = int(np.int64(reached.heap[0]))
        reached.place[tile] = SETTLED
        size -= 1
        if size > 0:
            _sink(reached, size, int(np.int64(reached.heap[size])), reached.key[size])
        _try_exit(ground, seeds, reached, tile)
        g = reached.g[tile]
        north, south = _closed_around(ground, tile, -REACH, 1), _closed_around(ground, tile, 1, REACH + 1)
        for k in range(moves.step.shape[0]):
            to = tile + moves.step[k]
            if north & moves.near_north[k] or south & moves.near_south[k] or reached.place[to] == SETTLED:
                continue
            total = g + _move_cost(ground, moves, k, tile, reached.g[to] - g)
            if total < reached.g[to]:
                size = _offer(ground, reached, to, total, k, size)
