"""Extent of a map: the raster that its tiles span, windows of that raster, conversion to CRS units."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from bumpymap.core import BadInputError, CostTable, Georeference
from bumpytiles import Grid, TileWindow

if TYPE_CHECKING:
    from rasterio.transform import Affine

__all__ = ["MAX_PIXELS", "MAX_SIDE", "MAX_TILES", "Placement", "RasterWindow", "check_extent", "fits_one_map"]

MAX_TILES = 100_000_000
"""Most tiles in the bounding window of a map: 30 km x 30 km of 3 m tiles."""
MAX_SIDE = 100_000
"""Most tiles along a side: 300 km. GDAL visits every block of a raster, even empty ones."""
MAX_PIXELS = 25_000_000_000
"""Most pixels in heightmap.tif."""


def fits_one_map(grid: Grid, window: TileWindow) -> bool:
    """Return whether one map may span a window; larger ones are written in sheets."""
    tiles = window.cols * window.rows
    along = max(window.cols, window.rows)
    return tiles <= MAX_TILES and along <= MAX_SIDE and tiles * grid.pixels**2 <= MAX_PIXELS


def check_extent(grid: Grid, window: TileWindow, remedy: str = "") -> None:
    """Refuse a window that is too large for a raster, as for two sites far apart or an outlying point.

    Gaps take almost no disk space or memory, but GDAL visits every pixel of most rasters, empty or not. The message
    names a ``remedy``, a sentence, if there is one.

    Raises
    ------
    BadInputError
        More than ``MAX_TILES`` tiles, ``MAX_SIDE`` of them along a side, or ``MAX_PIXELS`` pixels.
    """
    tiles = window.cols * window.rows
    if fits_one_map(grid, window):
        return
    width, height = (side * grid.tile_size / 1000 for side in (window.cols, window.rows))
    raise BadInputError(
        f"the survey spans {width:,.1f} km x {height:,.1f} km: {tiles:,} tiles of {grid.tile_size:g} m, or "
        f"{tiles * grid.pixels**2:,} heightmap pixels. One map may span {MAX_TILES:,} tiles, {MAX_SIDE:,} along a "
        f"side, and {MAX_PIXELS:,} pixels. "
        f"{remedy}Map sites that lie far apart in separate runs; if it is one site, look for points far outside it"
    )


@dataclass(frozen=True, slots=True)
class RasterWindow:
    """A window of the raster."""

    tiles: TileWindow
    """The tiles in it."""
    line: int
    """Raster row of its north edge, in tiles from the top."""
    column: int
    """Raster column of its west edge, in tiles."""

    def pixel_indices(self, found: dict[str, NDArray[np.int64]]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return line and column in the window, from its north-west corner, of tiles given by ``row`` and ``col``."""
        return self.tiles.row + self.tiles.rows - 1 - found["row"], found["col"] - self.tiles.col


@dataclass(frozen=True, slots=True)
class Placement:
    """The raster that a map spans, and its position in the survey's CRS."""

    georeference: Georeference
    grid: Grid
    window: TileWindow
    """The smallest window around all tiles, which the rasters span."""

    @classmethod
    def of(cls, table: CostTable) -> "Placement":
        """Return the placement of a map. Raises BadInputError if it is too large for a raster."""
        check_extent(table.tiles.grid, table.tiles.window)
        return cls(table.georeference, table.tiles.grid, table.tiles.window)

    @property
    def horizontal_crs(self) -> CRS | None:
        """The survey's CRS without its vertical part, for two-dimensional geometries."""
        crs = self.georeference.crs
        return None if crs is None else crs.to_2d()

    @property
    def height_crs(self) -> CRS | None:
        """The survey's CRS, with its vertical part only if that is in metres, as all heights in the files are."""
        crs = self.georeference.crs
        in_metres = crs is not None and crs.is_compound and crs.axis_info[-1].unit_conversion_factor == 1.0
        return crs if in_metres else self.horizontal_crs

    def to_crs(self, tiles: NDArray[np.floating] | NDArray[np.integer]) -> NDArray[np.float64]:
        """Convert grid coordinates (1 = one tile, 0 = the CRS origin) to units of the CRS."""
        return np.asarray(tiles * self.grid.tile_size / self.georeference.metres_per_unit, dtype=np.float64)

    def transform(self, pixels: int) -> "Affine":
        """Return the affine transform of a raster with ``pixels`` x ``pixels`` pixels per tile, in units of the CRS."""
        from rasterio.transform import Affine

        west, north = self.to_crs(np.array([self.window.col, self.window.row + self.window.rows]))
        step = self.grid.tile_size / self.georeference.metres_per_unit / pixels
        return Affine(step, 0.0, float(west), 0.0, -step, float(north))

    def windows(self, side: int, *, aligned: bool) -> Iterator[RasterWindow]:
        """Split the raster into windows of ``side`` x ``side`` tiles, north-west first; smaller ones at the edges.

        If ``aligned``, cuts are counted from the CRS origin (a multiple of a block's side then cuts no block), else
        from the north-west corner of the raster.
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
    """Split ``start`` to ``stop`` at multiples of ``side`` from ``origin``."""
    edges = [start, *range(start + 1 + (origin - start - 1) % side, stop, side), stop]
    return list(pairwise(edges))
