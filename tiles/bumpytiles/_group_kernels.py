"""Compiled loops that group points by block of tiles. Nothing here allocates (see ``bumpytiles.native``)."""

import math
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpytiles.native import helper, kernel
from bumpytiles.scaling import coordinate

__all__ = [
    "BLOCK_TILES",
    "MAX_CELLS",
    "BlockWindow",
    "Coordinates",
    "GroupScratch",
    "ScaledCoordinates",
    "ScaledTiledPoints",
    "TiledPoints",
    "count_points",
    "count_scaled_points",
    "scatter_points",
    "scatter_scaled_points",
]

BLOCK_TILES = 16
"""Tiles along a side of a block: one unit of work."""
MAX_CELLS = 1 << 22
"""Blocks in the window around a chunk that are counted in a table."""

Floats = Annotated[NDArray[np.float64], 1]
Words = Annotated[NDArray[np.int32], 1]
Bytes = Annotated[NDArray[np.uint8], 1]
Flags = Annotated[NDArray[np.bool_], 1]
Indices = Annotated[NDArray[np.int64], 1]
Places = Annotated[NDArray[np.int32], 1]


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
    flag: Flags


class ScaledTiledPoints(NamedTuple):
    """The same, with coordinates as integers of the file's own grid."""

    easting: Words
    northing: Words
    upward: Words
    tile: Bytes
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
    """Where points go, filled by `count_points`."""

    cell: Places
    """(n,) block of each point in the window."""
    tile: Bytes
    """(n,)."""


@helper
def _index(coordinate: float, size: float) -> Any:
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
    col, row = _index(easting, window.tile_size), _index(northing, window.tile_size)
    c = (row // BLOCK_TILES - window.first_row) * window.cols + col // BLOCK_TILES - window.first_col
    out.cell[i] = c
    out.tile[i] = (row % BLOCK_TILES) * BLOCK_TILES + col % BLOCK_TILES
    counts[c + 1] += 1


@kernel
def count_points(points: Coordinates, window: BlockWindow, counts: Indices, out: GroupScratch) -> None:
    """Find block and tile of each point; count the points of each block ``c`` of the window in ``counts[c + 1]``."""
    for i in range(len(points.easting)):
        _count(i, points.easting[i], points.northing[i], window, counts, out)


@kernel
def count_scaled_points(
    points: ScaledCoordinates, scaling: Floats, window: BlockWindow, counts: Indices, out: GroupScratch
) -> None:
    """Do the same for points of a file's own grid, see `bumpytiles.scaling.Scaling.numbers`."""
    for i in range(len(points.easting)):
        easting, northing = coordinate(points.easting[i], scaling, 0), coordinate(points.northing[i], scaling, 1)
        _count(i, easting, northing, window, counts, out)


@helper
def _scatter(points: Any, flag: Flags, found: GroupScratch, place: Indices, out: Any) -> None:
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
def scatter_points(points: Coordinates, flag: Flags, found: GroupScratch, place: Indices, out: TiledPoints) -> None:
    """Put points block by block; ``place`` is where the next point of each block of the window goes, and moves on."""
    _scatter(points, flag, found, place, out)


@kernel
def scatter_scaled_points(
    points: ScaledCoordinates, flag: Flags, found: GroupScratch, place: Indices, out: ScaledTiledPoints
) -> None:
    """Do the same with points of a file's own grid."""
    _scatter(points, flag, found, place, out)
