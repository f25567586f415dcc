"""Where the tiles of a map lie in its files: canonical order, raster window, CRS units."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS
from rasterio.transform import Affine

from bumpymap.errors import BadInputError
from bumpymap.types import CostMap, Georeference
from bumpytiles import Grid, TileWindow

__all__ = ["MAX_PIXELS", "MAX_TILES", "Chunk", "Placement", "check_extent"]

MAX_TILES = 100_000_000
"""Most tiles that the window around a survey may span: 30 km x 30 km of 3 m tiles."""
MAX_PIXELS = 25_000_000_000
"""Most pixels of the height map of that window."""


def check_extent(grid: Grid, window: TileWindow) -> None:
    """Refuse a window that no raster should span: two sites far apart, or a point far outside.

    Gaps cost next to no disk, but a raster has to be walked through: the largest window allowed, with two sites of
    100 x 100 tiles in its corners, was measured to take 4 minutes and 1.2 GB of memory on 2 cores.

    Raises
    ------
    BadInputError
        More than ``MAX_TILES`` tiles or ``MAX_PIXELS`` pixels.
    """
    tiles = window.cols * window.rows
    if tiles <= MAX_TILES and tiles * grid.pixels**2 <= MAX_PIXELS:
        return
    width, height = (side * grid.tile_size / 1000 for side in (window.cols, window.rows))
    raise BadInputError(
        f"the survey spans {width:,.1f} km x {height:,.1f} km: {tiles:,} tiles of {grid.tile_size:g} m, or "
        f"{tiles * grid.pixels**2:,} heightmap pixels. One map may span {MAX_TILES:,} tiles and {MAX_PIXELS:,} pixels. "
        "Map sites that lie far apart in separate runs; if it is one site, look for points far outside it"
    )


@dataclass(frozen=True, slots=True)
class Chunk:
    """A rectangle of the raster that holds some tiles."""

    line: int
    """Its northmost raster row, in tiles from the top."""
    column: int
    """Its westmost raster column, in tiles."""
    lines: int
    columns: int
    members: NDArray[np.int64]
    """(k,) positions in canonical order of the tiles inside."""


@dataclass(frozen=True, slots=True)
class Placement:
    """Tiles of a map in canonical order: north row first, west column first."""

    georeference: Georeference
    grid: Grid
    window: TileWindow
    """The smallest window around all tiles: what the rasters span."""
    order: NDArray[np.int64]
    """(n,) ``values[order]`` brings any per-tile array of the map into canonical order."""
    line: NDArray[np.int64]
    """(n,) raster row of each tile, counted from the north, in canonical order."""
    column: NDArray[np.int64]
    """(n,) raster column, counted from the west, in canonical order."""

    @classmethod
    def of(cls, cost_map: CostMap) -> "Placement":
        """Place the tiles of a map. Raises BadInputError where there are none, or where they span too much."""
        patches = cost_map.patches
        if len(patches.col) == 0:
            raise BadInputError("no tile of the survey holds a point that counts: there is nothing to map")
        window = TileWindow.around(patches.col, patches.row)
        check_extent(patches.grid, window)
        order = np.lexsort((patches.col, -patches.row))
        line = window.row + window.rows - 1 - patches.row[order]
        column = patches.col[order] - window.col
        if np.any((np.diff(line) == 0) & (np.diff(column) == 0)):
            raise ValueError("two rows of the map are the same tile")
        return cls(cost_map.georeference, patches.grid, window, order, line, column)

    @property
    def horizontal_crs(self) -> CRS | None:
        """The survey's CRS without its vertical part: what flat geometries lie in."""
        crs = self.georeference.crs
        return None if crs is None else crs.to_2d()

    def to_crs(self, tiles: NDArray[np.floating] | NDArray[np.integer]) -> NDArray[np.float64]:
        """Turn grid coordinates (1 = one tile, 0 = the CRS origin) into units of the CRS."""
        return np.asarray(tiles * self.grid.tile_size / self.georeference.metres_per_unit, dtype=np.float64)

    def transform(self, pixels: int) -> Affine:
        """Affine of a raster with ``pixels`` x ``pixels`` pixels a tile, in units of the CRS."""
        west, north = self.to_crs(np.array([self.window.col, self.window.row + self.window.rows]))
        step = self.grid.tile_size / self.georeference.metres_per_unit / pixels
        return Affine(step, 0.0, float(west), 0.0, -step, float(north))

    def raster(self, values: NDArray[np.generic], fill: int) -> NDArray[np.generic]:
        """Lay out one value a tile; ``values`` are in the map's order, gaps hold ``fill``; (rows, cols), north up."""
        canvas = np.full((self.window.rows, self.window.cols), fill, dtype=values.dtype)
        canvas[self.line, self.column] = values[self.order]
        return canvas

    def chunks(self, side: int, *, everywhere: bool = False) -> Iterator[Chunk]:
        """Cut the raster into squares of ``side`` tiles; give those that hold a tile, or all, north-west first."""
        across, down = (-(-count // side) for count in (self.window.cols, self.window.rows))
        key = self.line // side * across + self.column // side
        by_key = np.argsort(key, kind="stable")
        key = key[by_key]
        wanted = np.arange(across * down) if everywhere else np.unique(key)
        starts, stops = (np.searchsorted(key, wanted, end) for end in ("left", "right"))
        for number, start, stop in zip(wanted, starts, stops, strict=True):
            line, column = (int(part) * side for part in divmod(int(number), across))
            lines, columns = min(side, self.window.rows - line), min(side, self.window.cols - column)
            yield Chunk(line, column, lines, columns, by_key[start:stop])
