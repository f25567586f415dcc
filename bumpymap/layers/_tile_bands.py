"""Write rasters with one pixel per tile."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import NO_CLASS, CostTable
from bumpymap.layers._cog import write_cog
from bumpymap.layers._raster_spec import BandSpec, RasterSpec
from bumpymap.layers.placement import Placement, RasterWindow
from bumpytiles import BLOCK_TILES

__all__ = ["write_bands", "write_codes"]

_BLOCK = 128
TILE_WINDOW = 16 * BLOCK_TILES
"""Side of a window, tiles: whole blocks, so that none is read twice."""
_Values = Callable[[dict[str, NDArray[Any]]], Iterable[NDArray[Any]]]


def write_bands(
    table: CostTable,
    path: Path,
    bands: Sequence[BandSpec],
    tags: dict[str, str],
    names: tuple[str, ...],
    values: _Values,
) -> None:
    """Write a float32 raster, NaN without a tile.

    Parameters
    ----------
    table : CostTable
        The tiles.
    path : Path
        The file to write.
    bands : sequence of BandSpec
    tags : dict
        Metadata of the file.
    names : tuple of str
        The columns that ``values`` needs.
    values : callable
        Returns an array (n,) for each band, given the columns of n tiles.

    Raises
    ------
    OutputError
        The file cannot be written.
    BadInputError
        The extent is too large for a raster.
    """
    place = Placement.of(table)
    spec = RasterSpec(
        bands=list(bands),
        dtype="float32",
        nodata=float("nan"),
        pixels=1,
        crs=place.horizontal_crs,
        overviews="AVERAGE",
        block=_BLOCK,
        tags=tags,
    )
    write_cog(path, place, spec, _painter(table, spec, names, values), TILE_WINDOW)


def write_codes(
    table: CostTable,
    path: Path,
    column: str,
    band: BandSpec,
    colours: Mapping[int, tuple[int, int, int, int]],
    tags: dict[str, str],
) -> None:
    """Write a uint8 raster of a column of codes, ``NO_CLASS`` without a tile; otherwise as `write_bands`."""
    place = Placement.of(table)
    spec = RasterSpec(
        bands=[band],
        dtype="uint8",
        nodata=NO_CLASS,
        pixels=1,
        crs=place.horizontal_crs,
        overviews="MODE",
        block=_BLOCK,
        colours=dict(colours),
        tags=tags,
        counts_nodata=True,
    )
    write_cog(path, place, spec, _painter(table, spec, (column,), lambda found: (found[column],)), TILE_WINDOW)


def _painter(
    table: CostTable, spec: RasterSpec, names: tuple[str, ...], values: _Values
) -> Callable[[RasterWindow], NDArray[np.generic] | None]:
    """Return a function that paints one value per tile and band; nodata in pixels without a tile."""

    def paint(window: RasterWindow) -> NDArray[np.generic] | None:
        if not table.tiles.holds(window.tiles):
            return None
        found = table.tiles.read(names, window.tiles)
        canvas = np.full((len(spec.bands), window.tiles.rows, window.tiles.cols), spec.nodata, dtype=spec.dtype)
        place = window.pixel_indices(found)
        for band, value in zip(canvas, values(found), strict=True):
            band[place] = value
        return canvas

    return paint
