"""Write the cost map as regions: cost.geojson in WGS 84, cost.fgb in the survey's CRS.

Both take some thousand regions at a time, so that memory does not grow with the map.
"""

import json
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import shapely
from numpy.typing import NDArray
from pyproj import Transformer

from bumpymap.core import NO_CLASS, BadInputError, atomic
from bumpymap.layers.lonlat import BoundingBox, outlines_in_crs, polygons_in_wgs84, wgs84_transformer
from bumpymap.layers.placement import Placement
from bumpymap.layers.regions import Regions

__all__ = ["GeoJsonCoordinates", "flatgeobuf_writer", "geojson_writer"]

_LOCAL = (
    "x and y are the survey's own coordinates, not longitude and latitude: its place on Earth is not "
    "known. This file is therefore not RFC 7946 GeoJSON"
)
_NO_CRS = (
    'ENGCRS["survey without a CRS",EDATUM["unknown"],CS[Cartesian,2],AXIS["x",east],AXIS["y",north],'
    'LENGTHUNIT["unit of the survey",{}]]'
)
_KINDS = {"region": pa.int64(), "class": pa.int32(), "tiles": pa.int64(), "passable": pa.bool_()}
_KINDS |= dict.fromkeys(("class_name", "reason", "c_r_basis"), pa.string())
"""Types of columns of cost.fgb; the others are float64."""
_PROPERTIES = (
    *("region", "class", "class_name", "reason", "passable", "c_r", "c_r_low", "c_r_high", "c_r_basis"),
    *("p_fail", "hazard", "cost", "area_m2", "tiles"),
)
_GEOMETRY = "geometry"
IN_MEMORY = 16 << 20
"""Most bytes of regions that are converted to FlatGeobuf in memory."""


