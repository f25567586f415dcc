"""Compiled loops that group points by block of tiles. Nothing here allocates (see ``bumpytiles.native``)."""

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
    """Coordinates as integers of the file's own grid, see `bumpytiles.scaling`; (n,) each."""

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


@helper
def tile_index(coordinate: float, size: float) -> Any:
    """Return the tile index along one axis; the twin of ``Grid.index``."""
    i = math.floor(coordinate / size)
    if coordinate < i * size:
        i -= 1
    elif coordinate >= (i + 1.0) * size:
        i += 1
    return np.int64(i)


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
def _place(number: Any, borders: Borders, per_tile: float) -> Any:
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
            col = _place(x, easting, borders.tiles_per_easting)
            row = _place(y, northing, borders.tiles_per_northing)
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
