"""Write the raster layers: roughness, class, reason, cost, barred, heightmap, obstacle and passage."""

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
from bumpymap.layers._raster_spec import BandSpec, RasterSpec
from bumpymap.layers._tile_bands import write_bands, write_codes
from bumpymap.layers._tile_pixels import HEIGHT_BLOCK, layer_tags, write_pixels
from bumpymap.layers.colours import BARRED_COLOURS, CLASS_COLOURS, OBJECT_COLOURS, REASON_COLOURS, UNKNOWN_OBJECT
from bumpymap.layers.placement import Placement, RasterWindow

__all__ = [
    "write_barred",
    "write_classes",
    "write_cost",
    "write_heightmap",
    "write_obstacles",
    "write_passage",
    "write_reasons",
    "write_roughness",
]


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
        dtype="float32",
        nodata=float("nan"),
        pixels=pixels,
        crs=place.height_crs,
        overviews="AVERAGE",
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
