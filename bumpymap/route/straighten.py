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
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import AXES_DEG, Floats, TracedLine, loops

Integers = NDArray[np.int64]


class Costs(NamedTuple):
    """Costs of the ground of a window."""

    tiles: NDArray[np.float32]
    """(rows, cols, axes) cost per tile of length, at least 1; infinite where closed."""
    gradient: NDArray[np.float32]
    """(rows, cols, 2) rise per length southwards and eastwards; (0, 0, 2) if slopes cost nothing."""
    climb: float
    """Cost of a rise of 1 along the way, tiles."""
    descent: float
    """The same downwards."""
    side: float
    """Cost of a length of 1 across a gradient of 1."""
    steepest: float
    """Directions across a larger gradient are barred."""


LEAST_MARGIN = 1e-6
"""Margins below this one, tiles, count as this one: what touches a closed tile may slip between two of them."""
_MAX_MARGIN = 0.5
"""Margin that closes a corridor of one tile, tiles."""
_WIDER = 1.05
"""Margin of a search as a multiple of that of the line (chosen)."""


def as_cost(cost: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return costs as loops take them, (rows, cols, axes); raises ValueError unless they are that or (rows, cols)."""
    cost = cost[..., None] if cost.ndim == 2 else cost
    if cost.ndim != 3 or cost.shape[2] not in (1, len(AXES_DEG)):
        raise ValueError(f"cost has the shape {cost.shape}; it must be rows and columns, and perhaps 8 axes")
    return np.ascontiguousarray(cost, np.float32)


def as_costs(cost: NDArray[np.floating] | Costs) -> Costs:
    """Return costs with what slopes add, nothing unless they have it, as loops take them; see `as_cost`."""
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
    """Return a line as loops take it."""
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
    out = TracedLine(integers[0], integers[1], np.empty(room), integers[2])
    count = loops.trace_line(costs, points, out)
    return TracedLine(out.row[:count], out.col[:count], out.length[:count], out.part[:count])


def line_cost(cost: NDArray[np.floating] | Costs, line: NDArray[np.floating]) -> float:
    """Return the exact integral of the cost along a line, in tiles; infinite if it crosses a closed tile.

    ``cost``: as `pull_tight`; ``line`` (n, 2): field coordinates of the corners.
    """
    return loops.sum_cost(as_costs(cost), _as_line(line))


def is_clear(cost: NDArray[np.floating] | Costs, line: NDArray[np.floating], margin: float = 0.0) -> bool:
    """Say whether a line keeps a margin from all closed tiles; see the module for start and goal.

    ``cost`` (rows, cols): infinite where closed; ``line`` (n, 2): field coordinates of the corners; ``margin``: tiles,
    at least 0 and below 0.5.
    """
    return loops.check_clear(as_costs(cost), _as_line(line), as_margin(margin))


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
    least, worth = _LEAST_MOVE * given, _WORTH * given
    best = _leave_out(cost, kept, worth, line)
    total = line_cost(cost, best)
    for _ in range(_ROUNDS):
        points = _with_new_corners(best)
        loops.move_corners(cost, kept, least, points, _DIRECTIONS, _FIRST_STEP, _LEAST_STEP, _SWEEPS)
        tried = _leave_out(cost, kept, worth, points)
        reached = line_cost(cost, tried)
        gain = total - reached
        if gain > 0.0:
            best, total = tried, reached
        if gain <= _GAIN * given:
            break
    return best if total <= given else line


def thin_out(cost: Costs, line: Floats, margin: float, least_saving: float) -> Floats:
    """Leave out corners of a tight line that hardly save anything; move those on borders of tiles to the cheaper side.

    Of an arc round a corner a few are left. A line along a border costs what the dearer side does: there, the last bit
    of a coordinate would decide.

    ``cost``, ``line``: as `pull_tight`; the line keeps more than the margin, or the arcs stay as they are; ``margin``:
    tiles, at least 0 and below 0.5; ``least_saving``: what a corner saves at least, tiles.
    """
    thin = _leave_out(cost, as_margin(margin) + _SPARE, least_saving, line)
    moved = thin.copy()
    loops.leave_borders(cost, moved, _ON_BORDER, _OFF_BORDER)
    return moved if is_clear(cost, moved, margin) and line_cost(cost, moved) < math.inf else thin


def _leave_out(cost: Costs, margin: float, worth: float, line: Floats) -> Floats:
    """Leave out corners without which the line costs no more than ``worth`` until none can be."""
    points = np.array(line, np.float64, order="C")
    return points[: loops.leave_out(cost, margin, worth, points, _SKIPPED)]


def _with_new_corners(line: Floats) -> Floats:
    """Set corners on every straight part: in its middle, and near its ends where it is long."""
    part = np.diff(line, axis=0)
    length = np.sqrt((part**2).sum(axis=1))
    near = np.minimum(1.0 / np.maximum(length, 1.0), 0.25)
    share = np.column_stack([np.zeros_like(near), near, np.full_like(near, 0.5), 1.0 - near])
    points = line[:-1, None] + share[..., None] * part[:, None]
    wanted = (share == 0.0) | (length > _LEAST_PART)[:, None]
    return np.ascontiguousarray(np.concatenate([points[wanted], line[-1:]]))
