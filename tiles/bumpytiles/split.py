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

import numpy as np
from numpy.typing import NDArray

from bumpytiles._group_kernels import BLOCK_TILES, Coordinates, ScaledTiledPoints, TiledPoints
from bumpytiles._sort_kernels import (
    STRIP,
    MarkedPoints,
    SortScratch,
    count_tiles,
    place_points,
    place_scaled_points,
    sort_tiles,
)
from bumpytiles.grid import Grid
from bumpytiles.grouping import PointPart
from bumpytiles.pack import BlockKey

__all__ = ["TilePoints", "join_tiles", "sort_block"]


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
    flag: NDArray[np.uint8]
    """(points,) the number that was passed with each point; 1: flagged."""


def join_tiles(parts: Sequence[TilePoints]) -> TilePoints:
    """Return the tiles of several parts, of one grid, in one; at least one part. Tiles and points keep their order."""
    whole = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("col", "row", "easting", "northing", "upward", "flag")
    }
    counts = np.concatenate([np.diff(part.starts) for part in parts])
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    return TilePoints(grid=parts[0].grid, starts=starts, **whole)


def sort_block(grid: Grid, key: BlockKey, parts: Sequence[PointPart]) -> TilePoints:
    """Sort the points of a block, given in one or more parts, by tile and hash; drop duplicates."""
    counts = np.zeros(BLOCK_TILES**2 + 1, np.int64)
    for part in parts:
        count_tiles(part.columns["tile"], counts)
    first, most = np.cumsum(counts), int(counts.max())
    n, starts, following = int(first[-1]), np.empty_like(first), first[:-1].copy()
    out, strip = _empty_points(n), Coordinates(*np.empty((3, STRIP)))
    for columns, scaling in parts:
        if scaling is None:
            place_points(TiledPoints(**columns), following, out)
        else:
            place_scaled_points(ScaledTiledPoints(**columns), scaling.numbers(), following, strip, out)
    scratch = SortScratch(
        key=np.empty(most, np.uint64),
        bucket=np.empty((1 << max(1, (most - 1).bit_length())) + 1, np.int32),
        order=np.empty(most, np.int32),
        rank=np.empty(most, np.uint64),
    )
    sort_tiles(first, starts, out, _empty_points(most), scratch)
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


def _empty_points(points: int) -> MarkedPoints:
    return MarkedPoints(np.empty(points), np.empty(points), np.empty(points), np.empty(points, np.uint8))
