"""Compiled kernels that pull a line tight: leave out corners, and move those that stay.

Both keep the ends, keep clear of closed tiles, and change nothing that does not lower the exact integral.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.route._line_kernels import segment_clear, segment_cost
from bumpytiles import helper, kernel

__all__ = ["Corners", "Shortcuts", "Tightening", "leave_out", "move_corners"]

Costs = NDArray[np.float32]
Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_A_END, _B_END = 1, 2


class Tightening(NamedTuple):
    """What a line is pulled over, and how."""

    cost: Annotated[Costs, 2]
    """(rows, cols) cost per tile of length."""
    margin: float
    """Distance that the line keeps from closed tiles, tiles."""
    gain: float
    """A corner is moved for a gain of at least this, tiles."""
    worth: float
    """A corner is left out if the line costs no more than this without it, tiles."""
    least_step: float
    """Corners are moved by steps down to this, tiles."""


class Shortcuts(NamedTuple):
    """What `leave_out` fills for n corners."""

    best: Annotated[Floats, 1]
    """(n,) cost up to each."""
    before: Annotated[Integers, 1]
    """(n,) the corner before each, if the line went through it."""


class Corners(NamedTuple):
    """What `move_corners` works on."""

    points: Annotated[Floats, 2]
    """(n, 2) field coordinates; changed."""
    step: Annotated[Floats, 1]
    """(n,) by how far each corner is moved next, tiles; changed."""
    directions: Annotated[Floats, 2]
    """(k, 8, 2) flattened to (8 k, 2): unit vectors; the next eight are tried whenever the last did not help."""


@helper
def _ends(a: int, b: int, count: int) -> int:
    """Which of two corners are the start or the goal of a line."""
    return (_A_END if a == 0 else 0) | (_B_END if b == count - 1 else 0)


@kernel
def leave_out(tightening: Tightening, points: Annotated[Floats, 2], most: int, out: Shortcuts) -> None:
    """Find the cheapest line through some of the corners in order, at most ``most`` - 1 left out between two of them.

    Of lines that cost nearly the same, the one with fewer corners wins: corners on straight lines go.
    """
    cost, n = tightening.cost, points.shape[0]
    out.best[0], out.before[0] = 0.0, 0
    for j in range(1, n):
        r1, c1 = points[j, 0], points[j, 1]
        out.best[j] = out.best[j - 1] + segment_cost(cost, points[j - 1, 0], points[j - 1, 1], r1, c1, math.inf)
        out.before[j] = j - 1
        for i in range(max(0, j - most), j - 1):
            r0, c0 = points[i, 0], points[i, 1]
            # From far to near: what leaves out fewer corners must be cheaper by what the corners are worth.
            allowed = tightening.worth if out.before[j] == j - 1 else -tightening.worth
            total = segment_cost(cost, r0, c0, r1, c1, out.best[j] + allowed - out.best[i])
            if total < math.inf and segment_clear(cost, r0, c0, r1, c1, tightening.margin, _ends(i, j, n)):
                out.best[j], out.before[j] = out.best[i] + total, i


@helper
def _two_segments(cost: Costs, points: Floats, i: int, r: float, c: float, limit: float) -> float:
    """Cost from corner ``i - 1`` over a point to ``i + 1``; infinite above a limit."""
    first = segment_cost(cost, points[i - 1, 0], points[i - 1, 1], r, c, limit)
    if not first < math.inf:
        return first
    return first + segment_cost(cost, r, c, points[i + 1, 0], points[i + 1, 1], limit - first)


@helper
def _two_clear(tightening: Tightening, points: Floats, i: int, r: float, c: float) -> bool:
    """Whether the line may go from corner ``i - 1`` over a point to ``i + 1``."""
    cost, margin, n = tightening.cost, tightening.margin, points.shape[0]
    before, after = _ends(i - 1, i, n) & _A_END, _ends(i, i + 1, n) & _B_END
    return segment_clear(cost, points[i - 1, 0], points[i - 1, 1], r, c, margin, before) and segment_clear(
        cost, r, c, points[i + 1, 0], points[i + 1, 1], margin, after
    )


@helper
def _move_corner(tightening: Tightening, corners: Corners, i: int, turn: int) -> bool:
    """Move a corner to the best of ten places around it: eight directions, and the borders nearest to it."""
    points, step = corners.points, corners.step[i]
    r0, c0 = points[i, 0], points[i, 1]
    here = _two_segments(tightening.cost, points, i, r0, c0, math.inf)
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
        total = _two_segments(tightening.cost, points, i, r, c, best)
        if total < best and _two_clear(tightening, points, i, r, c):
            best, moved = total, True
            points[i, 0], points[i, 1] = r, c
            # The places that follow are still those around the old one.
    return moved


@kernel
def move_corners(tightening: Tightening, corners: Corners, most: int) -> None:
    """Move corners in turn until no step helps any of them, at most ``most`` times all of them."""
    n, turns = corners.points.shape[0], corners.directions.shape[0] // 8
    for turn in range(most):
        active = False
        for i in range(1, n - 1):
            if corners.step[i] < tightening.least_step:
                continue
            active = True
            if not _move_corner(tightening, corners, i, turn % turns):
                corners.step[i] *= 0.5
                continue
            # A step that helped is tried again, a longer one too; and the neighbours may now find something.
            corners.step[i] = min(2.0 * corners.step[i], 1.0)
            for near in range(i - 1, i + 2, 2):
                corners.step[near] = max(corners.step[near], 0.25 * corners.step[i])
        if not active:
            break
