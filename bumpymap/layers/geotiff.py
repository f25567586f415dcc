"""Write the raster layers: one pixel per tile (roughness, class, speeds), or several (heightmap, obstacle, passage).

relief.tif holds the heights of the ground without holes, for looking at.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    BANDS,
    BARRED_TEXT,
    CANOPY,
    CLASS_NAMES,
    FREE,
    NO_CLASS,
    OBJECT_NAMES,
    OBSTACLE,
    REASON_TEXT,
    UNSEEN,
    Barred,
    CostTable,
    Reason,
    speed_bands,
)
from bumpymap.layers._cog import TILE_WINDOW, write_cog
from bumpymap.layers.colours import BARRED_COLOURS, CLASS_COLOURS, OBJECT_COLOURS, REASON_COLOURS, UNKNOWN_OBJECT
from bumpymap.layers.placement import BandSpec, Placement, RasterSpec, RasterWindow
from bumpytiles import BLOCK_TILES, TileTable, TileWindow

__all__ = [
    "HEIGHT_BLOCK",
    "box_sum",
    "layer_tags",
    "write_bands",
    "write_barred",
    "write_classes",
    "write_codes",
    "write_cost",
    "write_heightmap",
    "write_obstacles",
    "write_passage",
    "write_pixels",
    "write_reasons",
    "write_relief",
    "write_roughness",
    "write_speeds",
]

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
        pixels=_PIXELS,
        crs=Placement.of(table).height_crs,
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
        crs=place.horizontal_crs,
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
        crs=place.horizontal_crs,
        overviews="MODE",
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


def write_roughness(table: CostTable, path: Path, about: dict[str, str] | None = None) -> None:
    """Write roughness.tif: a float32 COG, one pixel per tile, one band for each of ``BANDS``, NaN if unknown.

    Parameters
    ----------
    table : CostTable
        The tiles.
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
    bands = [BandSpec(band.name, band.unit, band.description) for band in BANDS]
    names = tuple(band.name for band in BANDS)
    tags = layer_tags(table, "ride cost and roughness of each tile", about)
    write_bands(table, path, bands, tags, names, lambda found: [found[name] for name in names])


def write_classes(table: CostTable, path: Path, about: dict[str, str] | None = None) -> None:
    """Write class.tif: a uint8 COG, the class of each tile; ``NO_CLASS`` (nodata) if unknown.

    The colour table is in the TIFF itself; names, colours and pixel counts of the classes are in ``class.tif.aux.xml``.
    For parameters and errors see `write_roughness`.
    """
    band = BandSpec("class", text="0 (flattest) to 3 (roughest)", categories=CLASS_NAMES)
    write_codes(table, path, "class_id", band, CLASS_COLOURS, layer_tags(table, "roughness class of each tile", about))


def write_reasons(table: CostTable, path: Path, about: dict[str, str] | None = None) -> None:
    """Write reason.tif: a uint8 COG, why a tile has no class, a `Reason`; ``NO_CLASS`` (nodata) without points.

    Names, colours and pixel counts are in ``reason.tif.aux.xml``. For parameters and errors see `write_roughness`.
    """
    band = BandSpec("reason", text="why a tile has no class", categories=tuple(REASON_TEXT[code] for code in Reason))
    colours = {int(code): colour for code, colour in REASON_COLOURS.items() if code != Reason.NO_POINTS}
    colours[NO_CLASS] = REASON_COLOURS[Reason.NO_POINTS]
    write_codes(table, path, "reason", band, colours, layer_tags(table, "why tiles have no class", about))


def write_cost(table: CostTable, path: Path, about: dict[str, str] | None = None) -> None:
    """Write cost.tif: a float32 COG, one pixel per tile: the factor on distance, NaN if the tile is not passable.

    Overviews average the passable tiles. For parameters and errors see `write_roughness`.
    """
    rule = table.rule
    own = {
        "fail_weight_m": f"{rule.fail_weight:g}",
        "drive_m": f"{rule.drive_m:g}",
        "slope_limit_deg": f"{rule.slope_limit_deg:g}",
    }
    band = BandSpec("cost", text="factor on distance: 1 + ride_weight c_r + fail_weight hazard")
    tags = layer_tags(table, "cost of driving over each tile", own | (about or {}))

    def costs(found: dict[str, NDArray[Any]]) -> tuple[NDArray[np.float64]]:
        cost = rule.cost(found["c_r"].astype(np.float64), rule.hazard(found["p_fail"]))
        return (np.where(found["barred"] == 0, cost, np.nan),)

    write_bands(table, path, [band], tags, ("c_r", "p_fail", "barred"), costs)


