"""Compiled kernels: pixels of a mosaic of tiles in; grown obstacles, the ways through each tile and its areas, out."""

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import OBSTACLE, STEP_EDGE, UNSEEN
from bumpytiles import helper, kernel

Bytes = NDArray[np.uint8]
Integers = NDArray[np.int32]
Booleans = NDArray[np.bool_]

_NORTH, _EAST, _SOUTH, _WEST = 1, 2, 4, 8
"""Bits of the sides of a tile."""
_FAR = 0xFFFF - 1
"""Distance, px, that stands for any farther: the highest of 16 bits but one."""
_FREE = 255
"""In the place of the number of an area: free, and not numbered yet."""


class Mosaic(NamedTuple):
    """Tiles of a block with a ring of one tile around them."""

    objects: Annotated[Bytes, 2]
    """(tiles * pixels, tiles * pixels) states of `bumpymap.core.ObjectStack`, settled."""
    pixels: int
    """Along a side of a tile."""
    radius: float
    """Distance from obstacles that the middle of the vehicle keeps, px."""
    corners: bool
    """True if free pixels hang together by their corners too, see `bumpymap.core.corners_join`."""


class InnerTiles(NamedTuple):
    """Values that are read and filled for the tiles within the ring."""

    edges: Annotated[Booleans, 3]
    """(tiles - 2, tiles - 2, 4) which edges can be crossed: north, east, south, west."""
    wanted: Annotated[Booleans, 2]
    """(tiles - 2, tiles - 2) which tiles to look at; in the others, the arrays that follow are filled with False."""
    passable: Annotated[Booleans, 2]
    """The same shape, filled: whether there is a way through the tile."""
    blocked: Annotated[Booleans, 2]
    """The same shape, filled: whether there would be none if every edge could be crossed."""
    near_obstacle: Annotated[Booleans, 2]
    """The same shape, filled: whether it is blocked, and an obstacle lies in it or within the radius of it."""


class GrowScratch(NamedTuple):
    """Scratch, see `grow_scratch`."""

    mask: Annotated[Bytes, 2]
    """(rows, cols) of pixels: where the middle of the vehicle cannot be."""
    near: Annotated[NDArray[np.uint16], 2]
    """(rows, cols + 2 * reach) distance along the column to what it cannot touch, px; large at both ends."""
    stack: Annotated[Integers, 1]
    """(pixels^2,) of a tile."""


def grow_scratch(mosaic: Mosaic) -> GrowScratch:
    """Make scratch for a mosaic."""
    rows, cols = mosaic.objects.shape
    near = np.empty((rows, cols + 2 * math.ceil(mosaic.radius)), np.uint16)
    return GrowScratch(np.empty((rows, cols), np.uint8), near, np.empty(mosaic.pixels**2, np.int32))


@helper
def _fill_near(objects: Bytes, margin: int, near: NDArray[np.uint16]) -> None:
    """Distance of each pixel to the nearest obstacle, step or unseen pixel of its column."""
    rows, cols = objects.shape
    far, step = np.uint16(_FAR), np.uint16(1)
    for r in range(rows):
        for c in range(near.shape[1]):
            near[r, c] = far
    for r in range(rows):
        line, mine = near[r, margin : margin + cols], objects[r]
        before = near[max(r - 1, 0), margin : margin + cols]
        for c in range(cols):
            taken = (mine[c] == OBSTACLE) | (mine[c] == UNSEEN) | (mine[c] == STEP_EDGE)
            line[c] = np.uint16(0) if taken else min(far, np.uint16(before[c] + step))
    for k in range(1, rows):
        line = near[rows - 1 - k, margin : margin + cols]
        behind = near[rows - k, margin : margin + cols]
        for c in range(cols):
            line[c] = min(line[c], np.uint16(behind[c] + step))


@kernel
def grow_obstacles(mosaic: Mosaic, scratch: GrowScratch) -> None:
    """Mark in ``scratch.mask`` where the middle of the vehicle cannot be: within a disc of what it cannot touch."""
    rows, cols = mosaic.objects.shape
    reach = math.ceil(mosaic.radius)
    _fill_near(mosaic.objects, reach, scratch.near)
    for r in range(rows):
        mask = scratch.mask[r]
        for c in range(cols):
            mask[c] = 0
    for across in range(-reach, reach + 1):
        up = -1
        while (up + 1) * (up + 1) + across * across < mosaic.radius * mosaic.radius:
            up += 1
        if up < 0:
            continue
        most = np.uint16(up)
        for r in range(rows):
            mask, near = scratch.mask[r], scratch.near[r, reach + across : reach + across + cols]
            for c in range(cols):
                mask[c] |= np.uint8(near[c] <= most)


