"""Compiled kernel: what the tiles around one tell about its pixels: canopy that stands on the ground, gaps, lines.

The states of single tiles come from `bumpymap.patches._object_kernels`. A pixel's answer depends on pixels up to 15
away, so with a ring of one tile of 15 pixels it is the same wherever a block is cut out.
"""

import math
from functools import cache
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    CANOPY,
    EMPTY,
    FREE,
    LONE,
    LOW_SOLID,
    MAYBE_SOLID,
    OBSTACLE,
    OVERHEAD,
    SEEN,
    SOLID,
    STEEP,
    UNDECIDED,
    UNSEEN,
)
from bumpytiles import helper, kernel

Bytes = NDArray[np.uint8]
Rows = NDArray[np.int32]

_MOST = 15
"""Farthest pixel that is looked at."""
_MARGIN = _MOST + 1
"""Pixels around a mosaic, so that nothing that is looked at lies beyond."""
_FULL = 17
"""Mark of an obstacle: in the sum of nine marks, the number of obstacles stands in front of that of all parts."""
_FILL, _RAY, _NEAR, _NEAR_IF_THIN = 3, 5, 5, 7
"""A pixel without points takes the state of one at most so far away, px; rays from the ground to what is overhead; and
the surroundings of a pixel overhead in which such ground is counted. Together at most 15."""
_CHANCE = 2.0
"""In a thin survey, fewer pixels of ground beneath what is overhead may lie beside it."""
_CHANCE_IF_LOW = 4
"""The same of what is low in a dense survey: ground in the corner of two walls may look as if it were beneath."""
_MAJORITY = 5
"""A pixel among so many of eight with an obstacle belongs to it."""
_NEARER = 2
"""In a thin survey, ground must be nearer than an obstacle by this factor of the squared distance to make a pixel
without points free."""
_SIDES, _SIDES_OF_YARD = 11, 13
"""Directions of 16 in which something overhead is met from ground beneath it, at least; and from ground in a pixel
without anything overhead: as many as in the corner of two walls are too few."""
_HELD = 1.0
"""Points on a pixel, on average, from which on most pixels beneath something hold points of it."""
_OPEN, _OPEN_MOST = 0.03, 0.3
"""Ground is seen beneath enough of what is overhead if so many of its pixels would hold such ground with this share of
the points of open ground; and never more than that."""
_HIDDEN = 24.0
"""Points on the surroundings of a pixel overhead, on average, of which one would be ground if it were not hidden."""
_HIDDEN_HALF, _HIDDEN_HALF_IF_THIN = 12.0, 6.0
"""The same in one half of the surroundings of what is low, a car say, deep beneath it: beside it there may be a gap."""
_SOLIDS = (SOLID, LOW_SOLID)
_REACHES, _NEXT = 3, 2
"""Rounds, and pixels in each, in which something that hides the ground goes on through what may hide it."""
_REACHED = 11
"""Label of what is reached in a round, until that ends."""
_GROW, _GROW_IF_THIN = 1, 3
"""Canopy within so many pixels of what lets no pulse through belongs to it."""
THIN = 0.4
"""Points on a pixel in a thin survey, at most."""
_HOLE_POINTS = 8.0
"""A disc with so many points on average is empty by chance once in 3,000 times."""
_GAP = 6
"""Most pixels between two parts of a line."""
_PART, _AROUND = 2, 3
"""A part of a line has so many pixels with points of obstacles beyond the gap, and none so far to its sides."""


_WIDEST, _ASIDE = 11, 2
"""Most pixels between two parts of a line of which few points were seen, and pixels that its parts may be off the
direction in which they are looked for."""
_BETWEEN = 7.0
"""Points that a gap in such a line would hold, at most, if it were none: chance leaves so many out once in a thousand
times."""
_THINNEST = 0.5
"""Width of the thinnest wall whose gaps are closed so, px: where it would have more points, a wide gap is one."""
_MIDDLE = 2
"""Pixels on either side of the middle of such a gap that are closed: what is known of both ends ends there."""


class SolidScratch(NamedTuple):
    """Scratch of `settle_solids`; maps have ``_MARGIN`` more pixels on all sides, without points."""

    offsets: Annotated[Rows, 2]
    """(n, 4) of all pixels up to 15 away, the nearest first: rows, columns, their squared distance, and pixels along
    the rows of a map; not changed."""
    marks: Annotated[Bytes, 2]
    """1 for pixels that hold a point of an obstacle, were it a single one, and ``_FULL`` for obstacles."""
    own: Annotated[Bytes, 1]
    """States of pixels with the points around them, row by row."""
    own_if_thin: Annotated[Bytes, 1]
    """The same in a thin survey."""
    label: Annotated[Bytes, 2]
    """States of the mosaic, with the nearest where there are no points."""
    under: Annotated[Bytes, 2]
    """1 for ground that was seen, 2 beneath what is overhead, 3 where it would be if any were seen."""
    around: Annotated[Bytes, 1]
    """(cols,) sums of 3 x 3 marks in a row of pixels."""


