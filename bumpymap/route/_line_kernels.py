"""Compiled kernels: straight lines over square tiles, their cost, whether they are clear; holes; the quarter car.

Field coordinates (r, c) of a window are in tiles: r from its north edge southwards, c from its west edge eastwards. A
tile is closed where its cost is infinite; everything outside the window is closed.

Costs are (rows, cols, axes): of one axis, alike in all directions, or along the eight of ``AXES_DEG``. Between two axes
cost is linear in the slope of the segment against the rows or columns, whichever it is nearer to: unlike angles, that
gives a turned or mirrored map the same bits. What climbing, descending and driving across a slope cost is added for the
very direction of the segment; the cost of a direction that is too steep across is infinite.
"""

import math
from typing import Annotated, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import TAN
from bumpytiles import helper, kernel

Floats = NDArray[np.float64]
Heading: TypeAlias = tuple[int, int, float, float, float]
"""Two axes, the share of the second in the cost; and southwards and eastwards in a length of 1."""

LEAST_MARGIN = 1e-6
"""Margins below this one, tiles, count as this one: what touches a closed tile may slip between two of them."""
_SLIVER = 1e-12
"""Pieces below this length, tiles, are rounding errors of a line through a corner of four tiles."""
_ROUNDING = 1e-9
"""Distances to closed tiles may be shorter than the margin by this, tiles, but not by more than half of it."""
A_END, B_END = 1, 2
"""Bits: which end of a segment is the start or the goal, and may be nearer to closed tiles than the margin."""


class Costs(NamedTuple):
    """Costs of the ground of a window."""

    tiles: Annotated[NDArray[np.float32], 3]
    """(rows, cols, axes) cost per tile of length, at least 1; infinite where closed."""
    gradient: Annotated[NDArray[np.float32], 3]
    """(rows, cols, 2) rise per length southwards and eastwards; (0, 0, 2) if slopes cost nothing."""
    climb: float
    """Cost of a rise of 1 along the way, tiles."""
    descent: float
    """The same downwards."""
    side: float
    """Cost of a length of 1 across a gradient of 1."""
    steepest: float
    """Directions across a larger gradient are barred."""


class Pieces(NamedTuple):
    """The pieces of a line, filled; longer than needed."""

    row: Annotated[NDArray[np.int64], 1]
    col: Annotated[NDArray[np.int64], 1]
    length: Annotated[Floats, 1]
    part: Annotated[NDArray[np.int64], 1]
    """The corner of the line before each."""
    pieces: Annotated[NDArray[np.int64], 1]
    """(1,) how many there are."""


@helper
def slope_cost(
    south: float, east: float, down: float, right: float, climb: float, descent: float, side: float, steepest: float
) -> float:
    """Return what a gradient adds to the cost of a direction; see `Costs` and `Heading`. Infinite if it is barred."""
    rise, across = south * down + east * right, abs(south * right - east * down)
    if across > steepest:
        return math.inf
    return (climb * rise if rise > 0.0 else -descent * rise) + side * across


@helper
def _heading(cost: Costs, dr: float, dc: float, length: float) -> Heading:
    """Return the two axes that a direction lies between, how far it is from the first, and the direction."""
    south, east = (dr / length, dc / length) if length > 0.0 else (0.0, 0.0)
    if cost.tiles.shape[2] == 1:
        return 0, 0, 0.0, south, east
    down, right = abs(dr), abs(dc)
    north_east, more = dr * dc < 0.0, max(down, right)
    t = min(down, right) / more if more > 0.0 else 0.0
    diagonal = 2 if north_east else 6
    straight = 0 if down >= right else 4
    between = (1 if north_east else 7) if down >= right else (3 if north_east else 5)
    if t <= TAN:
        return straight, between, t / TAN, south, east
    return between, diagonal, (t - TAN) / (1.0 - TAN), south, east


@helper
def _cost_of(cost: Costs, heading: Heading, row: int, col: int) -> float:
    """Cost of a tile in a direction; infinite outside the window."""
    if row < 0 or col < 0 or row >= cost.tiles.shape[0] or col >= cost.tiles.shape[1]:
        return math.inf
    total = np.float64(cost.tiles[row, col, heading[0]])
    if heading[2] != 0.0 and total < math.inf:
        total += heading[2] * (np.float64(cost.tiles[row, col, heading[1]]) - total)
    if cost.gradient.shape[0] > 0:
        south, east = np.float64(cost.gradient[row, col, 0]), np.float64(cost.gradient[row, col, 1])
        total += slope_cost(south, east, heading[3], heading[4], cost.climb, cost.descent, cost.side, cost.steepest)
    return float(total)