def write_barred(table: CostTable, path: Path, about: dict[str, str] | None = None) -> None:
    """Write barred.tif: a uint8 COG, why a tile is not passable, a `Barred`; ``NO_CLASS`` (nodata) without points.

    Names, colours and pixel counts are in ``barred.tif.aux.xml``. For parameters and errors see `write_roughness`.
    """
    names = tuple(BARRED_TEXT[code] for code in Barred)
    band = BandSpec("barred", text="why the tile is not passable", categories=names)
    write_codes(table, path, "barred", band, BARRED_COLOURS, layer_tags(table, "why tiles are not passable", about))


def write_heightmap(table: CostTable, path: Path, about: dict[str, str] | None = None) -> None:
    """Write heightmap.tif: a float32 COG, the heightmaps of all tiles side by side, NaN in pixels without points.

    For parameters and errors see `write_roughness`.
    """
    place = Placement.of(table)
    pixels = place.grid.pixels
    spec = RasterSpec(
        bands=[BandSpec("height", "m", "mean height of the points in the pixel")],
        pixels=pixels,
        crs=place.height_crs,
        block=HEIGHT_BLOCK,
        tags=layer_tags(table, "height map", about),
        # On 56 million pixels, level 6 took twice the time of level 1 and saved 4 % of the bytes.
        level=1,
    )
    write_pixels(table, path, spec, ("heights",), lambda found, _: found["heights"])


def write_obstacles(table: CostTable, path: Path, about: dict[str, str] | None = None) -> None:
    """Write obstacle.tif: a uint8 COG with the pixels of heightmap.tif: free, obstacle, canopy or unknown.

    Pixels are unknown where no ground is known, and where objects are part of the relief because all points were
    measured as ground. For parameters and errors see `write_roughness`.
    """
    place = Placement.of(table)
    pixels = place.grid.pixels
    spec = RasterSpec(
        bands=[BandSpec("obstacle", text="what stands on the ground", categories=OBJECT_NAMES)],
        dtype="uint8",
        nodata=NO_CLASS,
        pixels=pixels,
        crs=place.horizontal_crs,
        overviews="MODE",
        block=HEIGHT_BLOCK,
        colours=OBJECT_COLOURS,
        tags=layer_tags(table, "obstacles", about),
        level=1,
        worst=(OBSTACLE, UNKNOWN_OBJECT, CANOPY, FREE),
    )

    def states(found: dict[str, NDArray[Any]], _: RasterWindow) -> NDArray[np.uint8]:
        objects = found["objects"]
        hidden = (objects == UNSEEN) | ((objects == FREE) & np.isnan(found["obstacle"])[:, None, None])
        return np.where(hidden, np.uint8(UNKNOWN_OBJECT), objects)

    write_pixels(table, path, spec, ("objects", "obstacle"), states)


def write_passage(table: CostTable, path: Path, about: dict[str, str] | None = None) -> None:
    """Write passage.tif: a uint8 COG with the pixels of heightmap.tif: where the middle of the vehicle can be.

    0: closed, because an obstacle, unseen ground or a tile that the ground bars is nearer than half the vehicle's width
    and its margin. From 1: the areas of a tile whose pixels hang together, the largest first. Areas of two tiles are
    joined where their pixels touch across the border. For parameters and errors see `write_roughness`.
    """
    place = Placement.of(table)
    spec = RasterSpec(
        bands=[
            BandSpec(
                "passage", text="areas of a tile in which the middle of the vehicle can move; 0 where it cannot be"
            )
        ],
        dtype="uint8",
        nodata=NO_CLASS,
        pixels=place.grid.pixels,
        crs=place.horizontal_crs,
        overviews="MODE",
        block=HEIGHT_BLOCK,
        tags=layer_tags(table, "where the vehicle fits", about),
        level=1,
        worst=tuple(range(NO_CLASS)),
    )
    write_pixels(table, path, spec, ("passage",), lambda found, _: found["passage"])


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
    bands = [BandSpec(band.name, band.unit, band.description) for band in speed_bands(table.speeds)]
    own = {"speeds_m_per_s": " ".join(f"{speed:g}" for speed in table.speeds)}
    tags = layer_tags(table, "pitch, roll and vertical acceleration at several speeds", own | (about or {}))
    write_bands(table, path, bands, tags, ("motion",), lambda found: found["motion"].T)