def solid_scratch(rows: int, cols: int) -> SolidScratch:
    """Make scratch for a mosaic."""
    tall, wide = rows + 2 * _MARGIN, cols + 2 * _MARGIN
    return SolidScratch(
        offsets=_offsets(wide),
        marks=np.zeros((tall, wide), np.uint8),
        own=np.full(tall * wide, UNSEEN, np.uint8),
        own_if_thin=np.full(tall * wide, UNSEEN, np.uint8),
        label=np.full((tall, wide), UNSEEN, np.uint8),
        under=np.zeros((tall, wide), np.uint8),
        around=np.empty(cols, np.uint8),
    )


@cache
def _offsets(wide: int) -> Rows:
    down, right = np.mgrid[-_MOST : _MOST + 1, -_MOST : _MOST + 1].reshape(2, -1)
    square = down * down + right * right
    order = np.lexsort((right, down, square))
    order = order[square[order] <= _MOST * _MOST]
    return np.stack([down, right, square, down * wide + right], axis=1)[order].astype(np.int32)


@helper
def is_overhead(state: int) -> bool:
    """Return whether a state is that of something over the vehicle."""
    return state % SEEN in OVERHEAD


@helper
def _points_per_pixel(objects: Bytes, pixels: int, top: int, left: int) -> float:
    """Points of a tile on each of its pixels, on average, by how many pixels are empty: as if they lay at random."""
    held = 0
    for r in range(top, top + pixels):
        for c in range(left, left + pixels):
            held += objects[r, c] != UNSEEN and objects[r, c] % SEEN != EMPTY
    return -math.log(max(1.0 - held / (pixels * pixels), 1e-9))


@helper
def _mark_parts(objects: Bytes, marks: Bytes) -> None:
    """Fill the marks."""
    for r in range(objects.shape[0]):
        line = marks[r + _MARGIN, _MARGIN : _MARGIN + objects.shape[1]]
        for c in range(len(line)):
            state = objects[r, c] % SEEN
            line[c] = (state == LONE) | (state == UNDECIDED) | (state == STEEP) | (_FULL * (state == OBSTACLE))


@helper
def _add_around(north: Bytes, middle: Bytes, south: Bytes, out: Bytes) -> None:
    """Fill the sums of three rows of marks over three columns."""
    for c in range(len(out)):
        k = c + _MARGIN
        out[c] = (north[k - 1] + north[k] + north[k + 1]) + (middle[k - 1] + middle[k] + middle[k + 1])
        out[c] += south[k - 1] + south[k] + south[k + 1]


@helper
def _fill_own(objects: Bytes, scratch: SolidScratch) -> None:
    """Fill the states of pixels with the points around them.

    In a thin survey a single point of an obstacle is one: a crate of 0.7 m has four points at 8 points/m2.
    """
    marks, around, cols = scratch.marks, scratch.around, objects.shape[1]
    for r in range(objects.shape[0]):
        row = r + _MARGIN
        _add_around(marks[row - 1], marks[row], marks[row + 1], around)
        first = row * marks.shape[1] + _MARGIN
        own, if_thin = scratch.own[first : first + cols], scratch.own_if_thin[first : first + cols]
        for c in range(cols):
            kind = objects[r, c] % SEEN
            # Tests without a branch, which a processor does for many pixels at once.
            joins = ((kind == FREE) | (kind == EMPTY)) & (around[c] >= _MAJORITY * _FULL)
            joins |= (kind == STEEP) & (around[c] > 1)
            own[c] = OBSTACLE if joins else objects[r, c]
            if_thin[c] = OBSTACLE if (kind == LONE) | (kind == UNDECIDED) else own[c]


