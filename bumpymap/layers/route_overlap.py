"""Where sheets of one map overlap: which value of a tile or pixel counts, whatever the order of the sheets."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CANOPY, FREE, NO_TILE, OBSTACLE, Barred
from bumpytiles import TileWindow

__all__ = ["SheetChoice", "window_slices", "worse_objects"]

_UNKNOWN_OBJECT = 3
_WORST = np.array([NO_TILE, _UNKNOWN_OBJECT, FREE, CANOPY, OBSTACLE], np.uint8)
"""States of a pixel of obstacle.tif; of two sheets, the later one counts."""
_OBJECT_RANK = np.zeros(256, np.uint8)
_OBJECT_RANK[_WORST] = np.arange(len(_WORST))
_TILE_RANK = np.full(256, 3, np.uint8)
_TILE_RANK[[NO_TILE, Barred.UNKNOWN, Barred.NO]] = 0, 1, 2
"""How much a tile counts, by what bars it: no tile, unknown, passable, barred."""


@dataclass(frozen=True, slots=True)
class SheetChoice:
    """Which of two sheets counts, for each tile that they share."""

    newer: NDArray[np.bool_]
    """(rows, cols) only the new one."""
    both: NDArray[np.bool_]
    """(rows, cols) both: the larger value."""

    @classmethod
    def of(cls, old: NDArray[np.uint8], new: NDArray[np.uint8]) -> "SheetChoice":
        """Compare what bars the tiles."""
        before, now = _TILE_RANK[old], _TILE_RANK[new]
        return cls(now > before, now == before)

    def codes(self, old: NDArray[np.uint8], new: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the codes that count."""
        return np.where(self.newer, new, np.where(self.both, np.maximum(old, new), old))

    def values(self, old: NDArray[np.float32], new: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the values that count; NaN only if both are."""
        return np.where(self.newer, new, np.where(self.both, np.fmax(old, new), old))


def window_slices(window: TileWindow, part: TileWindow, pixels: int = 1) -> tuple[slice, slice]:
    """Return where a part of a window lies in its arrays."""
    top = (window.row + window.rows - part.row - part.rows) * pixels
    left = (part.col - window.col) * pixels
    return slice(top, top + part.rows * pixels), slice(left, left + part.cols * pixels)


def worse_objects(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return, of the states of pixels in two sheets, the one that counts."""
    return _WORST[np.maximum(_OBJECT_RANK[first], _OBJECT_RANK[second])]
