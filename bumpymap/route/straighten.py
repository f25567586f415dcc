"""Lines over a map, what they cost, whether they keep clear of closed tiles, and how a way is pulled tight.

Field coordinates (r, c) of a window are in tiles: r from its north edge southwards, c from its west edge eastwards;
the middle of ``cost[i, j]`` is at (i + 0.5, j + 0.5). A tile is closed where its cost is infinite; everything outside
the window is closed.

A line keeps a margin: its distance to every closed tile, a full square, is at least that. Start and goal may be nearer
to closed tiles; then the straight part that leads away from such an end, and it alone, need not keep more from these
tiles than the end does. A margin of 0 counts as 1e-6 tiles, so that no line slips between two closed tiles that touch
at a corner.

A way is pulled tight in turns until nothing is gained: corners are left out wherever the straight line costs no more
(the cheapest choice among several in a row); new corners are set beside each that is left and in the middle of long
straight parts; all corners are moved by ever smaller steps. Every cost is the exact integral. The result is never
dearer, and never nearer to closed tiles than allowed.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import AXES_DEG, TracedLine
from bumpymap.route._line_kernels import (
    A_END,
    B_END,
    LEAST_MARGIN,
    Costs,
    Pieces,
    check_clear,
    segment_clear,
    segment_cost,
    sum_cost,
    trace_line,
)
from bumpytiles import helper, kernel

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


class Tightening(NamedTuple):
    """Limits of pulling a line."""

    margin: float
    """Distance that the line keeps from closed tiles, tiles."""
    gain: float
    """A corner is moved for a gain of at least this, tiles."""
    worth: float
    """A corner is left out if the line costs no more than this without it, tiles."""
    least_step: float
    """Corners are moved by steps down to this, tiles."""


class Corners(NamedTuple):
    """The corners that `move_corners` moves."""

    points: Annotated[Floats, 2]
    """(n, 2) field coordinates; changed."""
    step: Annotated[Floats, 1]
    """(n,) by how far each corner is moved next, tiles; changed."""
    spent: Annotated[Floats, 1]
    """(n,) cost from the corner before to each; filled."""
    directions: Annotated[Floats, 2]
    """(k, 8, 2) flattened to (8 k, 2): unit vectors; the next eight are tried whenever the last did not help."""


@helper
def _ends(a: int, b: int, count: int) -> int:
    """Return the bits of those of two corners that are the start or the goal of a line."""
    return (A_END if a == 0 else 0) | (B_END if b == count - 1 else 0)


@helper
def _choose(
    cost: Costs, tightening: Tightening, points: Floats, n: int, skips: int, best: Floats, before: Integers
) -> None:  # fmt: skip
    """Fill the cost up to each of n corners, and the one before it, of the cheapest line through some of them."""
    best[0], before[0] = 0.0, 0
    for j in range(1, n):
        r1, c1 = points[j, 0], points[j, 1]
        best[j] = best[j - 1] + segment_cost(cost, points[j - 1, 0], points[j - 1, 1], r1, c1, math.inf)
        before[j] = j - 1
        for i in range(max(0, j - skips), j - 1):
            r0, c0 = points[i, 0], points[i, 1]
            # From far to near: what leaves out fewer corners must be cheaper by what the corners are worth.
            allowed = tightening.worth if before[j] == j - 1 else -tightening.worth
            total = segment_cost(cost, r0, c0, r1, c1, best[j] + allowed - best[i])
            if total < math.inf and segment_clear(cost, r0, c0, r1, c1, tightening.margin, _ends(i, j, n)):
                best[j], before[j] = best[i] + total, i


@kernel
def leave_out(
    cost: Costs,
    tightening: Tightening,
    points: Annotated[Floats, 2],
    skips: int,
    best: Annotated[Floats, 1],
    before: Annotated[Integers, 1],
) -> None:
    """Leave out corners, until none can be, so that the line through the others in order is the cheapest.

    At most ``skips`` - 1 are left out between two of them at once. Of lines that cost nearly the same, that with fewer
    corners wins: corners on straight lines go. ``points`` (n, 2): changed: the corners that stay come first; ``best``
    (n,): scratch; ``before`` (n,): scratch, and in ``before[0]`` the number of corners that stay.
    """
    n, count = 0, points.shape[0]
    while n != count:
        n, count = count, 1
        _choose(cost, tightening, points, n, skips, best, before)
        at = n - 1
        while at > 0:  # turn the links round: from each corner that stays to the next one
            best[before[at]], at = at, before[at]
            count += 1
        for k in range(count):
            points[k, 0], points[k, 1] = points[at, 0], points[at, 1]
            at = int(best[at]) if k < count - 1 else 0
    before[0] = count


@kernel
def leave_borders(cost: Costs, points: Annotated[Floats, 2], near: float, shift: float) -> None:
    """Move corners that are ``near`` to borders of tiles by ``shift`` from them, to where the line costs least, tiles.

    ``points`` (n, 2): changed.
    """
    for i in range(1, points.shape[0] - 1):
        r0, c0 = points[i, 0], points[i, 1]
        row, col = math.floor(r0 + 0.5), math.floor(c0 + 0.5)
        on_row, on_col = abs(r0 - row) < near, abs(c0 - col) < near
        least = math.inf
        for k in range(4):
            if not (on_row or on_col) or (k > 1 and not on_row) or (k % 2 == 1 and not on_col):
                continue
            r = row + (shift if k > 1 else -shift) if on_row else r0
            c = col + (shift if k % 2 == 1 else -shift) if on_col else c0
            total = _two_segments(cost, points, i, r, c, math.inf)
            if total < least:
                least = total
                points[i, 0], points[i, 1] = r, c


@helper
def _two_segments(cost: Costs, points: Floats, i: int, r: float, c: float, limit: float) -> float:
    """Cost from corner ``i - 1`` over a point to ``i + 1``; infinite above a limit."""
    first = segment_cost(cost, points[i - 1, 0], points[i - 1, 1], r, c, limit)
    if not first < math.inf:
        return first
    return first + segment_cost(cost, r, c, points[i + 1, 0], points[i + 1, 1], limit - first)


@helper
def _two_clear(cost: Costs, margin: float, points: Floats, i: int, r: float, c: float) -> bool:
    """Return whether the line may go from corner ``i - 1`` over a point to ``i + 1``."""
    n = points.shape[0]
    before, after = _ends(i - 1, i, n) & A_END, _ends(i, i + 1, n) & B_END
    return segment_clear(cost, points[i - 1, 0], points[i - 1, 1], r, c, margin, before) and segment_clear(
        cost, r, c, points[i + 1, 0], points[i + 1, 1], margin, after
    )


@helper
def _spend(cost: Costs, corners: Corners, i: int) -> None:
    """Fill the cost from a corner's predecessor to it."""
    points = corners.points
    corners.spent[i] = segment_cost(cost, points[i - 1, 0], points[i - 1, 1], points[i, 0], points[i, 1], math.inf)


