"""Compiled kernel: what the tiles around one tell about its pixels: canopy that stands on the ground, gaps, lines.

The states of single tiles come from `bumpymap.patches.kernels.objects`. A pixel's answer depends on pixels up to 15
away, so with a ring of one tile of 15 pixels it is the same wherever a block is cut out.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CANOPY, EMPTY, FREE, LONE, OBSTACLE, SEEN, SOLID, STEEP, UNDECIDED, UNSEEN
from bumpytiles import helper, kernel

__all__ = ["SolidScratch", "settle_solids", "solid_scratch"]

Bytes = NDArray[np.uint8]
Rows = NDArray[np.int32]

_MOST = 15
"""Farthest pixel that is looked at."""
_FILL, _RAY, _NEAR = 3, 5, 5
"""A pixel without points takes the state of one at most so far away, px; rays from the ground to what is overhead; and
the surroundings of a pixel overhead in which such ground is counted. With `_COMPANY` together 15."""
_COMPANY, _MAJORITY = 2, 5
"""In a thin survey two points of an obstacle so close together are no bird; and a pixel among so many of eight with an
obstacle belongs to it."""
_NEARER = 2
"""In a thin survey, ground must be nearer than an obstacle by this factor of the squared distance to make a pixel
without points free."""
_SIDES = 11
"""Directions of 16 in which something overhead is met from ground beneath it, at least."""
_OPEN, _OPEN_MOST = 0.03, 0.3
"""Ground is seen beneath enough of what is overhead if so many of its pixels would hold such ground with this share of
the points of open ground; and never more than that."""
_HIDDEN = 24.0
"""Points on the surroundings of a pixel overhead, on average, of which one would be ground if it were not hidden."""
_GROW = 3
"""Canopy within so many pixels of what lets no pulse through belongs to it."""
_THIN = 0.4
"""Points on a pixel in a thin survey, at most."""
_HOLE_POINTS = 8.0
"""A disc with so many points on average is empty by chance once in 3,000 times."""
_GAP = 6
"""Most pixels between two parts of a line."""
_PART, _AROUND = 2, 3
"""A part of a line has so many pixels with points of obstacles beyond the gap, and none so far to its sides."""


class SolidScratch(NamedTuple):
    """Scratch of `settle_solids`."""

    offsets: Annotated[Rows, 2]
    """(n, 3) rows, columns and their squared distance, of all pixels up to 15 away, the nearest first; not changed."""
    label: Annotated[Bytes, 2]
    """(rows, cols) states of the mosaic, with the nearest where there are no points."""
    under: Annotated[Bytes, 2]
    """The same shape: 1 for ground that was seen, 2 beneath what is overhead."""


def solid_scratch(rows: int, cols: int) -> SolidScratch:
    """Make scratch for a mosaic."""
    down, right = np.mgrid[-_MOST : _MOST + 1, -_MOST : _MOST + 1].reshape(2, -1)
    square = down * down + right * right
    order = np.lexsort((right, down, square))
    order = order[square[order] <= _MOST * _MOST]
    offsets = np.stack([down, right, square], axis=1)[order].astype(np.int32)
    return SolidScratch(np.ascontiguousarray(offsets), *(np.empty((rows, cols), np.uint8) for _ in range(2)))


@helper
def _is_overhead(state: int) -> bool:
    return state != UNSEEN and (state % SEEN == CANOPY or state % SEEN == SOLID)


@helper
def _is_part(objects: Bytes, r: int, c: int) -> bool:
    """Return whether a pixel holds a point of an obstacle, were it a single one."""
    if not (0 <= r < objects.shape[0] and 0 <= c < objects.shape[1]) or objects[r, c] == UNSEEN:
        return False
    state = objects[r, c] % SEEN
    return state == OBSTACLE or state == LONE or state == UNDECIDED or state == STEEP  # noqa: PLR1714 (no set)


@helper
def _points_per_pixel(objects: Bytes, pixels: int, top: int, left: int) -> float:
    """Points of a tile on each of its pixels, on average, by how many pixels are empty: as if they lay at random."""
    held = 0
    for r in range(top, top + pixels):
        for c in range(left, left + pixels):
            held += objects[r, c] != UNSEEN and objects[r, c] % SEEN != EMPTY
    return -math.log(max(1.0 - held / (pixels * pixels), 1e-9))


@helper
def _own_state(objects: Bytes, r: int, c: int, thin: bool) -> int:
    """State of a pixel, with the points around it."""
    state = objects[r, c]
    if state == UNSEEN or state % SEEN == OBSTACLE or _is_overhead(state):
        return state
    if _is_part(objects, r, c):
        reach = 1 if state == STEEP else _COMPANY
        if thin or state == STEEP:
            for row in range(r - reach, r + reach + 1):
                for col in range(c - reach, c + reach + 1):
                    if (row != r or col != c) and _is_part(objects, row, col):
                        return OBSTACLE
        return state
    count = 0
    for row in range(max(0, r - 1), min(objects.shape[0], r + 2)):
        for col in range(max(0, c - 1), min(objects.shape[1], c + 2)):
            count += objects[row, col] != UNSEEN and objects[row, col] % SEEN == OBSTACLE
    return OBSTACLE if count >= _MAJORITY else state


@helper
def _nearest_state(objects: Bytes, r: int, c: int, hole: float, thin: bool, offsets: Rows) -> int:
    """State of the nearest pixel with points; an obstacle counts as nearer than it is."""
    rows, cols = objects.shape
    found, square = UNSEEN, 0
    factor = _NEARER if thin else 1
    for k in range(len(offsets)):
        if offsets[k, 2] > hole or (found != UNSEEN and offsets[k, 2] > factor * square):
            break
        row, col = r + offsets[k, 0], c + offsets[k, 1]
        if not (0 <= row < rows and 0 <= col < cols):
            continue
        state = _own_state(objects, row, col, thin)
        if state == UNSEEN or state % SEEN == EMPTY:
            continue
        near, state = offsets[k, 2] <= _FILL * _FILL, state % SEEN
        if state == OBSTACLE and near:
            return OBSTACLE
        if found == UNSEEN:
            square = offsets[k, 2]
        if _is_overhead(state) and near and offsets[k, 2] == square:
            found = state
        elif found == UNSEEN:
            found = FREE
    return found


@helper
def _label(objects: Bytes, pixels: int, hole: float, scratch: SolidScratch) -> bool:
    """Fill the labels; returns whether anything is overhead."""
    overhead = False
    for tile_row in range(objects.shape[0] // pixels):
        for tile_col in range(objects.shape[1] // pixels):
            top, left = tile_row * pixels, tile_col * pixels
            mean = _points_per_pixel(objects, pixels, top, left)
            limit = min(max(hole * hole, _HOLE_POINTS / (math.pi * max(mean, 1e-9))), 1.0 * _MOST * _MOST)
            for r in range(top, top + pixels):
                for c in range(left, left + pixels):
                    state = _own_state(objects, r, c, mean < _THIN)
                    if state != UNSEEN and state % SEEN == EMPTY:
                        state = _nearest_state(objects, r, c, limit, mean < _THIN, scratch.offsets)
                    scratch.label[r, c] = state
                    overhead = overhead or _is_overhead(state)
    return overhead


@helper
def _meets(label: Bytes, r: int, c: int, direction: int) -> bool:
    """Return whether a ray from a pixel meets something overhead, in one of 16 directions."""
    turn, sign = direction % 8, (1 if direction < 8 else -1)
    # Slopes of 0, 1/2, 1, 2, ...: integers alone, so that every machine meets the same pixels.
    down, right = sign * min(2, turn, 8 - turn), sign * max(-2, min(2, 4 - turn))
    for step in range(2, _RAY + 1):  # a pixel beside one with ground may be the same thing's rim
        row, col = r + (step * down + 1) // 2, c + (step * right + 1) // 2
        if not (0 <= row < label.shape[0] and 0 <= col < label.shape[1]):
            return False
        if _is_overhead(label[row, col]):
            return True
    return False


@helper
def _is_under(label: Bytes, r: int, c: int) -> bool:
    """Return whether the ground in a pixel lies beneath what is overhead: it is on all sides, not as beside a wall."""
    hits = 0
    for direction in range(8):
        one, other = _meets(label, r, c, direction), _meets(label, r, c, direction + 8)
        if not (one or other):
            return False
        hits += one + other
    return hits >= _SIDES


@helper
def _stands(r: int, c: int, mean: float, scratch: SolidScratch) -> bool:
    """Whether what is overhead stands on the ground: none is seen around, or beneath what lets no pulse through."""
    overhead = under = ground = 0
    solid = False
    for k in range(len(scratch.offsets)):
        square = scratch.offsets[k, 2]
        if square > _NEAR * _NEAR:
            break
        row, col = r + scratch.offsets[k, 0], c + scratch.offsets[k, 1]
        if 0 <= row < scratch.label.shape[0] and 0 <= col < scratch.label.shape[1]:
            overhead += _is_overhead(scratch.label[row, col])
            under += scratch.under[row, col] == 2
            ground += scratch.under[row, col] > 0
            solid = solid or (scratch.label[row, col] % SEEN == SOLID and square <= _GROW * _GROW)
    hidden = ground == 0 and mean * math.pi * _NEAR * _NEAR >= _HIDDEN
    enough = min(_OPEN_MOST, 1.0 - math.exp(-_OPEN * mean))
    return hidden or (solid and under < max(1.0, enough * overhead))


@helper
def _is_line_end(objects: Bytes, r: int, c: int, down: int, right: int) -> bool:
    """Whether a line of obstacle points that ends in a pixel comes from one direction, with nothing at its sides."""
    count = 0
    for step in range(1, _GAP + 1):
        row, col = r - (step * down + 1) // 2, c - (step * right + 1) // 2
        found = _is_part(objects, row, col)
        for side in range(-1, 2, 2):
            # Across the line: down and right change places.
            found = found or _is_part(objects, row + side * (abs(right) // 2), col + side * (abs(down) // 2))
            if _is_part(objects, row + side * (_AROUND * right // 2), col - side * (_AROUND * down // 2)):
                return False
        count += found
    return count >= _PART


@helper
def _join_lines(objects: Bytes, out: Bytes) -> None:
    """Close the gaps in lines of obstacle points, such as wires of which a few points were seen."""
    rows, cols = objects.shape
    for r in range(rows):
        for c in range(cols):
            if not _is_part(objects, r, c):
                continue
            for turn in range(8):
                down, right = min(2, turn, 8 - turn), max(-2, min(2, 4 - turn))
                gap = 0
                for step in range(1, _GAP + 2):
                    if step * step * (down * down + right * right) > 4 * (_GAP + 1) * (_GAP + 1):
                        break  # a step across the corners of pixels is longer
                    if _is_part(objects, r + (step * down + 1) // 2, c + (step * right + 1) // 2):
                        gap = step
                        break
                if gap < 2:
                    continue
                row, col = r + (gap * down + 1) // 2, c + (gap * right + 1) // 2
                ends = _is_line_end(objects, r, c, down, right) and _is_line_end(objects, row, col, -down, -right)
                if not ends:
                    continue
                for step in range(gap + 1):
                    row, col = r + (step * down + 1) // 2, c + (step * right + 1) // 2
                    if out[row, col] != UNSEEN:
                        out[row, col] = OBSTACLE


@kernel
def settle_solids(
    objects: Annotated[Bytes, 2], pixels: int, hole: float, scratch: SolidScratch, out: Annotated[Bytes, 2]
) -> None:
    """Fill the states of a mosaic; what is left is ``FREE``, ``OBSTACLE``, ``CANOPY``, ``UNDECIDED``, ``UNSEEN``.

    ``hole`` is the distance from all points beyond which a pixel is unseen, px; more in a tile with few points.
    """
    rows, cols = objects.shape
    if _label(objects, pixels, hole, scratch):
        for r in range(rows):
            for c in range(cols):
                state = objects[r, c]
                ground = state != UNSEEN and (state >= SEEN or state == FREE)
                scratch.under[r, c] = 0 if not ground else (2 if _is_under(scratch.label, r, c) else 1)
    for tile in range((rows // pixels) * (cols // pixels)):
        top, left = tile // (cols // pixels) * pixels, tile % (cols // pixels) * pixels
        mean = _points_per_pixel(objects, pixels, top, left)
        for r in range(top, top + pixels):
            for c in range(left, left + pixels):
                state = scratch.label[r, c]
                if state == UNSEEN:
                    out[r, c] = UNSEEN
                elif _is_overhead(state):
                    canopy = FREE if objects[r, c] % SEEN == EMPTY else CANOPY
                    out[r, c] = OBSTACLE if _stands(r, c, mean, scratch) else canopy
                else:
                    out[r, c] = FREE if state % SEEN == LONE or state % SEEN == STEEP else state % SEEN
    _join_lines(objects, out)
