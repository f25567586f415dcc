"""Points and areas of a user's file, for routes: geometries, names and CRS; the tiles that areas touch or hold.

GeoJSON, GPX and CSV are read here: GDAL would choose a driver by what the file holds, and some formats name other files
or URLs to read.
"""

import csv
import io
import json
import logging
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from xml.etree import ElementTree as ET

import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError, ProjError

from bumpymap.core import (
    BadInputError,
    Each,
    Nullable,
    describe_crs,
    parse_json,
    raster_lock,
    read_regular,
    shape_fault,
    short_names,
    short_repr,
    stated_crs,
)
from bumpymap.layers.map_reader import MapReader
from bumpytiles import Grid, TileWindow

_REMEDY = "Give a GeoJSON, which a GIS can save"


VectorLayer = tuple[NDArray[np.object_], list[str], CRS | None]
"""Content of a file: shapely geometries in two dimensions, of the features that have one, (n,); their field
``name``, empty without one; the CRS as the file states it, of a GeoJSON that states none longitude and latitude, or
None if its numbers cannot be degrees."""


def read_vectors(path: Path) -> VectorLayer:
    """Read a GeoJSON or GPX file; of the latter the waypoints, or else the points of its routes.

    Raises BadInputError: the file is missing, damaged or of another format.
    """
    try:
        return _read_gpx(path) if path.suffix.lower() == ".gpx" else _read_geojson(path)
    except (OSError, ValueError, SyntaxError) as error:
        raise BadInputError(f"cannot read {path}: {error}. {_REMEDY}") from error
    except CRSError as error:
        raise BadInputError(f"cannot read {path}: {str(error).splitlines()[0]}. {_REMEDY}") from error


_FEATURE = {"type": str, "geometry?": Nullable({"type": str}), "properties?": Nullable(Each())}
_GEOJSON_SHAPE = _FEATURE | {
    "features?": [_FEATURE],
    "crs?": Nullable({"type": str, "properties": {"name?": str}}),
}


def geojson_features(path: Path) -> tuple[list[tuple[shapely.Geometry, dict[str, Any]]], str | None]:
    """Read a GeoJSON file.

    Returns ``features``: geometry, in two dimensions, and properties of each feature that has a geometry; ``crs``: name
    of the CRS that the file states; files of RFC 7946 state none. Raises OSError, ValueError: the file cannot be read,
    or is no GeoJSON.
    """
    record = parse_json(read_regular(path).decode("utf-8-sig"))
    if fault := shape_fault(record, _GEOJSON_SHAPE):
        raise ValueError(f"it is no GeoJSON: {fault}")
    stated = record.get("crs") or {"type": "name", "properties": {}}
    if stated["type"] != "name":
        raise ValueError("its CRS is given by a link, which is not followed")
    found = []
    for number, one in enumerate(record.get("features", ()) if record["type"] == "FeatureCollection" else [record], 1):
        geometry, about = (one.get("geometry"), one.get("properties")) if one["type"] == "Feature" else (one, None)
        if geometry is not None:
            try:
                found.append((shapely.force_2d(shapely.from_geojson(json.dumps(geometry))), about or {}))
            except shapely.errors.GEOSException as error:
                said = str(error).partition(": ")[2].splitlines()[0]
                raise ValueError(f"the {geometry['type']} of feature {number} is damaged: {said}") from error
    return found, stated["properties"].get("name")


def line_parts(geometry: shapely.Geometry) -> list[NDArray[np.float64]]:
    """Return the positions of each line of a LineString or MultiLineString, (n, 2) each."""
    return [shapely.get_coordinates(part) for part in shapely.get_parts(geometry) if not part.is_empty]


def _read_geojson(path: Path) -> VectorLayer:
    features, stated = geojson_features(path)
    shapes = np.array([geometry for geometry, _ in features], object)
    names = [about.get("name") for _, about in features]
    if stated is not None:
        return _layer(shapes, names, stated_crs(stated))
    degrees = (np.abs(shapely.get_coordinates(shapes)) <= (180.0, 90.0)).all()
    return _layer(shapes, names, CRS.from_user_input("OGC:CRS84") if degrees else None)


def _read_gpx(path: Path) -> VectorLayer:
    root = ET.fromstring(read_regular(path).decode("utf-8-sig"))  # noqa: S314 (expat limits what entities grow to, and fetches none)
    if root.tag.rpartition("}")[2] != "gpx":
        raise ValueError("it is no GPX")
    found = list(_gpx_points(root, "{*}wpt")) or list(_gpx_points(root, "{*}rte/{*}rtept"))
    points = [shapely.Point(place) for place, _ in found]
    return _layer(np.array(points, object), [name for _, name in found], CRS.from_user_input("OGC:CRS84"))