@helper
def _move_corner(cost: Costs, tightening: Tightening, corners: Corners, i: int, turn: int) -> bool:
    """Move a corner to the best of ten places around it: eight directions, and the borders nearest to it."""
    points, step = corners.points, corners.step[i]
    r0, c0 = points[i, 0], points[i, 1]
    here = corners.spent[i] + corners.spent[i + 1]
    best, moved = here - tightening.gain, False
    for k in range(10):
        r, c = r0, c0
        if k < 8:
            r += step * corners.directions[turn * 8 + k, 0]
            c += step * corners.directions[turn * 8 + k, 1]
        elif k == 8:
            r = math.floor(r0 + 0.5)
        else:
            c = math.floor(c0 + 0.5)
        if k >= 8 and abs(r - r0) + abs(c - c0) > 2.0 * step:
            continue
        total = _two_segments(cost, points, i, r, c, best)
        if total < best and _two_clear(cost, tightening.margin, points, i, r, c):
            best, moved = total, True
            points[i, 0], points[i, 1] = r, c
            # The places that follow are still those around the old one.
    if moved:
        _spend(cost, corners, i)
        _spend(cost, corners, i + 1)
    return moved


@kernel
def move_corners(cost: Costs, tightening: Tightening, corners: Corners, sweeps: int) -> None:
    """Move corners in turn until no step helps any of them, at most ``sweeps`` times all of them."""
    n, turns = corners.points.shape[0], corners.directions.shape[0] // 8
    for i in range(1, n):
        _spend(cost, corners, i)
    for turn in range(sweeps):
        active = False
        for i in range(1, n - 1):
            if corners.step[i] < tightening.least_step:
                continue
            active = True
            if not _move_corner(cost, tightening, corners, i, turn % turns):
                corners.step[i] *= 0.5
                continue
            # A step that helped is tried again, a longer one too; and the neighbours may now find something.
            corners.step[i] = min(2.0 * corners.step[i], 1.0)
            for near in range(i - 1, i + 2, 2):
                corners.step[near] = max(corners.step[near], 0.25 * corners.step[i])
        if not active:
            break


_MAX_MARGIN = 0.5
"""Margin that closes a corridor of one tile, tiles."""
_WIDER = 1.05
"""Margin of a search as a multiple of that of the line (chosen)."""


