"""Write the cost map as regions: cost.geojson in WGS 84, cost.fgb in the survey's CRS.

Both take some thousand regions at a time, so that memory does not grow with the map.
"""

import json
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import shapely
import shapely.geometry
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError

from bumpymap.core import CLASS_NAMES, FAIL_SHARE, NO_CLASS, REASON_TEXT, BadInputError, atomic
from bumpymap.layers.placement import Placement
from bumpymap.layers.regions import Regions

_TRIES = 33
"""Points along each side of the raster at which the transformation is tried first: chosen."""
_SEGMENT = 32
"""Longest straight segment of an outline, tiles. In longitude and latitude, the middle of a 96 m segment is off by at
most 1.2 mm (measured up to 80 degrees north and south): less than the 7 decimals that are kept."""
_GRID_DECIMALS = 9
"""Of tiles: far below what a file keeps, far above the error of a double."""
DEGREE_DECIMALS, _METRE_DECIMALS = 7, 3
"""Of longitude and latitude, 1 cm, and of the survey's own coordinates, 1 mm: chosen."""


def wgs84_transformer(placement: Placement) -> Transformer:
    """Return the transformer from the survey's CRS to WGS 84 longitude and latitude, tried on points of the raster.

    Raises BadInputError: there is no CRS, or no known transformation from it to longitude and latitude at this place;
    or it lies across the antimeridian.
    """
    crs, window = placement.horizontal_crs, placement.window
    if crs is None:
        raise BadInputError(
            "the survey has no CRS, so cost.geojson cannot say where on Earth it is. Pass `crs='EPSG:CODE'`, "
            "or `local=True` to write it in the survey's own coordinates"
        )
    try:
        transformer = Transformer.from_crs(crs, CRS.from_epsg(4326), always_xy=True)
    except ProjError as error:
        raise BadInputError(
            f"the survey's CRS ({crs.name}) has no known relation to longitude and latitude, so cost.geojson cannot "
            "say where on Earth it is. Pass another with `force_crs='EPSG:CODE'`, or `local=True` to keep its own "
            "coordinates"
        ) from error
    cols, rows = np.meshgrid(
        np.linspace(window.col, window.col + window.cols, _TRIES),
        np.linspace(window.row, window.row + window.rows, _TRIES),
    )
    degrees = transformer.transform(placement.to_crs(cols.ravel()), placement.to_crs(rows.ravel()))
    if not np.isfinite(degrees).all():
        raise _outside(placement)
    if np.ptp(degrees[0]) > 180.0:
        raise BadInputError(
            "the survey lies on both sides of the antimeridian, where longitudes jump from 180 to -180 degrees. Pass "
            "`local=True` to write cost.geojson in the survey's own coordinates"
        )
    return transformer


def _outside(placement: Placement) -> BadInputError:
    return BadInputError(
        f"the survey's coordinates lie outside the area where its CRS ({placement.horizontal_crs}) can be converted to "
        "longitude and latitude. Pass the right one with `force_crs='EPSG:CODE'`, or `local=True`"
    )


_LOCAL = (
    "x and y are the survey's own coordinates, not longitude and latitude: its place on Earth is not "
    "known. This file is therefore not RFC 7946 GeoJSON"
)
_NO_CRS = (
    'ENGCRS["survey without a CRS",EDATUM["unknown"],CS[Cartesian,2],AXIS["x",east],AXIS["y",north],'
    'LENGTHUNIT["unit of the survey",{}]]'
)
_KINDS = {"region": "int64", "class": "int32", "zone": "int32", "tiles": "int64", "passable": "bool"}
_KINDS |= dict.fromkeys(("class_name", "reason", "c_r_basis"), "string")
"""Types of columns of cost.fgb; the others are float64."""
_PROPERTIES = (
    *("region", "class", "class_name", "reason", "passable", "zone", "c_r", "c_r_low", "c_r_high", "c_r_basis"),
    *("p_fail", "hazard", "cost", "area_m2", "tiles"),
)
_GEOMETRY = "geometry"
IN_MEMORY = 16 << 20
"""Most bytes of regions that are converted to FlatGeobuf in memory: chosen."""


