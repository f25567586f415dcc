"""Sort a stream of points into tiles.

Points arrive in any order, in chunks of any size, from any number of files. Each chunk is grouped by blocks of tiles;
when a block is complete its points are sorted *once*: by tile, and inside a tile by a hash of their coordinates. This
order has three advantages:

- it does not depend on the order of arrival, so floating-point sums over a tile have the same bits for any chunk size,
  order of files and number of threads;
- exact duplicates become neighbours, and are counted once;
- the first k points of a tile are a random sample of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpytiles._kernels import (
    BLOCK_TILES,
    MAX_CELLS,
    BlockWindow,
    GroupScratch,
    MarkedPoints,
    SortScratch,
    TiledPoints,
    group,
    rank_points,
    sort_points,
)
from bumpytiles.grid import Grid
from bumpytiles.pack import BlockKey, Column

__all__ = [
    "BLOCK_TILES",
    "POINT_COLUMNS",
    "GroupedPoints",
    "PointColumns",
    "TilePoints",
    "group_points",
    "join_tiles",
    "sort_block",
]

POINT_COLUMNS = (
    Column("easting", "<f8"),
    Column("northing", "<f8"),
    Column("upward", "<f8"),
    Column("tile", "|u1"),
    Column("flag", "|b1"),
)
"""A waiting point: 26 bytes."""

PointColumns = dict[str, NDArray[Any]]
"""Columns of `POINT_COLUMNS`, (n,) each."""


@dataclass(frozen=True, slots=True)
class TilePoints:
    """The points of some tiles. Tile ``t`` owns the points ``starts[t]:starts[t + 1]``, in their sorted order."""

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
    """(points,) the mark that was passed with each point."""


def join_tiles(parts: Sequence[TilePoints]) -> TilePoints:
    """Return the tiles of several parts, of one grid, in one; at least one part. Tiles and points keep their order."""
    whole = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("col", "row", "easting", "northing", "upward", "flag")
    }
    counts = np.concatenate([np.diff(part.starts) for part in parts])
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    return TilePoints(grid=parts[0].grid, starts=starts, **whole)


@dataclass(frozen=True, slots=True)
class GroupedPoints:
    """A chunk of points, grouped by block."""

    keys: list[BlockKey]
    """Blocks with points in the chunk, south-west first."""
    starts: NDArray[np.int64]
    """(blocks + 1,) where each block's points begin."""
    points: PointColumns
    """(n,) columns."""

    def block(self, place: int) -> PointColumns:
        """Return views of the points of the block ``keys[place]``."""
        span = slice(int(self.starts[place]), int(self.starts[place + 1]))
        return {name: array[span] for name, array in self.points.items()}

    def __len__(self) -> int:
        """Return the number of points."""
        return int(self.starts[-1])


def group_points(
    grid: Grid,
    easting: NDArray[np.float64],
    northing: NDArray[np.float64],
    upward: NDArray[np.float64],
    flag: NDArray[np.bool_],
) -> GroupedPoints:
    """Group a chunk of points by block; coordinates (n,) in metres, ``flag`` (n,) belongs to them."""
    n = len(easting)
    points: PointColumns = {column.name: np.empty(n, column.dtype) for column in POINT_COLUMNS}
    if n == 0:
        return GroupedPoints([], np.zeros(1, np.int64), points)
    corners = [grid.index(np.array([axis.min(), axis.max()])) // BLOCK_TILES for axis in (northing, easting)]
    (south, north), (west, east) = (tuple(int(side) for side in pair) for pair in corners)
    rows, cols = north - south + 1, east - west + 1
    if rows * cols > MAX_CELLS:
        return _group_scattered(grid, easting, northing, upward, flag)
    counts = np.zeros(rows * cols + 1, np.int64)
    x, y, z = (np.ascontiguousarray(column, np.float64) for column in (easting, northing, upward))
    given = MarkedPoints(x, y, z, np.ascontiguousarray(flag, np.bool_))
    window = BlockWindow(grid.tile_size, west, south, cols)
    scratch = GroupScratch(np.empty(n, np.int32), np.empty(n, np.uint8), np.empty(rows * cols, np.int64))
    group(given, window, counts, TiledPoints(**points), scratch)
    present = np.flatnonzero(np.diff(counts))
    keys = [(south + cell // cols, west + cell % cols) for cell in present.tolist()]
    return GroupedPoints(keys, np.append(counts[present], n), points)


def _group_scattered(grid: Grid, *columns: NDArray[Any]) -> GroupedPoints:
    """Group points that are far apart: a table of all blocks between them would be too large."""
    easting, northing, _, _ = columns
    col, row = grid.index(easting), grid.index(northing)
    order = np.lexsort((col // BLOCK_TILES, row // BLOCK_TILES))
    block = np.stack([row // BLOCK_TILES, col // BLOCK_TILES], axis=1)[order]
    changes = np.flatnonzero((np.diff(block, axis=0) != 0).any(axis=1)) + 1
    starts = np.concatenate(([0], changes, [len(order)])).astype(np.int64)
    tile = ((row % BLOCK_TILES) * BLOCK_TILES + col % BLOCK_TILES).astype(np.uint8)
    names = [column.name for column in POINT_COLUMNS]
    points = {name: array[order] for name, array in zip(names, (*columns[:3], tile, columns[3]), strict=True)}
    return GroupedPoints([(int(r), int(c)) for r, c in block[starts[:-1]]], starts, points)


def sort_block(grid: Grid, key: BlockKey, parts: Sequence[PointColumns]) -> TilePoints:
    """Sort the points of a block, given in one or more parts, by tile and hash; drop duplicates."""
    names = [column.name for column in POINT_COLUMNS]
    joined = parts[0] if len(parts) == 1 else {n: np.concatenate([part[n] for part in parts]) for n in names}
    points = TiledPoints(**{name: joined[name] for name in names})
    n = len(points.easting)
    rank, counts = np.empty(n, np.uint64), np.zeros(BLOCK_TILES**2 + 1, np.int64)
    rank_points(points, rank, counts)
    most = int(counts.max())
    starts = np.empty_like(counts)
    out = MarkedPoints(np.empty(n), np.empty(n), np.empty(n), np.empty(n, np.bool_))
    scratch = SortScratch(
        by_tile=np.empty(n, np.int32),
        tile_key=np.empty(n, np.uint64),
        bucket=np.empty((1 << max(1, (most - 1).bit_length())) + 1, np.int64),
        order=np.empty(most, np.int32),
        rank=np.empty(most, np.uint64),
    )
    sort_points(points, rank, np.cumsum(counts), starts, out, scratch)
    kept = int(starts[-1])
    present = np.flatnonzero(np.diff(starts))
    return TilePoints(
        grid=grid,
        col=key[1] * BLOCK_TILES + present % BLOCK_TILES,
        row=key[0] * BLOCK_TILES + present // BLOCK_TILES,
        starts=np.append(starts[present], kept),
        easting=out.easting[:kept],
        northing=out.northing[:kept],
        upward=out.upward[:kept],
        flag=out.flag[:kept],
    )
