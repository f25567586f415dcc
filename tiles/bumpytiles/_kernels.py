"""Compiled loops over points: grouping by block, and the one canonical order inside a block.

The order inside a tile is that of a hash of the coordinates. Hashes are evenly spread, so a tile is cut into as many
buckets as it has points by the leading bits, and only the few points of a bucket are compared.

Nothing here allocates (see ``bumpytiles.native``): scratch arrays come from the caller.
"""

import math
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpytiles.native import helper, kernel

__all__ = [
    "BLOCK_TILES",
    "MAX_CELLS",
    "BlockWindow",
    "GroupScratch",
    "MarkedPoints",
    "SortScratch",
    "TiledPoints",
    "group",
    "rank_points",
    "sort_points",
]

BLOCK_TILES = 16
"""Tiles along a side of a block: one unit of work."""
MAX_CELLS = 1 << 22
"""Blocks in the window around a chunk that `group` counts in a table."""

Floats = Annotated[NDArray[np.float64], 1]
Bytes = Annotated[NDArray[np.uint8], 1]
Flags = Annotated[NDArray[np.bool_], 1]
Indices = Annotated[NDArray[np.int64], 1]
Places = Annotated[NDArray[np.int32], 1]
Keys = Annotated[NDArray[np.uint64], 1]


class MarkedPoints(NamedTuple):
    """Points, (n,) each."""

    easting: Floats
    """m, as the two that follow."""
    northing: Floats
    upward: Floats
    flag: Flags
    """A mark that travels with each point."""


class TiledPoints(NamedTuple):
    """Points that know their tile, (n,) each."""

    easting: Floats
    """m, as the two that follow."""
    northing: Floats
    upward: Floats
    tile: Bytes
    """Tile inside the block, row * 16 + column."""
    flag: Flags


class BlockWindow(NamedTuple):
    """The window of blocks around some points."""

    tile_size: float
    """m."""
    first_col: int
    """South-west block, as the next."""
    first_row: int
    cols: int
    """Width in blocks."""


class GroupScratch(NamedTuple):
    """Scratch of `group`."""

    cell: Places
    """(n,) block of each point in the window."""
    tile: Bytes
    """(n,)."""
    place: Indices
    """(blocks of the window,) where the next point of each block goes."""


class SortScratch(NamedTuple):
    """Scratch of `sort_points`."""

    by_tile: Places
    """(n,) points, tile by tile."""
    tile_key: Keys
    """(n,) their keys."""
    bucket: Indices
    """(at least a tile's points, rounded up to a power of two from 2, + 1,) where each bucket's points begin."""
    order: Places
    """(most points of a tile,) points of a tile in their final order."""
    rank: Keys
    """The same, their keys."""


@helper
def _index(coordinate: float, size: float) -> Any:
    """Return the tile index along one axis; the twin of ``Grid.index``."""
    i = math.floor(coordinate / size)
    if coordinate < i * size:
        i -= 1
    elif coordinate >= (i + 1.0) * size:
        i += 1
    return np.int64(i)