@dataclass(frozen=True, slots=True)
class GeoJsonCoordinates:
    """The coordinates of cost.geojson: WGS 84 longitude and latitude, or the survey's own."""

    placement: Placement
    to_degrees: Transformer | None
    """Transformer to longitude and latitude; None: keep the survey's own coordinates."""

    @classmethod
    def of(cls, placement: Placement, *, local: bool) -> "GeoJsonCoordinates":
        """Choose longitude and latitude if possible, else the survey's own coordinates if ``local``.

        Raises BadInputError: the survey has no CRS, or one that cannot be transformed, and ``local`` is False.
        """
        try:
            return cls(placement, wgs84_transformer(placement))
        except BadInputError:
            if not local:
                raise
            return cls(placement, None)

    @property
    def members(self) -> dict[str, Any]:
        """Members of the feature collection that declare local coordinates; none for longitude and latitude.

        Without the member ``crs`` of GeoJSON before RFC 7946, GDAL takes every GeoJSON file for WGS 84, one whose
        ``crs`` is null too, and QGIS shows a survey off the coast of Africa, at 0, 0.
        """
        if self.to_degrees is not None:
            return {}
        crs, scale = self.placement.horizontal_crs, self.placement.georeference.metres_per_unit
        name = _NO_CRS.format(scale) if crs is None else crs.to_wkt()
        declared = {"crs": {"type": "name", "properties": {"name": name}}}
        return {"local_coordinates": _LOCAL, "metres_per_unit": scale, **declared}

    def polygons(self, polygons: NDArray[np.object_]) -> NDArray[np.object_]:
        """Convert polygons (m,) in grid coordinates (1 = one tile), with sides along the sides of tiles, to these.

        Own coordinates are rounded to 1 mm, degrees to 1 cm; rings stay right-hand. Polygons with the same vertices
        along their common borders keep this property. Raises BadInputError: a point cannot be transformed to longitude
        and latitude.
        """
        place, to_degrees = self.placement, self.to_degrees
        if to_degrees is None:
            own: NDArray[np.object_] = shapely.transform(
                polygons, lambda points: place.to_crs(points).round(_METRE_DECIMALS)
            )
            return own

        def move(points: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.column_stack(to_degrees.transform(points[:, 0], points[:, 1])).round(DEGREE_DECIMALS)

        # The points in between are rounded because those of a side in one direction and the other differ in the last
        # bit.
        split = shapely.segmentize(polygons, _SEGMENT)
        placed = shapely.transform(split, lambda points: place.to_crs(points.round(_GRID_DECIMALS)))
        outlines: NDArray[np.object_] = shapely.transform(placed, move)
        if not np.isfinite(shapely.bounds(outlines)).all():
            raise _outside(place)
        return outlines

    @property
    def has_degrees(self) -> bool:
        """True if these are longitude and latitude."""
        return self.to_degrees is not None

    def in_crs(self, grid_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert (n, 2) easting and northing on the grid, m, to units of the survey's CRS."""
        return np.asarray(grid_m / self.placement.georeference.metres_per_unit, dtype=np.float64)

    def in_file(self, grid_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert points (n, 2) on the grid, m, to these; own coordinates are rounded to 1 mm, degrees to 1 cm.

        Raises BadInputError: a point cannot be transformed to longitude and latitude.
        """
        own = self.in_crs(grid_m)
        if self.to_degrees is None:
            return own.round(_METRE_DECIMALS)
        degrees = np.column_stack(self.to_degrees.transform(own[:, 0], own[:, 1])).round(DEGREE_DECIMALS)
        if not np.isfinite(degrees).all():
            raise BadInputError(
                f"a position lies outside the area where the survey's CRS ({self.placement.horizontal_crs}) can be "
                "converted to longitude and latitude. Map the survey again with the right one, `force_crs='EPSG:CODE'`"
            )
        return degrees


def outline_of(geometry: Mapping[str, Any]) -> tuple[NDArray[np.float64], tuple[float, float]]:
    """Return the corners of a polygon of GeoJSON, (n, 2), and a point in it."""
    polygon = shapely.geometry.shape(geometry)
    inside = polygon.representative_point()
    return shapely.get_coordinates(polygon), (float(inside.x), float(inside.y))


def feature(
    properties: Mapping[str, Any], geometry: shapely.Geometry | None, number: int | None = None
) -> dict[str, Any]:
    """Return a GeoJSON feature for `write_features`; ``number`` is its id."""
    head = {"type": "Feature"} if number is None else {"type": "Feature", "id": number}
    return head | {"properties": properties, "geometry": geometry}


def write_features(path: Path, name: str, place: GeoJsonCoordinates, features: Sequence[Mapping[str, Any]]) -> None:
    """Write a GeoJSON file: RFC 7946 in WGS 84, or the survey's own coordinates, which its members declare.

    ``name``: of the collection, which GIS programs show; ``place``: coordinates of the features; ``features``: from
    `feature`. Raises OutputError: the file cannot be written.
    """
    geometries = [each["geometry"] for each in features if each["geometry"] is not None]
    collection = {"type": "FeatureCollection", "name": name, **place.members}
    collection |= {"bbox": shapely.total_bounds(geometries).tolist()} if geometries else {}
    collection["features"] = features
    text = json.dumps(
        collection, ensure_ascii=False, allow_nan=False, separators=(",", ":"), default=shapely.geometry.mapping
    )
    with atomic(path) as temporary:
        temporary.write_bytes(f"{text}\n".encode("utf-8", "backslashreplace"))


@contextmanager
def geojson_writer(
    path: Path, place: GeoJsonCoordinates, about: Mapping[str, Any] | None = None
) -> Iterator[Callable[[Regions], None]]:
    """Write cost.geojson: RFC 7946, one feature per region, WGS 84 with 7 decimals.

    Local coordinates are rounded to 1 mm, and a member of the collection declares them. ``place``: coordinates of the
    file; ``about``: further members of the feature collection, such as vehicle and calibration. Yields a function that
    appends `Regions`; call it repeatedly. Raises OutputError: the file cannot be written.
    """
    head = {"type": "FeatureCollection", "name": "cost", **place.members, **(about or {})}
    encode = json.JSONEncoder(ensure_ascii=False, allow_nan=False).encode
    boxes: list[NDArray[np.float64]] = []
    with atomic(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        file.write(encode(head)[:-1])
        file.write(', "features": [')
        separator = "\n"

        def add(regions: Regions) -> None:
            nonlocal separator
            outlines, columns = place.polygons(regions.outlines), region_columns(regions)
            boxes.append(shapely.total_bounds(outlines))
            for number, geometry in enumerate(_geometries(outlines)):
                properties = {name: values[number] for name, values in columns.items()}
                head = {"type": "Feature", "id": properties["region"], "properties": properties}
                file.write(separator + encode({**head, "geometry": geometry}))
                separator = ",\n"

        yield add
        low, high = np.min(boxes, axis=0)[:2], np.max(boxes, axis=0)[2:]
        file.write(f'\n], "bbox": {encode([*low.tolist(), *high.tolist()])}}}\n')


def _geometries(outlines: NDArray[np.object_]) -> Iterator[dict[str, Any]]:
    """Yield polygons as GeoJSON; converting all at once takes a quarter of the time."""
    _, coordinates, offsets = shapely.to_ragged_array(outlines)
    points, (ring, polygon) = coordinates.tolist(), (offset.tolist() for offset in offsets)
    rings = [points[start:stop] for start, stop in pairwise(ring)]
    for start, stop in pairwise(polygon):
        yield {"type": "Polygon", "coordinates": rings[start:stop]}


@contextmanager
def flatgeobuf_writer(
    path: Path, placement: Placement, about: Mapping[str, str] | None = None
) -> Iterator[Callable[[Regions], None]]:
    """Write cost.fgb: FlatGeobuf with the regions of cost.geojson, in the survey's CRS if it has one.

    FlatGeobuf starts with an index of all features, so regions are first collected in a temporary Arrow file. ``about``
    is metadata of the layer, such as vehicle and calibration. For the rest see `geojson_writer`.
    """
    import pyarrow as pa

    with atomic(path, (pa.ArrowException,)) as temporary:
        waiting = temporary.with_name(f"{temporary.stem}.arrow")
        kinds = ((name, pa.type_for_alias(_KINDS.get(name, "float64"))) for name in _PROPERTIES)
        schema, count = pa.schema([*kinds, (_GEOMETRY, pa.binary())]), 0
        with pa.OSFile(str(waiting), "wb") as file, pa.ipc.new_stream(file, schema) as stream:

            def add(regions: Regions) -> None:
                nonlocal count
                count += len(regions.tiles)
                columns: dict[str, Any] = region_columns(regions)
                columns[_GEOMETRY] = shapely.to_wkb(shapely.transform(regions.outlines, placement.to_crs), byte_order=1)
                stream.write_batch(
                    pa.record_batch([pa.array(columns[field.name], field.type) for field in schema], schema=schema)
                )

            yield add
        _convert(waiting, count, temporary, placement, about or {})


def _convert(waiting: Path, regions: int, temporary: Path, placement: Placement, about: Mapping[str, str]) -> None:
    """Convert the Arrow file ``waiting``, which holds ``regions`` rows, to FlatGeobuf."""
    import pyarrow as pa
    from pyogrio.errors import DataLayerError, DataSourceError, FeatureError, FieldError, GeometryError
    from pyogrio.raw import read, write_arrow

    crs = placement.horizontal_crs
    # Small files are made in memory. GDAL takes what follows a '!' in a path for a member of an archive, and does not
    # notice if the disk fills up in the last bytes (seen in 3.8 and 3.12), so the last feature is read back.
    to_disk = waiting.stat().st_size > IN_MEMORY and "!" not in str(temporary)
    target = temporary if to_disk else BytesIO()
    with pa.OSFile(str(waiting), "rb") as file, warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="'crs' was not provided")
        try:
            write_arrow(
                pa.ipc.open_stream(file),
                target,
                layer="cost",
                driver="FlatGeobuf",
                geometry_name=_GEOMETRY,
                geometry_type="Polygon",
                crs=None if crs is None else crs.to_wkt(),
                layer_metadata=dict(about),
            )
            if isinstance(target, BytesIO):
                temporary.write_bytes(target.getbuffer())
            else:
                read(temporary, skip_features=regions - 1, max_features=1)
        except (DataLayerError, DataSourceError, FeatureError, FieldError, GeometryError, ValueError) as error:
            raise OSError(str(error)) from error


def region_columns(regions: Regions) -> dict[str, list[Any]]:
    """Return the properties of the regions as Python values; None becomes null."""
    known, names = regions.class_id != NO_CLASS, (*CLASS_NAMES, "unknown")
    # The drives behind c_r: all, or those that got through where many fail.
    basis = np.where(regions.p_fail >= FAIL_SHARE, "survivors", "drives").astype(object)
    basis[np.isnan(regions.c_r)] = None
    return {
        "region": regions.number.tolist(),
        "class": [int(value) if is_known else None for value, is_known in zip(regions.class_id, known, strict=True)],
        "class_name": [names[min(code, len(CLASS_NAMES))] for code in regions.class_id.tolist()],
        "reason": [
            None if is_known else REASON_TEXT[code] for code, is_known in zip(regions.reason, known, strict=True)
        ],
        "passable": regions.passable.tolist(),
        "zone": [number or None for number in regions.zone.tolist()],
        "c_r": plain_numbers(regions.c_r, 6),
        "c_r_low": plain_numbers(regions.c_r_low, 6),
        "c_r_high": plain_numbers(regions.c_r_high, 6),
        "c_r_basis": basis.tolist(),
        "p_fail": plain_numbers(regions.p_fail, 6),
        "hazard": plain_numbers(regions.hazard, 9),
        "cost": plain_numbers(regions.cost, 6),
        "area_m2": plain_numbers(regions.tiles * regions.placement.grid.tile_size**2, 3),
        "tiles": regions.tiles.tolist(),
    }


def plain_numbers(values: NDArray[np.floating], decimals: int) -> list[float | None]:
    """Round numbers, (n,); what is not finite becomes None, since JSON has no NaN."""
    rounded: list[float] = values.round(decimals).tolist()
    return [value if is_number else None for value, is_number in zip(rounded, np.isfinite(values), strict=True)]
