"""Write route.gpx: GPX 1.1, a waypoint for each stop, a track for each route.

Elements stand in the order of the schema (http://www.topografix.com/GPX/1/1/gpx.xsd). No time is written: the same
routes have the same bytes.
"""

import math
import re
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, Route, atomic
from bumpymap.layers.route.coordinates import RouteCoordinates
from bumpymap.layers.route.figures import P_ARRIVES_NOTE
from bumpymap.layers.route.geojson import stop_names

__all__ = ["write_gpx"]

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