def _gpx_points(root: ET.Element, path: str) -> Iterator[tuple[tuple[float, float], str | None]]:
    for point in root.iterfind(path):
        try:
            place = float(point.attrib["lon"]), float(point.attrib["lat"])
        except (KeyError, ValueError):
            place = (np.nan, np.nan)
        if not np.isfinite(place).all():
            said = ", ".join(f"{name}={value[:40]!r}" for name, value in list(point.attrib.items())[:4])
            raise ValueError(f"a point of it is not a place: {said or 'it has no lon and lat'}")
        yield place, point.findtext("{*}name")


def _layer(geometry: NDArray[np.object_], names: Sequence[Any] | NDArray[np.object_], crs: CRS | None) -> VectorLayer:
    has_shape = ~(shapely.is_missing(geometry) | shapely.is_empty(geometry))
    if not np.isfinite(shapely.get_coordinates(geometry[has_shape])).all():
        raise ValueError("a coordinate is not a finite number")
    texts = [str(name).strip() if isinstance(name, str | int) else "" for name in names]
    return geometry[has_shape], [text for text, known in zip(texts, has_shape, strict=True) if known], crs


_log = logging.getLogger(__name__)

_COLUMNS: dict[Literal["lonlat", "crs"], tuple[tuple[str, str], ...]] = {
    "lonlat": (("lon", "lat"), ("longitude", "latitude"), ("lng", "lat")),
    "crs": (("x", "y"), ("easting", "northing")),
}
"""Names of the columns of a CSV that hold coordinates."""
_ALLOWED = "lon,lat; or x,y or easting,northing in the survey's CRS; and, if you like, name"
_MOST = 100_000
"""Points that are read at most: a file with more is not a list of places to drive to."""


@dataclass(frozen=True, slots=True)
class FilePoint:
    """A point of a file."""

    name: str
    """As in the file; its number there, from 1, if it has none."""
    x: float
    """Longitude, degrees, or x in the survey's CRS."""
    y: float
    """Latitude, degrees, or y in the survey's CRS."""
    system: Literal["lonlat", "crs"]
    """The one of the two that it is."""


def read_points(path: str | os.PathLike[str]) -> list[FilePoint]:
    """Read the points of a GeoJSON, GPX or CSV file, in their order.

    Of a GPX file the waypoints are read; if it has none, the points of its routes. A CSV has a line of column names:
    ``lon,lat``, or ``x,y`` or ``easting,northing`` in the survey's CRS, and perhaps ``name``. Raises BadInputError: the
    file is missing, damaged or of another format, or holds no points or something else.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if not path.is_file():
        raise BadInputError(f"there is no file {path}. Give a file of points: .geojson, .gpx or .csv")
    if suffix == ".csv":
        found = _read_csv(path)
    elif suffix in {".geojson", ".json", ".gpx"}:
        found = _of_layer(path, *read_vectors(path))
    else:
        raise BadInputError(f"{path} is not a file of points that can be read. Give .geojson, .gpx or .csv")
    if not found:
        raise BadInputError(f"{path} holds no points. Give a file with at least one")
    if len(found) > _MOST:
        raise BadInputError(f"{path} holds {len(found):,} points; at most {_MOST:,} can be read")
    return found


def _of_layer(path: Path, geometry: NDArray[np.object_], names: Sequence[str], crs: CRS | None) -> list[FilePoint]:
    """Return the points of a vector layer in longitude and latitude; in the survey's CRS if they cannot be that."""
    kinds = shapely.get_type_id(geometry)
    other = ~np.isin(kinds, (shapely.GeometryType.POINT, shapely.GeometryType.MULTIPOINT))
    if other.any():
        kind = shapely.GeometryType(int(kinds[other][0])).name.lower()
        raise BadInputError(f"{path} holds a {kind}; only points can be start, goal or stops of a route")
    parts, owner = shapely.get_parts(geometry, return_index=True)
    x, y = shapely.get_x(parts), shapely.get_y(parts)
    system: Literal["lonlat", "crs"] = "lonlat"
    if crs is None:
        system = "crs"
        _log.warning("the numbers of %s cannot be degrees: they are read in the survey's CRS", path)
    else:
        x, y = _lonlat(path, crs, x, y)
    return [
        FilePoint(names[index] or str(number), float(east), float(north), system)
        for number, (index, east, north) in enumerate(zip(owner, x, y, strict=True), start=1)
    ]


