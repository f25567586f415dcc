"""Outlines of regions in the survey's CRS, and on the globe: WGS 84 longitude and latitude."""

import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError

from bumpymap.errors import BadInputError
from bumpymap.products.regions import Regions

__all__ = ["bounding_box", "outlines_in_crs", "outlines_on_globe"]

_SEGMENT = 32
"""Longest straight piece of an outline, tiles. The middle of a 96 m side moves by at most 1.2 mm on the way to
longitude and latitude (measured up to 80 degrees north and south): less than the 7 decimals that are kept."""


def outlines_in_crs(regions: Regions) -> NDArray[np.object_]:
    """Outlines in units of the survey's CRS, (m,) polygons."""
    outlines: NDArray[np.object_] = shapely.transform(regions.outlines, regions.placement.to_crs)
    return outlines


def outlines_on_globe(regions: Regions, decimals: int = 7) -> NDArray[np.object_]:
    """Outlines in WGS 84 longitude and latitude, right-hand rings, cut where they cross the antimeridian.

    Parameters
    ----------
    regions : Regions
        Of a survey whose CRS is known.
    decimals : int
        Coordinates are rounded to so many; 7 are 1 cm.

    Returns
    -------
    array (m,) of polygons, or multipolygons where one was cut

    Raises
    ------
    BadInputError
        The CRS has no known relation to longitude and latitude.
    """
    to_degrees = _transformer(regions.placement.horizontal_crs)

    def move(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.column_stack(to_degrees.transform(points[:, 0], points[:, 1])).round(decimals)

    placed = shapely.transform(shapely.segmentize(regions.outlines, _SEGMENT), regions.placement.to_crs)
    outlines: NDArray[np.object_] = shapely.transform(placed, move)
    if not np.isfinite(shapely.bounds(outlines)).all():
        raise BadInputError(
            f"the survey's coordinates lie outside of what its CRS ({regions.placement.horizontal_crs}) can turn into "
            "longitude and latitude. Pass the right one with --crs EPSG:CODE, or --local"
        )
    return _cut_at_antimeridian(outlines, decimals)


def bounding_box(outlines: NDArray[np.object_]) -> list[float]:
    """West, south, east, north in degrees; where the antimeridian is inside, west is the greater one (RFC 7946 5.2)."""
    west, south, east, north = shapely.bounds(shapely.get_parts(outlines)).T
    low, high = float(west.min()), float(east.max())
    if low < -90.0 and high > 90.0:
        low, high = float(west[west > 0].min()), float(east[east < 0].max())
    return [low, float(south.min()), high, float(north.max())]


def _transformer(crs: CRS | None) -> Transformer:
    if crs is None:
        raise BadInputError(
            "the survey has no CRS, so cost.geojson cannot say where on Earth it is. Pass --crs EPSG:CODE, "
            "or --local to write it in the survey's own coordinates"
        )
    try:
        return Transformer.from_crs(crs, CRS.from_epsg(4326), always_xy=True)
    except ProjError as error:
        raise BadInputError(
            f"the survey's CRS ({crs.name}) has no known relation to longitude and latitude, so cost.geojson cannot "
            "say where on Earth it is. Pass another with --crs EPSG:CODE, or --local to keep its own coordinates"
        ) from error


def _cut_at_antimeridian(outlines: NDArray[np.object_], decimals: int) -> NDArray[np.object_]:
    bounds = shapely.bounds(outlines)
    crossing = bounds[:, 2] - bounds[:, 0] > 180.0
    if not crossing.any():
        return outlines

    def unwrap(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.column_stack([np.where(points[:, 0] < 0, points[:, 0] + 360.0, points[:, 0]), points[:, 1]])

    whole = shapely.transform(outlines[crossing], unwrap)
    west_side = shapely.intersection(whole, shapely.box(0.0, -90.0, 180.0, 90.0))
    east_side = shapely.intersection(whole, shapely.box(180.0, -90.0, 360.0, 90.0))
    west_side = shapely.transform(west_side, lambda points: points.round(decimals))
    east_side = shapely.transform(east_side, lambda points: (points - [360.0, 0.0]).round(decimals))
    parts = [shapely.get_parts(shapely.normalize(pair)) for pair in zip(west_side, east_side, strict=True)]
    cut = outlines.copy()
    cut[crossing] = [shapely.reverse(shapely.multipolygons(part)) for part in parts]
    return cut
