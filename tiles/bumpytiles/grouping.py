"""Group a chunk of points by block of tiles, in metres or on the grid of their file, and sort the points of a block.

Points arrive in any order, in chunks of any size, from any number of files. Each chunk is grouped by blocks of tiles;
when a block is complete its points are sorted *once*: by tile, and inside a tile by a hash of where they are in it.
This order has four advantages:

- it does not depend on the order of arrival, so floating-point sums over a tile have the same bits for any chunk size,
  order of files and number of threads;
- it does not depend on where the ground lies: moved by whole tiles, raised, turned by 90 degrees or mirrored, a tile
  keeps it;
- exact duplicates become neighbours, and are counted once;
- the first k points of a tile are a random sample of it.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpytiles._loops import loops
from bumpytiles.grid import BELOW, BLOCK_TILES, Grid
from bumpytiles.pack import BlockKey, Column

Triple = tuple[float, float, float]

DECIMALS = 8
"""Decimals that coordinates are rounded to, in the file's unit."""
_ROUND = 10.0**DECIMALS
_MOST_CELLS = 1 << 22
"""Blocks in the window around a chunk that are counted in a table."""


@dataclass(frozen=True, slots=True)
class Scaling:
    """How integers become coordinates: ``integer * scale + offset``, rounded to 1e-8, times the metres of the unit."""

    scales: Triple
    offsets: Triple
    units: Triple
    """m, of x, y and z."""

    def numbers(self) -> NDArray[np.float64]:
        """Return scales, offsets and units as an array (9,) for loops."""
        return np.array([*self.scales, *self.offsets, *self.units])

    @classmethod
    def of(cls, numbers: Any) -> "Scaling":
        """Restore it from nine numbers."""
        x, y, z, *others = (float(number) for number in numbers)
        return cls((x, y, z), (others[0], others[1], others[2]), (others[3], others[4], others[5]))

    def coordinates(self, axis: int, integers: Any) -> NDArray[np.float64]:
        """Return coordinates, m, of integers (n,) of an axis; too large ones become infinite or not a number."""
        with np.errstate(over="ignore", invalid="ignore"):
            there = np.asarray(integers, np.float64) * self.scales[axis] + self.offsets[axis]
            found: NDArray[np.float64] = np.rint(there * _ROUND) / _ROUND * self.units[axis]
        return found