@helper
def _beside(k: int) -> tuple[int, int]:
    """Rows and columns from a pixel to one of the four at its sides, or (from the fifth on) at its corners."""
    if k < 4:
        return (k == 2) - (k == 0), (k == 1) - (k == 3)
    return 1 - 2 * (k & 1), 1 - (k & 2)


@helper
def _flood(cells: Bytes, start: int, value: int, corners: bool, stack: Integers) -> tuple[int, int]:
    """Give the pixels of a tile that are as one of them, and hang together with it, another value.

    Returns how many there are, and the sides of the tile that they touch.
    """
    size, count, sides, depth = cells.shape[0], 0, 0, 1
    before = cells[start // size, start % size]
    stack[0] = start
    cells[start // size, start % size] = value
    while depth > 0:
        depth -= 1
        count += 1
        r, c = stack[depth] // size, stack[depth] % size
        sides |= (_NORTH if r == 0 else 0) | (_SOUTH if r == size - 1 else 0)
        sides |= (_WEST if c == 0 else 0) | (_EAST if c == size - 1 else 0)
        for k in range(8 if corners else 4):
            down, right = _beside(k)
            row, col = r + down, c + right
            if 0 <= row < size and 0 <= col < size and cells[row, col] == before:
                cells[row, col] = value
                stack[depth] = row * size + col
                depth += 1
    return count, sides


@helper
def _count(sides: int) -> int:
    """Return the number of sides in a set."""
    return (sides & 1) + ((sides >> 1) & 1) + ((sides >> 2) & 1) + ((sides >> 3) & 1)


@helper
def _near_obstacle(mosaic: Mosaic, top: int, left: int) -> bool:
    """Return whether an obstacle or a step lies in a tile, or within the radius of one of its pixels."""
    rows, cols = mosaic.objects.shape
    reach, last = math.ceil(mosaic.radius), mosaic.pixels - 1
    for r in range(max(0, top - reach), min(rows, top + last + reach + 1)):
        down = max(0, top - r, r - top - last)
        for c in range(max(0, left - reach), min(cols, left + last + reach + 1)):
            right = max(0, left - c, c - left - last)
            stands = mosaic.objects[r, c] == OBSTACLE or mosaic.objects[r, c] == STEP_EDGE
            if stands and down * down + right * right < mosaic.radius * mosaic.radius:
                return True
    return False


@helper
def _find_way(mosaic: Mosaic, row: int, col: int, tiles: InnerTiles, scratch: GrowScratch) -> None:
    """Fill what is asked of one tile."""
    pixels = mosaic.pixels
    top, left = (row + 1) * pixels, (col + 1) * pixels
    mask = scratch.mask[top : top + pixels, left : left + pixels]
    own = mosaic.objects[top : top + pixels, left : left + pixels]
    usable, empty, free = 0, True, 0
    for k in range(4):
        usable |= (1 << k) if tiles.edges[row, col, k] else 0
    for r in range(pixels):
        for c in range(pixels):
            empty = empty and own[r, c] != OBSTACLE and own[r, c] != UNSEEN and own[r, c] != STEP_EDGE
            free += mask[r, c] == 0
    least = 1 if empty else 2
    if free == pixels * pixels:
        tiles.passable[row, col], tiles.blocked[row, col] = _count(usable) >= least, False
        tiles.near_obstacle[row, col] = False
        return
    passable, blocked = False, True
    for start in range(pixels * pixels):
        if mask[start // pixels, start % pixels] == 0:
            _, sides = _flood(mask, start, 2, mosaic.corners, scratch.stack)
            passable = passable or _count(sides & usable) >= least
            blocked = blocked and _count(sides) < least
    tiles.passable[row, col], tiles.blocked[row, col] = passable, blocked
    tiles.near_obstacle[row, col] = blocked and _near_obstacle(mosaic, top, left)


@helper
def _number_tile(free: Bytes, corners: bool, areas: Bytes, stack: Integers, sizes: Integers) -> None:
    """Give the areas of one tile their numbers."""
    size, count, found = free.shape[0], 0, 0
    for k in range(size * size):
        r, c = k // size, k % size
        areas[r, c] = _FREE * free[r, c]
        count += free[r, c]
    if count == size * size:  # one area
        areas[:, :] = 1
        return
    for k in range(size * size):
        if areas[k // size, k % size] == _FREE:
            found = min(found + 1, _FREE - 1)
            sizes[found], _ = _flood(areas, k, found, corners, stack)
    first = 1
    for number in range(2, found + 1):
        if sizes[number] > sizes[first]:
            first = number
    if first > 1:
        for k in range(size * size):
            number = areas[k // size, k % size]
            areas[k // size, k % size] = 1 if number == first else (first if number == 1 else number)


@kernel
def number_areas(
    free: Annotated[Bytes, 4],
    corners: bool,
    areas: Annotated[Bytes, 4],
    stack: Annotated[Integers, 1],
    sizes: Annotated[Integers, 1],
) -> None:
    """Give the areas of free pixels of every tile numbers from 1, the largest (of equal ones the northernmost), or 0.

    ``free`` and ``areas`` are (rows, cols, pixels, pixels); ``stack`` takes pixels^2 and ``sizes`` 255 numbers. Pixels
    hang together by their sides, and by their ``corners`` if that is so. Of more than 254 areas, the last share one.
    """
    for row in range(free.shape[0]):
        for col in range(free.shape[1]):
            _number_tile(free[row, col], corners, areas[row, col], stack, sizes)


@helper
def _meet(edge: Bytes, one: int, beyond: Bytes, other: int, corners: bool) -> bool:
    """Return whether areas of two tiles touch across their border; ``edge``, ``beyond``: the pixels on both sides."""
    last, wide = len(edge) - 1, 1 if corners else 0
    meet = False
    for k in range(len(edge)):
        for m in range(max(0, k - wide), min(last, k + wide) + 1):
            meet |= edge[k] == one and beyond[m] == other
    return meet


@helper
def _joined_over(upper: Bytes, side: Bytes, lower: Bytes, is_south: bool, is_east: bool, corners: bool) -> bool:
    """Return whether an area of a tile beside ``upper`` and ``lower`` touches the first areas of both.

    ``upper`` lies north of ``lower``, diagonally, and west of it if ``is_east``; ``side`` is the tile south of
    ``upper`` if ``is_south``, else the one north of ``lower``.
    """
    last, most = len(side) - 1, 0
    for k in range(side.shape[0] * side.shape[0]):
        most = max(most, int(side[k // side.shape[0], k % side.shape[0]]))
    above, below, across = (last, 0, lower) if is_south else (0, last, upper)
    up_down = upper if is_south else lower
    inner, outer = (last, 0) if is_east == is_south else (0, last)
    for number in range(1, most + 1):
        if _meet(up_down[above], 1, side[below], number, corners) and _meet(
            side[:, inner], number, across[:, outer], 1, corners
        ):
            return True
    return False


@helper
def _meet_at_corner(upper: Bytes, lower: Bytes, is_east: bool) -> bool:
    """Return whether the first areas of two tiles that lie diagonally touch where the tiles do."""
    last = upper.shape[0] - 1
    touch: bool = upper[last, last if is_east else 0] == 1 and lower[0, 0 if is_east else last] == 1
    return touch


@kernel
def close_split(
    areas: Annotated[Bytes, 4],
    largest: Annotated[Integers, 2],
    passable: Annotated[Booleans, 2],
    corners: bool,
    split: Annotated[Booleans, 2],
) -> None:
    """Mark the tiles to close so that the largest areas of any two passable tiles that touch are joined.

    Of two tiles side by side whose largest areas do not touch, the one with the smaller area is closed (of equal ones
    the southern or eastern). So it is with two tiles that touch at a corner, unless an area of one of the two tiles
    beside them joins both. Areas touch by ``corners`` too, if pixels hang together by them. All arrays are
    (rows, cols, ..); ``split`` comes filled with False.
    """
    rows, cols = passable.shape
    for r in range(rows):
        for c in range(cols):
            if not passable[r, c]:
                continue
            for k in range(4):  # east, south, south-east, south-west
                row = r + (k > 0)
                col = c + (k == 0) + (k == 2) - (k == 3)
                if row >= rows or col < 0 or col >= cols or not passable[row, col]:
                    continue
                here, there = areas[r, c], areas[row, col]
                if k == 0:
                    joined = _meet(here[:, -1], 1, there[:, 0], 1, corners)
                elif k == 1:
                    joined = _meet(here[-1], 1, there[0], 1, corners)
                else:
                    is_east = k == 2
                    joined = (
                        (corners and _meet_at_corner(here, there, is_east))
                        or _joined_over(here, areas[row, c], there, True, is_east, corners)
                        or _joined_over(here, areas[r, col], there, False, is_east, corners)
                    )
                if not joined:
                    if largest[r, c] < largest[row, col]:
                        split[r, c] = True
                    else:
                        split[row, col] = True


@kernel
def find_ways(mosaic: Mosaic, tiles: InnerTiles, scratch: GrowScratch) -> None:
    """Fill ``passable``, ``blocked`` and ``near_obstacle`` of the inner tiles that are wanted.

    ``scratch`` comes from `grow_obstacles`; its mask is changed.
    """
    for row in range(tiles.passable.shape[0]):
        for col in range(tiles.passable.shape[1]):
            if tiles.wanted[row, col]:
                _find_way(mosaic, row, col, tiles, scratch)
                continue
            tiles.passable[row, col] = tiles.blocked[row, col] = tiles.near_obstacle[row, col] = False
