"""Sort a stream of points into tiles.

Points arrive in any order, in chunks of any size, from any number of files. They are dropped into blocks of tiles;
when a block is complete its points are put in order *once*: by tile, and inside a tile by a hash of their own
coordinates. That one sort gives three things at a time:

- the order no longer depends on how the points came, so plain floating-point sums over a tile have the same bits for
  any chunk size, any order of files, any number of threads;
- exact duplicates become neighbours, and count once;
- the first k points of a tile are a random sample of it.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpytiles.grid import Grid, TileWindow

__all__ = ["BLOCK_TILES", "TileBuckets", "TilePoints"]

BLOCK_TILES = 16
"""Tiles along a side of a block: one unit of work."""
_TILE_BITS = 8
_MULTIPLIERS = (0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9)


@dataclass(frozen=True, slots=True)
class TilePoints:
    """The points of some tiles. Tile ``t`` owns the points ``starts[t]:starts[t + 1]``, in their canonical order."""

    grid: Grid
    col: NDArray[np.int64]
    """(tiles,) tile column."""
    row: NDArray[np.int64]
    """(tiles,) tile row."""
    starts: NDArray[np.int64]
    """(tiles + 1,) where each tile's points begin."""
    easting: NDArray[np.float64]
    """(points,) m."""
    northing: NDArray[np.float64]
    """(points,) m."""
    upward: NDArray[np.float64]
    """(points,) m."""
    flag: NDArray[np.bool_]
    """(points,) the mark that came with each point."""


@dataclass(frozen=True, slots=True)
class _Points:
    """Columns of points, in any order."""

    easting: NDArray[np.float64]
    northing: NDArray[np.float64]
    upward: NDArray[np.float64]
    flag: NDArray[np.bool_]

    def take(self, index: NDArray[np.int64] | slice) -> "_Points":
        return _Points(self.easting[index], self.northing[index], self.upward[index], self.flag[index])

    @classmethod
    def join(cls, parts: list["_Points"]) -> "_Points":
        return cls(
            np.concatenate([part.easting for part in parts]),
            np.concatenate([part.northing for part in parts]),
            np.concatenate([part.upward for part in parts]),
            np.concatenate([part.flag for part in parts]),
        )


