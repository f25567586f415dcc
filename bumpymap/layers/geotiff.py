"""Write the raster layers: roughness.tif, class.tif, cost.tif, heightmap.tif."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BANDS, CLASS_NAMES, NO_CLASS, PASSABLE_COLUMNS, REASON_TEXT, CostTable, Reason
from bumpymap.layers._cog import BandSpec, RasterSpec, write_cog
from bumpymap.layers.placement import Placement, RasterWindow
from bumpytiles import BLOCK_TILES, TileTable

__all__ = ["CLASS_COLOURS", "write_classes", "write_cost", "write_heightmap", "write_roughness"]

CLASS_COLOURS: dict[int, tuple[int, int, int, int]] = {
    0: (44, 123, 182, 255),
    1: (171, 217, 233, 255),
    2: (253, 174, 97, 255),
    3: (215, 25, 28, 255),
    NO_CLASS: (0, 0, 0, 0),
}
"""Red, green, blue, alpha of each class, from blue (smooth) to red (very rough); safe for colour-blind readers."""

_TILE_BLOCK = 128
_HEIGHT_BLOCK = 512
_TILE_WINDOW = 16 * BLOCK_TILES
"""Side of a window, tiles: whole blocks, so that none is read twice."""
_WINDOW_PIXELS = 1024
"""Side of a window of heightmap.tif, pixels; rounded down to whole blocks, at least one."""


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
    place = Placement.of(table)
    gaps = {band.name: np.nan for band in BANDS}
    spec = RasterSpec(
        bands=[BandSpec(band.name, band.unit, band.description) for band in BANDS],
        dtype="float32",
        nodata=float("nan"),
        pixels=1,
        crs=place.horizontal_crs,
        overviews="AVERAGE",
        block=_TILE_BLOCK,
        tags=_tags(table, "ride cost and roughness of each tile", about),
    )
    write_cog(path, place, spec, _painter(table.tiles, gaps, "float32"), _TILE_WINDOW)


def write_classes(table: CostTable, path: Path, about: dict[str, str] | None = None) -> None:
    """Write class.tif: a uint8 COG; band 1 is the class, ``NO_CLASS`` (nodata) if unknown, band 2 the reason.

    Category names are in ``class.tif.aux.xml``, where GDAL keeps them; the colour table is in the TIFF itself.
    For parameters and errors see `write_roughness`.
    """
    place = Placement.of(table)
    spec = RasterSpec(
        bands=[
            BandSpec("class", text="0 (flattest) to 3 (roughest)", categories=CLASS_NAMES),
            BandSpec("reason", text="why a tile has no class", categories=tuple(REASON_TEXT[code] for code in Reason)),
        ],
        dtype="uint8",
        nodata=NO_CLASS,
        pixels=1,
        crs=place.horizontal_crs,
        overviews="MODE",
        block=_TILE_BLOCK,
        colours=CLASS_COLOURS,
        tags=_tags(table, "roughness class of each tile", about),
        write_empty=True,  # tiles without points have a reason too
    )
    gaps = {"class_id": NO_CLASS, "reason": Reason.NO_POINTS}
    write_cog(path, place, spec, _painter(table.tiles, gaps, "uint8", write_empty=True), _TILE_WINDOW)


def write_cost(table: CostTable, path: Path, about: dict[str, str] | None = None) -> None:
    """Write cost.tif: a float32 COG, one pixel per tile: the factor on distance, NaN if the tile is not passable.

    Overviews average the passable tiles. For parameters and errors see `write_roughness`.
    """
    place = Placement.of(table)
    rule = table.rule
    own = {
        "fail_weight_m": f"{rule.fail_weight:g}",
        "drive_m": f"{rule.drive_m:g}",
        "slope_limit_deg": f"{rule.slope_limit_deg:g}",
    }
    spec = RasterSpec(
        bands=[BandSpec("cost", text="factor on distance: 1 + ride_weight c_r + fail_weight hazard")],
        dtype="float32",
        nodata=float("nan"),
        pixels=1,
        crs=place.horizontal_crs,
        overviews="AVERAGE",
        block=_TILE_BLOCK,
        tags=_tags(table, "cost of driving over each tile", own | (about or {})),
    )

    def paint(window: RasterWindow) -> NDArray[np.float32] | None:
        if not table.tiles.holds(window.tiles):
            return None
        found = table.tiles.read(PASSABLE_COLUMNS, window.tiles)
        cost = rule.cost(found["c_r"].astype(np.float64), rule.hazard(found["p_fail"]))
        canvas = np.full((1, window.tiles.rows, window.tiles.cols), np.nan, dtype=np.float32)
        canvas[0][window.pixel_indices(found)] = np.where(rule.passable(found), cost, np.nan)
        return canvas

    write_cog(path, place, spec, paint, _TILE_WINDOW)


def write_heightmap(table: CostTable, path: Path, about: dict[str, str] | None = None) -> None:
    """Write heightmap.tif: a float32 COG, the heightmaps of all tiles side by side, NaN in pixels without points.

    For parameters and errors see `write_roughness`.
    """
    place = Placement.of(table)
    pixels = place.grid.pixels
    spec = RasterSpec(
        bands=[BandSpec("height", "m", "mean height of the points in the pixel")],
        dtype="float32",
        nodata=float("nan"),
        pixels=pixels,
        crs=place.height_crs,
        overviews="AVERAGE",
        block=_HEIGHT_BLOCK,
        tags=_tags(table, "height map", about),
        # On 56 million pixels, level 6 took twice the time of level 1 and saved 4 % of the bytes.
        level=1,
    )

    def paint(window: RasterWindow) -> NDArray[np.float32] | None:
        if not table.tiles.holds(window.tiles):
            return None
        found = table.tiles.read(("heights",), window.tiles)
        line, column = window.pixel_indices(found)
        lines, columns = window.tiles.rows, window.tiles.cols
        canvas = np.full((lines, pixels, columns, pixels), np.nan, dtype=np.float32)
        canvas[line, :, column, :] = found["heights"]
        return canvas.reshape(1, lines * pixels, columns * pixels)

    write_cog(path, place, spec, paint, max(1, _WINDOW_PIXELS // (BLOCK_TILES * pixels)) * BLOCK_TILES)


def _painter(
    tiles: TileTable, gaps: Mapping[str, float], dtype: str, *, write_empty: bool = False
) -> Callable[[RasterWindow], NDArray[np.generic] | None]:
    """Return a function that paints one value per tile and band; ``gaps`` are the values of pixels without a tile."""

    def paint(window: RasterWindow) -> NDArray[np.generic] | None:
        if not (write_empty or tiles.holds(window.tiles)):
            return None
        canvas = np.empty((len(gaps), window.tiles.rows, window.tiles.cols), dtype=dtype)
        found = tiles.read(tuple(gaps), window.tiles)
        place = window.pixel_indices(found)
        for band, (name, gap) in zip(canvas, gaps.items(), strict=True):
            band[...] = gap
            band[place] = found[name]
        return canvas

    return paint


def _tags(table: CostTable, title: str, about: dict[str, str] | None) -> dict[str, str]:
    grid = table.tiles.grid
    own = {
        "title": title,
        "tile_size_m": f"{grid.tile_size:g}",
        "ride_weight_m_per_rad": f"{table.rule.ride_weight:g}",
    }
    return own | (about or {})
