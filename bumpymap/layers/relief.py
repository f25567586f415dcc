"""Write relief.tif: the heights of the ground without holes, for looking at."""

from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CostTable
from bumpymap.layers.geotiff import HEIGHT_BLOCK, layer_tags, write_pixels
from bumpymap.layers.placement import BandSpec, Placement, RasterSpec
from bumpytiles import TileTable, TileWindow

__all__ = ["box_sum", "write_relief"]

_Number = TypeVar("_Number", np.int64, np.float64)


def box_sum(values: NDArray[_Number], half: int) -> NDArray[_Number]:
    """Return the sum in the square of ``2 * half + 1`` pixels around each pixel, (rows, cols) as ``values``."""
    for axis in (0, 1):
        pad = [(half + 1, half) if other == axis else (0, 0) for other in (0, 1)]
        total = np.cumsum(np.pad(values, pad), axis=axis)
        size = values.shape[axis]
        upper, lower = (np.take(total, np.arange(size) + at, axis=axis) for at in (2 * half + 1, 0))
        values = upper - lower
    return values


_PIXELS = 3
"""Pixels along a side of a tile."""
_GAPS = (1, 2, 4, 8)
"""Half widths of the boxes that a pixel without heights is filled from, pixels."""
_MARGIN = -(-_GAPS[-1] // _PIXELS)
"""Tiles around a window in which heights are needed for its pixels."""
_READ_TILES = 4096
"""Most tiles to read at a time."""
_CENTIMETRE = 0.01


def write_relief(
    table: CostTable, path: Path, about: dict[str, str] | None = None, around: TileTable | None = None
) -> None:
    """Write relief.tif: a float32 COG, 3 x 3 pixels per tile, the mean height in each, with holes filled.

    A pixel without heights has the mean of those pixels with heights that are at most 1 pixel away along both axes,
    else at most 2, 4 or 8; NaN if there are none, and in tiles without points. Heights are rounded to 1 cm.

    Parameters
    ----------
    table, path, about
        See `write_roughness`.
    around : TileTable, optional
        The tiles of the whole map if ``table`` is a part of it: pixels at the edge are filled from both sides.

    Raises
    ------
    OutputError
        The file cannot be written.
    BadInputError
        The extent is too large for a raster.
    """
    spec = RasterSpec(
        bands=[BandSpec("height", "m", "mean height, holes filled from around them; measure on heightmap.tif")],
        dtype="float32",
        nodata=float("nan"),
        pixels=_PIXELS,
        crs=Placement.of(table).height_crs,
        overviews="AVERAGE",
        block=HEIGHT_BLOCK,
        tags=layer_tags(table, "relief for looking at: holes are filled; measure on heightmap.tif", about),
    )
    source = around or table.tiles
    write_pixels(table, path, spec, (), lambda found, window: _filled(source, window.tiles, found["row"], found["col"]))


def _filled(
    tiles: TileTable, window: TileWindow, row: NDArray[np.int64], col: NDArray[np.int64]
) -> NDArray[np.float32]:
    """Return the pixels of some tiles of a window, (n, 3, 3), m; NaN where no heights are near."""
    if not len(row):
        return np.empty((0, _PIXELS, _PIXELS), np.float32)
    wide = TileWindow(window.col - _MARGIN, window.row - _MARGIN, window.cols + 2 * _MARGIN, window.rows + 2 * _MARGIN)
    heights, known = _means(tiles, wide)
    values, left = np.where(known, heights, np.nan), ~known
    # Sums of whole numbers are exact, so a pixel has the same value in every window that it is in.
    for half in _GAPS:
        if not left.any():
            break
        count = box_sum(known.astype(np.int64), half)
        total = box_sum(heights, half)
        near = left & (count > 0)
        values[near] = np.rint(total[near] / count[near])
        left &= ~near
    metres = (values * _CENTIMETRE).astype(np.float32)
    by_tile = metres.reshape(wide.rows, _PIXELS, wide.cols, _PIXELS)
    return np.asarray(by_tile[wide.row + wide.rows - 1 - row, :, col - wide.col, :])


def _means(tiles: TileTable, window: TileWindow) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the mean height of each pixel of a window, north up, in whole cm, 0 without any, and where there are any.

    A pixel of the heightmap counts where its middle lies.
    """
    shape = (window.rows, _PIXELS, window.cols, _PIXELS)
    means, known = np.zeros(shape, np.int64), np.zeros(shape, np.bool_)
    fine = tiles.grid.pixels
    place = (2 * np.arange(fine) + 1) * _PIXELS // (2 * fine)
    for strip in tiles.strips(_READ_TILES, window):
        found = tiles.read(("heights",), strip)
        heights = found["heights"].astype(np.float64)
        counted = np.isfinite(heights)
        heights[~counted] = 0.0
        line, column = window.row + window.rows - 1 - found["row"], found["col"] - window.col
        for down in np.unique(place):
            for right in np.unique(place):
                inside = np.ix_(np.arange(len(line)), place == down, place == right)
                count = counted[inside].sum(axis=(1, 2))
                total = heights[inside].sum(axis=(1, 2))
                some = count > 0
                where = line[some], down, column[some], right
                means[where] = np.rint(total[some] / count[some] / _CENTIMETRE)
                known[where] = True
    flat = (window.rows * _PIXELS, window.cols * _PIXELS)
    return means.reshape(flat), known.reshape(flat)