@helper
def _is_open(cost: Costs, row: int, col: int) -> bool:
    inside = 0 <= row < cost.tiles.shape[0] and 0 <= col < cost.tiles.shape[1]
    return inside and float(cost.tiles[row, col, 0]) < math.inf


@helper
def _first_tile(a: float, delta: float) -> int:
    """Tile, along one axis, that a line enters when it leaves ``a`` in the direction of ``delta``."""
    tile = math.floor(a)
    return tile - 1 if delta < 0.0 and tile == a else tile


@helper
def _crossing(a: float, delta: float, tile: int) -> float:
    """Share of a line after which it leaves the tile, along one axis; large if never."""
    if delta == 0.0:
        return 2.0
    return (tile + (1.0 if delta > 0.0 else 0.0) - a) / delta


@helper
def _dearer_shift(cost: Costs, heading: Heading, r: float, c: float, row: int, col: int) -> tuple[int, int]:
    """Shift from a tile to the one before it, where a line runs on the border of both and that one is dearer.

    ``r`` is the row of a line that keeps it, NaN otherwise; ``c`` likewise.
    """
    here = _cost_of(cost, heading, row, col)
    if r == row and _cost_of(cost, heading, row - 1, col) > here:
        return 1, 0
    if c == col and _cost_of(cost, heading, row, col - 1) > here:
        return 0, 1
    return 0, 0


@helper
def _dearer_beside(
    cost: Costs, heading: Heading, r0: float, c0: float, dr: float, dc: float, row: int, col: int
) -> float:
    up, left = _dearer_shift(cost, heading, r0 if dr == 0.0 else math.nan, c0 if dc == 0.0 else math.nan, row, col)
    return _cost_of(cost, heading, row - up, col - left)


@helper
def segment_cost(cost: Costs, r0: float, c0: float, r1: float, c1: float, limit: float) -> float:
    """Exact integral of the cost along a segment; infinite as soon as it passes ``limit``.

    Where the segment runs along a border, the dearer of both tiles counts.
    """
    dr, dc = r1 - r0, c1 - c0
    length = math.sqrt(dr * dr + dc * dc)
    heading = _heading(cost, dr, dc, length)
    # Whole numbers as floats: to convert each to an integer and back takes longer than a tile.
    north, west = np.floor(r0), np.floor(c0)
    north -= 1.0 if dr < 0.0 and north == r0 else 0.0
    west -= 1.0 if dc < 0.0 and west == c0 else 0.0
    row, col = int(north), int(west)
    keeps = dr == 0.0 or dc == 0.0
    if north <= r1 <= north + 1.0 and west <= c1 <= west + 1.0 and not keeps:  # in one tile: nothing to divide
        total = length * _cost_of(cost, heading, row, col) if length > _SLIVER else 0.0
        return total if total <= limit else math.inf
    down, right = 1.0 if dr > 0.0 else -1.0, 1.0 if dc > 0.0 else -1.0
    r_edge, c_edge = north + max(down, 0.0), west + max(right, 0.0)
    next_r, next_c = (r_edge - r0) / dr if dr != 0.0 else 2.0, (c_edge - c0) / dc if dc != 0.0 else 2.0
    total, t = 0.0, 0.0
    while True:
        end = min(next_r, next_c, 1.0)
        piece = (end - t) * length
        if piece > _SLIVER:
            if keeps:
                total += piece * _dearer_beside(cost, heading, r0, c0, dr, dc, row, col)
            else:
                total += piece * _cost_of(cost, heading, row, col)
            if not total <= limit:
                return math.inf
        if end >= 1.0:
            return total
        if next_r <= end:
            row += 1 if dr > 0.0 else -1
            r_edge += down
            next_r = (r_edge - r0) / dr
        if next_c <= end:
            col += 1 if dc > 0.0 else -1
            c_edge += right
            next_c = (c_edge - c0) / dc
        t = max(t, end)


@helper
def _to_square(r: float, c: float, row: int, col: int) -> float:
    """Distance of a point to a tile; 0 in it."""
    dr = max(row - r, r - row - 1.0, 0.0)
    dc = max(col - c, c - col - 1.0, 0.0)
    return math.sqrt(dr * dr + dc * dc)