@helper
def _nearest_state(own: Bytes, at: int, most: int, factor: int, offsets: Rows) -> int:
    """State of the nearest pixel with points, of so many; an obstacle counts as nearer than it is."""
    found, square = UNSEEN, 0
    for k in range(1, most):
        state = own[at + offsets[k, 3]] % SEEN
        if state == EMPTY or state == UNSEEN % SEEN:
            continue
        if found != UNSEEN and offsets[k, 2] > factor * square:
            break
        near = offsets[k, 2] <= _FILL * _FILL
        if state == OBSTACLE and near:
            return OBSTACLE
        if found == UNSEEN:
            square = offsets[k, 2]
        if is_overhead(state) and near and offsets[k, 2] == square:
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
            own, factor = (scratch.own_if_thin, _NEARER) if mean < THIN else (scratch.own, 1)
            most = 0
            while most < len(scratch.offsets) and scratch.offsets[most, 2] <= limit:
                most += 1
            for r in range(_MARGIN + top, _MARGIN + top + pixels):
                label, first = scratch.label[r], r * scratch.label.shape[1]
                for c in range(_MARGIN + left, _MARGIN + left + pixels):
                    state = own[first + c]
                    if state % SEEN == EMPTY:
                        state = np.uint8(_nearest_state(own, first + c, most, factor, scratch.offsets))
                    label[c] = state
                    overhead |= is_overhead(state)
    return overhead


@helper
def _is_solid_near(label: Bytes, r: int, c: int) -> bool:
    """Return whether something within ``_NEXT`` pixels hides the ground."""
    for row in range(r - _NEXT, r + _NEXT + 1):
        for col in range(c - _NEXT, c + _NEXT + 1):
            if label[row, col] % SEEN in _SOLIDS:
                return True
    return False


@helper
def _continue_solids(objects: Bytes, label: Bytes) -> None:
    """Label canopy that may hide the ground as what does, where it continues that."""
    rows, cols = objects.shape
    for _ in range(_REACHES):
        for r in range(rows):
            for c in range(cols):
                row, col = r + _MARGIN, c + _MARGIN
                is_asked = objects[r, c] % SEEN == MAYBE_SOLID == label[row, col] % SEEN
                if is_asked and _is_solid_near(label, row, col):
                    label[row, col] = _REACHED
        for r in range(_MARGIN, _MARGIN + rows):
            for c in range(_MARGIN, _MARGIN + cols):
                label[r, c] = LOW_SOLID if label[r, c] == _REACHED else label[r, c]


