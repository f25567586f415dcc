"""Find the part of a survey that nobody has classified, beside one that has ground classes.

Points of class 0 or 1 alone do not tell it: ground filters leave roofs, crowns, cars and water in these classes too. So
a part of the survey counts as never classified only if all of this holds:

- it is large: made of squares of 27 m, three quarters of whose tiles hold points, all of class 0 or 1. Houses, groups
  of trees, ponds and rivers are smaller, and between them ground is seen.
- it lies at the edge: most of its tiles have no classified tile beyond them in one of the four directions. A hall, a
  wood or a lake amid classified ground has some all around, however large it is.
- its ground goes on where the classified ground ends: along most of their common border the lowest points of its tiles
  are level with the lowest ground points of the tiles beside them. The border of a roof or a crown is a jump. What is
  nearer to a stretch of the border that jumps than to one that is level is left out, up to 60 m from there.

All of it depends on tiles and their points alone, not on the files that they come from. What it cannot tell is water of
class 1 that reaches the edge of the survey, 27 m wide, and level with its shore: such water needs class 9.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import POINT_GROUND, POINT_OTHER, Mask
from bumpytiles import BLOCK_TILES, BlockKey

NO_POINT, BLANK, CLASSED, GROUND, MIXED = range(5)
"""Mask of a tile: without points; all points of class 0 or 1; of other classes too, but no ground; ground; ground and
points of class 0 or 1."""
_SIDE_M, _FILLED = 27.0, 0.75
"""Side of a square that is large, and the share of its tiles that hold points."""
_GAP = 3
"""Most tiles from one of the unclassified part to the ground beside it."""
_LEVEL_M = 0.5
"""A tile is level with ground beside it if its lowest point lies so near that of the ground, or where the slope of the
ground leads, or between both, m."""
_VOTERS = 9
"""Side of the square whose tiles say together whether a border is level there."""
_JUMP_REACH_M = 60.0
"""Distance up to which a border where the lowest points jump decides about tiles nearer to it than to a level one, m.
Chosen."""

REACH = _GAP + 1
"""Tiles up to this number from those in question are compared with them."""
Lowest = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64], bool]
"""Rows, columns and lowest points of some tiles, (n,) each, m; and whether of their ground points alone."""


def tile_marks(flags: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return the mark of each tile of a block, (256,), from the kinds of its points, (256, 8): `TileBuckets.flags`."""
    ground, blank, some = flags[:, POINT_GROUND], flags[:, POINT_OTHER], flags.any(axis=1)
    only_blank = blank & (flags.sum(axis=1) == 1)
    marks = np.select([ground & blank, ground, only_blank, some], [MIXED, GROUND, BLANK, CLASSED], NO_POINT)
    return marks.astype(np.uint8)