@helper
def _crosses(r0: float, c0: float, r1: float, c1: float, row: int, col: int) -> bool:
    """Return whether a segment has a point in common with a tile."""
    first, last = 0.0, 1.0
    for axis in range(2):
        a, delta, low = (r0, r1 - r0, row) if axis == 0 else (c0, c1 - c0, col)
        if delta == 0.0:
            if a < low or a > low + 1:
                return False
            continue
        t0, t1 = (low - a) / delta, (low + 1 - a) / delta
        first, last = max(first, min(t0, t1)), min(last, max(t0, t1))
    return first <= last


@helper
def _gap(r0: float, c0: float, r1: float, c1: float, row: int, col: int) -> float:
    """Distance of a segment to a tile: that of an end to the tile, or of a corner of the tile to the segment."""
    if _crosses(r0, c0, r1, c1, row, col):
        return 0.0
    dr, dc = r1 - r0, c1 - c0
    square = dr * dr + dc * dc
    least = min(_to_square(r0, c0, row, col), _to_square(r1, c1, row, col))
    if square == 0.0:
        return least
    for k in range(4):
        r, c = row + k // 2 - r0, col + k % 2 - c0
        t = min(max((r * dr + c * dc) / square, 0.0), 1.0)
        r, c = r - t * dr, c - t * dc
        least = min(least, math.sqrt(r * r + c * c))
    return least


@helper
def segment_clear(cost: Costs, r0: float, c0: float, r1: float, c1: float, margin: float, ends: int) -> bool:
    """Return whether a segment keeps a margin from all closed tiles.

    From a tile that an end in ``ends`` is nearer to, it need not keep more than that end does.
    """
    dr, dc = r1 - r0, c1 - c0
    for row in range(math.floor(min(r0, r1) - margin), math.floor(max(r0, r1) + margin) + 1):
        first, last = 0.0, 1.0
        if dr != 0.0:
            t0, t1 = (row - margin - r0) / dr, (row + 1 + margin - r0) / dr
            first, last = max(0.0, min(t0, t1)), min(1.0, max(t0, t1))
        west, east = c0 + first * dc, c0 + last * dc
        for col in range(math.floor(min(west, east) - margin), math.floor(max(west, east) + margin) + 1):
            if _is_open(cost, row, col):
                continue
            need = margin
            if ends & A_END:
                need = min(need, _to_square(r0, c0, row, col))
            if ends & B_END:
                need = min(need, _to_square(r1, c1, row, col))
            if _gap(r0, c0, r1, c1, row, col) < need - min(_ROUNDING, 0.5 * need):
                return False
    return True


@kernel
def sum_cost(cost: Costs, points: Annotated[Floats, 2], out: Annotated[Floats, 1]) -> None:
    """Fill ``out[0]`` with the cost of a line, (n, 2) field coordinates of its corners."""
    total = 0.0
    for i in range(points.shape[0] - 1):
        total += segment_cost(cost, points[i, 0], points[i, 1], points[i + 1, 0], points[i + 1, 1], math.inf)
    out[0] = total


@kernel
def check_clear(
    cost: Costs, points: Annotated[Floats, 2], margin: float, out: Annotated[NDArray[np.bool_], 1]
) -> None:  # fmt: skip
    """Fill ``out[0]``: whether a line keeps a margin; its first and last point may be nearer to closed tiles."""
    last = points.shape[0] - 2
    out[0] = True
    for i in range(last + 1):
        r0, c0, r1, c1 = points[i, 0], points[i, 1], points[i + 1, 0], points[i + 1, 1]
        ends = (A_END if i == 0 else 0) | (B_END if i == last else 0)
        if out[0]:
            out[0] = segment_clear(cost, r0, c0, r1, c1, margin, ends)
        if out[0]:
            out[0] = segment_cost(cost, r0, c0, r1, c1, math.inf) < math.inf


@kernel
def connect(cost: Costs, r: float, c: float, margin: float, out: Annotated[Floats, 2]) -> None:
    """Fill (m, m) costs from a start or goal to the middles of the tiles around it; infinite if not clear."""
    reach = out.shape[0] // 2
    top, left = math.floor(r) - reach, math.floor(c) - reach
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            row, col = top + i, left + j
            out[i, j] = math.inf
            if _is_open(cost, row, col):
                found = segment_cost(cost, r, c, row + 0.5, col + 0.5, math.inf)
                if found < math.inf and segment_clear(cost, r, c, row + 0.5, col + 0.5, margin, A_END):
                    out[i, j] = found


@kernel
def find_near(points: Annotated[Floats, 2], margin: float, out: Annotated[NDArray[np.bool_], 3]) -> None:
    """Fill (n, rows, cols): which tiles are nearer than a margin to the segments from ``points[0]`` to each other."""
    for k in range(out.shape[0]):
        for row in range(out.shape[1]):
            for col in range(out.shape[2]):
                gap = _gap(points[0, 0], points[0, 1], points[k + 1, 0], points[k + 1, 1], row, col)
                out[k, row, col] = gap < margin - min(_ROUNDING, 0.5 * margin)


