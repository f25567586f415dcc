"""Compiled loops over points: grouping by block, and the one canonical order inside a block."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["BLOCK_TILES", "MAX_CELLS", "group", "sort_points"]

BLOCK_TILES = 16
"""Tiles along a side of a block: one unit of work."""
MAX_CELLS = 1 << 22
"""Blocks in the window around a chunk that `group` counts in a table."""

Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]


def _compiled(function: Callable[..., Any]) -> Any:
    """Compile once and keep the result beside the module or in the user's cache; without either, in every run."""
    try:
        return njit(cache=True, nogil=True)(function)
    except RuntimeError:  # nowhere to write: a read-only installation and no home
        return njit(nogil=True)(function)


@_compiled
def _index(coordinate: float, size: float) -> Any:
    """Return the tile index along one axis; the twin of ``Grid.index``."""
    i = math.floor(coordinate / size)
    if coordinate < i * size:
        i -= 1
    elif coordinate >= (i + 1.0) * size:
        i += 1
    return np.int64(i)


@_compiled
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
    """
    n = len(easting)
    cell = np.empty(n, np.int32)
    tile = np.empty(n, np.uint8)
    for i in range(n):
        col, row = _index(easting[i], size), _index(northing[i], size)
        c = (row // BLOCK_TILES - first_row) * cols + col // BLOCK_TILES - first_col
        cell[i] = c
        tile[i] = (row % BLOCK_TILES) * BLOCK_TILES + col % BLOCK_TILES
        counts[c + 1] += 1
    for c in range(1, len(counts)):
        counts[c] += counts[c - 1]
    place = counts[:-1].copy()
    for i in range(n):
        c = cell[i]
        p = place[c]
        place[c] = p + 1
        out_easting[p] = easting[i]
        out_northing[p] = northing[i]
        out_upward[p] = upward[i]
        out_tile[p] = tile[i]
        out_flag[p] = flag[i]


@_compiled
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


@_compiled
def hashes(easting: Floats, northing: Floats, upward: Floats, out: NDArray[np.uint64]) -> None:
    """Hash every point into ``out``, (n,) uint64."""
    for i in range(len(easting)):
        out[i] = _hash(easting[i], northing[i], upward[i]) >> np.uint64(8)


@_compiled
def sort_points(
    easting: Floats,
    northing: Floats,
    upward: Floats,
    tile: Bytes,
    flag: Flags,
    key: NDArray[np.uint64],
    starts: Indices,
    out_easting: Floats,
    out_northing: Floats,
    out_upward: Floats,
    out_flag: Flags,
) -> Any:
    """Put points tile by tile, inside a tile by ``key`` (then by coordinates); drop exact duplicates.

    Keys are evenly spread, so each tile is cut into as many buckets as it has points by their leading bits, and only
    the few points of a bucket are compared.

    Parameters
    ----------
    easting, northing, upward, tile, flag, key : (n,)
        Points; ``key`` holds 56 bits.
    starts : (257,) int64
        Filled: where each tile of the block begins in the output.
    out_easting, out_northing, out_upward, out_flag : (n,)
        Filled up to the number of points that is returned. Of twins, a flagged one stays.
    """
    n, tiles = len(easting), BLOCK_TILES * BLOCK_TILES
    first = np.zeros(tiles + 1, np.int64)
    for i in range(n):
        first[int(tile[i]) + 1] += 1
    most = np.int64(0)
    for t in range(tiles):
        most = max(most, first[t + 1])
        first[t + 1] += first[t]
    place = first[:-1].copy()
    by_tile = np.empty(n, np.int32)
    tile_key = np.empty(n, np.uint64)
    for i in range(n):
        t = int(tile[i])
        by_tile[place[t]] = i
        tile_key[place[t]] = key[i]
        place[t] += 1
    bits = 1
    while (1 << bits) < most:
        bits += 1
    bucket = np.empty((1 << bits) + 1, np.int64)
    order = np.empty(most, np.int32)
    rank = np.empty(most, np.uint64)
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
        bucket[: (1 << width) + 1] = 0
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
    return kept