class TileBuckets:
    """Collects points by block; hands out whole blocks with their points sorted into tiles.

    Examples
    --------
    >>> import numpy as np
    >>> buckets = TileBuckets(Grid(tile_size=3.0))
    >>> buckets.add(np.array([0.5, 2.5, 3.0]), np.zeros(3), np.ones(3), np.zeros(3, bool))
    >>> [(int(c), int(n)) for block in buckets.blocks() for c, n in zip(block.col, np.diff(block.starts))]
    [(0, 2), (1, 1)]
    """

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        self._blocks: dict[tuple[int, int], list[_Points]] = {}

    def __len__(self) -> int:
        """Count the blocks that hold points."""
        return len(self._blocks)

    def add(
        self,
        easting: NDArray[np.float64],
        northing: NDArray[np.float64],
        upward: NDArray[np.float64],
        flag: NDArray[np.bool_],
    ) -> None:
        """Take a chunk of points; coordinates (n,) in metres, ``flag`` (n,) travels with them."""
        if len(easting) == 0:
            return
        points = _Points(easting, northing, upward, flag)
        block_col = self.grid.index(easting) // BLOCK_TILES
        block_row = self.grid.index(northing) // BLOCK_TILES
        order = np.lexsort((block_col, block_row))
        points, block_col, block_row = points.take(order), block_col[order], block_row[order]
        changes = np.flatnonzero((np.diff(block_col) != 0) | (np.diff(block_row) != 0)) + 1
        starts = [0, *changes.tolist()]
        for start, stop in zip(starts, [*starts[1:], len(order)], strict=True):
            key = (int(block_row[start]), int(block_col[start]))
            self._blocks.setdefault(key, []).append(points.take(np.arange(start, stop)))

    def merge(self, other: "TileBuckets") -> None:
        """Take all points of another collection over the same grid."""
        for key, parts in other._blocks.items():  # noqa: SLF001 - of its own class
            self._blocks.setdefault(key, []).extend(parts)

    def flagged_share(self) -> float:
        """Share of the tiles holding points in which at least one point is flagged, 0..1 (0 without points)."""
        flagged = total = 0
        for parts in self._blocks.values():
            tile = np.concatenate([self._tile_in_block(part) for part in parts])
            marks = np.concatenate([part.flag for part in parts])
            total += int(np.count_nonzero(np.bincount(tile)))
            flagged += int(np.count_nonzero(np.bincount(tile[marks])))
        return flagged / total if total else 0.0

    def window(self) -> TileWindow:
        """Rectangle of whole blocks around all points (there must be some)."""
        rows, cols = (np.array(axis) for axis in zip(*self._blocks, strict=True))
        around = TileWindow.around(cols, rows)
        return TileWindow(*(side * BLOCK_TILES for side in (around.col, around.row, around.cols, around.rows)))

    def blocks(self) -> Iterator[TilePoints]:
        """Hand out the blocks, south-west first. Each leaves memory when it is handed out."""
        for key in sorted(self._blocks):
            yield self._sorted(key, _Points.join(self._blocks.pop(key)))

    def _tile_in_block(self, points: _Points) -> NDArray[np.int64]:
        col, row = self.grid.index(points.easting), self.grid.index(points.northing)
        return (row % BLOCK_TILES) * BLOCK_TILES + col % BLOCK_TILES

    def _sorted(self, key: tuple[int, int], points: _Points) -> TilePoints:
        tile = self._tile_in_block(points)
        points, tile = _canonical(points, tile)
        present, first = np.unique(tile, return_index=True)
        return TilePoints(
            grid=self.grid,
            col=key[1] * BLOCK_TILES + present % BLOCK_TILES,
            row=key[0] * BLOCK_TILES + present // BLOCK_TILES,
            starts=np.append(first, len(tile)).astype(np.int64),
            easting=points.easting,
            northing=points.northing,
            upward=points.upward,
            flag=points.flag,
        )


def _canonical(points: _Points, tile: NDArray[np.int64]) -> tuple[_Points, NDArray[np.int64]]:
    """Order points by tile and hash; drop exact duplicates (a flagged twin wins)."""
    key = (_hash(points) >> np.uint64(_TILE_BITS)) | (tile.astype(np.uint64) << np.uint64(64 - _TILE_BITS))
    order = np.argsort(key)
    key = key[order]
    same_as_next = key[1:] == key[:-1]
    if same_as_next.any():
        tied = np.zeros(len(key), bool)
        tied[1:] |= same_as_next
        tied[:-1] |= same_as_next
        order[tied] = _break_ties(points, order[tied], key[tied])
    points, tile = points.take(order), tile[order]
    if not same_as_next.any():
        return points, tile
    twin = np.zeros(len(key), bool)
    twin[1:] = same_as_next
    for column in (points.easting, points.northing, points.upward):
        twin[1:] &= column[1:] == column[:-1]
    keep = np.flatnonzero(~twin)
    return points.take(keep), tile[keep]


def _break_ties(points: _Points, index: NDArray[np.int64], key: NDArray[np.uint64]) -> NDArray[np.int64]:
    tied = points.take(index)
    order = np.lexsort((~tied.flag, tied.upward, tied.northing, tied.easting, key))
    ranked: NDArray[np.int64] = index[order]
    return ranked


def _hash(points: _Points) -> NDArray[np.uint64]:
    """64 well-mixed bits of a point's coordinates (multiply and fold each, then Stafford's finaliser)."""
    mixed = np.zeros(len(points.easting), np.uint64)
    for column, multiplier in zip((points.easting, points.northing, points.upward), _MULTIPLIERS, strict=True):
        bits = (column + 0.0).view(np.uint64)  # + 0.0 turns -0.0 into 0.0
        mixed ^= bits
        mixed *= np.uint64(multiplier)
        mixed ^= mixed >> np.uint64(32)
    mixed *= np.uint64(0xD6E8FEB86659FD93)
    mixed ^= mixed >> np.uint64(32)
    return mixed
