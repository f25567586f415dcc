"""Compiled loops over points: grouping by block, and the one canonical order inside a block.

Nothing here allocates (see ``bumpytiles.native``): scratch arrays come from the caller.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpytiles.native import entry, inner

__all__ = ["BLOCK_TILES", "MAX_CELLS", "group", "rank_points", "sort_points"]

BLOCK_TILES = 16
"""Tiles along a side of a block: one unit of work."""
MAX_CELLS = 1 << 22
"""Blocks in the window around a chunk that `group` counts in a table."""

Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]
Places = NDArray[np.int32]
Keys = NDArray[np.uint64]


@inner
def _index(coordinate: float, size: float) -> Any:
    """Return the tile index along one axis; the twin of ``Grid.index``."""
    i = math.floor(coordinate / size)
    if coordinate < i * size:
        i -= 1
    elif coordinate >= (i + 1.0) * size:
        i += 1
    return np.int64(i)


@entry("f8:1 f8:1 f8:1 ?:1 f8 i8 i8 i8 i8:1 f8:1 f8:1 f8:1 u1:1 ?:1 i4:1 u1:1 i8:1")
def group(
    easting: Floats,
    northing: Floats,
    upward: Floats,
    flag: Flags,
    size: float,
    first_col: int,
    first_row: int,
    cols: int,
    counts: Indices,
    out_easting: Floats,
    out_northing: Floats,
    out_upward: Floats,
    out_tile: Bytes,
    out_flag: Flags,
    cell: Places,
    tile: Bytes,
    place: Indices,
) -> None:
    """Put points block by block, in their own order inside a block (a counting sort).

    Parameters
    ----------
    easting, northing, upward : (n,) float64
        m.
    flag : (n,) bool
    size : float
        Side of a tile, m.
    first_col, first_row, cols : int
        South-west block of the window around the points, and its width in blocks.
    counts : (blocks of the window + 1,) int64, zeros
        Filled: where the points of each block begin.
    out_easting, out_northing, out_upward, out_tile, out_flag : (n,)
        Filled; ``out_tile`` is the tile inside the block, row * 16 + column.
    cell : (n,) int32, tile : (n,) uint8, place : (blocks of the window,) int64
        Scratch.
    """
    n = len(easting)
    for i in range(n):
        col, row = _index(easting[i], size), _index(northing[i], size)
        c = (row // BLOCK_TILES - first_row) * cols + col // BLOCK_TILES - first_col
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
        out_easting[p] = easting[i]
        out_northing[p] = northing[i]
        out_upward[p] = upward[i]
        out_tile[p] = tile[i]
        out_flag[p] = flag[i]


@inner
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


@entry("f8:1 f8:1 f8:1 u1:1 u8:1 i8:1")
def rank_points(easting: Floats, northing: Floats, upward: Floats, tile: Bytes, key: Keys, first: Indices) -> None:
    """Hash every point, and count the points of each tile.

    Parameters
    ----------
    easting, northing, upward, tile : (n,)
        Points.
    key : (n,) uint64
        Filled: 56 bits.
    first : (257,) int64, zeros
        Filled: the points of each tile ``t`` of the block, at ``t + 1``.
    """
    for i in range(len(easting)):
        key[i] = _hash(easting[i], northing[i], upward[i]) >> np.uint64(8)
        first[int(tile[i]) + 1] += 1


@entry("f8:1 f8:1 f8:1 u1:1 ?:1 u8:1 i8:1 i8:1 f8:1 f8:1 f8:1 ?:1 i4:1 u8:1 i8:1 i4:1 u8:1")
def sort_points(
    easting: Floats,
    northing: Floats,
    upward: Floats,
    tile: Bytes,
    flag: Flags,
    key: Keys,
    first: Indices,
    starts: Indices,
    out_easting: Floats,
    out_northing: Floats,
    out_upward: Floats,
    out_flag: Flags,
    by_tile: Places,
    tile_key: Keys,
    bucket: Indices,
    order: Places,
    rank: Keys,
) -> None:
    """Put points tile by tile, inside a tile by ``key`` (then by coordinates); drop exact duplicates.

    Keys are evenly spread, so each tile is cut into as many buckets as it has points by their leading bits, and only
    the few points of a bucket are compared.

    Parameters
    ----------
    easting, northing, upward, tile, flag, key : (n,)
        Points; ``key`` holds 56 bits.
    first : (257,) int64
        Where each tile's points begin when they are put tile by tile.
    starts : (257,) int64
        Filled: where each tile of the block begins in the output; last, the number of points that stay.
    out_easting, out_northing, out_upward, out_flag : (n,)
        Filled up to that number. Of twins, a flagged one stays.
    by_tile : (n,) int32, tile_key : (n,) uint64
        Scratch, as are all that follow.
    bucket : (at least a tile's points, rounded up to a power of two from 2, + 1,) int64
    order : (most points of a tile,) int32, rank : (the same,) uint64
    """
    n, tiles = len(easting), BLOCK_TILES * BLOCK_TILES
    for t in range(tiles):
        starts[t] = first[t]
    for i in range(n):
        p = starts[int(tile[i])]
        by_tile[p] = i
        tile_key[p] = key[i]
        starts[int(tile[i])] = p + 1
    kept = np.int64(0)
    for t in range(tiles):
        starts[t] = kept
        count = first[t + 1] - first[t]
        if count == 0:
            continue
        width = 1
        while (1 << width) < count:
            width += 1
        shift = np.uint64(56 - width)
        for b in range((1 << width) + 1):
            bucket[b] = 0
        for j in range(first[t], first[t + 1]):
            bucket[int(tile_key[j] >> shift) + 1] += 1
        for b in range(1, (1 << width) + 1):
            bucket[b] += bucket[b - 1]
        for j in range(first[t], first[t + 1]):
            b = int(tile_key[j] >> shift)
            order[bucket[b]] = by_tile[j]
            rank[bucket[b]] = tile_key[j]
            bucket[b] += 1
        for j in range(1, count):
            i, k = order[j], rank[j]
            m = j
            while m > 0:
                o = order[m - 1]
                if rank[m - 1] < k:
                    break
                if rank[m - 1] == k:
                    if easting[o] != easting[i]:
                        later = easting[o] > easting[i]
                    elif northing[o] != northing[i]:
                        later = northing[o] > northing[i]
                    elif upward[o] != upward[i]:
                        later = upward[o] > upward[i]
                    else:
                        later = flag[i] and not flag[o]
                    if not later:
                        break
                order[m] = o
                rank[m] = rank[m - 1]
                m -= 1
            order[m] = i
            rank[m] = k
        begin = kept
        for j in range(count):
            i = order[j]
            if (
                kept > begin
                and out_easting[kept - 1] == easting[i]
                and out_northing[kept - 1] == northing[i]
                and out_upward[kept - 1] == upward[i]
            ):
                continue
            out_easting[kept] = easting[i]
            out_northing[kept] = northing[i]
            out_upward[kept] = upward[i]
            out_flag[kept] = flag[i]
            kept += 1
    starts[tiles] = kept
