"""Points of a user's file, for routes: GeoJSON, GPX or CSV."""

import csv
import io
import logging
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError

from bumpymap.core import BadInputError, read_regular
from bumpymap.layers.route_vectors import VectorLayer, read_vectors

__all__ = ["FilePoint", "read_points"]

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
    """Which of the two it is."""


def read_points(path: str | os.PathLike[str]) -> list[FilePoint]:
    """Read the points of a GeoJSON, GPX or CSV file, in their order.

    Of a GPX file the waypoints are read; if it has none, the points of its routes. A CSV has a line of column names:
    ``lon,lat``, or ``x,y`` or ``easting,northing`` in the survey's CRS, and perhaps ``name``.

    Raises
    ------
    BadInputError
        The file is missing, damaged or of another format, or holds no points or something else.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if not path.is_file():
        raise BadInputError(f"there is no file {path}. Give a file of points: .geojson, .gpx or .csv")
    if suffix == ".csv":
        found = _read_csv(path)
    elif suffix in {".geojson", ".json", ".gpx"}:
        found = _of_layer(path, read_vectors(path))
    else:
        raise BadInputError(f"{path} is not a file of points that can be read. Give .geojson, .gpx or .csv")
    if not found:
        raise BadInputError(f"{path} holds no points. Give a file with at least one")
    if len(found) > _MOST:
        raise BadInputError(f"{path} holds {len(found):,} points; at most {_MOST:,} can be read")
    return found


def _of_layer(path: Path, layer: VectorLayer) -> list[FilePoint]:
    """Return the points of a vector layer in longitude and latitude; in the survey's CRS if they cannot be that."""
    kinds = shapely.get_type_id(layer.geometry)
    other = ~np.isin(kinds, (shapely.GeometryType.POINT, shapely.GeometryType.MULTIPOINT))
    if other.any():
        kind = shapely.GeometryType(int(kinds[other][0])).name.lower()
        raise BadInputError(f"{path} holds a {kind}; only points can be start, goal or stops of a route")
    parts, owner = shapely.get_parts(layer.geometry, return_index=True)
    x, y = shapely.get_x(parts), shapely.get_y(parts)
    system: Literal["lonlat", "crs"] = "lonlat"
    if layer.crs is None:
        system = "crs"
        _log.warning("the numbers of %s cannot be degrees: they are read in the survey's CRS", path)
    else:
        x, y = _lonlat(path, layer.crs, x, y)
    names = [layer.names[index] or str(number) for number, index in enumerate(owner, start=1)]
    return [FilePoint(name, float(east), float(north), system) for name, east, north in zip(names, x, y, strict=True)]


def _lonlat(
    path: Path, crs: CRS, x: NDArray[np.float64], y: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Convert to WGS 84 longitude and latitude."""
    if crs.equals(CRS.from_epsg(4326), ignore_axis_order=True):
        return x, y
    try:
        longitude, latitude = Transformer.from_crs(crs, CRS.from_epsg(4326), always_xy=True).transform(x, y)
    except ProjError as error:
        raise BadInputError(f"{path} is in {crs.name}, which cannot be converted to longitude and latitude") from error
    return np.asarray(longitude), np.asarray(latitude)


def _read_csv(path: Path) -> list[FilePoint]:
    try:
        with io.StringIO(read_regular(path).decode("utf-8-sig"), newline="") as file:
            head = file.readline()
            separator = max(",;\t", key=head.count)
            names = [name.strip().lower() for name in next(csv.reader([head], delimiter=separator), [])]
            lines = list(csv.reader(file, delimiter=separator))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise BadInputError(f"cannot read {path}: {error}. It must be a text file of columns {_ALLOWED}") from error
    for system, pairs in _COLUMNS.items():
        for pair in pairs:
            if set(pair) <= set(names):
                columns = [names.index(name) for name in pair]
                name_column = names.index("name") if "name" in names else None
                filled = [(number, line) for number, line in enumerate(lines, start=2) if any(map(str.strip, line))]
                where = [f"{path}, line {number}: '{separator.join(line)}'" for number, line in filled]
                return [
                    _point(at, number, line, columns, name_column, system)
                    for at, (number, line) in zip(where, filled, strict=True)
                ]
    raise BadInputError(f"{path} has the columns {', '.join(names) or '(none)'}; it needs {_ALLOWED}")


def _point(
    where: str,
    number: int,
    line: Sequence[Any],
    columns: Sequence[int],
    name_column: int | None,
    system: Literal["lonlat", "crs"],
) -> FilePoint:
    try:
        x, y = (float(line[column]) for column in columns)
    except (ValueError, IndexError) as error:
        raise BadInputError(f"{where} has no two numbers where they belong; write decimals with a point") from error
    if not np.isfinite([x, y]).all():
        raise BadInputError(f"{where} is not a place")
    named = line[name_column].strip() if name_column is not None and name_column < len(line) else ""
    return FilePoint(named or str(number - 1), x, y, system)
