"""Which blocks are complete: no unread chunk can add points to them."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bumpytiles import BLOCK_TILES, BlockKey, Bounds, Grid

__all__ = ["BlockCompletion"]

_MARGIN = 1.01
"""Points may lie this far outside their bounds, m (readers accept 1 m)."""
_MOST_CELLS = 4_000_000
"""In a window of more blocks nothing is counted, and no block is complete before the end."""


class BlockCompletion:
    """Counts, for each block, the unread areas that overlap it.

    Parameters
    ----------
    grid : Grid
    bounds : sequence of Bounds or None
        Bounds of the points of each area, m; None if they are not known.
    """

    def __init__(self, grid: Grid, bounds: Sequence[Bounds | None]) -> None:
        self._boxes = [None if box is None else _blocks(grid, box) for box in bounds]
        known = np.array([box for box in self._boxes if box is not None], dtype=np.int64).reshape(-1, 4)
        self._unknown = len(bounds) - len(known)
        self._open_areas: NDArray[np.int32] | None = None
        if not len(known):
            return
        self._south, self._west = int(known[:, 0].min()), int(known[:, 2].min())
        rows, cols = int(known[:, 1].max()) - self._south, int(known[:, 3].max()) - self._west
        if rows * cols <= _MOST_CELLS:
            self._open_areas = np.zeros((rows, cols), np.int32)
            for box in known.tolist():
                self._open_areas[self._inside(box)] += 1

    def mark_read(self, area: int) -> None:
        """Record that all points of an area are read."""
        box = self._boxes[area]
        if box is None:
            self._unknown -= 1
        elif self._open_areas is not None:
            self._open_areas[self._inside(box)] -= 1

    def is_complete(self, key: BlockKey) -> bool:
        """Return whether no unread area overlaps a block."""
        if self._unknown or self._open_areas is None:
            return False
        row, col = key[0] - self._south, key[1] - self._west
        if not (0 <= row < self._open_areas.shape[0] and 0 <= col < self._open_areas.shape[1]):
            return False  # a point outside all bounds: its file will be rejected
        return bool(self._open_areas[row, col] == 0)

    def _inside(self, box: Sequence[int]) -> tuple[slice, slice]:
        south, north, west, east = (int(side) for side in box)
        return slice(south - self._south, north - self._south), slice(west - self._west, east - self._west)


def _blocks(grid: Grid, box: Bounds) -> tuple[int, int, int, int]:
    """Return the blocks that overlap a box: first row, last row + 1, first column, last column + 1."""
    low = grid.index(np.array([box.south, box.west]) - _MARGIN) // BLOCK_TILES
    high = grid.index(np.array([box.north, box.east]) + _MARGIN) // BLOCK_TILES + 1
    return int(low[0]), int(high[0]), int(low[1]), int(high[1])
