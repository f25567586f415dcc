"""How a window is turned before a search, so that turned maps and the way back cost the same.

A search prefers one of several ways that cost the same, or nearly so, by the order in which it looks at tiles, and a
local search ends where it began. So every search runs in the same frame: from the end in the cheaper tile to the other,
southwards more than eastwards, and never northwards or westwards.
"""

import math
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

__all__ = ["Frame", "Point", "is_open", "settle_point"]

Floats = NDArray[np.float64]
Point = tuple[float, float]
"""Field coordinates (r, c)."""
Number = TypeVar("Number", bound=np.generic)

_QUANTUM = 2.0**-30


def settle_point(point: Point) -> Point:
    """Round a point to within 1e-9 tiles, to a place inside its tile.

    Turned and shifted coordinates are exact then, and no point is on a border, where it would change its tile.
    """
    if not (math.isfinite(point[0]) and math.isfinite(point[1])):
        raise ValueError(f"{point} is no point: field coordinates are two finite numbers")
    r, c = (_settled(x) for x in point)
    return r, c


def _settled(x: float) -> float:
    """Round one coordinate."""
    tile = math.floor(x)
    return tile + min(max(round((x - tile) / _QUANTUM), 1), round(1 / _QUANTUM) - 1) * _QUANTUM


def is_open(cost: NDArray[np.float32], point: Point) -> bool:
    """Say whether a point lies in an open tile of a window."""
    row, col = math.floor(point[0]), math.floor(point[1])
    inside = 0 <= row < cost.shape[0] and 0 <= col < cost.shape[1]
    return inside and bool(cost[row, col] < math.inf)


class Frame(NamedTuple):
    """What is done to a window, in this order, and to the ends of a way."""

    back: bool
    """Whether the search runs from goal to start."""
    flip_rows: bool
    flip_cols: bool
    transpose: bool

    @classmethod
    def of(cls, cost: NDArray[np.float32], start: Point, goal: Point) -> "Frame":
        """Choose the frame for a start and a goal in the window."""
        back = _rank(cost, start) > _rank(cost, goal)
        down, right = (goal[0] - start[0], goal[1] - start[1]) if not back else (start[0] - goal[0], start[1] - goal[1])
        return cls(back, down < 0.0, right < 0.0, abs(down) < abs(right))

    def turn(self, values: NDArray[Number]) -> NDArray[Number]:
        """Turn an array (rows, cols); a view."""
        turned = values[:: -1 if self.flip_rows else 1, :: -1 if self.flip_cols else 1]
        return turned.T if self.transpose else turned

    def turn_back(self, values: NDArray[Number]) -> NDArray[Number]:
        """Undo `turn`; a view."""
        turned = values.T if self.transpose else values
        return turned[:: -1 if self.flip_rows else 1, :: -1 if self.flip_cols else 1]

    def ends(self, shape: tuple[int, ...], start: Point, goal: Point) -> tuple[Point, Point]:
        """Turn start and goal in a window of ``shape``, and put them in order."""
        (r0, c0), (r1, c1) = (self._place(shape, point) for point in ((goal, start) if self.back else (start, goal)))
        return (r0, c0), (r1, c1)

    def _place(self, shape: tuple[int, ...], point: Point) -> Point:
        r = shape[0] - point[0] if self.flip_rows else point[0]
        c = shape[1] - point[1] if self.flip_cols else point[1]
        return (c, r) if self.transpose else (r, c)

    def line_back(self, shape: tuple[int, ...], line: Floats) -> Floats:
        """Turn a line (n, 2) back to a window of ``shape``, from its start to its goal."""
        line = line[:: -1 if self.back else 1, :: -1 if self.transpose else 1].copy()
        for axis, flipped in enumerate((self.flip_rows, self.flip_cols)):
            if flipped:
                line[:, axis] = shape[axis] - line[:, axis]
        return line


def _rank(cost: NDArray[np.float32], point: Point) -> tuple[float, ...]:
    """Return what tells two ends apart: the same on turned maps, but for the last two numbers."""
    row, col = math.floor(point[0]), math.floor(point[1])
    r, c = abs(point[0] - row - 0.5), abs(point[1] - col - 0.5)
    return float(cost[row, col]), max(r, c), min(r, c), *point
