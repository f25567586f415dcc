"""A window as the search takes it, start and goal as it takes them, and the search itself."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.route._frame import Number, Point, is_open
from bumpymap.route._line_kernels import connect
from bumpymap.route._moves import REACH, move_tables
from bumpymap.route._search_kernels import NEW, NOT_REACHED, Ground, Reached, Seeds, mark_crowded, search
from bumpymap.route.line import is_clear, line_cost, wide_margin

__all__ = ["BYTES_PER_TILE", "MOST_TILES", "RingedWindow"]

Floats = NDArray[np.float64]

BYTES_PER_TILE = 36
"""Memory that a search takes at most: the costs that it is given, with and without the ring, and the arrays below."""
MOST_TILES = 2_000_000_000
"""Tiles of a window, which the search numbers with 32 bits; the ring takes the rest."""


@dataclass(frozen=True, slots=True)
class RingedWindow:
    """A window as the search takes it: with a ring of closed tiles."""

    cost: NDArray[np.float32]
    """(rows + 2 * REACH, cols + 2 * REACH)."""
    margin: float
    least: float
    """Least cost; 1 if all is closed."""

    @classmethod
    def of(cls, cost: NDArray[np.float32], margin: float) -> "RingedWindow":
        """Set a ring around costs; raises ValueError where one is below 1 or NaN."""
        least = float(cost.min(initial=math.inf))
        if not least >= 1.0:
            raise ValueError(f"the least cost is {least}; every cost must be a number of at least 1, or infinite")
        ringed = np.full((cost.shape[0] + 2 * REACH, cost.shape[1] + 2 * REACH), np.inf, np.float32)
        ringed[REACH:-REACH, REACH:-REACH] = cost
        return cls(ringed, wide_margin(margin), least if least < math.inf else 1.0)

    def inner(self, values: NDArray[Number]) -> NDArray[Number]:
        """Return values of the flattened window without the ring."""
        return values.reshape(self.cost.shape)[REACH:-REACH, REACH:-REACH]

    def seeds(self, start: Point, goal: Point | None) -> Seeds:
        """Connect start and goal with the middles of tiles around them."""
        first = self._connect(start)
        row, col = np.nonzero(first < math.inf)
        tile = (row + math.floor(start[0])) * self.cost.shape[1] + col + math.floor(start[1])
        if goal is None:
            return Seeds(tile, first[row, col], np.full_like(first, math.inf), math.inf)
        return Seeds(tile, first[row, col], self._connect(goal), self.straight_cost(start, goal))

    def _connect(self, point: Point) -> Floats:
        """Costs straight from a point to the middles of tiles around it; infinite if it lies in a closed tile."""
        out = np.full((2 * REACH + 1, 2 * REACH + 1), math.inf)
        r, c = point[0] + REACH, point[1] + REACH
        if is_open(self.cost, (r, c)):
            connect(self.cost, r, c, self.margin, out)
        return out

    def straight_cost(self, start: Point, goal: Point) -> float:
        """Cost of the straight line; infinite if it is not clear."""
        line = np.array([start, goal], np.float64) + REACH
        return line_cost(self.cost, line) if is_clear(self.cost, line, self.margin) else math.inf

    def search(self, seeds: Seeds, goal: Point, bound: float) -> Reached:
        """Run the search; ``bound`` as in `Ground`."""
        crowded = np.ones(self.cost.shape, np.uint8)
        mark_crowded(self.cost, REACH, np.zeros(self.cost.shape[1], np.int64), crowded)
        width, count = self.cost.shape[1], self.cost.size
        ground = Ground(self.cost.ravel(), crowded.ravel(), width, goal[0] + REACH, goal[1] + REACH, self.least, bound)
        reached = Reached(
            np.full(count, math.inf),
            np.full(count, NOT_REACHED, np.uint8),
            np.full(count, NEW, np.int32),
            np.empty(count, np.int32),
            np.empty(count),
            np.zeros(1, np.int64),
            np.zeros(1),
        )
        search(ground, move_tables(width, self.margin), seeds, reached)
        return reached
