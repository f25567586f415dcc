"""Areas that routes avoid or keep within: polygons of a user's file, and the tiles that they touch or hold."""

import logging
import os
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError

from bumpymap.core import BadInputError, describe_crs
from bumpymap.layers.route_map import RouteMap
from bumpymap.layers.route_vectors import read_vectors
from bumpytiles import Grid, TileWindow

__all__ = ["read_areas", "tiles_in", "tiles_within"]

_log = logging.getLogger(__name__)

_GEOJSON = (".geojson", ".json")
_SUFFIXES = (*_GEOJSON, ".gpkg", ".fgb", ".shp")
_POLYGONS = (shapely.GeometryType.POLYGON, shapely.GeometryType.MULTIPOLYGON)
_ROUNDING = 1e-6
"""Length that is no overlap, in tiles: areas that share a border with a tile neither touch it nor leave it out."""
_STEPS = 4096
"""Parts that an edge as long as the map is cut into before it is converted: a straight line of another CRS is bent."""
_BEYOND = 0.25
"""How far around the map areas are kept, in lengths of its sides."""
_NEAR_M = 5000.0
"""How far from the map areas may lie whose numbers are thought to be swapped, m."""


def read_areas(
    path: str | os.PathLike[str], route_map: RouteMap, *, allow_outside: bool = False
) -> NDArray[np.object_]:
    """Read polygons and place them on the grid of a map.

    Their CRS is the one that the file states; a GeoJSON that states none is in longitude and latitude, or in the map's
    CRS if its numbers cannot be degrees. If the map has no CRS, they must be in the survey's own coordinates: a file
    without a CRS, or a GeoJSON.

    Parameters
    ----------
    path : path
        GeoJSON, GeoPackage, FlatGeobuf or Shapefile.
    route_map : RouteMap
    allow_outside : bool
        Whether it is no error that no area lies on the map.

    Returns
    -------
    array (n,) of shapely polygons
        In metres on the grid, cut off somewhat beyond the map; empty if none lies on it, which is logged as a warning.

    Raises
    ------
    BadInputError
        The file is missing, damaged or of another format, holds something else than polygons, or states no CRS while
        the map has one, or one while the map has none; or no area lies on the map.
    """
    path = Path(path)
    if not path.is_file() or path.suffix.lower() not in _SUFFIXES:
        what = "is not a file of polygons that can be read" if path.is_file() else "is missing"
        raise BadInputError(f"{path} {what}. Give polygons as {', '.join(_SUFFIXES)}")
    layer = read_vectors(path)
    kinds = shapely.get_type_id(layer.geometry)
    if not len(kinds) or not np.isin(kinds, _POLYGONS).all():
        held = "nothing" if not len(kinds) else shapely.GeometryType(int(kinds[~np.isin(kinds, _POLYGONS)][0])).name
        raise BadInputError(f"{path} holds {held.lower()}; areas must be polygons. Draw polygons and save them alone")
    areas = _on_map(path, layer.geometry, layer.crs, route_map)
    if not len(areas):
        hint = ""
        if _near_swapped(layer.geometry, route_map):
            hint = "They would if x (east) and y (north), or longitude and latitude, changed places. "
        said = f"no area of {path}, read in {_system(layer.crs, route_map)}, lies on the map. {hint}"
        if not allow_outside:
            raise BadInputError(
                f"{said}Give areas on the map, or pass `allow_outside=True` if there need be none, as when one file "
                "serves several maps"
            )
        _log.warning("%s", said.strip())
    return areas


def _on_map(path: Path, geometry: NDArray[np.object_], crs: CRS | None, route_map: RouteMap) -> NDArray[np.object_]:
    """Return the polygons that lie on the map, in metres on the grid."""
    placed = _on_grid(path, shapely.make_valid(geometry), crs, route_map)
    areas: NDArray[np.object_] = shapely.get_parts(placed)
    areas = areas[np.isin(shapely.get_type_id(areas), _POLYGONS) & ~shapely.is_empty(areas)]
    return np.asarray(areas[shapely.intersects(areas, _outline(route_map))], object)


def _near_swapped(geometry: NDArray[np.object_], route_map: RouteMap) -> bool:
    """Return whether a corner lies near the map if its two numbers change places, as degrees or in the map's CRS."""
    x, y = shapely.get_coordinates(geometry).T[::-1]
    places = [route_map.to_grid(x, y)]
    degrees = (np.abs(x) <= 180.0) & (np.abs(y) <= 90.0)
    if route_map.has_crs and degrees.any():
        places.append(route_map.from_lonlat(x[degrees], y[degrees]))
    near = shapely.buffer(_outline(route_map), _NEAR_M)
    return any(bool(shapely.intersects_xy(near, *place).any()) for place in places)


def _system(crs: CRS | None, route_map: RouteMap) -> str:
    own = route_map.georeference.crs
    if own is None:
        return "the survey's own coordinates"
    return describe_crs(own.to_2d()) if crs is None else crs.name


def tiles_in(areas: NDArray[np.object_], window: TileWindow, grid: Grid) -> NDArray[np.bool_]:
    """Return which tiles an area touches, be it by a corner; sharing a border is not touching.

    Parameters
    ----------
    areas : array (n,) of polygons
        In metres on the grid.
    window : TileWindow
    grid : Grid

    Returns
    -------
    bool (rows, cols)
    """
    whole = _local(areas, window, grid)
    inside, rows, cols = _centres_inside(whole, window)
    inside[rows, cols] = shapely.intersects(whole, _tiles(rows, cols))
    return inside


