"""Compiled loops that group points by block of tiles, and sort those of a block.

They are sorted by tile, and inside a tile into one canonical order. The points are put tile by tile first, and those of
a tile are sorted while they are in the processor's cache. Their order is that of a hash of where they are inside the
tile: a tile that is moved by whole tiles, raised, turned by 90 degrees or mirrored keeps its order. Hashes are evenly
spread, so a tile is cut into as many buckets as it has points by the leading bits, and only the few points of a bucket
are compared.

Nothing here allocates (see ``bumpytiles.native``): scratch arrays come from the caller.
"""

import math
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpytiles.native import helper, kernel

BLOCK_TILES = 16
"""Tiles along a side of a block: one unit of work."""
MAX_CELLS = 1 << 22
"""Blocks in the window around a chunk that are counted in a table."""

Floats = Annotated[NDArray[np.float64], 1]
Words = Annotated[NDArray[np.int32], 1]
Bytes = Annotated[NDArray[np.uint8], 1]
Borders = Annotated[NDArray[np.int64], 1]
Indices = Annotated[NDArray[np.int64], 1]
Places = Annotated[NDArray[np.int32], 1]
Colours = Annotated[NDArray[np.uint32], 1]


class Coordinates(NamedTuple):
    """Coordinates, (n,) each."""

    easting: Floats
    """m, as the two that follow."""
    northing: Floats
    upward: Floats


class ScaledCoordinates(NamedTuple):
    """Coordinates as integers of the file's own grid, see `Scaling`; (n,) each."""

    easting: Words
    northing: Words
    upward: Words


class TiledPoints(NamedTuple):
    """Points that know their tile, (n,) each."""

    easting: Floats
    """m, as the two that follow."""
    northing: Floats
    upward: Floats
    tile: Bytes
    """Tile inside the block, row * 16 + column."""
    flag: Bytes


class ScaledTiledPoints(NamedTuple):
    """The same, with coordinates as integers of the file's own grid."""

    easting: Words
    northing: Words
    upward: Words
    tile: Bytes
    flag: Bytes


class BlockWindow(NamedTuple):
    """The window of blocks around some points."""

    tile_size: float
    """m."""
    first_col: int
    """South-west block, as the next."""
    first_row: int
    cols: int
    """Width in blocks."""


class TileBorders(NamedTuple):
    """Where tiles begin on the grid of a file."""

    easting: Borders
    """(columns + 1,) the lowest integer in each column of tiles, and in the one behind the last."""
    northing: Borders
    """(rows + 1,) the same for rows."""
    tiles_per_easting: float
    """About how many columns an integer is wide."""
    tiles_per_northing: float
    first_col: int
    """Of the borders."""
    first_row: int


class GroupScratch(NamedTuple):
    """Where points go, filled by `count_points`."""

    cell: Places
    """(n,) block of each point in the window."""
    tile: Bytes
    """(n,)."""


DECIMALS = 8
"""Decimals that coordinates are rounded to, in the file's unit."""
ROUND = 10.0**DECIMALS


@helper
def coordinate(number: int, scaling: Floats, axis: int) -> float:
    """Return a coordinate in metres from the integer of an axis, see `Scaling`: the same bits as of its method."""
    there = np.rint((number * scaling[axis] + scaling[3 + axis]) * ROUND) / ROUND
    return float(there * scaling[6 + axis])


@helper
def coordinates(
    numbers: Words,
    scaling: Floats,
    axis: int,
    out: Floats,
) -> None:
    """Do the same for many integers of an axis."""
    scale, offset, unit = scaling[axis], scaling[3 + axis], scaling[6 + axis]
    for i in range(len(numbers)):
        out[i] = np.rint((numbers[i] * scale + offset) * ROUND) / ROUND * unit


PER_METRE = 1e8
"""Steps a metre in which tile and pixel are told: finer than the grids of files, but coarser than the rounding of
decimal numbers, feet and borders to float64, which is 3e-9 m at 10,000 km."""
BELOW = -0.5 / PER_METRE
"""A coordinate that lies so far below a border, m, or less, is on it."""


@helper
def tile_index(coordinate: float, size: float) -> Any:
    """Return the tile index along one axis; the twin of ``Grid.index``."""
    i = math.floor(coordinate / size)
    if coordinate - i * size < BELOW:
        i -= 1
    elif coordinate - (i + 1.0) * size >= BELOW:
        i += 1
    return np.int64(i)


