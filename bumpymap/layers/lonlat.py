"""Outlines of regions in the survey's CRS and in WGS 84 longitude and latitude."""

import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError

from bumpymap.core import BadInputError
from bumpymap.layers.placement import Placement
from bumpymap.layers.regions import Regions

__all__ = ["BoundingBox", "outlines_in_crs", "polygons_in_wgs84", "wgs84_transformer"]

_TRIES = 33
"""Points along each side of the raster at which the transformation is tried first."""

_SEGMENT = 32
"""Longest straight segment of an outline, tiles. In longitude and latitude, the middle of a 96 m segment is off by at
most 1.2 mm (measured up to 80 degrees north and south): less than the 7 decimals that are kept."""

_GRID_DECIMALS = 9


def outlines_in_crs(regions: Regions) -> NDArray[np.object_]:
    """Return the outlines in units of the survey's CRS, (m,) polygons."""
    outlines: NDArray[np.object_] = shapely.transform(regions.outlines, regions.placement.to_crs)
    return outlines


def wgs84_transformer(placement: Placement) -> Transformer:
    """Return the transformer from the survey's CRS to WGS 84 longitude and latitude, tried on points of the raster.

    Raises
    ------
    BadInputError
        There is no CRS, or no known transformation from it to longitude and latitude at this place.
    """
    transformer = _transformer(placement.horizontal_crs)
    window = placement.window
    cols, rows = np.meshgrid(
        np.linspace(window.col, window.col + window.cols, _TRIES),
        np.linspace(window.row, window.row + window.rows, _TRIES),
    )
    if not np.isfinite(transformer.transform(placement.to_crs(cols.ravel()), placement.to_crs(rows.ravel()))).all():
        raise _outside(placement)
    return transformer


def polygons_in_wgs84(
    polygons: NDArray[np.object_], placement: Placement, to_degrees: Transformer, decimals: int = 7
) -> NDArray[np.object_]:
    """Return polygons in WGS 84 longitude and latitude, right-hand rings, cut at the antimeridian.

    Polygons with the same vertices along their common borders keep this property, on either side of the antimeridian.

    Parameters
    ----------
    polygons : array (m,) of polygons
        In grid coordinates (1 = one tile), with sides along the sides of tiles.
    placement : Placement
        Of a survey with a CRS.
    to_degrees : Transformer
        From `wgs84_transformer`.
    decimals : int
        Decimals to round coordinates to; 7 are 1 cm.

    Returns
    -------
    array (m,) of polygons
        A multipolygon for each outline that was cut.

    Raises
    ------
    BadInputError
        A point cannot be transformed to longitude and latitude.
    """

    def move(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.column_stack(to_degrees.transform(points[:, 0], points[:, 1])).round(decimals)

    # The points in between are rounded because those of a side in one direction and the other differ in the last bit.
    split = shapely.segmentize(polygons, _SEGMENT)
    placed = shapely.transform(split, lambda points: placement.to_crs(points.round(_GRID_DECIMALS)))
    outlines: NDArray[np.object_] = shapely.transform(placed, move)
    if not np.isfinite(shapely.bounds(outlines)).all():
        raise _outside(placement)
    return _cut_at_antimeridian(outlines, decimals)


class BoundingBox:
    """Running bounding box of outlines."""

    def __init__(self) -> None:
        self._boxes = np.empty((0, 4))

    def add(self, outlines: NDArray[np.object_]) -> None:
        """Include outlines; those with x > 0 (east of Greenwich) are kept apart from the others."""
        boxes = np.concatenate([self._boxes, shapely.bounds(shapely.get_parts(outlines))])
        sides = [boxes[boxes[:, 0] > 0], boxes[boxes[:, 0] <= 0]]
        self._boxes = np.array([[*side[:, :2].min(0), *side[:, 2:].max(0)] for side in sides if len(side)])

    def bounds(self) -> list[float]:
        """Return west, south, east, north."""
        return [*map(float, self._boxes[:, :2].min(0)), *map(float, self._boxes[:, 2:].max(0))]

    def bounds_in_wgs84(self) -> list[float]:
        """Return the bounds in degrees; if the box crosses the antimeridian, west exceeds east (RFC 7946, 5.2)."""
        west, south, east, north = self.bounds()
        if west < -90.0 and east > 90.0 and len(self._boxes) == 2:
            west, east = float(self._boxes[0, 0]), float(self._boxes[1, 2])
        return [west, south, east, north]


def _outside(placement: Placement) -> BadInputError:
    return BadInputError(
        f"the survey's coordinates lie outside the area where its CRS ({placement.horizontal_crs}) can be converted to "
        "longitude and latitude. Pass the right one with `force_crs='EPSG:CODE'`, or `local=True`"
    )


def _transformer(crs: CRS | None) -> Transformer:
    if crs is None:
        raise BadInputError(
            "the survey has no CRS, so cost.geojson cannot say where on Earth it is. Pass `crs='EPSG:CODE'`, "
            "or `local=True` to write it in the survey's own coordinates"
        )
    try:
        return Transformer.from_crs(crs, CRS.from_epsg(4326), always_xy=True)
    except ProjError as error:
        raise BadInputError(
            f"the survey's CRS ({crs.name}) has no known relation to longitude and latitude, so cost.geojson cannot "
            "say where on Earth it is. Pass another with `force_crs='EPSG:CODE'`, or `local=True` to keep its own "
            "coordinates"
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
    cut = outlines.copy()
    cut[crossing] = [_polygons_of(pair) for pair in zip(west_side, east_side, strict=True)]
    return cut


def _polygons_of(sides: tuple[shapely.Geometry, shapely.Geometry]) -> shapely.MultiPolygon:
    """Join what lies on both sides of the antimeridian, without points and lines of outlines that only touch it."""
    parts = shapely.get_parts(shapely.normalize(np.array(sides)))
    return shapely.reverse(shapely.multipolygons(parts[shapely.area(parts) > 0]))
