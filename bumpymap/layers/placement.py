"""Extent of a map: the raster that its tiles span, all about it but its pixels, windows, conversion to CRS units."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from bumpymap.core import BadInputError, Band, CostTable, Georeference
from bumpytiles import Grid, TileWindow

if TYPE_CHECKING:
    from rasterio.transform import Affine

MAX_TILES = 400_000_000
"""Most tiles in the bounding window of a map: 60 km x 60 km of 3 m tiles. One of a corridor on the diagonal of it took
4 minutes of CPU time, 1.1 GB of memory and 1.4 GB of disk space: GDAL visits every tile of rasters of tiles."""
MAX_SIDE = 100_000
"""Most tiles along a side: 300 km. GDAL visits every block of a raster, even empty ones."""
MAX_PIXELS = 100_000_000_000
"""Most pixels in heightmap.tif."""


def check_extent(grid: Grid, window: TileWindow) -> None:
    """Refuse a window that is too large for a raster, as for two sites far apart or an outlying point.

    Gaps take almost no disk space or memory, but GDAL visits every tile of most rasters, empty or not. Raises
    BadInputError: more than ``MAX_TILES`` tiles, ``MAX_SIDE`` of them along a side, or ``MAX_PIXELS`` pixels.
    """
    tiles = window.cols * window.rows
    along = max(window.cols, window.rows)
    if tiles <= MAX_TILES and along <= MAX_SIDE and tiles * grid.pixels**2 <= MAX_PIXELS:
        return
    width, height = (side * grid.tile_size / 1000 for side in (window.cols, window.rows))
    raise BadInputError(
        f"the survey spans {width:,.1f} km x {height:,.1f} km: {tiles:,} tiles of {grid.tile_size:g} m, or "
        f"{tiles * grid.pixels**2:,} heightmap pixels. One map may span {MAX_TILES:,} tiles, {MAX_SIDE:,} along a "
        f"side, and {MAX_PIXELS:,} pixels. If it is smaller, look for points far outside it. Else map parts of it in "
        "separate runs, whose rasters lie on one grid, or give larger tiles with `tile_size`, or fewer `pixels`"
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


@dataclass(frozen=True, slots=True)
class Placement:
    """The raster that a map spans, and its position in the survey's CRS; for errors see `check_extent`."""

    georeference: Georeference
    grid: Grid
    window: TileWindow
    """The smallest window around all tiles, which the rasters span."""

    def __post_init__(self) -> None:
        check_extent(self.grid, self.window)

    @classmethod
    def of(cls, table: CostTable) -> "Placement":
        """Return the placement of a map."""
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

        def cuts(start: int, stop: int, origin: int) -> list[tuple[int, int]]:
            return list(pairwise([start, *range(start + 1 + (origin - start - 1) % side, stop, side), stop]))

        cols = cuts(window.col, east, 0 if aligned else window.col)
        rows = cuts(window.row, north, 0 if aligned else north)
        for south, top in reversed(rows):
            for west, right in cols:
                inside = TileWindow(west, south, right - west, top - south)
                yield RasterWindow(inside, north - top, west - window.col)


@dataclass(frozen=True, slots=True)
class RasterSpec:
    """Everything about a raster but its pixels."""

    bands: Sequence[Band]
    crs: CRS | None
    dtype: str = "float32"
    nodata: float = math.nan
    pixels: int = 1
    """Pixels along the side of a tile."""
    overviews: str = "AVERAGE"
    """Resampling method of the overviews, as GDAL names it."""
    block: int = 128
    """Side of an internal block of the file, pixels."""
    colours: dict[int, tuple[int, int, int, int]] = field(default_factory=dict)
    """Colours of the values of band 1 that pixels can have, nodata included."""
    tags: dict[str, str] = field(default_factory=dict)
    """Metadata of the file."""
    counts_nodata: bool = False
    """In overviews nodata is a value among others: for rasters of one pixel a tile whose nodata means unknown."""
    level: int = 6
    """DEFLATE compression level, 1 to 9."""
    is_photo: bool = False
    """True: red, green, blue and alpha, stored as JPEG with a mask; nodata is not noted."""
