"""The cost of driving pixel by pixel, with what stops the vehicle grown by half its width: for least-cost tools."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import OPEN_THROUGH, BadInputError
from bumpymap.layers._cog import write_cog
from bumpymap.layers._raster_spec import BandSpec, RasterSpec
from bumpymap.layers.export.area import ExportArea
from bumpymap.layers.placement import Placement, RasterWindow

__all__ = ["COST_NAME", "write_pixel_cost"]

COST_NAME = "cost.tif"
_BLOCK = 512
_WINDOW_TILES = 64


def write_pixel_cost(folder: Path, area: ExportArea) -> dict[str, Any]:
    """Write cost.tif: a float32 COG, the cost of a metre on each pixel, NaN where the middle of the vehicle cannot be.

    Raises
    ------
    BadInputError
        The vehicle fits nowhere in the area.
    """
    site = area.route_map
    pixels, free = site.grid.pixels, 0

    def paint(window: RasterWindow) -> NDArray[np.float32]:
        nonlocal free
        field = site.read(window.tiles, ("c_r", "p_fail"))
        cost = field.rule.cost(field.c_r.astype(np.float64), field.rule.hazard(field.p_fail)).astype(np.float32)
        cost[~np.isin(field.barred, OPEN_THROUGH)] = np.nan
        out = np.repeat(np.repeat(cost, pixels, 0), pixels, 1)
        out[~site.passage(window.tiles) | ~np.isfinite(out)] = np.nan
        free += int(np.isfinite(out).sum())
        return out[None]

    place = Placement(site.georeference, site.grid, area.window)
    spec = RasterSpec(
        bands=[BandSpec("cost", text="factor on distance where the middle of the vehicle can be")],
        dtype="float32",
        nodata=float("nan"),
        pixels=pixels,
        crs=place.horizontal_crs,
        overviews="AVERAGE",
        block=_BLOCK,
        tags={"title": "cost of driving over each pixel", "vehicle": site.vehicle.name},
        level=1,
    )
    write_cog(folder / COST_NAME, place, spec, paint, _WINDOW_TILES)
    if not free:
        raise BadInputError("the vehicle fits nowhere in the area, so no robot can drive there. Choose another area")
    return {"pixels": free, "pixel_m": site.grid.pixel_size}