@dataclass(frozen=True, slots=True)
class ScaledPoints:
    """Points of one file, (n,) each."""

    easting: NDArray[np.int32]
    """Integers of the file's grid, as the two that follow."""
    northing: NDArray[np.int32]
    upward: NDArray[np.int32]
    flag: NDArray[np.uint8]
    """A number that travels with each point."""
    scaling: Scaling
    colour: NDArray[np.uint32] | None = None
    """Red, green and blue, 8 bits each, blue lowest; 0: none. None: no point has one."""

    def coordinates(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return easting, northing and height, m."""
        east, north, up = (
            self.scaling.coordinates(axis, values)
            for axis, values in enumerate((self.easting, self.northing, self.upward))
        )
        return east, north, up


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
    photo: NDArray[np.uint8] | None = None
    """(tiles, pixels, pixels, 3) red, green, blue of the highest coloured point in each pixel, north up; 0: none.
    None: no point has a colour."""


def join_tiles(parts: Sequence[TilePoints]) -> TilePoints:
    """Return the tiles of several parts, of one grid, in one; at least one part. Tiles and points keep their order."""
    whole = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("col", "row", "easting", "northing", "upward", "flag")
    }
    counts = np.concatenate([np.diff(part.starts) for part in parts])
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    photo = None
    if any(part.photo is not None for part in parts):
        photo = np.concatenate([photo_of(part) for part in parts])
    return TilePoints(grid=parts[0].grid, starts=starts, **whole, photo=photo)


def photo_of(points: TilePoints) -> NDArray[np.uint8]:
    """Return the photo of tiles; black if no point has a colour."""
    side = points.grid.pixels
    return np.zeros((len(points.col), side, side, 3), np.uint8) if points.photo is None else points.photo


PointColumns = dict[str, NDArray[Any]]
"""Columns of `POINT_COLUMNS` or `SCALED_COLUMNS`, (n,) each."""


class PointPart(NamedTuple):
    """Some waiting points."""

    columns: PointColumns
    scaling: Scaling | None
    """None: coordinates are in metres."""

    def in_metres(self) -> "PointPart":
        """Return the same points with coordinates in metres."""
        if self.scaling is None:
            return self
        there = [(n, axis) for n, axis in enumerate(_AXES) if axis in self.columns]
        metres = {axis: self.scaling.coordinates(n, self.columns[axis]) for n, axis in there}
        return PointPart(self.columns | metres, None)


def sort_block(grid: Grid, key: BlockKey, parts: Sequence[PointPart]) -> TilePoints:
    """Sort the points of a block, given in one or more parts, by tile and hash; drop duplicates."""
    counts = np.zeros(BLOCK_TILES**2 + 1, np.int64)
    for part in parts:
        loops.count_tiles(part.columns["tile"], counts)
    first = np.cumsum(counts)
    n, starts, following = int(first[-1]), np.empty_like(first), first[:-1].copy()
    out: PointColumns = {axis: np.empty(n) for axis in _AXES} | {"flag": np.empty(n, np.uint8)}
    coloured = any(_COLOUR.name in part.columns for part in parts)
    size = BLOCK_TILES**2 * grid.pixels**2 if coloured else 0
    corner = np.array([key[1], key[0]]) * BLOCK_TILES
    colour = np.zeros(size, np.uint32)
    photo = {"corner": corner, "tile_size": grid.tile_size, "pixels": grid.pixels, "colour": colour}
    photo["height"] = np.full(size, -np.inf)
    for columns, scaling in parts:
        place = loops.place_points if scaling is None else loops.place_scaled_points
        place(_NO_COLOURS | columns, np.empty(0) if scaling is None else scaling.numbers(), following, out, photo)
    loops.sort_tiles(first, starts, corner, grid.tile_size, out)
    kept = int(starts[-1])
    present = np.flatnonzero(np.diff(starts))
    rgb = colour.reshape(-1, grid.pixels, grid.pixels)[present] if coloured else colour
    return TilePoints(
        grid=grid,
        col=key[1] * BLOCK_TILES + present % BLOCK_TILES,
        row=key[0] * BLOCK_TILES + present // BLOCK_TILES,
        starts=np.append(starts[present], kept),
        photo=np.stack([rgb >> 16, rgb >> 8, rgb], axis=-1).astype(np.uint8) if coloured else None,
        **{name: values[:kept] for name, values in out.items()},
    )


_MOST_BORDERS = 1 << 16
"""Columns or rows of tiles in a chunk whose borders are looked up."""
_FAR = 1 << 33
"""Beyond all integers."""
_MARKS = (Column("tile", "|u1"), Column("flag", "|u1"))
_AXES = ("easting", "northing", "upward")
POINT_COLUMNS = (*(Column(axis, "<f8") for axis in _AXES), *_MARKS)
"""A waiting point with its coordinates in metres: 26 bytes."""
SCALED_COLUMNS = (*(Column(axis, "<i4") for axis in _AXES), *_MARKS)
"""The same with integers of the grid of its file: 14 bytes."""
_COLOUR = Column("colour", "<u4")
"""Of points that have one, see `bumpytiles.ScaledPoints`."""
_NO_COLOURS: PointColumns = {_COLOUR.name: np.empty(0, np.uint32)}


def columns_of(scaling: Scaling | None, *, coloured: bool) -> tuple[Column, ...]:
    """Return the columns of points with a scaling, or in metres."""
    return (*(POINT_COLUMNS if scaling is None else SCALED_COLUMNS), *((_COLOUR,) if coloured else ()))


@dataclass(frozen=True, slots=True)
class GroupedPoints:
    """A chunk of points, grouped by block."""

    keys: list[BlockKey]
    """Blocks with points in the chunk, south-west first."""
    starts: NDArray[np.int64]
    """(blocks + 1,) where each block's points begin."""
    points: PointColumns
    """(n,) columns."""
    scaling: Scaling | None = None
    """None: coordinates are in metres."""

    def count(self, place: int) -> int:
        """Return the number of points of the block ``keys[place]``."""
        return int(self.starts[place + 1] - self.starts[place])

    def block(self, place: int, names: Iterable[str]) -> PointPart:
        """Return views of some columns, as far as there are any, of the points of the block ``keys[place]``."""
        span = slice(int(self.starts[place]), int(self.starts[place + 1]))
        return PointPart({name: self.points[name][span] for name in names if name in self.points}, self.scaling)

    def of_blocks(self, places: Sequence[int]) -> "GroupedPoints":
        """Return a copy with some of the blocks, given by their places in increasing order."""
        spans = [slice(int(self.starts[place]), int(self.starts[place + 1])) for place in places]
        counts = [span.stop - span.start for span in spans]
        columns = _empty_columns(self.columns, sum(counts))
        for name, array in columns.items():
            np.concatenate([self.points[name][span] for span in spans], out=array)
        starts = np.concatenate(([0], np.cumsum(counts))).astype(np.int64)
        return GroupedPoints([self.keys[place] for place in places], starts, columns, self.scaling)

    @property
    def columns(self) -> tuple[Column, ...]:
        """Columns of the points."""
        return columns_of(self.scaling, coloured=_COLOUR.name in self.points)

    @property
    def size_bytes(self) -> int:
        """Memory that the points take."""
        return len(self) * sum(column.row_bytes for column in self.columns)

    def __len__(self) -> int:
        """Return the number of points."""
        return int(self.starts[-1])


def group_points(
    grid: Grid,
    easting: NDArray[np.float64],
    northing: NDArray[np.float64],
    upward: NDArray[np.float64],
    flag: NDArray[np.uint8] | NDArray[np.bool_],
    colour: NDArray[np.uint32] | None = None,
) -> GroupedPoints:
    """Group a chunk of points by block; coordinates (n,) in metres, ``flag`` and ``colour`` (n,) belong to them."""
    columns = zip(_AXES, (easting, northing, upward), strict=True)
    points = {axis: np.ascontiguousarray(column, np.float64) for axis, column in columns}
    marks = np.ascontiguousarray(flag, np.uint8)
    window = _window(grid, points["easting"], points["northing"])
    if window is None:
        return _group_scattered(grid, colour, *points.values(), marks)
    counts, cell, tile = window.scratch(len(marks))
    loops.count_points(points, window, counts, cell, tile)
    return window.grouped(points, (marks, colour, cell, tile), counts, None)


def group_scaled_points(grid: Grid, points: ScaledPoints) -> GroupedPoints:
    """Group a chunk of points of a file's own grid by block."""
    scaling, n = points.scaling, len(points.flag)
    axes = (points.easting, points.northing)
    spans = [(int(values.min()), int(values.max())) if n else (0, 0) for values in axes]
    window = _window(grid, *(scaling.coordinates(axis, span) for axis, span in enumerate(spans)))
    borders = None if window is None else _borders(grid, scaling, spans)
    if window is None or borders is None:
        return group_points(grid, *points.coordinates(), points.flag, points.colour)
    counts, cell, tile = window.scratch(n)
    loops.count_scaled_points(points, *borders, window, counts, cell, tile)
    marks = np.ascontiguousarray(points.flag, np.uint8)
    return window.grouped(points, (marks, points.colour, cell, tile), counts, scaling)


def _borders(
    grid: Grid, scaling: Scaling, spans: Sequence[tuple[int, int]]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]] | None:
    """Return where columns and rows of tiles begin among the integers of x and y, and the first tile.

    Behind the last one its end follows. None if that is not simple.
    """
    found, first = [], []
    for axis, span in enumerate(spans):
        low, high = grid.index(scaling.coordinates(axis, span)).tolist()
        step = scaling.scales[axis] * scaling.units[axis] / grid.tile_size
        if step <= 0 or high - low > _MOST_BORDERS:
            return None
        found.append(_first_integers(grid, scaling, axis, np.arange(low, high + 2)))
        first.append(low)
    return found[0], found[1], np.array(first)