def tiles_within(areas: NDArray[np.object_], window: TileWindow, grid: Grid) -> NDArray[np.bool_]:
    """Return which tiles lie wholly in the areas, taken together; for parameters see `tiles_in`."""
    whole = _local(areas, window, grid)
    inside, rows, cols = _centres_inside(whole, window)
    inside[rows, cols] = shapely.covers(whole, _tiles(rows, cols))
    return inside


def _local(areas: NDArray[np.object_], window: TileWindow, grid: Grid) -> shapely.Geometry:
    """Return the areas as one geometry in tiles east and south of the window's north-west corner, cut to the window."""
    origin = np.array([window.col, window.row + window.rows]) * grid.tile_size
    placed = shapely.transform(np.asarray(areas, object), lambda xy: (xy - origin) / (grid.tile_size, -grid.tile_size))
    near = shapely.intersection(placed, shapely.box(-1.0, -1.0, window.cols + 1.0, window.rows + 1.0))
    whole: shapely.Geometry = shapely.union_all(near)
    shapely.prepare(whole)
    return whole


def _centres_inside(
    whole: shapely.Geometry, window: TileWindow
) -> tuple[NDArray[np.bool_], NDArray[np.int64], NDArray[np.int64]]:
    """Return which tiles have their centre inside, and rows and columns of those near an outline, to be looked at.

    GDAL is fast and looks at centres; the tiles near the outlines are few and left to exact tests.
    """
    from rasterio.features import rasterize

    shape = (window.rows, window.cols)
    outline = shapely.boundary(whole)
    if shapely.is_empty(whole):
        return np.zeros(shape, bool), np.empty(0, np.int64), np.empty(0, np.int64)
    inside = rasterize([whole], shape, dtype="uint8").astype(bool)
    near = rasterize([outline], shape, all_touched=True, dtype="uint8").astype(bool)
    wide = near.copy()  # one tile more on all sides, for what GDAL rounds
    wide[1:] |= near[:-1]
    wide[:-1] |= near[1:]
    near = wide.copy()
    wide[:, 1:] |= near[:, :-1]
    wide[:, :-1] |= near[:, 1:]
    rows, cols = np.nonzero(wide)
    return inside, rows, cols


def _tiles(rows: NDArray[np.int64], cols: NDArray[np.int64]) -> NDArray[np.object_]:
    """Return the squares of tiles, smaller by what rounding may do."""
    squares: NDArray[np.object_] = shapely.box(
        cols + _ROUNDING, rows + _ROUNDING, cols + 1.0 - _ROUNDING, rows + 1.0 - _ROUNDING
    )
    return squares


def _outline(route_map: RouteMap) -> shapely.Geometry:
    """Return the rectangle of the map, m."""
    bounds = route_map.grid.window_bounds(route_map.window)
    return shapely.box(bounds.west, bounds.south, bounds.east, bounds.north)


def _on_grid(path: Path, geometry: NDArray[np.object_], crs: CRS | None, route_map: RouteMap) -> NDArray[np.object_]:
    """Convert geometries of a file to metres on the grid."""
    own, unit = route_map.georeference.crs, route_map.georeference.metres_per_unit
    if own is None:
        if crs is not None and path.suffix.lower() not in _GEOJSON:  # a GeoJSON can only state longitude and latitude
            raise BadInputError(
                f"{path} is in {crs.name}, and the map has no CRS. Save the areas in the survey's own coordinates and "
                "without a CRS, or map the survey with `crs='EPSG:CODE'`"
            )
        return np.asarray(shapely.transform(geometry, lambda xy: xy * unit), object)
    if crs is None and path.suffix.lower() in _GEOJSON:
        _log.warning("the numbers of %s cannot be degrees: they are read in %s", path, describe_crs(own.to_2d()))
        return np.asarray(shapely.transform(geometry, lambda xy: xy * unit), object)
    if crs is None:
        raise BadInputError(
            f"{path} states no CRS, so its place on the map is not known. Save it with the CRS "
            f"{describe_crs(own.to_2d())}, or as GeoJSON in longitude and latitude"
        )
    try:
        transformer = Transformer.from_crs(crs, own.to_2d(), always_xy=True)
    except ProjError as error:
        raise BadInputError(f"{path} is in {crs.name}, which cannot be converted to the CRS of the map") from error
    near, step = _around(route_map, transformer)
    if near is not None:
        # What lies far from the map may not have coordinates in its CRS, and would be cut into very many parts.
        geometry = shapely.intersection(geometry, near)
    cut = shapely.segmentize(geometry, step)
    return np.asarray(
        shapely.transform(cut, lambda xy: np.column_stack(transformer.transform(xy[:, 0], xy[:, 1])) * unit), object
    )


def _around(route_map: RouteMap, transformer: Transformer) -> tuple[shapely.Geometry | None, float]:
    """Return the surroundings of the map in the CRS of a file, None if they have no bounds there; and a short length.

    A map across the antimeridian has two of them in degrees, one on each side.
    """
    bounds, unit = route_map.grid.window_bounds(route_map.window), route_map.georeference.metres_per_unit
    x0, y0, x1, y1 = (side / unit for side in (bounds.west, bounds.south, bounds.east, bounds.north))
    west, south, east, north = transformer.transform_bounds(x0, y0, x1, y1, densify_pts=21, direction="INVERSE")
    is_cut = east < west
    side = max(east - west + (360.0 if is_cut else 0.0), north - south)
    if not (np.isfinite(side) and side > 0.0):
        degrees = transformer.source_crs is not None and transformer.source_crs.is_geographic
        return None, 1e-3 if degrees else 100.0
    far = _BEYOND * side
    spans = [(west - far, 180.0), (-180.0, east + far)] if is_cut else [(west - far, east + far)]
    boxes = [shapely.box(low, south - far, high, north + far) for low, high in spans]
    return shapely.union_all(boxes), side / _STEPS
