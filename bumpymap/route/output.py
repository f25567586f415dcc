"""Write the files of a route: all of them to a folder, or one of them alone."""

import logging
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Route, StraightLine, UsageError
from bumpymap.layers import (
    MANIFEST_NAME,
    OTHER_FILES,
    GeoJsonCoordinates,
    MapFile,
    MapReader,
    OutputFolder,
    Placement,
    describe_file,
    refuse_present,
    require_folder,
    require_new_file,
    route_coordinates,
    route_properties,
    software_versions,
    stop_names,
    window_around,
    write_gpx,
    write_profile,
    write_route_geojson,
)
from bumpymap.views import route_layers, view_writers

_log = logging.getLogger(__name__)

ROUTE_MANIFEST_NAME = "route.json"
ROUTE_KINDS = {".geojson": "route.geojson", ".gpx": "route.gpx", ".csv": "profile.csv"}
"""Name of the file that is written alone, by its suffix."""
_VIEWS = ("route.qml", MapFile.PROJECT)
ROUTE_FILES = OutputFolder(
    (*ROUTE_KINDS.values(), *_VIEWS, ROUTE_MANIFEST_NAME),
    ROUTE_MANIFEST_NAME,
    views=_VIEWS,
)
_AROUND_M = 10.0
"""Ground around the ways when their project is opened, m (chosen)."""


def check_out(out: Path, *, overwrite: bool) -> str | None:
    """Check, before anything is computed, that files can be written to a folder, or one to a file. Writes nothing.

    ``out``: a folder, or one file that ends in a suffix of `ROUTE_KINDS`. Returns the name of what a single file
    holds; None for a folder. Raises UsageError: ``out`` is named like a file of a
    kind that is not written; OutputError: there are files that must not be replaced, or the place of a file is missing.
    """
    suffix, is_folder = out.suffix.lower(), out.is_dir()
    if suffix in ROUTE_KINDS and (not is_folder or out.is_symlink()):
        require_new_file(out, overwrite=overwrite)
        return ROUTE_KINDS[suffix]
    if suffix in OTHER_FILES and not is_folder:
        raise UsageError(
            f"{out} is named like a {suffix} file, which is not written here. Give a folder as `out`, or a file that "
            f"ends in {', '.join(ROUTE_KINDS)}"
        )
    require_folder(out)
    refuse_present(out, ROUTE_FILES.names, overwrite=overwrite)
    return None


def write_route(
    route: Route, source: MapReader, out: Path, manifest: Mapping[str, Any], *, overwrite: bool = False
) -> list[Path]:
    """Write route.geojson, route.gpx, profile.csv, route.json and a project of QGIS to a folder.

    ``out`` may be a file instead, for one of the first three.

    All files appear or none; links are replaced, never followed. Files of an earlier run that this one does not write
    are removed. Without longitude and latitude route.gpx is left out, and route.json says so. Except for route.json no
    file depends on the time, and none but it and map.qgs on folder names.

    ``source``: the map that it was planned on; ``manifest``: the run's own entries for route.json, such as settings.
    Returns what was written, the manifest last. Raises UsageError, OutputError: see `check_out`; or a file cannot be
    written; BadInputError: a layer cannot be read, or the route has no longitude and latitude and ``out`` is a GPX
    file.
    """
    one_file, place = check_out(out, overwrite=overwrite), route_coordinates(route)
    notes: list[str] = []
    writers: dict[str, Callable[[Path], None]] = {
        "route.geojson": partial(write_route_geojson, route),
        "route.gpx": partial(write_gpx, route),
        "profile.csv": partial(write_profile, route),
    }
    if one_file is not None:
        writers[one_file](out)
        return [out]
    if not place.has_degrees:
        del writers["route.gpx"]
        notes = ["route.gpx was not written: the layers have no CRS, so longitude and latitude are unknown"]
        _log.warning(notes[0])
    spot = Placement(route.georeference, route.grid, window_around(route, _AROUND_M))
    writers |= view_writers(route_layers(route), spot, source, out, "ways")
    layers = {"path": str(source.folder), "run_sha256": describe_file(source.folder / MANIFEST_NAME)["sha256"]}
    of_map = source.manifest
    kept: dict[str, Any] = {name: of_map[name] for name in ("vehicle", "calibration", "cost", "crs") if name in of_map}
    head = {"format": "bumpymap-route", "version": 1, **manifest, "layers": [layers], **kept}
    head |= {"routes": [_describe(route, place)], "notes": notes, "versions": software_versions()}
    return ROUTE_FILES.write(out, writers, lambda _, files: head | {"files": files}, overwrite=overwrite)


def _describe(route: Route, place: GeoJsonCoordinates) -> dict[str, Any]:
    names = stop_names(len(route.stops))
    return {
        **route_properties(route),
        "stops": [{"name": name, **spot} for name, spot in zip(names, _spots(route.stops, place), strict=True)],
        "corners": len(route.line),
        "straight": None if route.straight is None else _describe_straight(route.straight, place),
    }


def _describe_straight(straight: StraightLine, place: GeoJsonCoordinates) -> dict[str, Any]:
    """Return what the straight line between the stops costs, and where it makes the way turn."""
    points = np.array([(turn.easting, turn.northing) for turn in straight.turns]).reshape(-1, 2)
    turns = [
        {**spot, "closed_m": round(turn.closed_m, 3), "length_m": round(turn.length_m, 3), "why": turn.why}
        for turn, spot in zip(straight.turns, _spots(points, place), strict=True)
    ]
    return {"cost_m": round(straight.cost_m, 3), "closed_m": round(straight.closed_m, 3), "turns": turns}


def _spots(points: NDArray[np.float64], place: GeoJsonCoordinates) -> list[dict[str, float]]:
    """Return points (n, 2) in the CRS of the survey, and their longitude and latitude if these are known."""
    both = zip(place.in_crs(points), place.in_file(points), strict=True)
    return [{"x": x, "y": y, **({"lon": lon, "lat": lat} if place.has_degrees else {})} for (x, y), (lon, lat) in both]
