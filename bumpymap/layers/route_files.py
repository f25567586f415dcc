"""The files of routes, route.geojson (RFC 7946), route.gpx (GPX 1.1) and profile.csv.

Coordinates are in the survey's CRS, and in WGS 84 longitude and latitude where that CRS is known. Elements of GPX stand
in the order of the schema (http://www.topografix.com/GPX/1/1/gpx.xsd). No time is written: the same route has the
same bytes. Writers take the path of a file that appears only when it is complete; they raise OutputError if it cannot
be written.
"""

import math
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import shapely
from numpy.typing import NDArray

from bumpymap.core import BadInputError, Route, atomic, chance_text, write_csv
from bumpymap.layers.placement import Placement
from bumpymap.layers.vector import DEGREE_DECIMALS, GeoJsonCoordinates, feature, write_features
from bumpytiles import TileWindow

P_ARRIVES_NOTE = "errors of neighbouring tiles go together: an estimate"
_SMALL = 6
"""Decimals of shares, angles per metre and ratios; lengths and times have 3."""
_DECIMALS = {
    **dict.fromkeys(("length_m", "straight_m"), 3),
    "detour": _SMALL,
    "cost_m": 3,
    **dict.fromkeys(("c_r_mean", "c_r_mean_low", "c_r_mean_high", "c_r_max", "c_r_max_low", "c_r_max_high"), _SMALL),
    **dict.fromkeys(("c_r_line", "c_r_line_low", "c_r_line_high"), _SMALL),
    "p_arrives": _SMALL,
    "p_fail_max": _SMALL,
    **dict.fromkeys(("unknown_m", "obstacle_m", "climb_m", "descent_m", "seconds"), 3),
    "tight_turns_deg": 1,
}
"""Properties of `RouteFigures` and the number of decimals that is written of each."""


def route_properties(route: Route) -> dict[str, Any]:
    """Return name, vehicle and figures of a route; a number that is not known is None."""
    figures = route.figures
    return {
        "name": route.name,
        "vehicle": route.vehicle.name,
        **{name: _rounded(float(getattr(figures, name)), decimals) for name, decimals in _DECIMALS.items()},
        "p_arrives_note": f"{figures.seen.condition}; {P_ARRIVES_NOTE}",
        **figures.seen.record(),
        "risk_m": _rounded(route.risk_m, 3),
        "why": route.straight.words if route.straight else "",
    }


def _rounded(value: float, decimals: int) -> float | None:
    """Round a number; None for one that is not finite."""
    return round(value, decimals) if math.isfinite(value) else None


_SEGMENT_M = 96.0
"""Longest straight segment of a line in longitude and latitude, m: its middle is then off by 1.2 mm at most, as for
the outlines of cost.geojson (see `GeoJsonCoordinates.polygons`)."""


def route_coordinates(route: Route) -> GeoJsonCoordinates:
    """Return the coordinates for files with this route.

    A survey without a CRS, with one that has no relation to longitude and latitude, or across the antimeridian keeps
    its own coordinates: it was mapped with ``local``.
    """
    return GeoJsonCoordinates.of(Placement(route.georeference, route.grid, window_around(route, 0.0)), local=True)


def window_around(route: Route, margin_m: float) -> TileWindow:
    """Return the tiles around line and stops of a route, and ``margin_m`` metres around them."""
    points = np.concatenate([route.line, route.stops])
    edges = np.array([points.min(axis=0) - margin_m, points.max(axis=0) + margin_m])
    return TileWindow.around(*route.grid.index(edges).T)


def write_route_geojson(route: Route, path: Path) -> None:
    """Write a route as GeoJSON: WGS 84 longitude and latitude with 7 decimals, plain 2D.

    Without a CRS the file holds the survey's own coordinates, and a member of the collection says so.

    Raises BadInputError: the route lies where its CRS has no longitude and latitude.
    """
    place = route_coordinates(route)
    # A way of length 0 has one corner, but a LineString has two positions.
    corners = np.repeat(route.line, 2, axis=0) if len(route.line) == 1 else route.line
    if place.has_degrees and (corners != corners[0]).any():  # GEOS knows no line of length 0
        # Points in between keep long segments straight on the ground.
        corners = shapely.get_coordinates(shapely.segmentize(shapely.linestrings(corners), _SEGMENT_M))
    line = feature(route_properties(route), shapely.LineString(place.in_file(corners)))
    roles, names, positions = stop_roles(len(route.stops)), stop_names(len(route.stops)), place.in_file(route.stops)
    stops = (
        feature({"role": role, "name": name}, shapely.Point(position))
        for role, name, position in zip(roles, names, positions.tolist(), strict=True)
    )
    write_features(path, "route", place, [line, *stops])