def as_cost(cost: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return costs as kernels take them, (rows, cols, axes); raises ValueError unless they are that or (rows, cols)."""
    cost = cost[..., None] if cost.ndim == 2 else cost
    if cost.ndim != 3 or cost.shape[2] not in (1, len(AXES_DEG)):
        raise ValueError(f"cost has the shape {cost.shape}; it must be rows and columns, and perhaps 8 axes")
    return np.ascontiguousarray(cost, np.float32)


def as_costs(cost: NDArray[np.floating] | Costs) -> Costs:
    """Return costs with what slopes add, nothing unless they have it, as kernels take them; see `as_cost`."""
    if isinstance(cost, Costs):
        tiles, gradient = as_cost(cost.tiles), np.ascontiguousarray(cost.gradient, np.float32)
        return cost._replace(tiles=tiles, gradient=gradient)
    return Costs(as_cost(cost), np.empty((0, 0, 2), np.float32), 0.0, 0.0, 0.0, math.inf)


def as_margin(margin: float) -> float:
    """Return the margin that lines keep; raises ValueError unless it is within [0, 0.5) tiles."""
    if not 0.0 <= margin < _MAX_MARGIN:
        raise ValueError(f"margin is {margin} tiles; it must be at least 0 and below {_MAX_MARGIN}")
    return max(margin, LEAST_MARGIN)


def wide_margin(margin: float) -> float:
    """Return the margin that a search keeps: a twentieth more, so that the way round a corner needs few corners."""
    least = as_margin(margin)
    return min(_WIDER * least, 0.5 * (least + _MAX_MARGIN))


def _as_line(line: NDArray[np.floating]) -> Floats:
    """Return a line as kernels take it."""
    if line.ndim != 2 or line.shape[1] != 2 or not np.isfinite(line).all():
        raise ValueError(f"a line is (n, 2) finite field coordinates, not {line.shape}")
    return np.ascontiguousarray(line, np.float64)


def trace(cost: NDArray[np.floating] | Costs, line: NDArray[np.floating]) -> TracedLine:
    """Cut a line at the borders of tiles.

    ``cost``: as `pull_tight`. It decides where a line runs along a border: there
    the dearer tile counts; ``line`` (n, 2): field coordinates of the corners, within the window. Raises ValueError: the
    line leaves the window.
    """
    costs, points = as_costs(cost), _as_line(line)
    rows, cols = costs.tiles.shape[:2]
    if line.size and ((line < 0.0) | (line > np.array([rows, cols]))).any():
        raise ValueError(f"the line leaves the window of {rows} x {cols} tiles")
    room = int(np.abs(np.diff(np.floor(points), axis=0)).sum()) + 3 * len(line)
    integers = np.empty((3, room), np.int64)
    pieces = Pieces(integers[0], integers[1], np.empty(room), integers[2], np.zeros(1, np.int64))
    trace_line(costs, points, pieces)
    count = int(pieces.pieces[0])
    return TracedLine(pieces.row[:count], pieces.col[:count], pieces.length[:count], pieces.part[:count])


def line_cost(cost: NDArray[np.floating] | Costs, line: NDArray[np.floating]) -> float:
    """Return the exact integral of the cost along a line, in tiles; infinite if it crosses a closed tile.

    ``cost``: as `pull_tight`; ``line`` (n, 2): field coordinates of the corners.
    """
    out = np.empty(1)
    sum_cost(as_costs(cost), _as_line(line), out)
    return float(out[0])


def is_clear(cost: NDArray[np.floating] | Costs, line: NDArray[np.floating], margin: float = 0.0) -> bool:
    """Say whether a line keeps a margin from all closed tiles; see the module for start and goal.

    ``cost`` (rows, cols): infinite where closed; ``line`` (n, 2): field coordinates of the corners; ``margin``: tiles,
    at least 0 and below 0.5.
    """
    out = np.empty(1, np.bool_)
    check_clear(as_costs(cost), _as_line(line), as_margin(margin), out)
    return bool(out[0])


_ON_BORDER, _OFF_BORDER = 1e-7, 1e-6
"""Distance from a border of corners that are moved off it, and distance that they have then, tiles (chosen)."""
_SKIPPED = 12
"""Corners in a row that one look may leave out (chosen); the next look begins with those that are left."""
_ROUNDS, _SWEEPS, _GAIN = 6, 60, 1e-6
"""Most rounds of pulling, most sweeps over all corners in each, and least gain of a round that is followed by another,
as a share of the cost (chosen)."""
_LEAST_MOVE, _WORTH = 1e-10, 1e-7
"""Least gain for which a corner is moved, and least saving for which it stays, as shares of the cost (chosen)."""
LEAST_SAVING = 1e-3
"""Least saving of a corner of a thinned line by default, tiles: 3 mm (chosen)."""
_FIRST_STEP, _LEAST_STEP = 0.5, 2e-5
"""First and least step by which corners are moved, tiles: down to 0.06 mm (chosen)."""
_AXES = np.arange(4) * 0.5 * np.pi
_TURNED = np.array([0.25, 0.125, 0.375, 0.0625, 0.1875, 0.3125, 0.4375])[:, None] * np.pi + _AXES
_ANGLES = np.concatenate([np.broadcast_to(_AXES, _TURNED.shape), _TURNED], axis=1).ravel()
_DIRECTIONS = np.column_stack([np.sin(_ANGLES), np.cos(_ANGLES)])
"""Along the axes always, and four more at angles that change: curved margins leave narrow ways to go."""
_SPARE = 5e-10
"""Addition to the margin, tiles: the line stays clear when its coordinates are rounded in other windows."""
_LEAST_PART = 1e-3
"""Shortest straight part on which new corners are set, tiles (chosen)."""


def pull_tight(cost: NDArray[np.floating] | Costs, line: Floats, margin: float = 0.0) -> Floats:
    """Return a line between the same ends that keeps the margin and costs no more.

    ``cost`` as of `find_way`; ``line`` (n, 2): field coordinates of a line that keeps the margin; ``margin``: tiles, at
    least 0 and below 0.5. Raises ValueError: the line has fewer than two corners, or crosses a closed tile.
    """
    cost = as_costs(cost)
    given = line_cost(cost, line)
    if len(line) < 2 or not given < math.inf:
        raise ValueError(f"a line of {len(line)} corners that costs {given} cannot be pulled tight")
    kept = as_margin(margin) + _SPARE
    tightening = Tightening(kept, _LEAST_MOVE * given, _WORTH * given, _LEAST_STEP)
    best = _leave_out(cost, tightening, np.ascontiguousarray(line, np.float64))
    total = line_cost(cost, best)
    for _ in range(_ROUNDS):
        points = _with_new_corners(best)
        corners = Corners(points, np.full(len(points), _FIRST_STEP), np.empty(len(points)), _DIRECTIONS)
        move_corners(cost, tightening, corners, _SWEEPS)
        tried = _leave_out(cost, tightening, points)
        reached = line_cost(cost, tried)
        gain = total - reached
        if gain > 0.0:
            best, total = tried, reached
        if gain <= _GAIN * given:
            break
    return best if total <= given else line


def thin_out(
    cost: NDArray[np.floating] | Costs, line: Floats, margin: float = 0.0, least_saving: float = LEAST_SAVING
) -> Floats:
    """Leave out corners of a tight line that hardly save anything: of an arc round a corner a few are left.

    ``cost``, ``line``: as `pull_tight`; the line keeps more than the margin, or the arcs stay as they are; ``margin``:
    tiles, at least 0 and below 0.5; ``least_saving``: what a corner saves at least, tiles.
    """
    thinning = Tightening(as_margin(margin) + _SPARE, 0.0, least_saving, _LEAST_STEP)
    return _leave_out(as_costs(cost), thinning, np.ascontiguousarray(line, np.float64))


def off_borders(cost: NDArray[np.floating] | Costs, line: Floats, margin: float = 0.0) -> Floats:
    """Move the corners of a line that lie on borders of tiles to the cheaper side.

    A line along a border costs what the dearer side does: there, the last bit of a coordinate would decide.

    ``cost``, ``line``, ``margin``: as `pull_tight`.
    """
    moved = np.array(line, np.float64, order="C")
    leave_borders(as_costs(cost), moved, _ON_BORDER, _OFF_BORDER)
    return moved if is_clear(cost, moved, margin) and line_cost(cost, moved) < math.inf else line


def _leave_out(cost: Costs, tightening: Tightening, line: Floats) -> Floats:
    """Leave out corners until none can be."""
    points, before = line.copy(), np.empty(len(line), np.int64)
    leave_out(cost, tightening, points, _SKIPPED, np.empty(len(line)), before)
    return points[: before[0]]


def _with_new_corners(line: Floats) -> Floats:
    """Set corners on every straight part: in its middle, and near its ends where it is long."""
    part = np.diff(line, axis=0)
    length = np.sqrt((part**2).sum(axis=1))
    near = np.minimum(1.0 / np.maximum(length, 1.0), 0.25)
    share = np.column_stack([np.zeros_like(near), near, np.full_like(near, 0.5), 1.0 - near])
    points = line[:-1, None] + share[..., None] * part[:, None]
    wanted = (share == 0.0) | (length > _LEAST_PART)[:, None]
    return np.ascontiguousarray(np.concatenate([points[wanted], line[-1:]]))
