"""The global tile grid: pure algebra between coordinates, tile indices and bounds.

The grid is anchored at the CRS origin, so that two surveys of one site share tiles. Tiles are half-open,
``[west, east) x [south, north)``, and so are pixels. All lengths are in metres; the caller converts CRS units first.

Float64 holds few decimal numbers, and few feet in metres: a coordinate is on a border if it lies less than half a step
of 1e-8 m below.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

BLOCK_TILES = 16
"""Tiles along a side of a block: one unit of work."""
PER_METRE = 1e8
"""Steps a metre in which tile and pixel are found, see above."""
BELOW = -0.5 / PER_METRE
"""A coordinate that lies so far below a border, m, or less, is on it."""


@dataclass(frozen=True, slots=True)
class Bounds:
    """An axis-parallel box, in metres."""

    west: float
    south: float
    east: float
    north: float


@dataclass(frozen=True, slots=True)
class TileWindow:
    """A rectangle of ``cols`` x ``rows`` tiles, the south-west one at ``(col, row)``."""

    col: int
    row: int
    cols: int
    rows: int

    @classmethod
    def around(cls, col: NDArray[np.integer], row: NDArray[np.integer]) -> "TileWindow":
        """Return the smallest window that contains every given tile (at least one)."""
        west, south = int(col.min()), int(row.min())
        return cls(west, south, int(col.max()) - west + 1, int(row.max()) - south + 1)

    def grown(self, ring: int) -> "TileWindow":
        """Return the window with ``ring`` more tiles on each side."""
        return TileWindow(self.col - ring, self.row - ring, self.cols + 2 * ring, self.rows + 2 * ring)

    def overlap(self, other: "TileWindow") -> "TileWindow":
        """Return the tiles that two windows share; if there are none, ``cols`` or ``rows`` is not positive."""
        west, south = max(self.col, other.col), max(self.row, other.row)
        cols = min(self.col + self.cols, other.col + other.cols) - west
        rows = min(self.row + self.rows, other.row + other.rows) - south
        return TileWindow(west, south, cols, rows)

    def cells(
        self, col: NDArray[np.int64], row: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:  # fmt: skip
        """Return line and column of tiles from the north-west corner of the window."""
        return self.row + self.rows - 1 - row, col - self.col

    def cut(self, rows: int) -> "Iterator[tuple[int, TileWindow]]":
        """Yield windows of up to ``rows`` whole rows, north first; each with the number of rows north of it."""
        for north in range(0, self.rows, rows):
            own = min(rows, self.rows - north)
            yield north, TileWindow(self.col, self.row + self.rows - north - own, self.cols, own)


@dataclass(frozen=True, slots=True)
class Grid:
    """Square tiles of ``tile_size`` metres, each divided into ``pixels`` x ``pixels``."""

    tile_size: float = 3.0
    """Side of a tile, m."""
    pixels: int = 15
    """Pixels along a side."""

    def __post_init__(self) -> None:
        if not (np.isfinite(self.tile_size) and self.tile_size > 0):
            raise ValueError(f"tile_size is {self.tile_size}; it must be a positive number of metres")
        if self.pixels < 1:
            raise ValueError(f"pixels is {self.pixels}; it must be at least 1")

    @property
    def pixel_size(self) -> float:
        """Side of a pixel, m."""
        return self.tile_size / self.pixels

    def index(self, coordinate: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the tile index along one axis: the ``i`` with ``i * size <= coordinate < (i + 1) * size``.

        The quotient may round across a border; two comparisons with the borders correct this.

        Parameters
        ----------
        coordinate : array (n,) float64
            Easting or northing, m.

        Returns
        -------
        array (n,) int64
        """
        size = self.tile_size
        i = np.floor(coordinate / size)
        i -= coordinate - i * size < BELOW
        i += coordinate - (i + 1.0) * size >= BELOW
        return i.astype(np.int64)

    def pixel(self, coordinate: NDArray[np.float64], tile: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the index of the pixel in its tile along one axis, from the west or the south; (n,) each."""
        steps = np.rint((coordinate - tile * self.tile_size) * PER_METRE)
        place = self.pixels * steps / np.rint(self.tile_size * PER_METRE)
        return np.minimum(np.asarray(place, np.int64), self.pixels - 1)

    def bounds(self, col: int, row: int) -> Bounds:
        """Return the bounds of one tile, m."""
        size = self.tile_size
        return Bounds(col * size, row * size, (col + 1) * size, (row + 1) * size)

    def window_bounds(self, window: TileWindow) -> Bounds:
        """Return the bounds of a window of tiles, m."""
        size, east, north = self.tile_size, window.col + window.cols, window.row + window.rows
        return Bounds(window.col * size, window.row * size, east * size, north * size)
