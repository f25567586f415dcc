"""Cost of cells for other tools: pixel by pixel with obstacles grown; for occupancy grids, unknown is not free."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import NO_TILE, OBSTACLE, OPEN_THROUGH, UNDECIDED, UNSEEN, BadInputError, Barred, TileField
from bumpymap.layers._cog import write_cog
from bumpymap.layers.export.area import ExportArea
from bumpymap.layers.placement import BandSpec, Placement, RasterSpec, RasterWindow

__all__ = [
    "COST_NAME",
    "DEAREST",
    "FREE_CELL",
    "LETHAL",
    "SLOWEST",
    "UNKNOWN_CELL",
    "CostScale",
    "cost_values",
    "keepout_values",
    "lay_objects",
    "passable_cost",
    "speed_values",
    "write_pixel_cost",
]

FREE_CELL, LETHAL, UNKNOWN_CELL = 0, 100, 255
"""Cells of an occupancy grid in mode ``raw``; map_server reads all values over 100 as unknown (-1)."""
DEAREST = 98
"""Value of the dearest passable tile. Not 99: newer costmaps read that as the inscribed radius of an obstacle."""
SLOWEST = 1
"""Least speed limit, percent. Not 0: the speed filter reads that as no limit."""


@dataclass(frozen=True, slots=True)
class CostScale:
    """How cost per metre becomes 0..98, linearly: 0 is cost 1 (smooth and safe), 98 is ``dearest`` and all above."""

    dearest: float

    def values(self, cost: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the values of costs, rounded; NaN where the cost is."""
        span = max(self.dearest - 1.0, np.finfo(np.float64).tiny)
        return np.clip(np.rint(DEAREST * (np.clip(cost, 1.0, self.dearest) - 1.0) / span), FREE_CELL, DEAREST)


def passable_cost(field: TileField) -> NDArray[np.float64]:
    """Return the cost per metre of passable tiles, (rows, cols), at the weights of the layers; NaN elsewhere."""
    cost = field.rule.cost(field.c_r.astype(np.float64), field.rule.hazard(field.p_fail))
    return np.where(field.barred == Barred.NO, cost, np.nan)


def cost_values(field: TileField, scale: CostScale) -> NDArray[np.uint8]:
    """Return cells for an occupancy grid in mode ``raw``, one a tile.

    Returns
    -------
    uint8 (rows, cols)
        0..98 by cost, 100 where the tile is known not to be passable, 255 where it is unknown or there is no tile.
    """
    cost = passable_cost(field)
    graded = np.where(np.isnan(cost), UNKNOWN_CELL, scale.values(cost)).astype(np.uint8)
    unknown = (field.barred == Barred.UNKNOWN) | (field.barred == NO_TILE)
    choices = [np.uint8(UNKNOWN_CELL), np.uint8(LETHAL)]
    return np.select([unknown, field.barred != Barred.NO], choices, graded)


def keepout_values(field: TileField) -> NDArray[np.uint8]:
    """Return a keepout mask, one cell a tile: 0 where the tile is passable, 100 elsewhere.

    Unknown tiles are 100 too: the keepout filter skips cells of a mask that are unknown.
    """
    return np.where(np.isnan(passable_cost(field)), LETHAL, FREE_CELL).astype(np.uint8)


def speed_values(field: TileField, comfort: float) -> NDArray[np.uint8]:
    """Return a speed mask, one cell a tile: percent of the profile's speed at which the ride stays under a limit.

    Parameters
    ----------
    field : TileField
    comfort : float
        Most pitch motion, rad/s. At v m/s, ground with a ride cost of c_r rad/m gives c_r v rad/s.

    Returns
    -------
    uint8 (rows, cols)
        1..100, rounded down. 1 where c_r is unknown, and where even that is too fast.
    """
    with np.errstate(divide="ignore"):
        percent = np.floor(100.0 * comfort / (field.c_r.astype(np.float64) * field.vehicle.speed_mps))
    limited = np.clip(np.nan_to_num(percent, nan=SLOWEST, posinf=100.0), SLOWEST, 100)
    return np.asarray(limited, np.uint8)


def lay_objects(
    cells: NDArray[np.uint8], objects: NDArray[np.uint8], judged: NDArray[np.bool_], unknown: int
) -> NDArray[np.uint8]:
    """Split the cells of tiles into pixels, and lay obstacles and unseen ground on them.

    Parameters
    ----------
    cells : uint8 (rows, cols)
        Of the tiles.
    objects : uint8 (rows * pixels, cols * pixels)
        Of obstacle.tif.
    judged : bool (rows, cols)
        Whether objects were told from ground in the tile. Else they are part of its relief and in its ride cost, and
        its pixels keep the value of the tile.
    unknown : int
        Value of pixels of passable tiles where neither ground nor anything else was seen.

    Returns
    -------
    uint8 (rows * pixels, cols * pixels)
        100 at obstacles, of unknown tiles too. Canopy is free: the vehicle fits under it.
    """
    pixels = objects.shape[0] // cells.shape[0]
    fine = np.repeat(np.repeat(cells, pixels, axis=0), pixels, axis=1)
    told = np.repeat(np.repeat(judged, pixels, axis=0), pixels, axis=1)
    fine[((objects == UNDECIDED) | (objects == UNSEEN)) & told & (fine < LETHAL)] = unknown
    fine[objects == OBSTACLE] = LETHAL
    return fine


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