@dataclass(frozen=True, slots=True)
class GeoJsonCoordinates:
    """The coordinates of cost.geojson: WGS 84 longitude and latitude, or the survey's own."""

    placement: Placement
    to_degrees: Transformer | None
    """Transformer to longitude and latitude; None: keep the survey's own coordinates."""

    @classmethod
    def of(cls, placement: Placement, *, local: bool) -> "GeoJsonCoordinates":
        """Choose longitude and latitude if possible, else the survey's own coordinates if ``local``.

        Raises
        ------
        BadInputError
            The survey has no CRS, or one that cannot be transformed, and ``local`` is False.
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
        """Convert polygons (m,) in grid coordinates (1 = one tile) to these; own coordinates are rounded to 1 mm."""
        if self.to_degrees is not None:
            return polygons_in_wgs84(polygons, self.placement, self.to_degrees)
        own: NDArray[np.object_] = shapely.transform(polygons, lambda points: self.placement.to_crs(points).round(3))
        return own

    def bounds(self, box: BoundingBox) -> list[float]:
        """Return west, south, east, north of a box in these coordinates."""
        return box.bounds() if self.to_degrees is None else box.bounds_in_wgs84()


@contextmanager
def geojson_writer(
    path: Path, place: GeoJsonCoordinates, about: Mapping[str, Any] | None = None
) -> Iterator[Callable[[Regions], None]]:
    """Write cost.geojson: RFC 7946, one feature per region, WGS 84 with 7 decimals.

    Local coordinates are rounded to 1 mm, and a member of the collection declares them.

    Parameters
    ----------
    path : Path
        The file, which appears when the ``with`` ends without an error.
    place : GeoJsonCoordinates
        Coordinates of the file.
    about : mapping, optional
        Further members of the feature collection, such as vehicle and calibration.

    Yields
    ------
    callable
        Appends `Regions`; call it repeatedly.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    head = {"type": "FeatureCollection", "name": "cost", **place.members, **(about or {})}
    encode = json.JSONEncoder(ensure_ascii=False, allow_nan=False).encode
    box = BoundingBox()
    with atomic(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        file.write(encode(head)[:-1])
        file.write(', "features": [')
        separator = "\n"

        def add(regions: Regions) -> None:
            nonlocal separator
            outlines, columns = place.polygons(regions.outlines), _columns(regions)
            box.add(outlines)
            for number, geometry in enumerate(_geometries(outlines)):
                properties = {name: values[number] for name, values in columns.items()}
                head = {"type": "Feature", "id": properties["region"], "properties": properties}
                file.write(separator + encode({**head, "geometry": geometry}))
                separator = ",\n"

        yield add
        file.write(f'\n], "bbox": {encode(place.bounds(box))}}}\n')


def _geometries(outlines: NDArray[np.object_]) -> Iterator[dict[str, Any]]:
    """Yield polygons and multipolygons as GeoJSON; converting all at once takes a quarter of the time."""
    parts, owner = shapely.get_parts(outlines, return_index=True)
    _, coordinates, (ring, polygon) = shapely.to_ragged_array(parts)
    points, ring, polygon = coordinates.tolist(), ring.tolist(), polygon.tolist()
    rings = [points[start:stop] for start, stop in pairwise(ring)]
    polygons = [rings[start:stop] for start, stop in pairwise(polygon)]
    first = np.searchsorted(owner, np.arange(len(outlines) + 1)).tolist()
    single = shapely.get_type_id(outlines) == shapely.GeometryType.POLYGON
    for is_polygon, (start, stop) in zip(single.tolist(), pairwise(first), strict=True):
        if is_polygon:
            yield {"type": "Polygon", "coordinates": polygons[start]}
        else:
            yield {"type": "MultiPolygon", "coordinates": polygons[start:stop]}


@contextmanager
def flatgeobuf_writer(
    path: Path, placement: Placement, about: Mapping[str, str] | None = None
) -> Iterator[Callable[[Regions], None]]:
    """Write cost.fgb: FlatGeobuf with the regions of cost.geojson, in the survey's CRS if it has one.

    FlatGeobuf starts with an index of all features, so regions are first collected in a temporary Arrow file.

    Parameters
    ----------
    path : Path
        The file, which appears when the ``with`` ends without an error.
    placement : Placement
        Placement of the map.
    about : mapping, optional
        Metadata of the layer, such as vehicle and calibration.

    Yields
    ------
    callable
        Appends `Regions`; call it repeatedly.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    with atomic(path, (pa.ArrowException,)) as temporary:
        waiting = temporary.with_name(f"{temporary.stem}.arrow")
        schema, count = _schema(), 0
        with pa.OSFile(str(waiting), "wb") as file, pa.ipc.new_stream(file, schema) as stream:

            def add(regions: Regions) -> None:
                nonlocal count
                count += len(regions.tiles)
                stream.write_batch(_batch(regions, schema))

            yield add
        _convert(waiting, count, temporary, placement, about or {})


def _schema() -> pa.Schema:
    kinds = ((name, _KINDS.get(name, pa.float64())) for name in _PROPERTIES)
    return pa.schema([*kinds, (_GEOMETRY, pa.binary())])


def _batch(regions: Regions, schema: pa.Schema) -> pa.RecordBatch:
    columns: dict[str, Any] = _columns(regions)
    columns[_GEOMETRY] = shapely.to_wkb(outlines_in_crs(regions), byte_order=1)
    return pa.record_batch([pa.array(columns[field.name], field.type) for field in schema], schema=schema)


def _convert(waiting: Path, regions: int, temporary: Path, placement: Placement, about: Mapping[str, str]) -> None:
    """Convert the Arrow file ``waiting``, which holds ``regions`` rows, to FlatGeobuf."""
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


def _columns(regions: Regions) -> dict[str, list[Any]]:
    """Return the properties of the regions as Python values; None becomes null."""
    known = regions.class_id != NO_CLASS
    return {
        "region": regions.number.tolist(),
        "class": [int(value) if is_known else None for value, is_known in zip(regions.class_id, known, strict=True)],
        "class_name": list(regions.class_name),
        "reason": [None if is_known else text for text, is_known in zip(regions.reason_text, known, strict=True)],
        "passable": regions.passable.tolist(),
        "c_r": _numbers(regions.c_r, 6),
        "c_r_low": _numbers(regions.c_r_low, 6),
        "c_r_high": _numbers(regions.c_r_high, 6),
        "c_r_basis": list(regions.c_r_basis),
        "p_fail": _numbers(regions.p_fail, 6),
        "hazard": _numbers(regions.hazard, 9),
        "cost": _numbers(regions.cost, 6),
        "area_m2": _numbers(regions.area_m2, 3),
        "tiles": regions.tiles.tolist(),
    }


def _numbers(values: NDArray[np.float64], decimals: int) -> list[float | None]:
    rounded: list[float] = values.round(decimals).tolist()
    return [value if is_number else None for value, is_number in zip(rounded, np.isfinite(values), strict=True)]
