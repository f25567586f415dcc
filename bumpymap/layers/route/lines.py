"""Write route.geojson (RFC 7946), route.gpx (GPX 1.1) and profile.csv: routes, their stops, and what lies along them.

Elements of GPX stand in the order of the schema (http://www.topografix.com/GPX/1/1/gpx.xsd). No time is written: the
same routes have the same bytes.
"""

import json
import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import shapely
from numpy.typing import NDArray

from bumpymap.core import BadInputError, Route, atomic, write_csv
from bumpymap.layers.route.coordinates import P_ARRIVES_NOTE, RouteCoordinates, route_properties
from bumpymap.layers.vector import BoundingBox

__all__ = ["PROFILE_COLUMNS", "stop_names", "stop_roles", "write_gpx", "write_profile", "write_route_geojson"]


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


GPX = "http://www.topografix.com/GPX/1/1"
_NEAR_M = 1e-6
"""Points of the profile this near to a corner are that corner."""
_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML 1.0 cannot hold."""


def write_gpx(routes: Sequence[Route], path: Path) -> None:
    """Write routes as GPX 1.1, with heights where they are known.

    A track has the corners of its way and the points of its profile between them. Heights are those of the survey:
    metres, in its vertical datum.

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
        The routes have no longitude and latitude.
    """
    place = RouteCoordinates.of(routes)
    if not place.has_degrees:
        raise BadInputError(
            "the layers have no CRS, so a GPX file cannot say where on Earth the route is. Map the survey with "
            "`crs='EPSG:CODE'`, or write the route as GeoJSON or CSV"
        )
    root = ET.Element("gpx", {"version": "1.1", "creator": "bumpymap", "xmlns": GPX})
    tracks = [track_points(route) for route in routes]
    degrees = [_degrees(points[:, :2], place) for points in tracks]
    _bounds(ET.SubElement(root, "metadata"), np.concatenate(degrees))
    _waypoints(root, routes, place)
    for route, points, positions in zip(routes, tracks, degrees, strict=True):
        track = ET.SubElement(root, "trk")
        _text(track, "name", route.name)
        _text(track, "desc", _description(route))
        _text(track, "type", "planned route")
        segment = ET.SubElement(track, "trkseg")
        for position, height in zip(positions, points[:, 2].tolist(), strict=True):
            _point(segment, "trkpt", position, height)
    ET.indent(root, " ")
    with atomic(path) as temporary:
        ET.ElementTree(root).write(temporary, encoding="utf-8", xml_declaration=True)


def track_points(route: Route) -> NDArray[np.float64]:
    """Return the points of a track in order, (n, 3): easting, northing and height, m (NaN if unknown).

    The points of the profile alone would cut corners; the corners alone would have few heights.
    """
    profile = route.profile
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(route.line, axis=0).T))])
    after = np.searchsorted(along, profile.distance)
    before_m = np.abs(profile.distance - along[np.maximum(after - 1, 0)])
    after_m = np.abs(profile.distance - along[np.minimum(after, len(along) - 1)])
    between = np.minimum(before_m, after_m) > _NEAR_M
    heights = np.interp(along, profile.distance, profile.z)
    corners = np.column_stack([route.line, heights])
    others = np.column_stack([profile.easting, profile.northing, profile.z])[between]
    order = np.argsort(np.concatenate([along, profile.distance[between]]), kind="stable")
    return np.asarray(np.concatenate([corners, others])[order], dtype=np.float64)


def _degrees(grid_m: NDArray[np.float64], place: RouteCoordinates) -> NDArray[np.float64]:
    """Return longitude (below 180, as the schema wants it) and latitude, (n, 2)."""
    degrees = place.in_file(grid_m)
    degrees[degrees[:, 0] == 180.0, 0] = -180.0
    return degrees


def _bounds(metadata: ET.Element, degrees: NDArray[np.float64]) -> None:
    _text(metadata, "name", "routes planned by bumpymap")
    west, south = degrees.min(axis=0)
    east, north = degrees.max(axis=0)
    if east - west <= 180.0:  # bounds cannot cross the antimeridian
        sides = {"minlat": south, "minlon": west, "maxlat": north, "maxlon": east}
        ET.SubElement(metadata, "bounds", {name: f"{value:.7f}" for name, value in sides.items()})


def _waypoints(root: ET.Element, routes: Sequence[Route], place: RouteCoordinates) -> None:
    written = set()
    for route in routes:
        stops = _degrees(route.stops, place)
        for name, position in zip(stop_names(len(stops)), stops, strict=True):
            if (name, *position) not in written:
                written.add((name, *position))
                _text(_point(root, "wpt", position, math.nan), "name", name)


def _point(parent: ET.Element, tag: str, position: NDArray[np.float64], height: float) -> ET.Element:
    lon, lat = position
    point = ET.SubElement(parent, tag, {"lat": f"{lat:.7f}", "lon": f"{lon:.7f}"})
    if math.isfinite(height):
        _text(point, "ele", f"{height:.3f}")
    return point


def _description(route: Route) -> str:
    figures = route.figures
    touching = f"touches obstacles on {figures.obstacle_m:.1f} m, " if figures.obstacle_m > 0.0 else ""
    return (
        f"{figures.length_m:.1f} m for {route.vehicle.name}, {touching}mean ride cost {figures.c_r_mean:.3f} rad/m, "
        f"P(arrives) {figures.p_arrives:.3f} ({P_ARRIVES_NOTE})"
    )


def _text(parent: ET.Element, tag: str, text: str) -> None:
    ET.SubElement(parent, tag).text = _NOT_XML.sub("?", text)


PROFILE_COLUMNS = (
    *("route", "distance_m", "lon", "lat", "x", "y"),
    *("z_m", "slope_deg", "c_r", "c_r_low", "c_r_high", "p_fail", "cost_m"),
)
"""Columns of profile.csv; ``x`` and ``y`` are in units of the survey's CRS."""
_FORMATS = ("%.3f", "%.7f", "%.7f", "%.3f", "%.3f", "%.3f", "%.3f", "%.6f", "%.6f", "%.6f", "%.6f", "%.3f")


def write_profile(routes: Sequence[Route], path: Path) -> None:
    """Write the profiles of routes as CSV (RFC 4180, UTF-8); what is unknown is empty.

    Parameters
    ----------
    routes : sequence of Route
        At least one, all on one grid; the column ``route`` holds their names.
    path : Path
        The file, which appears only when it is complete.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    place = RouteCoordinates.of(routes)
    write_csv(path, PROFILE_COLUMNS, (row for route in routes for row in _rows(route, place)))


def _rows(route: Route, place: RouteCoordinates) -> Iterator[tuple[str, ...]]:
    profile = route.profile
    grid_m = np.column_stack([profile.easting, profile.northing])
    degrees = place.in_file(grid_m) if place.has_degrees else np.full_like(grid_m, np.nan)
    columns = (
        *(profile.distance, *degrees.T, *place.in_crs(grid_m).T),
        *(profile.z, profile.slope, profile.c_r, profile.c_r_low, profile.c_r_high, profile.p_fail, profile.cost),
    )
    texts = [_texts(values, form) for values, form in zip(columns, _FORMATS, strict=True)]
    return zip([route.name] * len(profile.distance), *texts, strict=True)


def _texts(values: NDArray[np.float64], form: str) -> list[str]:
    return ["" if text in {"nan", "inf", "-inf"} else text for text in (form % value for value in values.tolist())]
