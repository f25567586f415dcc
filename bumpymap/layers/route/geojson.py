"""Write route.geojson: RFC 7946, a line for each route, a point for each of its stops."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from bumpymap.core import Route, atomic
from bumpymap.layers.lonlat import BoundingBox
from bumpymap.layers.route.coordinates import RouteCoordinates
from bumpymap.layers.route.figures import route_properties

__all__ = ["stop_names", "stop_roles", "write_route_geojson"]


def write_route_geojson(routes: Sequence[Route], path: Path) -> None:
    """Write routes as GeoJSON: WGS 84 longitude and latitude with 7 decimals, plain 2D.

    Without a CRS the file holds the survey's own coordinates, and a member of the collection says so. A stop that
    several routes share is written once.

    Parameters
    ----------
    routes : sequence of Route
        At least one, all on one grid.
    path : Path
        The file, which appears only when it is complete.

    Raises
    ------
    OutputError
        The file cannot be written.
    BadInputError
        A route lies where its CRS has no longitude and latitude.
    """
    place = RouteCoordinates.of(routes)
    box = BoundingBox()
    lines = [_line(route, place, box) for route in routes]
    features = [*lines, *_stops(routes, place, box)]
    collection = {
        "type": "FeatureCollection",
        "name": "route",
        **place.files.members,
        "bbox": place.files.bounds(box),
        "features": features,
    }
    text = json.dumps(collection, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    with atomic(path) as temporary:
        temporary.write_bytes(f"{text}\n".encode("utf-8", "backslashreplace"))


def stop_roles(stops: int) -> list[str]:
    """Return what each stop of a route is: the first is the start, the last is the goal."""
    return ["start", *["via"] * (stops - 2), "goal"][:stops]


def stop_names(stops: int) -> list[str]:
    """Return a name for each stop of a route: start, via 1, via 2, ..., goal."""
    return [f"via {place}" if role == "via" else role for place, role in enumerate(stop_roles(stops))]


def _line(route: Route, place: RouteCoordinates, box: BoundingBox) -> dict[str, Any]:
    # A way of length 0 has one corner, but a LineString has two positions.
    corners = np.repeat(route.line, 2, axis=0) if len(route.line) == 1 else route.line
    parts = place.line_in_file(corners)
    box.add(_objects([shapely.linestrings(part) for part in parts]))
    geometry: dict[str, Any] = {"type": "LineString", "coordinates": parts[0].tolist()}
    if len(parts) > 1:
        geometry = {"type": "MultiLineString", "coordinates": [part.tolist() for part in parts]}
    return {"type": "Feature", "properties": route_properties(route), "geometry": geometry}


def _stops(routes: Sequence[Route], place: RouteCoordinates, box: BoundingBox) -> Iterator[dict[str, Any]]:
    written: set[tuple[str, float, float]] = set()
    for route in routes:
        positions = place.in_file(route.stops)
        box.add(_objects(list(shapely.points(positions))))
        roles, names = stop_roles(len(positions)), stop_names(len(positions))
        for role, name, position in zip(roles, names, positions.tolist(), strict=True):
            key = (role, position[0], position[1])
            if key not in written:
                written.add(key)
                point = {"type": "Point", "coordinates": position}
                yield {"type": "Feature", "properties": {"role": role, "name": name}, "geometry": point}


def _objects(geometries: list[Any]) -> NDArray[np.object_]:
    found = np.empty(len(geometries), dtype=object)
    found[:] = geometries
    return found