def _first_integers(grid: Grid, scaling: Scaling, axis: int, tiles: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the lowest integer of each tile along an axis. Tiles may be narrower than a step between integers."""
    goal = tiles * grid.tile_size
    with np.errstate(over="ignore", invalid="ignore"):  # of scales that nobody would choose: the search below finds all
        about = (goal / scaling.units[axis] - scaling.offsets[axis]) / scaling.scales[axis]
        low = np.floor(about).astype(np.int64) - 2
    high = low + 5

    def reaches(integers: NDArray[np.int64]) -> NDArray[np.bool_]:
        return scaling.coordinates(axis, integers) - goal >= BELOW

    near = ~reaches(low) & reaches(high)
    low, high = np.where(near, low, -_FAR), np.where(near, high, _FAR)
    while (wide := high - low > 1).any():
        middle = (low + high) // 2
        inside = reaches(middle)
        high, low = np.where(wide & inside, middle, high), np.where(wide & ~inside, middle, low)
    return high


@dataclass(frozen=True, slots=True)
class _Window:
    """The blocks around a chunk."""

    tile_size: float
    """m."""
    first_col: int
    """South-west block, as the next."""
    first_row: int
    cols: int
    """Blocks from west to east, as the next from south to north."""
    rows: int

    def scratch(self, points: int) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.uint8]]:
        """Return zeros for the points of each cell, behind another, and arrays for the cell and tile of each point."""
        return np.zeros(self.rows * self.cols + 1, np.int64), np.empty(points, np.int32), np.empty(points, np.uint8)

    def grouped(
        self,
        points: ScaledPoints | PointColumns,
        more: tuple[NDArray[np.uint8], NDArray[np.uint32] | None, NDArray[np.int32], NDArray[np.uint8]],
        counts: NDArray[np.int64],
        scaling: Scaling | None,
    ) -> GroupedPoints:
        """Return points in the order of the blocks, of which cell ``c`` has ``counts[c + 1]``.

        ``more`` (n,) each: flag, colour, cell and tile of the points.
        """
        flag, colour, cell, tile = more
        columns = _empty_columns(columns_of(scaling, coloured=colour is not None), len(flag))
        colours = _NO_COLOURS[_COLOUR.name] if colour is None else np.ascontiguousarray(colour)
        scatter = loops.scatter_points if scaling is None else loops.scatter_scaled_points
        scatter(points, flag, colours, cell, tile, np.cumsum(counts), _NO_COLOURS | columns)
        present = np.flatnonzero(counts[1:])
        rows, cols = np.divmod(present, self.cols)
        keys = list(zip((self.first_row + rows).tolist(), (self.first_col + cols).tolist(), strict=True))
        starts = np.concatenate(([0], np.cumsum(counts[1:][present])))
        return GroupedPoints(keys, starts, columns, scaling)


def _window(grid: Grid, easting: NDArray[np.float64], northing: NDArray[np.float64]) -> _Window | None:
    """Return the blocks around points; None if there are too many for a table."""
    if not len(easting):
        return _Window(grid.tile_size, 0, 0, 1, 1)
    corners = [grid.index(np.array([axis.min(), axis.max()])) // BLOCK_TILES for axis in (northing, easting)]
    (south, north), (west, east) = (tuple(int(side) for side in pair) for pair in corners)
    rows, cols = north - south + 1, east - west + 1
    return None if rows * cols > _MOST_CELLS else _Window(grid.tile_size, west, south, cols, rows)


def _empty_columns(columns: Sequence[Column], points: int) -> PointColumns:
    """Return columns that lie in one piece of memory: fewer and larger pages."""
    memory = np.empty(points * sum(column.row_bytes for column in columns), np.uint8)
    found, at = {}, 0
    for column in columns:
        end = at + points * column.row_bytes
        found[column.name] = memory[at:end].view(column.dtype)
        at = end
    return found


def _group_scattered(grid: Grid, colour: NDArray[np.uint32] | None, *columns: NDArray[Any]) -> GroupedPoints:
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
    points |= {} if colour is None else {_COLOUR.name: colour[order]}
    return GroupedPoints([(int(r), int(c)) for r, c in block[starts[:-1]]], starts, points)
