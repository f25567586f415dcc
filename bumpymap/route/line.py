"""Lines over a map: which tiles they cross, what they cost, and whether they keep clear of closed tiles.

Field coordinates (r, c) of a window are in tiles: r from its north edge southwards, c from its west edge eastwards;
the middle of ``cost[i, j]`` is at (i + 0.5, j + 0.5). A tile is closed where its cost is infinite; everything outside
the window is closed.

A line keeps a margin: its distance to every closed tile, a full square, is at least that. Start and goal may be nearer
to closed tiles; then the straight part that leads away from such an end, and it alone, need not keep more from these
tiles than the end does. A margin of 0 counts as 1e-6 tiles, so that no line slips between two closed tiles that touch
at a corner.
"""

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import TracedLine
from bumpymap.route._line_kernels import LEAST_MARGIN, Line, Pieces, check_clear, sum_cost, trace_line

__all__ = ["as_cost", "as_margin", "is_clear", "line_cost", "trace", "wide_margin"]

_MAX_MARGIN = 0.5
_WIDER = 1.05


def as_cost(cost: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return costs as kernels take them; raises ValueError unless they are two-dimensional."""
    if cost.ndim != 2:
        raise ValueError(f"cost has {cost.ndim} dimensions; it must have two: rows and columns")
    return np.ascontiguousarray(cost, np.float32)


def as_margin(margin: float) -> float:
    """Return the margin that lines keep; raises ValueError unless it is within [0, 0.5) tiles."""
    if not 0.0 <= margin < _MAX_MARGIN:
        raise ValueError(f"margin is {margin} tiles; it must be at least 0 and below {_MAX_MARGIN}")
    return max(margin, LEAST_MARGIN)


def wide_margin(margin: float) -> float:
    """Return the margin that a search keeps: a twentieth more, so that the way round a corner needs few corners."""
    least = as_margin(margin)
    return min(_WIDER * least, 0.5 * (least + _MAX_MARGIN))


def _as_line(cost: NDArray[np.floating], line: NDArray[np.floating]) -> Line:
    """Return a line as kernels take it."""
    if line.ndim != 2 or line.shape[1] != 2 or not np.isfinite(line).all():
        raise ValueError(f"a line is (n, 2) finite field coordinates, not {line.shape}")
    return Line(as_cost(cost), np.ascontiguousarray(line, np.float64))


def trace(cost: NDArray[np.floating], line: NDArray[np.floating]) -> TracedLine:
    """Cut a line at the borders of tiles.

    Parameters
    ----------
    cost : array (rows, cols) float32
        Cost per length; infinite where closed. It decides where a line runs along a border: there the dearer tile
        counts.
    line : array (n, 2) float64
        Field coordinates of the corners, within the window.

    Returns
    -------
    TracedLine

    Raises
    ------
    ValueError
        The line leaves the window.
    """
    checked = _as_line(cost, line)
    if line.size and ((line < 0.0) | (line > np.array(cost.shape))).any():
        raise ValueError(f"the line leaves the window of {cost.shape[0]} x {cost.shape[1]} tiles")
    most = int(np.abs(np.diff(np.floor(checked.points), axis=0)).sum()) + 3 * len(line)
    integers = np.empty((2, most), np.int64)
    pieces = Pieces(integers[0], integers[1], np.empty(most), np.zeros(1, np.int64))
    trace_line(checked, pieces)
    count = int(pieces.pieces[0])
    return TracedLine(pieces.row[:count], pieces.col[:count], pieces.length[:count])


def line_cost(cost: NDArray[np.floating], line: NDArray[np.floating]) -> float:
    """Return the exact integral of the cost along a line, in tiles; infinite if it crosses a closed tile.

    Parameters
    ----------
    cost : array (rows, cols) float32
        Cost per length; infinite where closed.
    line : array (n, 2) float64
        Field coordinates of the corners.
    """
    out = np.empty(1)
    sum_cost(_as_line(cost, line), out)
    return float(out[0])


def is_clear(cost: NDArray[np.floating], line: NDArray[np.floating], margin: float = 0.0) -> bool:
    """Say whether a line keeps a margin from all closed tiles; see the module for start and goal.

    Parameters
    ----------
    cost : array (rows, cols) float32
        Infinite where closed.
    line : array (n, 2) float64
        Field coordinates of the corners.
    margin : float
        Tiles, at least 0 and below 0.5.
    """
    out = np.empty(1, np.bool_)
    check_clear(_as_line(cost, line), as_margin(margin), out)
    return bool(out[0])