@kernel
def group(points: MarkedPoints, window: BlockWindow, counts: Indices, out: TiledPoints, scratch: GroupScratch) -> None:
    """Put points block by block, in their own order inside a block (a counting sort).

    Parameters
    ----------
    points : MarkedPoints
    window : BlockWindow
        Holds all points.
    counts : (blocks of the window + 1,) int64, zeros
        Filled: where the points of each block begin.
    out : TiledPoints
        Filled.
    scratch : GroupScratch
    """
    n = len(points.easting)
    cell, tile, place = scratch.cell, scratch.tile, scratch.place
    for i in range(n):
        col, row = _index(points.easting[i], window.tile_size), _index(points.northing[i], window.tile_size)
        c = (row // BLOCK_TILES - window.first_row) * window.cols + col // BLOCK_TILES - window.first_col
        cell[i] = c
        tile[i] = (row % BLOCK_TILES) * BLOCK_TILES + col % BLOCK_TILES
        counts[c + 1] += 1
    for c in range(1, len(counts)):
        counts[c] += counts[c - 1]
    for c in range(len(place)):
        place[c] = counts[c]
    for i in range(n):
        c = cell[i]
        p = place[c]
        place[c] = p + 1
        out.easting[p] = points.easting[i]
        out.northing[p] = points.northing[i]
        out.upward[p] = points.upward[i]
        out.tile[p] = tile[i]
        out.flag[p] = points.flag[i]


@helper
def _hash(x: float, y: float, z: float) -> np.uint64:
    """64 well-mixed bits of a point's coordinates (multiply and fold each, then Stafford's finaliser)."""
    mixed = np.uint64(0)
    # + 0.0 turns -0.0 into 0.0
    mixed ^= np.float64(x + 0.0).view(np.uint64)
    mixed *= np.uint64(0x9E3779B97F4A7C15)
    mixed ^= mixed >> np.uint64(32)
    mixed ^= np.float64(y + 0.0).view(np.uint64)
    mixed *= np.uint64(0xC2B2AE3D27D4EB4F)
    mixed ^= mixed >> np.uint64(32)
    mixed ^= np.float64(z + 0.0).view(np.uint64)
    mixed *= np.uint64(0x165667B19E3779F9)
    mixed ^= mixed >> np.uint64(32)
    mixed *= np.uint64(0xD6E8FEB86659FD93)
    mixed ^= mixed >> np.uint64(32)
    return mixed


@kernel
def rank_points(points: TiledPoints, key: Keys, first: Indices) -> None:
    """Hash every point, and count the points of each tile.

    Parameters
    ----------
    points : TiledPoints
    key : (n,) uint64
        Filled: 56 bits.
    first : (257,) int64, zeros
        Filled: the points of each tile ``t`` of the block, at ``t + 1``.
    """
    for i in range(len(points.easting)):
        key[i] = _hash(points.easting[i], points.northing[i], points.upward[i]) >> np.uint64(8)
        first[int(points.tile[i]) + 1] += 1


@helper
def _fill_buckets(begin: int, end: int, scratch: SortScratch) -> None:
    """Put the points ``begin:end`` of ``by_tile`` into ``order`` by the leading bits of their keys."""
    tile_key, bucket = scratch.tile_key, scratch.bucket
    width = 1
    while (1 << width) < end - begin:
        width += 1
    shift = np.uint64(56 - width)
    for b in range((1 << width) + 1):
        bucket[b] = 0
    for j in range(begin, end):
        bucket[int(tile_key[j] >> shift) + 1] += 1
    for b in range(1, (1 << width) + 1):
        bucket[b] += bucket[b - 1]
    for j in range(begin, end):
        b = int(tile_key[j] >> shift)
        scratch.order[bucket[b]] = scratch.by_tile[j]
        scratch.rank[bucket[b]] = tile_key[j]
        bucket[b] += 1


@helper
def _comes_later(points: TiledPoints, o: int, i: int) -> Any:
    """Whether point o goes behind point i, where their keys are equal."""
    if points.easting[o] != points.easting[i]:
        return points.easting[o] > points.easting[i]
    if points.northing[o] != points.northing[i]:
        return points.northing[o] > points.northing[i]
    if points.upward[o] != points.upward[i]:
        return points.upward[o] > points.upward[i]
    return points.flag[i] and not points.flag[o]


@helper
def _insert_by_key(points: TiledPoints, count: int, order: Places, rank: Keys) -> None:
    """Sort the first points of ``order`` by insertion: the buckets have nearly sorted them."""
    for j in range(1, count):
        i, k = order[j], rank[j]
        m = j
        while m > 0:
            o = order[m - 1]
            if rank[m - 1] < k or (rank[m - 1] == k and not _comes_later(points, o, i)):
                break
            order[m] = o
            rank[m] = rank[m - 1]
            m -= 1
        order[m] = i
        rank[m] = k


@helper
def _append_single(points: TiledPoints, order: Places, begin: int, out: MarkedPoints) -> int:
    """Append points to the ``begin`` that ``out`` holds, but for exact duplicates; returns how many there are now."""
    kept = begin
    for j in range(len(order)):
        i = order[j]
        if (
            kept > begin
            and out.easting[kept - 1] == points.easting[i]
            and out.northing[kept - 1] == points.northing[i]
            and out.upward[kept - 1] == points.upward[i]
        ):
            continue
        out.easting[kept] = points.easting[i]
        out.northing[kept] = points.northing[i]
        out.upward[kept] = points.upward[i]
        out.flag[kept] = points.flag[i]
        kept += 1
    return kept


@kernel
def sort_points(
    points: TiledPoints, key: Keys, first: Indices, starts: Indices, out: MarkedPoints, scratch: SortScratch
) -> None:
    """Put points tile by tile, inside a tile by ``key`` (then by coordinates); drop exact duplicates.

    Parameters
    ----------
    points : TiledPoints
    key : (n,) uint64
        56 bits.
    first : (257,) int64
        Where each tile's points begin when they are put tile by tile.
    starts : (257,) int64
        Filled: where each tile of the block begins in the output; last, the number of points that stay.
    out : MarkedPoints
        Filled up to that number. Of twins, a flagged one stays.
    scratch : SortScratch
    """
    tiles = BLOCK_TILES * BLOCK_TILES
    for t in range(tiles):
        starts[t] = first[t]
    for i in range(len(points.easting)):
        p = starts[int(points.tile[i])]
        scratch.by_tile[p] = i
        scratch.tile_key[p] = key[i]
        starts[int(points.tile[i])] = p + 1
    kept = 0
    for t in range(tiles):
        starts[t] = kept
        count = first[t + 1] - first[t]
        if count > 0:
            _fill_buckets(first[t], first[t + 1], scratch)
            _insert_by_key(points, count, scratch.order, scratch.rank)
            kept = _append_single(points, scratch.order[:count], kept, out)
    starts[tiles] = kept
