"""Write the files of a route, or of the reach from one start: all of them to a folder, or one of them alone."""

import logging
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from os.path import lexists
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import OutputError, Route, StraightLine, UsageError
from bumpymap.layers import (
    MANIFEST_NAME,
    OTHER_FILES,
    GeoJsonCoordinates,
    MapFile,
    MapReader,
    OutputFolder,
    Placement,
    ReachField,
    describe_file,
    refuse_present,
    require_folder,
    route_coordinates,
    route_properties,
    software_versions,
    stop_names,
    window_around,
    write_gpx,
    write_isochrones,
    write_profile,
    write_reach,
    write_route_geojson,
)
from bumpymap.views import reach_layers, route_layers, view_writers

_log = logging.getLogger(__name__)

ROUTE_MANIFEST_NAME = "route.json"
ROUTE_KINDS = {".geojson": "route.geojson", ".gpx": "route.gpx", ".csv": "profile.csv"}
REACH_KINDS = {".tif": "reach.tif", ".geojson": "isochrones.geojson"}
"""Name of the file that is written alone, by its suffix."""
_VIEWS = ("route.qml", "reach.qml", "isochrones.qml", MapFile.PROJECT)
ROUTE_FILES = OutputFolder(
    (*ROUTE_KINDS.values(), *REACH_KINDS.values(), *_VIEWS, ROUTE_MANIFEST_NAME),
    ROUTE_MANIFEST_NAME,
    views=_VIEWS,
)
_AROUND_M = 10.0
"""Ground around the ways when their project is opened, m (chosen)."""


def check_out(out: Path, kinds: Mapping[str, str], *, overwrite: bool) -> str | None:
    """Check, before anything is computed, that files can be written to a folder, or one to a file. Writes nothing.

    ``out``: a folder, or one file that ends in a suffix of ``kinds``, `ROUTE_KINDS` or `REACH_KINDS`. Returns the name,
    by ``kinds``, of what a single file holds; None for a folder. Raises UsageError: ``out`` is named like a file of a
    kind that is not written; OutputError: there are files that must not be replaced, or the place of a file is missing.
    """
    suffix, is_folder = out.suffix.lower(), out.is_dir()
    if suffix in kinds and (not is_folder or out.is_symlink()):
        if not out.parent.is_dir():
            raise OutputError(
                f"cannot write {out}: there is no folder {out.parent}. Create it, or choose another `out`"
            )
        if lexists(out) and not overwrite:
            raise OutputError(f"{out} exists. Choose another `out`, or pass `overwrite=True` to replace it")
        return kinds[suffix]
    if suffix in OTHER_FILES and not is_folder:
        raise UsageError(
            f"{out} is named like a {suffix} file, which is not written here. Give a folder as `out`, or a file that "
            f"ends in {', '.join(kinds)}"
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
    one_file, place = check_out(out, ROUTE_KINDS, overwrite=overwrite), route_coordinates(route)
    notes: list[str] = []
    writers: dict[str, Callable[[Path], None]] = {
        "route.geojson": partial(write_route_geojson, route),
        "route.gpx": partial(write_gpx, route),
        "profile.csv": partial(write_profile, route),
    }
    if not place.has_degrees and one_file is None:
        del writers["route.gpx"]
        notes = ["route.gpx was not written: the layers have no CRS, so longitude and latitude are unknown"]
        _log.warning(notes[0])
    if one_file is None:
        spot = Placement(route.georeference, route.grid, window_around(route, _AROUND_M))
        writers |= view_writers(route_layers(route), spot, source, out, "ways")
    entries = {**manifest, **_describe_layers(source), "routes": [_describe(route, place)], "notes": notes}
    return _write(writers, out, one_file, entries, overwrite=overwrite)


def write_reach_files(
    reach: ReachField,
    source: MapReader,
    out: Path,
    manifest: Mapping[str, Any],
    *,
    levels: Sequence[float] = (),
    overwrite: bool = False,
) -> list[Path]:
    """Write reach.tif, isochrones.geojson (with levels), route.json and a project of QGIS to a folder.

    ``out`` may be one file instead, .tif for the raster or .geojson for the isochrones; ``levels`` of these: minutes.
    For the other parameters, the result and errors see `write_route`.
    """
    one_file = check_out(out, REACH_KINDS, overwrite=overwrite)
    about = {"vehicle": source.vehicle.name}
    writers: dict[str, Callable[[Path], None]] = {"reach.tif": partial(write_reach, reach, about=about)}
    if levels:
        writers["isochrones.geojson"] = partial(write_isochrones, reach, levels, about=about)
    if one_file is None:
        writers |= view_writers(reach_layers(reach, levels), reach.placement, source, out, "what can be reached")
    entries = {**manifest, **_describe_layers(source), "notes": []}
    return _write(writers, out, one_file, entries, overwrite=overwrite)


def _write(
    writers: Mapping[str, Callable[[Path], None]],
    out: Path,
    one_file: str | None,
    entries: Mapping[str, Any],
    *,
    overwrite: bool,
) -> list[Path]:
    """Write one file, from `check_out`, or all of them and route.json with these entries."""
    if one_file is not None:
        if one_file not in writers:
            raise UsageError(
                f"{out} would hold {one_file}, which needs levels. Give the levels of the isochrones too, or a folder"
            )
        writers[one_file](out)
        return [out]
    head = {"format": "bumpymap-route", "version": 1, **entries, "versions": software_versions()}
    return ROUTE_FILES.write(out, writers, lambda _, files: head | {"files": files}, overwrite=overwrite)


def _describe_layers(source: MapReader) -> dict[str, Any]:
    """Return the layers that a route was planned on: their folder, the checksum of run.json, the calibration."""
    layers = {"path": str(source.folder), "run_sha256": describe_file(source.folder / MANIFEST_NAME)["sha256"]}
    kept = "vehicle", "calibration", "cost", "crs"
    return {"layers": [layers], **{name: source.manifest[name] for name in kept if name in source.manifest}}


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