def stop_roles(stops: int) -> list[str]:
    """Return what each stop of a route is: the first is the start, the last is the goal."""
    return ["start", *["via"] * (stops - 2), "goal"][:stops]


def stop_names(stops: int) -> list[str]:
    """Return a name for each stop of a route: start, via 1, via 2, ..., goal."""
    return [f"via {place}" if role == "via" else role for place, role in enumerate(stop_roles(stops))]


GPX = "http://www.topografix.com/GPX/1/1"
_NEAR_M = 1e-6
"""Points of the profile this near to a corner, m, are that corner: far above rounding, far below any length."""
_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML 1.0 cannot hold."""


def write_gpx(route: Route, path: Path) -> None:
    """Write a route as GPX 1.1, with heights where they are known.

    A track has the corners of its way and the points of its profile between them. Heights are those of the survey:
    metres, in its vertical datum.

    Raises BadInputError: the route has no longitude and latitude.
    """
    place = route_coordinates(route)
    if not place.has_degrees:
        raise BadInputError(
            "the layers have no CRS, so a GPX file cannot say where on Earth the route is. Map the survey with "
            "`crs='EPSG:CODE'`, or write the route as GeoJSON or CSV"
        )
    root = ET.Element("gpx", {"version": "1.1", "creator": "bumpymap", "xmlns": GPX})
    points = track_points(route)
    degrees = place.in_file(points[:, :2])
    metadata = ET.SubElement(root, "metadata")
    _text(metadata, "name", "route planned by bumpymap")
    west, south = degrees.min(axis=0)
    east, north = degrees.max(axis=0)
    sides = {"minlat": south, "minlon": west, "maxlat": north, "maxlon": east}
    ET.SubElement(metadata, "bounds", {name: f"{value:.7f}" for name, value in sides.items()})
    for name, position in zip(stop_names(len(route.stops)), place.in_file(route.stops), strict=True):
        _text(_point(root, "wpt", position, math.nan), "name", name)
    track = ET.SubElement(root, "trk")
    _text(track, "name", route.name)
    _text(track, "desc", _description(route))
    _text(track, "type", "planned route")
    segment = ET.SubElement(track, "trkseg")
    for position, height in zip(degrees, points[:, 2].tolist(), strict=True):
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
        f"arrives {chance_text(figures.p_arrives)} {figures.seen.condition} ({P_ARRIVES_NOTE}). {figures.seen.sentence}"
    ).rstrip()


def _text(parent: ET.Element, tag: str, text: str) -> None:
    ET.SubElement(parent, tag).text = _NOT_XML.sub("?", text)


_PROFILE = {
    "distance_m": 3,
    **dict.fromkeys(("lon", "lat"), DEGREE_DECIMALS),
    **dict.fromkeys(("x", "y", "z_m", "slope_deg"), 3),
    **dict.fromkeys(("c_r", "c_r_low", "c_r_high", "p_fail"), _SMALL),
    "cost_m": 3,
    "obstacle": 0,
    "c_r_line": _SMALL,
    "speed_mps": 3,
}
"""Columns of profile.csv after the route, and their decimals; ``x`` and ``y`` are in units of the survey's CRS."""
PROFILE_COLUMNS = ("route", *_PROFILE)


def write_profile(route: Route, path: Path) -> None:
    """Write the profile of a route as CSV (RFC 4180, UTF-8): its name in the column ``route``; unknown is empty."""
    profile, place = route.profile, route_coordinates(route)
    grid_m = np.column_stack([profile.easting, profile.northing])
    degrees = place.in_file(grid_m) if place.has_degrees else np.full_like(grid_m, np.nan)
    columns = (
        *(profile.distance, *degrees.T, *place.in_crs(grid_m).T),
        *(profile.z, profile.slope, profile.c_r, profile.c_r_low, profile.c_r_high, profile.p_fail, profile.cost),
        *(profile.obstacle, profile.c_r_line, profile.speed),
    )
    texts = [
        [f"{value:.{decimals}f}" if math.isfinite(value) else "" for value in values.tolist()]
        for values, decimals in zip(columns, _PROFILE.values(), strict=True)
    ]
    write_csv(path, PROFILE_COLUMNS, zip([route.name] * len(profile.distance), *texts, strict=True))