def _lonlat(
    path: Path, crs: CRS, x: NDArray[np.float64], y: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Convert to WGS 84 longitude and latitude."""
    try:
        longitude, latitude = Transformer.from_crs(crs, CRS.from_epsg(4326), always_xy=True).transform(x, y)
    except ProjError as error:
        raise BadInputError(f"{path} is in {crs.name}, which cannot be converted to longitude and latitude") from error
    return np.asarray(longitude), np.asarray(latitude)


def _read_csv(path: Path) -> list[FilePoint]:
    try:
        text = read_regular(path).decode("utf-8-sig")
        separator = max(",;\t", key=text.partition("\n")[0].count)
        head, *lines = list(csv.reader(io.StringIO(text, newline=""), delimiter=separator)) or [[]]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise BadInputError(f"cannot read {path}: {error}. It must be a text file of columns {_ALLOWED}") from error
    names = [name.strip().lower() for name in head]
    known = [(system, pair) for system, pairs in _COLUMNS.items() for pair in pairs if set(pair) <= set(names)]
    if not known:
        raise BadInputError(f"{path} has the columns {short_names(names) or '(none)'}; it needs {_ALLOWED}")
    system, pair = known[0]
    found = []
    for number, line in enumerate(lines, start=2):
        if not any(map(str.strip, line)):
            continue
        try:
            x, y = (float(line[names.index(name)]) for name in pair)
        except (ValueError, IndexError):
            x = y = math.nan
        if not (math.isfinite(x) and math.isfinite(y)):
            raise BadInputError(
                f"{path}, line {number}: {short_repr(separator.join(line))} has no two numbers where they belong; "
                "write decimals with a point"
            )
        named = dict(zip(names, line, strict=False)).get("name", "").strip()
        found.append(FilePoint(named or str(number - 1), x, y, system))
    return found


_GEOJSON = (".geojson", ".json")
_POLYGONS = (shapely.GeometryType.POLYGON, shapely.GeometryType.MULTIPOLYGON)
_ROUNDING = 1e-6
"""Length that is no overlap, in tiles: areas that share a border with a tile neither touch it nor leave it out."""
_STEPS = 4096
"""Parts that an edge as long as the map is cut into before it is converted, as a straight line of another CRS is bent:
chosen."""
_BEYOND = 0.25
"""How far around the map areas are kept, in lengths of its sides: chosen."""


def read_areas(
    path: str | os.PathLike[str], route_map: MapReader, *, allow_outside: bool = False
) -> NDArray[np.object_]:
    """Read polygons and place them on the grid of a map.

    Their CRS is the one that the file states, else longitude and latitude, or the map's CRS if its numbers cannot be
    degrees. If the map has no CRS, they must be in the survey's own coordinates.

    ``path``: a GeoJSON; ``allow_outside``: whether it is no error that an area does
    not lie on the map. Returns (n,) shapely polygons: in metres on the grid, cut off somewhat beyond the map;
    without those that do not lie on it, which a warning names. Raises BadInputError: the file is missing, damaged or of
    another format, or holds something else than polygons; or an area does not lie on the map.
    """
    path = Path(path)
    if not path.is_file() or path.suffix.lower() not in _GEOJSON:
        what = "is not a file of polygons that can be read" if path.is_file() else "is missing"
        raise BadInputError(
            f"{path} {what}. Give polygons as {' or '.join(_GEOJSON)}; QGIS saves a layer so, or "
            "ogr2ogr -t_srs EPSG:4326 OUT.geojson FILE"
        )
    geometry, _, crs = read_vectors(path)
    kinds = shapely.get_type_id(geometry)
    if not len(kinds) or not np.isin(kinds, _POLYGONS).all():
        kind = "nothing" if not len(kinds) else shapely.GeometryType(int(kinds[~np.isin(kinds, _POLYGONS)][0])).name
        raise BadInputError(f"{path} holds {kind.lower()}; areas must be polygons. Draw polygons and save them alone")
    parts, owner = shapely.get_parts(_on_grid(path, shapely.make_valid(geometry), crs, route_map), return_index=True)
    placed = np.isin(shapely.get_type_id(parts), _POLYGONS) & ~shapely.is_empty(parts)
    bounds = route_map.grid.window_bounds(route_map.window)
    placed &= shapely.intersects(parts, shapely.box(bounds.west, bounds.south, bounds.east, bounds.north))
    is_on = np.isin(np.arange(len(geometry)), owner[placed])
    if not is_on.all():
        numbers = short_names([str(number) for number in np.flatnonzero(~is_on) + 1])
        map_crs = route_map.georeference.crs
        system = "the survey's own coordinates"
        if map_crs is not None:
            system = describe_crs(map_crs.to_2d()) if crs is None else crs.name
        said = (
            f"{(~is_on).sum()} of the {len(is_on)} areas of {path}, read in {system}, do not lie on the map: number "
            f"{numbers}"
        )
        if not allow_outside:
            raise BadInputError(
                f"{said}. Give areas on the map, or pass `allow_outside=True` if they need not be there, as when one "
                "file serves several maps"
            )
        _log.warning("%s", said)
    return np.asarray(parts[placed], object)


def tiles_in(areas: NDArray[np.object_], window: TileWindow, grid: Grid, *, wholly: bool = False) -> NDArray[np.bool_]:
    """Return the tiles (rows, cols) that an area touches, be it by a corner; sharing a border is not touching.

    ``areas`` (n,) of polygons: in metres on the grid; ``wholly``: only the tiles that lie wholly in the areas, taken
    together.
    """
    from rasterio.features import rasterize

    # The areas as one geometry in tiles east and south of the window's north-west corner, cut to the window.
    origin, shape = np.array([window.col, window.row + window.rows]) * grid.tile_size, (window.rows, window.cols)
    placed = shapely.transform(np.asarray(areas, object), lambda xy: (xy - origin) / (grid.tile_size, -grid.tile_size))
    near = shapely.intersection(placed, shapely.box(-1.0, -1.0, window.cols + 1.0, window.rows + 1.0))
    whole: shapely.Geometry = shapely.union_all(near)
    if shapely.is_empty(whole):
        return np.zeros(shape, bool)
    # GDAL is fast and looks at centres; the tiles up to one from the outlines are few and left to exact tests.
    around = shapely.buffer(shapely.boundary(whole), 1.0)
    with raster_lock():
        inside: NDArray[np.bool_] = rasterize([whole], shape, dtype="uint8").astype(bool)
        rows, cols = np.nonzero(rasterize([around], shape, all_touched=True, dtype="uint8"))
    # Squares of tiles, smaller by what rounding may do.
    low, high = _ROUNDING, 1.0 - _ROUNDING
    squares = shapely.box(cols + low, rows + low, cols + high, rows + high)
    shapely.prepare(whole)
    inside[rows, cols] = shapely.covers(whole, squares) if wholly else shapely.intersects(whole, squares)
    return inside


def _on_grid(path: Path, geometry: NDArray[np.object_], crs: CRS | None, route_map: MapReader) -> NDArray[np.object_]:
    """Convert geometries of a file to metres on the grid."""
    map_crs, unit = route_map.georeference.crs, route_map.georeference.metres_per_unit
    if map_crs is None:
        return np.asarray(shapely.transform(geometry, lambda xy: xy * unit), object)
    if crs is None:
        _log.warning("the numbers of %s cannot be degrees: they are read in %s", path, describe_crs(map_crs.to_2d()))
        return np.asarray(shapely.transform(geometry, lambda xy: xy * unit), object)
    try:
        transformer = Transformer.from_crs(crs, map_crs.to_2d(), always_xy=True)
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


def _around(route_map: MapReader, transformer: Transformer) -> tuple[shapely.Geometry | None, float]:
    """Return the surroundings of the map in the CRS of a file, None if it has no bounds there; and a short length."""
    bounds, unit = route_map.grid.window_bounds(route_map.window), route_map.georeference.metres_per_unit
    x0, y0, x1, y1 = (side / unit for side in (bounds.west, bounds.south, bounds.east, bounds.north))
    west, south, east, north = transformer.transform_bounds(x0, y0, x1, y1, densify_pts=21, direction="INVERSE")
    side = max(east - west, north - south)
    if not (np.isfinite(side) and east > west):  # across the antimeridian it ends west of where it begins
        degrees = transformer.source_crs is not None and transformer.source_crs.is_geographic
        return None, 1e-3 if degrees else 100.0
    pad = _BEYOND * side
    return shapely.box(west - pad, south - pad, east + pad, north + pad), side / _STEPS
