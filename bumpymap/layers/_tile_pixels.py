"""Write rasters with several pixels in each tile: heightmap, relief and obstacle."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CostTable
from bumpymap.layers._cog import write_cog
from bumpymap.layers._raster_spec import RasterSpec
from bumpymap.layers.placement import Placement, RasterWindow
from bumpytiles import BLOCK_TILES

__all__ = ["HEIGHT_BLOCK", "layer_tags", "write_pixels"]

HEIGHT_BLOCK = 512
"""Side of a block of these rasters, pixels."""
_WINDOW_PIXELS = 1024
"""Side of a window of such a raster, pixels; rounded down to whole blocks of tiles, at least one."""
_SPARSE = 0.1
"""Below this share of tiles with points in its extent a survey is sparse: then these rasters have smaller blocks, and
those without values are not made."""


def write_pixels(
    table: CostTable,
    path: Path,
    spec: RasterSpec,
    names: tuple[str, ...],
    values: Callable[[dict[str, NDArray[Any]], RasterWindow], NDArray[Any]],
) -> None:
    """Write a raster with ``spec.pixels`` pixels along each side of a tile; nodata where there is no tile.

    Parameters
    ----------
    table : CostTable
        The tiles.
    path : Path
        The file to write.
    spec : RasterSpec
        Everything but the pixels.
    names : tuple of str
        The columns that ``values`` needs.
    values : callable
        Returns the pixels, (n, pixels, pixels), of n tiles, given their columns and the window that they are all of.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    place, pixels = Placement.of(table), spec.pixels

    def pieces(window: RasterWindow) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[Any]]:
        found = table.tiles.read(names, window.tiles)
        return *window.pixel_indices(found), values(found, window)

    def paint(window: RasterWindow) -> NDArray[np.generic] | None:
        if not table.tiles.holds(window.tiles):
            return None
        line, column, stack = pieces(window)
        lines, columns = window.tiles.rows, window.tiles.cols
        canvas = np.full((lines, pixels, columns, pixels), spec.nodata, dtype=spec.dtype)
        canvas[line, :, column, :] = stack
        return canvas.reshape(1, lines * pixels, columns * pixels)

    sparse = table.tiles.tiles < _SPARSE * place.window.cols * place.window.rows
    side = max(1, _WINDOW_PIXELS // (BLOCK_TILES * pixels)) * BLOCK_TILES
    write_cog(path, place, spec, paint, side, pieces if sparse else None)


def layer_tags(table: CostTable, title: str, about: dict[str, str] | None) -> dict[str, str]:
    """Return the metadata of a raster: its title, the tile size, the weight of the ride, and what is given."""
    grid = table.tiles.grid
    own = {
        "title": title,
        "tile_size_m": f"{grid.tile_size:g}",
        "ride_weight_m_per_rad": f"{table.rule.ride_weight:g}",
    }
    return own | (about or {})
