"""Read a vector file of a user's: geometries, names and CRS.

GeoJSON and GPX are read here: GDAL would choose a driver by what the file holds, and some formats name other files or
URLs to read. The binary formats go to GDAL once they begin as their name says.
"""

import json
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS
from pyproj.exceptions import CRSError

from bumpymap.core import BadInputError, parse_json, read_regular, stated_crs
from bumpymap.layers.map_files import require_format

__all__ = ["VectorLayer", "read_vectors"]

"""Largest GeoJSON or GPX file that is read."""
_REMEDY = "Give a vector file such as GeoJSON, which a GIS can save"


@dataclass(frozen=True, slots=True)
class VectorLayer:
    """One layer of a vector file."""

    geometry: NDArray[np.object_]
    """(n,) shapely geometries in two dimensions, of the features that have one."""
    names: tuple[str, ...]
    """(n,) of the field ``name``; empty strings without one."""
    crs: CRS | None
    """As the file states it; of a GeoJSON that states none longitude and latitude, or None if its numbers cannot be
    degrees."""


def read_vectors(path: Path) -> VectorLayer:
    """Read the only layer of a vector file; of a GPX file the waypoints, or else the points of its routes.

    Raises
    ------
    BadInputError
        The file is missing, damaged or no vector file, or it has several layers.
    """
    try:
        if path.suffix.lower() in {".geojson", ".json"}:
            return _read_geojson(path)
        if path.suffix.lower() == ".gpx":
            return _read_gpx(path)
    except (OSError, ValueError, LookupError, TypeError, AttributeError, SyntaxError) as error:
        raise BadInputError(f"cannot read {path}: {error}. {_REMEDY}") from error
    except (CRSError, shapely.errors.GEOSException) as error:
        raise BadInputError(f"cannot read {path}: {str(error).splitlines()[0]}. {_REMEDY}") from error
    require_format(path)
    return _read_by_gdal(path)


def _text(path: Path) -> str:
    return read_regular(path).decode("utf-8-sig")


def _read_geojson(path: Path) -> VectorLayer:
    record = parse_json(_text(path))
    if not isinstance(record, dict) or "type" not in record:
        raise ValueError("it is no GeoJSON: it has no type")
    features = record["features"] if record["type"] == "FeatureCollection" else [record]
    found, names = [], []
    for feature in features:
        geometry = feature["geometry"] if feature["type"] == "Feature" else feature
        if geometry is not None:
            found.append(json.dumps(geometry, allow_nan=False))
            names.append((feature.get("properties") or {}).get("name") if feature["type"] == "Feature" else None)
    shapes = np.asarray(shapely.force_2d(shapely.from_geojson(found)), object)
    stated = record.get("crs")
    if stated is not None:
        if stated["type"] != "name":
            raise ValueError("its CRS is given by a link, which is not followed")
        return _layer(shapes, names, stated_crs(str(stated["properties"]["name"])))
    degrees = (np.abs(shapely.get_coordinates(shapes)) <= (180.0, 90.0)).all()
    return _layer(shapes, names, CRS.from_user_input("OGC:CRS84") if degrees else None)


def _read_gpx(path: Path) -> VectorLayer:
    root = ET.fromstring(_text(path))  # noqa: S314 (expat limits what entities grow to, and fetches none)
    if root.tag.rpartition("}")[2] != "gpx":
        raise ValueError("it is no GPX")
    found = list(_gpx_points(root, "{*}wpt")) or list(_gpx_points(root, "{*}rte/{*}rtept"))
    points = [shapely.Point(place) for place, _ in found]
    return _layer(np.array(points, object), [name for _, name in found], CRS.from_user_input("OGC:CRS84"))


def _gpx_points(root: ET.Element, path: str) -> Iterator[tuple[tuple[float, float], str | None]]:
    for point in root.iterfind(path):
        place = float(point.attrib["lon"]), float(point.attrib["lat"])
        if not np.isfinite(place).all():
            raise ValueError("a point of it is not a place")
        yield place, point.findtext("{*}name")


def _read_by_gdal(path: Path) -> VectorLayer:
    import pyogrio
    from pyogrio.raw import read

    errors = (
        pyogrio.errors.DataSourceError,
        pyogrio.errors.DataLayerError,
        pyogrio.errors.FeatureError,
        pyogrio.errors.FieldError,
        pyogrio.errors.GeometryError,
        shapely.errors.GEOSException,
        CRSError,
        ValueError,
        UnboundLocalError,  # of pyogrio, where the CRS is no text
    )
    try:
        layers = [str(name) for name, kind in pyogrio.list_layers(path) if kind is not None]
        if len(layers) != 1:
            listed = ", ".join(layers) or "none"
            raise BadInputError(f"{path} must hold one layer of geometries; it holds: {listed}. Save one by itself")
        with warnings.catch_warnings(action="ignore"):  # such as of rings that do not end where they began
            about, _, wkb, columns = read(path, layer=layers[0], columns=["name"], force_2d=True)
        crs = None if about["crs"] is None else stated_crs(about["crs"])
        geometry = shapely.from_wkb(wkb)
    except errors as error:
        # GDAL's text on a file that it cannot open gives advice on GDAL.
        damaged = isinstance(error, pyogrio.errors.DataSourceError | UnboundLocalError)
        said = "it is damaged" if damaged else error
        raise BadInputError(f"cannot read {path}: {said}. {_REMEDY}") from error
    return _layer(geometry, columns[0] if len(columns) else [None] * len(geometry), crs)


def _layer(geometry: NDArray[np.object_], names: Sequence[Any] | NDArray[np.object_], crs: CRS | None) -> VectorLayer:
    held = ~(shapely.is_missing(geometry) | shapely.is_empty(geometry))
    if not np.isfinite(shapely.get_coordinates(geometry[held])).all():
        raise ValueError("a coordinate is not a finite number")
    texts = [str(name).strip() if isinstance(name, str | int) else "" for name in names]
    return VectorLayer(geometry[held], tuple(text for text, kept in zip(texts, held, strict=True) if kept), crs)