@helper
def pixels_from(first: Any, coordinate: Any, size: float, pixels: int) -> Any:
    """Return how many pixels a coordinate lies from the border ``first`` of its tile; the whole ones are the index.

    By whole steps: on the border of two pixels there is no rounding.
    """
    return pixels * np.rint((coordinate - first) * PER_METRE) / np.rint(size * PER_METRE)


@helper
def _count(i: int, easting: float, northing: float, window: BlockWindow, counts: Indices, out: GroupScratch) -> None:
    """Note block and tile of a point."""
    col, row = tile_index(easting, window.tile_size), tile_index(northing, window.tile_size)
    c = (row // BLOCK_TILES - window.first_row) * window.cols + col // BLOCK_TILES - window.first_col
    out.cell[i] = c
    out.tile[i] = (row % BLOCK_TILES) * BLOCK_TILES + col % BLOCK_TILES
    counts[c + 1] += 1


@kernel
def count_points(points: Coordinates, window: BlockWindow, counts: Indices, out: GroupScratch) -> None:
    """Find block and tile of each point; count the points of each block ``c`` of the window in ``counts[c + 1]``."""
    for i in range(len(points.easting)):
        _count(i, points.easting[i], points.northing[i], window, counts, out)


@helper
def _interval_of(number: Any, borders: Borders, per_tile: float) -> Any:
    """Return which interval between ``borders`` holds an integer; an interval is about ``1 / per_tile`` wide."""
    i = min(max(int((number - borders[0]) * per_tile), 0), len(borders) - 2)
    while number < borders[i]:
        i -= 1
    while number >= borders[i + 1]:
        i += 1
    return i


@kernel
def count_scaled_points(
    points: ScaledCoordinates, borders: TileBorders, window: BlockWindow, counts: Indices, out: GroupScratch
) -> None:
    """Do the same for points of a file's own grid: by the borders of the tiles, without their coordinates."""
    west = borders.first_col - window.first_col * BLOCK_TILES
    south = borders.first_row - window.first_row * BLOCK_TILES
    easting, northing = borders.easting, borders.northing
    x_first, x_end, y_first, y_end = 0, 0, 0, 0  # of the tile of the point before
    cell, tile, run = 0, 0, 0
    for i in range(len(points.easting)):
        x, y = np.int64(points.easting[i]), np.int64(points.northing[i])
        if not (x_first <= x < x_end and y_first <= y < y_end):  # neighbours in a file are neighbours on the ground
            counts[cell + 1] += run
            col = _interval_of(x, easting, borders.tiles_per_easting)
            row = _interval_of(y, northing, borders.tiles_per_northing)
            x_first, x_end, y_first, y_end = easting[col], easting[col + 1], northing[row], northing[row + 1]
            col, row, run = col + west, row + south, 0
            cell = (row // BLOCK_TILES) * window.cols + col // BLOCK_TILES
            tile = (row % BLOCK_TILES) * BLOCK_TILES + col % BLOCK_TILES
        run += 1
        out.cell[i] = cell
        out.tile[i] = tile
    counts[cell + 1] += run


@helper
def _scatter(points: Any, flag: Bytes, found: GroupScratch, place: Indices, out: Any) -> None:
    """Put points block by block, in their own order inside a block."""
    for i in range(len(flag)):
        c = found.cell[i]
        p = place[c]
        place[c] = p + 1
        out.easting[p] = points.easting[i]
        out.northing[p] = points.northing[i]
        out.upward[p] = points.upward[i]
        out.tile[p] = found.tile[i]
        out.flag[p] = flag[i]


@kernel
def scatter_points(points: Coordinates, flag: Bytes, found: GroupScratch, place: Indices, out: TiledPoints) -> None:
    """Put points block by block; ``place`` is where the next point of each block of the window goes, and moves on."""
    _scatter(points, flag, found, place, out)


@kernel
def scatter_scaled_points(
    points: ScaledCoordinates, flag: Bytes, found: GroupScratch, place: Indices, out: ScaledTiledPoints
) -> None:
    """Do the same with points of a file's own grid."""
    _scatter(points, flag, found, place, out)


@kernel
def scatter_colours(colour: Colours, cell: Places, place: Indices, out: Colours) -> None:
    """Put the colours of points block by block, as the other kernels put the points."""
    for i in range(len(colour)):
        c = cell[i]
        out[place[c]] = colour[i]
        place[c] += 1


STRIP = 512
"""Points that are turned into metres at once."""
_KEY_BITS = 56
"""Bits of the hash of a point by which the points of a tile are ordered."""

Keys = Annotated[NDArray[np.uint64], 1]


class MarkedPoints(NamedTuple):
    """Points, (n,) each."""

    easting: Floats
    """m, as the two that follow."""
    northing: Floats
    upward: Floats
    flag: Bytes
    """A number that travels with each point; 1: flagged."""


class SortScratch(NamedTuple):
    """Scratch of `sort_tiles`; ``most`` is the largest number of points of a tile."""

    key: Keys
    """(most,) keys of the points of a tile."""
    bucket: Places
    """(``most`` rounded up to a power of two, at least 2, + 1,) where each bucket's points begin."""
    order: Places
    """(most,) points of a tile in their final order."""
    rank: Keys
    """The same, their keys."""


@kernel
def count_tiles(tile: Bytes, first: Indices) -> None:
    """Count the points of each tile ``t`` of a block in ``first[t + 1]``; ``first`` is (257,) int64."""
    for i in range(len(tile)):
        first[int(tile[i]) + 1] += 1


@helper
def _place(points: MarkedPoints, tile: Bytes, following: Indices, out: MarkedPoints) -> None:
    t = int(tile[0])
    p = following[t]
    for i in range(len(tile)):
        if tile[i] != t:  # neighbours in a file are neighbours on the ground
            following[t] = p
            t = int(tile[i])
            p = following[t]
        out.easting[p] = points.easting[i]
        out.northing[p] = points.northing[i]
        out.upward[p] = points.upward[i]
        out.flag[p] = points.flag[i]
        p += 1
    following[t] = p


class BlockPhoto(NamedTuple):
    """The picture of a block that points are painted on."""

    corner: Indices
    """(2,) column and row of its south-west tile."""
    tile_size: float
    """m."""
    pixels: int
    """Along the side of a tile."""
    height: Floats
    """(256 * pixels^2,) height of the point that each pixel shows, m; -inf: none."""
    colour: Colours
    """The same, its colour; 0: none."""


@helper
def _paint(points: MarkedPoints, tile: Bytes, colour: Colours, photo: BlockPhoto) -> None:
    size, pixels = photo.tile_size, photo.pixels
    last = np.int64(pixels - 1)
    for i in range(len(tile)):
        if colour[i] == 0:
            continue
        t = np.int64(tile[i])
        west = (photo.corner[0] + t % BLOCK_TILES) * size
        south = (photo.corner[1] + t // BLOCK_TILES) * size
        c = min(last, np.int64(pixels_from(west, points.easting[i], size, pixels)))
        r = min(last, np.int64(pixels_from(south, points.northing[i], size, pixels)))
        p = (t * pixels + last - r) * pixels + c
        # Of two at one height the larger number counts: the order of the points does not matter.
        up = points.upward[i]
        if up > photo.height[p] or (up == photo.height[p] and colour[i] > photo.colour[p]):
            photo.height[p], photo.colour[p] = up, colour[i]


@kernel
def place_points(
    points: TiledPoints, colour: Colours, following: Indices, out: MarkedPoints, photo: BlockPhoto
) -> None:
    """Put points tile by tile; ``following`` (256,) is where the next point of each tile goes, and moves on.

    Points with ``colour`` (n,), which is empty for others, are painted: a pixel shows the highest of them.
    """
    if len(points.tile) > 0:
        marked = MarkedPoints(points.easting, points.northing, points.upward, points.flag)
        _place(marked, points.tile, following, out)
        if len(colour) > 0:
            _paint(marked, points.tile, colour, photo)


@kernel
def place_scaled_points(
    points: ScaledTiledPoints,
    scaling: Floats,
    colour: Colours,
    following: Indices,
    strip: Coordinates,
    out: MarkedPoints,
    photo: BlockPhoto,
) -> None:
    """Do the same with points of a file's own grid, see `bumpytiles.Scaling.numbers`.

    ``strip`` is scratch, (``STRIP``,) each.
    """
    for first in range(0, len(points.tile), STRIP):
        last = min(first + STRIP, len(points.tile))
        n = last - first
        there = MarkedPoints(strip.easting[:n], strip.northing[:n], strip.upward[:n], points.flag[first:last])
        coordinates(points.easting[first:last], scaling, 0, there.easting)
        coordinates(points.northing[first:last], scaling, 1, there.northing)
        coordinates(points.upward[first:last], scaling, 2, there.upward)
        _place(there, points.tile[first:last], following, out)
        if len(colour) > 0:
            _paint(there, points.tile[first:last], colour[first:last], photo)


@helper
def hash_point(x: float, y: float, z: float) -> np.uint64:
    """Return 64 well-mixed bits of three numbers (multiply and fold each, then Stafford's finaliser)."""
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


@helper
def _fill_buckets(count: int, scratch: SortScratch) -> None:
    """Put the first points of the tile into ``order`` by the leading bits of their keys."""
    key, bucket = scratch.key, scratch.bucket
    width = 1
    while (1 << width) < count:
        width += 1
    shift = np.uint64(_KEY_BITS - width)
    for b in range((1 << width) + 1):
        bucket[b] = 0
    for j in range(count):
        bucket[int(key[j] >> shift) + 1] += 1
    for b in range(1, (1 << width) + 1):
        bucket[b] += bucket[b - 1]
    for j in range(count):
        b = int(key[j] >> shift)
        scratch.order[bucket[b]] = j
        scratch.rank[bucket[b]] = key[j]
        bucket[b] += 1


@helper
def _comes_later(points: MarkedPoints, o: int, i: int) -> Any:
    """Return whether point o goes behind point i, where their keys are equal."""
    if points.easting[o] != points.easting[i]:
        return points.easting[o] > points.easting[i]
    if points.northing[o] != points.northing[i]:
        return points.northing[o] > points.northing[i]
    if points.upward[o] != points.upward[i]:
        return points.upward[o] > points.upward[i]
    return (int(points.flag[o]) + 255) & 255 > (int(points.flag[i]) + 255) & 255


@helper
def _insert_by_key(points: MarkedPoints, count: int, order: Places, rank: Keys) -> None:
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
def _append_single(points: MarkedPoints, count: int, scratch: SortScratch, begin: int, out: MarkedPoints) -> int:
    """Append points to the ``begin`` that ``out`` holds, but for exact duplicates; returns how many there are now."""
    order, rank, kept = scratch.order, scratch.rank, begin
    for j in range(count):
        i = order[j]
        if (
            j > 0
            and rank[j] == rank[j - 1]
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


_PER_METRE = 1e6
"""Steps of the offsets that are hashed: coarser than the rounding of coordinates of any size."""


@helper
def _from_middle(coordinate: float, first: float, size: float) -> float:
    """Return the distance of a coordinate from the middle of its tile, which begins at ``first``, in steps."""
    return float(abs(np.rint((coordinate - first) * _PER_METRE) - 0.5 * size * _PER_METRE))


@helper
def _fill_keys(count: int, west: float, south: float, size: float, tile: MarkedPoints, key: Keys) -> None:
    """Hash where the points are: how far from the middle of the tile, to either side, and above its lowest point."""
    low = tile.upward[0]
    for j in range(1, count):
        low = min(low, tile.upward[j])
    for j in range(count):
        x, y = _from_middle(tile.easting[j], west, size), _from_middle(tile.northing[j], south, size)
        z = np.rint((tile.upward[j] - low) * _PER_METRE)
        key[j] = hash_point(min(x, y), max(x, y), z) >> np.uint64(64 - _KEY_BITS)


@kernel
def sort_tiles(
    first: Indices,
    starts: Indices,
    corner: Indices,
    size: float,
    points: MarkedPoints,
    tile: MarkedPoints,
    scratch: SortScratch,
) -> None:
    """Sort points inside their tiles by the hash of where they are (then by coordinates); drop exact duplicates.

    Parameters
    ----------
    first : (257,) int64
        Where each tile's points begin.
    starts : (257,) int64
        Filled: where each tile's points begin afterwards; last, the number of points that stay.
    corner : (2,) int64
        Column and row of the block's south-west tile.
    size : float
        Side of a tile, m.
    points : MarkedPoints
        Tile by tile; sorted in place. Of twins, the one with the first flag of 1, 2, ... 255, 0 stays.
    tile : MarkedPoints
        Scratch for the points of a tile.
    scratch : SortScratch
    """
    kept = 0
    for t in range(BLOCK_TILES * BLOCK_TILES):
        starts[t] = kept
        begin, count = first[t], first[t + 1] - first[t]
        if count == 0:
            continue
        for j in range(count):
            x, y, z = points.easting[begin + j], points.northing[begin + j], points.upward[begin + j]
            tile.easting[j], tile.northing[j], tile.upward[j], tile.flag[j] = x, y, z, points.flag[begin + j]
        west, south = (corner[0] + t % BLOCK_TILES) * size, (corner[1] + t // BLOCK_TILES) * size
        _fill_keys(count, west, south, size, tile, scratch.key)
        _fill_buckets(count, scratch)
        _insert_by_key(tile, count, scratch.order, scratch.rank)
        kept = _append_single(tile, count, scratch, kept, points)
    starts[BLOCK_TILES * BLOCK_TILES] = kept
