"""Export a map, or a route as a mission for QGroundControl, to a folder of its own."""

import os
from dataclasses import dataclass
from os.path import lexists
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, ExportSettings, Number, OutputError, shape_fault, writing_to
from bumpymap.layers import MapReader, OutputFolder, geojson_features, line_parts, write_manifest
from bumpymap.views.export.area import choose_area, write_nav2, write_pixel_cost
from bumpymap.views.export.gridmap import write_gridmap
from bumpymap.views.words import seen_sizes
from bumpytiles import TileWindow

_WAYPOINT = 16
"""MAV_CMD_NAV_WAYPOINT."""
_RELATIVE = 3
"""MAV_FRAME_GLOBAL_RELATIVE_ALT: heights above the home position. Rovers stay on the ground whatever it is."""
_ARDUPILOT, _ROVER = 3, 10
"""MAV_AUTOPILOT_ARDUPILOTMEGA, MAV_TYPE_GROUND_ROVER."""
_MOST_WAYPOINTS = 10_000
"""Chosen."""


def read_route_line(path: Path, *, through_obstacles: bool = False) -> tuple[NDArray[np.float64], float]:
    """Read the first line of a route file.

    ``path``: GeoJSON (RFC 7946) with a LineString or MultiLineString, as ``route.geojson``; ``through_obstacles``: read
    a route that touches obstacles (its property ``obstacle_m``) too. Returns ``line`` float64 (n, 2): longitude and
    latitude of its corners, degrees; ``obstacle_m``: length on which it touches obstacles, m. Raises BadInputError: the
    file cannot be read, or holds no such line, or one that touches obstacles.
    """
    try:
        corners, touched = _first_line(path)
    except (OSError, ValueError) as error:
        raise BadInputError(
            f"cannot read a route from {path}: {error}. Give a GeoJSON file with a line, such as the route.geojson "
            "that `bumpymap route` writes"
        ) from error
    if touched > 0.0 and not through_obstacles:
        raise BadInputError(
            f"the route in {path} touches obstacles on {touched:.1f} m. Plan one that does not, or pass "
            "`through_obstacles=True` here too"
        )
    longitude, latitude = corners.T
    if len(corners) < 2 or not (np.abs(longitude) <= 180.0).all() or not (np.abs(latitude) <= 90.0).all():
        raise BadInputError(f"the line in {path} is not one of two or more points in longitude and latitude (degrees)")
    return corners, touched


def _first_line(path: Path) -> tuple[NDArray[np.float64], float]:
    """Return the first line of a GeoJSON, its parts one after the other, and its length on obstacles, m."""
    for geometry, about in geojson_features(path)[0]:
        if geometry.geom_type in {"LineString", "MultiLineString"}:
            touched = about.get("obstacle_m") or 0.0
            if fault := shape_fault(touched, Number(0.0), "obstacle_m"):
                raise ValueError(fault)
            return np.concatenate(line_parts(geometry)), float(touched)
    raise ValueError("it holds no line")


def make_plan(route_map: MapReader, line: NDArray[np.float64]) -> dict[str, Any]:
    """Make a mission on the ground along a line over a map, as the JSON of a plan of QGroundControl.

    ``route_map``: gives the speed, and the height of the ground at the start; ``line`` float64 (n, 2): longitude and
    latitude of its corners, degrees. Raises BadInputError: the line leaves the map or has too many corners, or the map
    has no CRS.
    """
    if len(line) > _MOST_WAYPOINTS:
        raise BadInputError(f"the route has {len(line):,} corners; a mission may have {_MOST_WAYPOINTS:,}")
    if not route_map.has_crs:
        raise BadInputError(
            "a mission is in longitude and latitude, and the map has no CRS. Map the survey with `crs='EPSG:CODE'`"
        )
    easting, northing = route_map.from_lonlat(line[:, 0], line[:, 1])
    bounds, edge = route_map.grid.window_bounds(route_map.window), 0.1  # m: files round coordinates to 1 cm
    inside = (easting >= bounds.west - edge) & (easting <= bounds.east + edge)
    inside &= (northing >= bounds.south - edge) & (northing <= bounds.north + edge)
    if not inside.all():
        number = int(np.flatnonzero(~inside)[0])
        raise BadInputError(
            f"point {number + 1} of the route, {line[number, 0]:.7f},{line[number, 1]:.7f}, lies outside of the map. "
            "Give the layers that the route was planned on"
        )
    places, speed = line[:, ::-1].tolist(), route_map.vehicle.speed_mps
    (col, *_), (row, *_) = (route_map.grid.index(axis).tolist() for axis in (easting, northing))
    heights = route_map.heights(TileWindow(col, row, 1, 1))
    ground = round(float(np.nanmean(heights)), 2) if np.isfinite(heights).any() else 0.0  # of the first tile; 0 unknown
    return {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "geoFence": {"circles": [], "polygons": [], "version": 2},
        "rallyPoints": {"points": [], "version": 2},
        "mission": {
            "version": 2,
            "firmwareType": _ARDUPILOT,
            "vehicleType": _ROVER,
            "cruiseSpeed": speed,
            "hoverSpeed": speed,
            "globalPlanAltitudeMode": 1,
            "plannedHomePosition": [*places[0], ground],
            "items": [_item(number, *place) for number, place in enumerate(places, start=1)],
        },
    }