@helper
def _meets(label: Bytes, r: int, c: int, direction: int) -> bool:
    """Return whether a ray from a pixel meets something overhead, in one of 16 directions."""
    turn, sign = direction % 8, (1 if direction < 8 else -1)
    # Slopes of 0, 1/2, 1, 2, ...: integers alone, so that every machine meets the same pixels.
    down, right = sign * min(2, turn, 8 - turn), sign * max(-2, min(2, 4 - turn))
    for step in range(2, _RAY + 1):  # a pixel beside one with ground may be the same object's rim
        if is_overhead(label[r + (step * down + 1) // 2, c + (step * right + 1) // 2]):
            return True
    return False


@helper
def _is_under(label: Bytes, r: int, c: int, sides: int) -> bool:
    """Return whether the ground in a pixel lies beneath what is overhead: it is on all sides, not as beside a wall."""
    hits = 0
    for direction in range(8):
        one, other = _meets(label, r, c, direction), _meets(label, r, c, direction + 8)
        if not (one or other):
            return False
        hits += one + other
    return hits >= sides


@helper
def _mark_under(objects: Bytes, pixels: int, tile: int, scratch: SolidScratch) -> None:
    """Mark the ground that was seen in a tile, by its number, and what is beneath something overhead."""
    cols = objects.shape[1] // pixels
    top, left = tile // cols * pixels, tile % cols * pixels
    is_held = _points_per_pixel(objects, pixels, top, left) >= _HELD
    for r in range(top, top + pixels):
        for c in range(left, left + pixels):
            state = objects[r, c]
            ground = state != UNSEEN and (state >= SEEN or state == FREE)
            sides = _SIDES_OF_YARD if is_held and not is_overhead(state) else _SIDES
            asked = ground or is_overhead(scratch.label[r + _MARGIN, c + _MARGIN])
            beneath = asked and _is_under(scratch.label, r + _MARGIN, c + _MARGIN, sides)
            scratch.under[r + _MARGIN, c + _MARGIN] = (2 if ground else 3) if beneath else ground


@helper
def _stands(r: int, c: int, mean: float, scratch: SolidScratch) -> bool:
    """Return whether what is overhead stands on the ground, of which none is seen around, or beneath a solid object."""
    overhead = under = ground = 0
    solid, low, near, least, grow, half = False, False, _NEAR, 1.0, _GROW, _HIDDEN_HALF
    if mean < THIN:
        near, least, grow, half = _NEAR_IF_THIN, _CHANCE, _GROW_IF_THIN, _HIDDEN_HALF_IF_THIN
    for k in range(len(scratch.offsets)):
        square = scratch.offsets[k, 2]
        if square > near * near:
            break
        row, col = r + scratch.offsets[k, 0], c + scratch.offsets[k, 1]
        overhead += is_overhead(scratch.label[row, col])
        under += scratch.under[row, col] == 2
        ground += 0 < scratch.under[row, col] < 3
        if square <= grow * grow:
            kind = scratch.label[row, col] % SEEN
            solid, low = solid or kind in _SOLIDS, low or kind == LOW_SOLID
    hidden = ground == 0 and mean * math.pi * near * near >= _HIDDEN
    enough = min(_OPEN_MOST, 1.0 - math.exp(-_OPEN * mean))
    return (
        hidden
        or (solid and under < max(least, enough * overhead))
        or (low and mean >= _HELD and under < _CHANCE_IF_LOW)
        or (low and _hides_half(r, c, near, half / max(mean, 1e-9), scratch))
    )


@helper
def _hides_half(r: int, c: int, near: int, least: float, scratch: SolidScratch) -> bool:
    """Return whether ``least`` pixels deep beneath something show no ground in one of 16 halves around a pixel."""
    for turn in range(8):
        # The same directions as those of rays.
        down, right = min(2, turn, 8 - turn), max(-2, min(2, 4 - turn))
        deep = other = ground = more = 0
        for k in range(len(scratch.offsets)):
            if scratch.offsets[k, 2] > near * near:
                break
            side = scratch.offsets[k, 0] * down + scratch.offsets[k, 1] * right
            under = scratch.under[r + scratch.offsets[k, 0], c + scratch.offsets[k, 1]]
            deep += side >= 0 and under >= 2
            ground += side >= 0 and under == 2
            other += side <= 0 and under >= 2
            more += side <= 0 and under == 2
        if (ground == 0 and deep >= least) or (more == 0 and other >= least):
            return True
    return False


@helper
def _points_of_end(marks: Bytes, r: int, c: int, down: int, right: int) -> int:
    """Return the pixels with points of a line that ends in a pixel and comes from one direction, 0 if it is none.

    There is nothing beside a line.
    """
    count = 0
    # Across the line, down and right change places.
    far_down, far_right = _AROUND * right // 2, -(_AROUND * down // 2)
    near_down, near_right = abs(right) // 2, abs(down) // 2
    for step in range(1, _GAP + 1):
        row, col = r - (step * down + 1) // 2, c - (step * right + 1) // 2
        if marks[row + far_down, col + far_right] > 0 or marks[row - far_down, col - far_right] > 0:
            return 0
        beside = marks[row + near_down, col + near_right] | marks[row - near_down, col - near_right]
        count += (marks[row, col] | beside) > 0
    return count if count >= _PART else 0


@helper
def _next_part(marks: Bytes, r: int, c: int, down: int, right: int) -> int:
    """Return the steps to the next pixel with a point of an obstacle, 0 if none is as near as a line may have a gap."""
    for step in range(1, _GAP + 2):
        if step * step * (down * down + right * right) > 4 * (_GAP + 1) * (_GAP + 1):
            return 0  # a step across the corners of pixels is longer
        if marks[r + (step * down + 1) // 2, c + (step * right + 1) // 2] > 0:
            return step
    return 0


@helper
def _close_middle(r: int, c: int, far_down: int, far_right: int, out: Bytes) -> None:
    """Close the middle of a gap from a pixel to one so many rows and columns away."""
    far = math.sqrt(float(far_down * far_down + far_right * far_right))
    for k in range(-_MIDDLE, _MIDDLE + 1):
        share = 0.5 + k / far
        # Rounded down, whatever their sign.
        row = r - _MARGIN + int(far_down * share + 0.5 + _MARGIN) - _MARGIN
        col = c - _MARGIN + int(far_right * share + 0.5 + _MARGIN) - _MARGIN
        if 0 <= row < out.shape[0] and 0 <= col < out.shape[1] and out[row, col] != UNSEEN:
            out[row, col] = OBSTACLE


@helper
def _join_far(marks: Bytes, r: int, c: int, turn: int, count: int, widest: float, out: Bytes) -> None:
    """Close the middle of a wide gap in a line of few points, of which ``count`` were seen up to a pixel."""
    down, right = min(2, turn, 8 - turn), max(-2, min(2, 4 - turn))
    across_down, across_right = (0, 1) if abs(right) < abs(down) else (1, 0)
    inside = _GAP + _AROUND + 1  # what a part of a line is looked for in
    for step in range(_GAP + 1, _WIDEST + 1):
        for aside in range(-_ASIDE, _ASIDE + 1):
            far_down = (step * down + 1) // 2 + aside * across_down
            far_right = (step * right + 1) // 2 + aside * across_right
            row, col, far = r + far_down, c + far_right, math.sqrt(float(far_down * far_down + far_right * far_right))
            if far > widest or not (
                inside <= row < marks.shape[0] - inside and inside <= col < marks.shape[1] - inside
            ):
                continue
            if marks[row, col] > 0:
                more = _points_of_end(marks, row, col, -down, -right)
                if more > 0 and (count + more) * far <= _BETWEEN * 2 * _GAP:
                    _close_middle(r, c, far_down, far_right, out)
                return


@helper
def _join_from(marks: Bytes, r: int, c: int, widest: float, out: Bytes) -> None:
    """Close the gaps in lines of obstacle points that lead east or south from a pixel, at most so wide, px."""
    for turn in range(8):
        down, right = min(2, turn, 8 - turn), max(-2, min(2, 4 - turn))
        gap = _next_part(marks, r, c, down, right)
        if gap == 1:
            continue
        count = _points_of_end(marks, r, c, down, right)
        if count == 0:
            continue
        if gap == 0:
            if widest > _GAP:
                _join_far(marks, r, c, turn, count, widest, out)
            continue
        if _points_of_end(marks, r + (gap * down + 1) // 2, c + (gap * right + 1) // 2, -down, -right) == 0:
            continue
        for step in range(gap + 1):
            row, col = r - _MARGIN + (step * down + 1) // 2, c - _MARGIN + (step * right + 1) // 2
            if out[row, col] != UNSEEN:
                out[row, col] = OBSTACLE


@helper
def _join_lines(objects: Bytes, pixels: int, marks: Bytes, out: Bytes) -> None:
    """Close the gaps in lines of obstacle points, such as wires of which a few points were seen."""
    cols = out.shape[1] // pixels
    for tile in range(out.shape[0] // pixels * cols):
        top, left = tile // cols * pixels, tile % cols * pixels
        widest = min(1.0 * _WIDEST, _BETWEEN / (_THINNEST * max(_points_per_pixel(objects, pixels, top, left), 1e-9)))
        for r in range(_MARGIN + top, _MARGIN + top + pixels):
            mine, below = marks[r], marks[r + 1]
            for c in range(_MARGIN + left, _MARGIN + left + pixels):
                inside = min(mine[c + 1], below[c - 1], below[c], below[c + 1]) > 0  # no gap begins here
                if mine[c] > 0 and not inside:
                    _join_from(marks, r, c, widest, out)


@kernel
def settle_solids(
    objects: Annotated[Bytes, 2], pixels: int, hole: float, scratch: SolidScratch, out: Annotated[Bytes, 2]
) -> None:
    """Fill the states of a mosaic; what is left is ``FREE``, ``OBSTACLE``, ``CANOPY``, ``UNDECIDED``, ``UNSEEN``.

    ``hole`` is the distance from all points beyond which a pixel is unseen, px; more in a tile with few points.
    """
    rows, cols = objects.shape
    _mark_parts(objects, scratch.marks)
    _fill_own(objects, scratch)
    overhead = _label(objects, pixels, hole, scratch)
    tiles = (rows // pixels) * (cols // pixels)
    if overhead:
        _continue_solids(objects, scratch.label)
    for tile in range(tiles if overhead else 0):
        _mark_under(objects, pixels, tile, scratch)
    for tile in range(tiles):
        top, left = tile // (cols // pixels) * pixels, tile % (cols // pixels) * pixels
        mean = _points_per_pixel(objects, pixels, top, left) if overhead else 0.0
        for r in range(top, top + pixels):
            for c in range(left, left + pixels):
                state = scratch.label[r + _MARGIN, c + _MARGIN]
                if state == UNSEEN:
                    out[r, c] = UNSEEN
                elif is_overhead(state):
                    canopy = FREE if objects[r, c] % SEEN == EMPTY else CANOPY
                    stands = _stands(r + _MARGIN, c + _MARGIN, mean, scratch)
                    out[r, c] = OBSTACLE if stands else canopy
                else:
                    out[r, c] = FREE if state % SEEN == LONE or state % SEEN == STEEP else state % SEEN
    _join_lines(objects, pixels, scratch.marks, out)