@kernel
def trace_line(cost: Costs, points: Annotated[Floats, 2], out: Pieces) -> None:
    """Cut a line at the borders of tiles; see `segment_cost`, which sums the same pieces."""
    n, rows, cols = 0, cost.tiles.shape[0], cost.tiles.shape[1]
    for i in range(points.shape[0] - 1):
        r0, c0, dr, dc = points[i, 0], points[i, 1], points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1]
        length = math.sqrt(dr * dr + dc * dc)
        heading = _heading(cost, dr, dc, length)
        row, col = _first_tile(r0, dr), _first_tile(c0, dc)
        along_r, along_c = r0 if dr == 0.0 else math.nan, c0 if dc == 0.0 else math.nan
        t = 0.0
        while t < 1.0:
            next_r, next_c = _crossing(r0, dr, row), _crossing(c0, dc, col)
            end = min(next_r, next_c, 1.0)
            if (end - t) * length > _SLIVER:
                up, left = _dearer_shift(cost, heading, along_r, along_c, row, col)
                # On the window's edge the tile inside it counts.
                out.row[n], out.col[n] = min(max(row - up, 0), rows - 1), min(max(col - left, 0), cols - 1)
                out.length[n], out.part[n] = (end - t) * length, i
                n += 1
            if next_r <= end:
                row += 1 if dr > 0.0 else -1
            if next_c <= end:
                col += 1 if dc > 0.0 else -1
            t = max(t, end)
    out.pieces[0] = n


@helper
def _mean_around(heights: Floats, row: int, col: int) -> float:
    """Mean of what is known in three by three pixels; NaN if nothing is."""
    total, count = 0.0, 0
    for r in range(row - 1, row + 2):
        for c in range(col - 1, col + 2):
            if not math.isnan(heights[r, c]):
                total += heights[r, c]
                count += 1
    return total / count if count > 0 else math.nan


@kernel
def fill_holes(
    heights: Annotated[Floats, 2],
    near: Annotated[NDArray[np.bool_], 2],
    rounds: int,
    place: Annotated[NDArray[np.int64], 2],
    mean: Annotated[Floats, 1],
) -> None:
    """Fill holes with the mean of their neighbours, all at once in each round.

    ``heights`` (rows * pixels + 2, cols * pixels + 2): m, NaN in holes, with one more pixel at all edges; ``near``
    (rows, cols): tiles whose holes are filled. ``place`` (2, n) and ``mean`` (n,) are scratch for all their pixels.
    """
    rows, cols = near.shape
    pixels, n = (heights.shape[0] - 2) // rows, 0
    for row in range(1, rows * pixels + 1):
        for col in range(1, cols * pixels + 1):
            if near[(row - 1) // pixels, (col - 1) // pixels] and math.isnan(heights[row, col]):
                place[0, n], place[1, n] = row, col
                n += 1
    for _ in range(rounds):
        for k in range(n):
            mean[k] = _mean_around(heights, place[0, k], place[1, k])
        left = 0
        for k in range(n):
            heights[place[0, k], place[1, k]] = mean[k]
            if math.isnan(mean[k]):
                place[0, left], place[1, left] = place[0, k], place[1, k]
                left += 1
        n = left


@kernel
def drive_quarter_car(
    slope: Annotated[Floats, 1],
    step: Annotated[Floats, 2],
    push: Annotated[Floats, 1],
    travel: Annotated[Floats, 1],
) -> None:
    """Fill the difference of the slopes of body and wheel of a quarter car after each slope of a profile, (n,).

    ``step`` (4, 4): its state, from rest, after a sample; ``push`` (4,): what a slope adds to that.
    """
    a = b = c = d = 0.0
    for k in range(len(slope)):
        u = slope[k]
        a, b, c, d = (
            step[0, 0] * a + step[0, 1] * b + step[0, 2] * c + step[0, 3] * d + push[0] * u,
            step[1, 0] * a + step[1, 1] * b + step[1, 2] * c + step[1, 3] * d + push[1] * u,
            step[2, 0] * a + step[2, 1] * b + step[2, 2] * c + step[2, 3] * d + push[2] * u,
            step[3, 0] * a + step[3, 1] * b + step[3, 2] * c + step[3, 3] * d + push[3] * u,
        )
        travel[k] = a - c