def _item(number: int, latitude: float, longitude: float) -> dict[str, Any]:
    """Return a waypoint: no hold, no heading of its own, on the ground."""
    return {
        "type": "SimpleItem",
        "autoContinue": True,
        "command": _WAYPOINT,
        "doJumpId": number,
        "frame": _RELATIVE,
        "params": [0, 0, 0, None, latitude, longitude, 0],
        "AMSLAltAboveTerrain": None,
        "Altitude": 0,
        "AltitudeMode": 1,
    }


DATUM_NAME = "datum.json"
"""The sidecar file with the local datum. It is written last: a folder that has one holds a complete export."""
_IMAGES = ("map", "keepout_mask", "speed_mask")
EXPORTS = {
    to: OutputFolder((*names, DATUM_NAME), DATUM_NAME)
    for to, names in {
        "nav2": (*(f"{name}.{end}" for name in _IMAGES for end in ("yaml", "pgm")), "nav2_params.yaml"),
        "gridmap": ("gridmap.mcap", "metadata.yaml"),
        "plan": ("route.plan",),
        "cost": ("cost.tif",),
    }.items()
}
"""Files of an export, by format."""


@dataclass(frozen=True, slots=True)
class Export:
    """Files that were written."""

    files: tuple[Path, ...]
    record: dict[str, Any]
    """The content of datum.json."""


def export_map(
    route_map: MapReader, out: str | os.PathLike[str], settings: ExportSettings, *, overwrite: bool = False
) -> Export:
    """Write a map for robots to a folder: all files, or none.

    ``route_map``: from `open_map`; ``out``: a folder of its own; ``overwrite``: replace an earlier export in the same
    format. Raises BadInputError: the map or the route cannot be read, the area does not touch the map, is too large, or
    holds nothing passable; OutputError: the folder holds something that must not be replaced, or cannot be written;
    UsageError: the folder holds the layers of a run, or the extra ``ros`` is needed and not installed.
    """
    folder, files = Path(out), EXPORTS[settings.to]
    by_pixels = settings.to == "cost" or (settings.resolution == "pixel" and settings.to in {"nav2", "gridmap"})
    split = route_map.grid.pixels if by_pixels else 1
    area = choose_area(route_map, split, settings.around, settings.radius, settings.datum)
    vehicle = route_map.vehicle
    record = {
        "format": "bumpymap-export",
        "version": 1,
        "to": settings.to,
        **area.describe(),
        "layers": [route_map.folder.resolve().name],
        "calibration": route_map.calibration_id,
        "vehicle": {"name": vehicle.name, "width_m": vehicle.width_m, "speed_m_per_s": vehicle.speed_mps},
        **seen_sizes(route_map.manifest).record(),
    }
    # The faults of what was given come first, but for those that take long to find.
    plan = _plan(route_map, settings) if settings.to == "plan" else None
    foreign = sorted({name for kind in EXPORTS.values() for name in kind.names} - {*files.names})
    if lexists(folder / DATUM_NAME) and (found := [name for name in foreign if lexists(folder / name)]):
        raise OutputError(f"{folder} already holds {found[0]} of an export in another format. Choose another `out`")
    files.check(folder, overwrite=overwrite)

    def describe(staged: Path, _: list[dict[str, Any]]) -> dict[str, Any]:
        with writing_to(folder):
            match settings.to:
                case "nav2":
                    record.update(write_nav2(staged, area, settings.max_cost))
                case "gridmap":
                    record.update(write_gridmap(staged, area))
                case "cost":
                    record.update(write_pixel_cost(staged, area))
            if plan:
                write_manifest(plan[0], staged / "route.plan")
                record["plan"] = plan[1]
        return record

    files.write(folder, {}, describe, overwrite=overwrite)
    return Export(tuple(folder / name for name in files.names), record)


def _plan(route_map: MapReader, settings: ExportSettings) -> tuple[dict[str, Any], dict[str, Any]]:
    """Make a mission of a route; return it, and what the sidecar file says of it."""
    route = settings.route or route_map.folder
    path = route / "route.geojson" if route.is_dir() else route
    if not path.exists():
        raise BadInputError(
            f"there is no {path}. Plan a route first: `bumpymap route`, then pass the folder that it wrote with `route`"
        )
    line, touched = read_route_line(path, through_obstacles=settings.through_obstacles)
    about = {"waypoints": len(line), "speed_m_per_s": route_map.vehicle.speed_mps}
    return make_plan(route_map, line), about | ({"obstacle_m": touched} if touched > 0.0 else {})