@dataclass(frozen=True, slots=True, eq=False)
class UnclassifiedPart:
    """Tiles that may be of the part that nobody has classified, in a window of whole blocks; rows grow to the north."""

    south: int
    west: int
    """The first row and column of tiles of the window."""
    marks: NDArray[np.uint8]
    """(rows, cols) marks of its tiles."""
    labels: NDArray[np.int32]
    """(rows, cols) number of the connected area of each of the tiles in question, from 1; else 0."""
    tile_size: float
    """m"""

    @classmethod
    def find(cls, blocks: Mapping[BlockKey, NDArray[np.uint8]], tile_size: float) -> Self | None:
        """Find large areas at the edge whose points all have class 0 or 1; None if there is none.

        ``blocks`` mapping of BlockKey to array (256,): marks of all tiles of the survey;
        ``tile_size``: m.
        """
        side = max(3, math.ceil(_SIDE_M / tile_size)) | 1
        least = _FILLED * side**2
        keys, every = np.array([*blocks], np.int64), np.stack([*blocks.values()]).reshape(-1, BLOCK_TILES, BLOCK_TILES)
        # A square lies in at most this number of blocks; one of them holds its share of the tiles.
        in_rich = (every == BLANK).sum(axis=(1, 2)) >= least / ((side - 2) // BLOCK_TILES + 2) ** 2
        if not in_rich.any():
            return None
        from scipy import ndimage

        ring = (side + 2 * _GAP) // BLOCK_TILES + 1
        first, stop = keys[in_rich].min(axis=0) - ring, keys[in_rich].max(axis=0) + ring + 1
        inside = ((keys >= first) & (keys < stop)).all(axis=1)
        rows, cols = (stop - first).tolist()
        window = np.zeros((rows, BLOCK_TILES, cols, BLOCK_TILES), np.uint8)
        window[keys[inside, 0] - first[0], :, keys[inside, 1] - first[1], :] = every[inside]
        marks = window.reshape(rows * BLOCK_TILES, cols * BLOCK_TILES)
        blank = marks == BLANK
        squares = (_around(blank, side) >= least) & (_around(marks > BLANK, side) == 0)
        labels = ndimage.label(blank & (_around(squares, side) > 0), np.ones((3, 3)))[0].astype(np.int32)
        south, west = (first * BLOCK_TILES).tolist()
        enclosed = (labels > 0) & _between(keys, every > BLANK, south, west, marks.shape)
        tiles, amid = (np.bincount(of, minlength=int(labels.max()) + 1) for of in (labels.ravel(), labels[enclosed]))
        labels[(2 * amid >= tiles)[labels]] = 0
        return cls(south, west, marks, labels, tile_size) if labels.any() else None

    @property
    def tiles(self) -> int:
        """Number of tiles in question."""
        return int(np.count_nonzero(self.labels))

    def blocks(self, reach: int) -> set[BlockKey]:
        """Return the blocks with tiles that are up to ``reach`` tiles away from one in question."""
        row, col = np.nonzero(_around(self.labels > 0, 2 * reach + 1))
        keys = np.stack([row + self.south, col + self.west], axis=1) // BLOCK_TILES
        return {(north, east) for north, east in np.unique(keys, axis=0).tolist()}

    def never_classified(self, lowest: Iterable[Lowest]) -> Mask:
        """Return which tiles, (rows, cols), nobody has classified, as the module says.

        ``lowest``: the lowest points of the tiles in question, and the lowest ground points of
        those up to ``REACH`` away from them; of other tiles as may be.
        """
        from scipy import ndimage

        heights = np.full(self.marks.shape, np.nan)
        for row, col, z_min, of_ground in lowest:
            at = np.stack([row - self.south, col - self.west])
            inside = ((at >= 0) & (at < np.array(self.marks.shape)[:, None])).all(axis=0)
            north, east = at[:, inside]
            wanted = self.marks[north, east] >= GROUND if of_ground else self.labels[north, east] > 0
            heights[north[wanted], east[wanted]] = z_min[inside][wanted]
        asked = self.labels > 0
        level, jump = self._compared(heights)
        areas = [np.bincount(self.labels[marks], minlength=int(self.labels.max()) + 1) for marks in (level, jump)]
        found = asked & ((areas[0] > areas[1]) | (areas[1] == 0))[self.labels]
        jumps = _around(jump, _VOTERS) > _around(level, _VOTERS)
        of_jump, of_level = (
            ndimage.distance_transform_edt(~border) if border.any() else np.full(border.shape, np.inf)
            for border in ((level | jump) & jumps, (level | jump) & ~jumps)
        )
        return np.asarray(found & ((of_jump > _JUMP_REACH_M / self.tile_size) | (of_level <= of_jump)))

    def _compared(self, lowest: NDArray[np.float64]) -> tuple[Mask, Mask]:
        """Return which of the tiles in question are level with ground beside them, and which are not."""
        asked, ground = self.labels > 0, np.where(self.marks >= GROUND, lowest, np.nan)
        has_ground = np.isfinite(ground)
        level, jump = np.zeros_like(asked), np.zeros_like(asked)
        for axis in (0, 1):
            for towards in (-1, 1):
                left = asked
                for away in range(1, _GAP + 1):
                    here = left & np.roll(has_ground, towards * away, axis)
                    height, beyond = (np.roll(ground, towards * step, axis) for step in (away, away + 1))
                    ahead = height + away * np.nan_to_num(height - beyond)
                    is_level = np.abs(lowest - np.clip(lowest, *np.sort([height, ahead], axis=0))) <= _LEVEL_M
                    level, jump, left = level | (here & is_level), jump | (here & ~is_level), left & ~here
        return level, jump

    def beside(self, found: Mask) -> Mask:
        """Return which tiles, (rows, cols), lie beside found ones and hold points of class 0 or 1.

        The border of the part lies in them, or it leaves them at its corners.
        """
        return np.asarray((_around(found, 3) > 0) & ~found & np.isin(self.marks, (BLANK, MIXED)))


def _around(marks: Mask, side: int) -> NDArray[np.int32]:
    """Count the marks in the square of ``side`` tiles, an odd number, around each tile."""
    from scipy import ndimage

    counts, line = marks.astype(np.int32), np.ones(side)
    for axis in (0, 1):
        counts = ndimage.correlate1d(counts, line, axis, mode="constant")
    return np.asarray(counts)


def _between(keys: NDArray[np.int64], marks: Mask, south: int, west: int, shape: tuple[int, int]) -> Mask:
    """Return which tiles of a window have marked tiles of the survey on all four sides, in their row and column.

    ``keys`` (n, 2) and ``marks`` (n, 16, 16) are all blocks of the survey.
    """
    block, *inner = np.nonzero(marks)
    tiles = [keys[block, axis] * BLOCK_TILES + inner[axis] for axis in (0, 1)]
    start, between = (south, west), np.ones(shape, np.bool_)
    for axis in (0, 1):
        line, place = tiles[axis] - start[axis], tiles[1 - axis] - start[1 - axis]
        kept = (line >= 0) & (line < shape[axis])
        first, last = np.full(shape[axis], np.iinfo(np.int64).max), np.full(shape[axis], np.iinfo(np.int64).min)
        np.minimum.at(first, line[kept], place[kept])
        np.maximum.at(last, line[kept], place[kept])
        here = np.arange(shape[1 - axis])
        within = (first[:, None] < here) & (here < last[:, None])
        between &= within if axis == 0 else within.T
    return between
