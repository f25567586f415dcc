"""Write speeds.tif: what is felt on each tile at several speeds."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CostTable, speed_bands
from bumpymap.layers._cog import write_cog
from bumpymap.layers._raster_spec import BandSpec, RasterSpec
from bumpymap.layers._tile_pixels import layer_tags
from bumpymap.layers.placement import Placement, RasterWindow
from bumpytiles import BLOCK_TILES

__all__ = ["write_speeds"]

_BLOCK = 128
_WINDOW = 16 * BLOCK_TILES
"""Side of a window, tiles: whole blocks, so that none is read twice."""


def write_speeds(table: CostTable, path: Path, about: dict[str, str] | None = None) -> None:
    """Write speeds.tif: a float32 COG, one pixel per tile, the bands of `speed_bands`, NaN if unknown.

    Parameters
    ----------
    table : CostTable
        The tiles, with ``speeds``.
    path : Path
        The file to write.
    about : dict, optional
        Metadata of the file, such as vehicle and calibration.

    Raises
    ------
    OutputError
        The file cannot be written.
    BadInputError
        The extent is too large for a raster.
    """
    bands = speed_bands(table.speeds)
    place = Placement.of(table)
    own = {"speeds_m_per_s": " ".join(f"{speed:g}" for speed in table.speeds)}
    spec = RasterSpec(
        bands=[BandSpec(band.name, band.unit, band.description) for band in bands],
        dtype="float32",
        nodata=float("nan"),
        pixels=1,
        crs=place.horizontal_crs,
        overviews="AVERAGE",
        block=_BLOCK,
        tags=layer_tags(table, "pitch, roll and vertical acceleration at several speeds", own | (about or {})),
    )

    def paint(window: RasterWindow) -> NDArray[np.float32] | None:
        if not table.tiles.holds(window.tiles):
            return None
        found = table.tiles.read(("motion",), window.tiles)
        canvas = np.full((len(bands), window.tiles.rows, window.tiles.cols), np.nan, dtype=np.float32)
        line, column = window.pixel_indices(found)
        canvas[:, line, column] = found["motion"].T
        return canvas

    write_cog(path, place, spec, paint, _WINDOW)
