"""Where the tiles of a map lie in its files: the raster that they span, windows of it, CRS units."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS
from rasterio.transform import Affine

from bumpymap.core import BadInputError, CostTable, Georeference
from bumpytiles import Grid, TileWindow

__all__ = ["MAX_PIXELS", "MAX_SIDE", "MAX_TILES", "Placement", "RasterWindow", "check_extent"]

MAX_TILES = 100_000_000
"""Most tiles that the window around a survey may span: 30 km x 30 km of 3 m tiles."""
MAX_SIDE = 100_000
"""Most tiles along a side: 300 km. GDAL walks along a raster even where it is empty, however few tiles high it is."""
MAX_PIXELS = 25_000_000_000
"""Most pixels of the height map of that window."""


def check_extent(grid: Grid, window: TileWindow) -> None:
    """Refuse a window that no raster should span: two sites far apart, or a point far outside.

    Gaps cost next to no disk and no memory, but GDAL walks through every pixel of a raster, empty or not.

    Raises
    ------
    BadInputError
        More than ``MAX_TILES`` tiles, ``MAX_SIDE`` of them along a side, or ``MAX_PIXELS`` pixels.
    """
    tiles = window.cols * window.rows
    along = max(window.cols, window.rows)
    if tiles <= MAX_TILES and along <= MAX_SIDE and tiles * grid.pixels**2 <= MAX_PIXELS:
        return
    width, height = (side * grid.tile_size / 1000 for side in (window.cols, window.rows))
    raise BadInputError(
        f"the survey spans {width:,.1f} km x {height:,.1f} km: {tiles:,} tiles of {grid.tile_size:g} m, or "
        f"{tiles * grid.pixels**2:,} heightmap pixels. One map may span {MAX_TILES:,} tiles, {MAX_SIDE:,} along a "
        f"side, and {MAX_PIXELS:,} pixels. "
        "Map sites that lie far apart in separate runs; if it is one site, look for points far outside it"
    )


@dataclass(frozen=True, slots=True)
class RasterWindow:
    """A rectangle of the raster."""

    tiles: TileWindow
    """The tiles in it."""
    line: int
    """Its northmost raster row, in tiles from the top."""
    column: int
    """Its westmost raster column, in tiles."""

    def pixel_indices(self, found: dict[str, NDArray[np.int64]]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Line and column inside the window, counted from its north-west corner, of tiles that were read for it."""
        return self.tiles.row + self.tiles.rows - 1 - found["row"], found["col"] - self.tiles.col


@dataclass(frozen=True, slots=True)
class Placement:
    """The raster that a map spans, and its place in the survey's CRS."""

    georeference: Georeference
    grid: Grid
    window: TileWindow
    """The smallest window around all tiles: what the rasters span."""

    @classmethod
    def of(cls, table: CostTable) -> "Placement":
        """Place the tiles of a map. Raises BadInputError where they span too much."""
        check_extent(table.tiles.grid, table.tiles.window)
        return cls(table.georeference, table.tiles.grid, table.tiles.window)

    @property
    def horizontal_crs(self) -> CRS | None:
        """The survey's CRS without its vertical part: what flat geometries lie in."""
        crs = self.georeference.crs
        return None if crs is None else crs.to_2d()

    @property
    def height_crs(self) -> CRS | None:
        """The survey's CRS with its vertical part, where that is in metres, as every height in the files is."""
        crs = self.georeference.crs
        in_metres = crs is not None and crs.is_compound and crs.axis_info[-1].unit_conversion_factor == 1.0
        return crs if in_metres else self.horizontal_crs

    def to_crs(self, tiles: NDArray[np.floating] | NDArray[np.integer]) -> NDArray[np.float64]:
        """Turn grid coordinates (1 = one tile, 0 = the CRS origin) into units of the CRS."""
        return np.asarray(tiles * self.grid.tile_size / self.georeference.metres_per_unit, dtype=np.float64)

    def transform(self, pixels: int) -> Affine:
        """Affine of a raster with ``pixels`` x ``pixels`` pixels a tile, in units of the CRS."""
        west, north = self.to_crs(np.array([self.window.col, self.window.row + self.window.rows]))
        step = self.grid.tile_size / self.georeference.metres_per_unit / pixels
        return Affine(step, 0.0, float(west), 0.0, -step, float(north))

    def windows(self, side: int, *, aligned: bool) -> Iterator[RasterWindow]:
        """Cut the raster into squares of ``side`` tiles, north-west first; those on the rim may be smaller.

        Cuts lie ``side`` tiles apart, counted from the CRS origin where ``aligned`` (a multiple of a block's side then
        cuts no block), and from the north-west corner of the raster elsewhere.
        """
        window = self.window
        east, north = window.col + window.cols, window.row + window.rows
        cols = _cuts(window.col, east, side, 0 if aligned else window.col)
        rows = _cuts(window.row, north, side, 0 if aligned else north)
        for south, top in reversed(rows):
            for west, right in cols:
                inside = TileWindow(west, south, right - west, top - south)
                yield RasterWindow(inside, north - top, west - window.col)


def _cuts(start: int, stop: int, side: int, origin: int) -> list[tuple[int, int]]:
    """Cut ``start`` to ``stop`` wherever the distance from ``origin`` is a multiple of ``side``."""
    edges = [start, *range(start + 1 + (origin - start - 1) % side, stop, side), stop]
    return list(pairwise(edges))
