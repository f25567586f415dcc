"""Write the raster layers: roughness, class, reason, cost, barred, heightmap and obstacle."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

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
)
from bumpymap.layers._cog import write_cog
from bumpymap.layers._raster_spec import BandSpec, RasterSpec
from bumpymap.layers.colours import BARRED_COLOURS, CLASS_COLOURS, OBJECT_COLOURS, REASON_COLOURS, UNKNOWN_OBJECT
from bumpymap.layers.placement import Placement, RasterWindow
from bumpytiles import BLOCK_TILES, TileTable

__all__ = [
    "write_barred",
    "write_classes",
    "write_cost",
    "write_heightmap",
    "write_obstacles",
    "write_reasons",
    "write_roughness",
]

_TILE_BLOCK = 128
_HEIGHT_BLOCK = 512
_TILE_WINDOW = 16 * BLOCK_TILES
"""Side of a window, tiles: whole blocks, so that none is read twice."""
_WINDOW_PIXELS = 1024
"""Side of a window of heightmap.tif, pixels; rounded down to whole blocks, at least one."""

_SPARSE = 0.1
"""Below this share of tiles with points in its extent a survey is sparse: then heightmap.tif and obstacle.tif have
smaller blocks, and those without values are not made."""


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
    """Write class.tif: a uint8 COG, the class of each tile; ``NO_CLASS`` (nodata) if unknown.

    The colour table is in the TIFF itself; names, colours and pixel counts of the classes are in ``class.tif.aux.xml``.
    For parameters and errors see `write_roughness`.
    """
    band = BandSpec("class", text="0 (flattest) to 3 (roughest)", categories=CLASS_NAMES)
    _write_codes(table, path, "class_id", band, CLASS_COLOURS, _tags(table, "roughness class of each tile", about))


def write_reasons(table: CostTable, path: Path, about: dict[str, str] | None = None) -> None:
    """Write reason.tif: a uint8 COG, why a tile has no class, a `Reason`; ``NO_CLASS`` (nodata) without points.

    Names, colours and pixel counts are in ``reason.tif.aux.xml``. For parameters and errors see `write_roughness`.
    """
    band = BandSpec("reason", text="why a tile has no class", categories=tuple(REASON_TEXT[code] for code in Reason))
    colours = {int(code): colour for code, colour in REASON_COLOURS.items() if code != Reason.NO_POINTS}
    colours[NO_CLASS] = REASON_COLOURS[Reason.NO_POINTS]
    _write_codes(table, path, "reason", band, colours, _tags(table, "why tiles have no class", about))


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
        found = table.tiles.read(("c_r", "p_fail", "barred"), window.tiles)
        cost = rule.cost(found["c_r"].astype(np.float64), rule.hazard(found["p_fail"]))
        canvas = np.full((1, window.tiles.rows, window.tiles.cols), np.nan, dtype=np.float32)
        canvas[0][window.pixel_indices(found)] = np.where(found["barred"] == 0, cost, np.nan)
        return canvas

    write_cog(path, place, spec, paint, _TILE_WINDOW)


def write_barred(table: CostTable, path: Path, about: dict[str, str] | None = None) -> None:
    """Write barred.tif: a uint8 COG, why a tile is not passable, a `Barred`; ``NO_CLASS`` (nodata) without points.

    Names, colours and pixel counts are in ``barred.tif.aux.xml``. For parameters and errors see `write_roughness`.
    """
    names = tuple(BARRED_TEXT[code] for code in Barred)
    band = BandSpec("barred", text="why the tile is not passable", categories=names)
    _write_codes(table, path, "barred", band, BARRED_COLOURS, _tags(table, "why tiles are not passable", about))


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
    _write_pixels(table, path, spec, ("heights",), lambda found: found["heights"])


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
        block=_HEIGHT_BLOCK,
        colours=OBJECT_COLOURS,
        tags=_tags(table, "obstacles", about),
        level=1,
        worst=(OBSTACLE, UNKNOWN_OBJECT, CANOPY, FREE),
    )

    def states(found: dict[str, NDArray[Any]]) -> NDArray[np.uint8]:
        objects = found["objects"]
        hidden = (objects == UNSEEN) | ((objects == FREE) & np.isnan(found["obstacle"])[:, None, None])
        return np.where(hidden, np.uint8(UNKNOWN_OBJECT), objects)

    _write_pixels(table, path, spec, ("objects", "obstacle"), states)


def _write_codes(
    table: CostTable,
    path: Path,
    column: str,
    band: BandSpec,
    colours: Mapping[int, tuple[int, int, int, int]],
    tags: dict[str, str],
) -> None:
    """Write a uint8 raster with one pixel per tile: a column of codes, ``NO_CLASS`` without a tile."""
    place = Placement.of(table)
    spec = RasterSpec(
        bands=[band],
        dtype="uint8",
        nodata=NO_CLASS,
        pixels=1,
        crs=place.horizontal_crs,
        overviews="MODE",
        block=_TILE_BLOCK,
        colours=dict(colours),
        tags=tags,
        counts_nodata=True,
    )
    write_cog(path, place, spec, _painter(table.tiles, {column: NO_CLASS}, "uint8"), _TILE_WINDOW)


def _write_pixels(
    table: CostTable,
    path: Path,
    spec: RasterSpec,
    names: tuple[str, ...],
    values: Callable[[dict[str, NDArray[Any]]], NDArray[Any]],
) -> None:
    """Write a raster with pixels in each tile; ``values`` makes them, (n, pixels, pixels), of the columns ``names``."""
    place, pixels = Placement.of(table), spec.pixels

    def pieces(window: RasterWindow) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[Any]]:
        found = table.tiles.read(names, window.tiles)
        return *window.pixel_indices(found), values(found)

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


def _painter(
    tiles: TileTable, gaps: Mapping[str, float], dtype: str
) -> Callable[[RasterWindow], NDArray[np.generic] | None]:
    """Return a function that paints one value per tile and band; ``gaps`` are the values of pixels without a tile."""

    def paint(window: RasterWindow) -> NDArray[np.generic] | None:
        if not tiles.holds(window.tiles):
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
