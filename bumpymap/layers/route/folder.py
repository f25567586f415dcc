"""Write the files of routes, or of the reach from one start: all of them to a folder, or one of them alone."""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from bumpymap.core import (
    Route,
    UsageError,
)
from bumpymap.layers.manifest import MANIFEST_NAME, describe_file, software_versions
from bumpymap.layers.products import write_own_folder
from bumpymap.layers.route.lines import (
    MapSource,
    RouteCoordinates,
    route_properties,
    stop_names,
    write_gpx,
    write_profile,
    write_route_geojson,
)
from bumpymap.layers.route.picture import (
    REACH_KINDS,
    ROUTE_KINDS,
    ROUTE_MANIFEST_NAME,
    ROUTE_NAMES,
    check_out,
    is_one_file,
    write_route_picture,
)
from bumpymap.layers.route.reach import ReachField, write_isochrones, write_reach, write_reach_back

__all__ = ["ReachLevels", "write_reach_files", "write_routes"]

_log = logging.getLogger(__name__)

ROUTE_MANIFEST_FORMAT = "bumpymap-route"
_VERSION = 1

Writer = Callable[[Path], None]


@dataclass(frozen=True, slots=True)
class ReachLevels:
    """The levels of isochrones."""

    values: Sequence[float]
    """m of cost, or minutes."""
    by: str = "cost"
    """``cost`` or ``minutes``."""


@dataclass(frozen=True)
class _RouteOutput:
    """The files of a run: how each is written, and what route.json says beside them."""

    writers: Mapping[str, Writer]
    """By name."""
    kinds: Mapping[str, str]
    """Name of what a single file is, by its suffix."""
    manifest: Mapping[str, Any]
    notes: list[str] = field(default_factory=list)


def write_routes(
    routes: Sequence[Route], source: MapSource, out: Path, *, manifest: Mapping[str, Any], overwrite: bool = False
) -> list[Path]:
    """Write route.geojson, route.gpx, profile.csv, route.png and route.json to a folder, or one of the first four.

    All files appear or none; links are replaced, never followed. Files of an earlier run that this one does not write
    are removed. Without longitude and latitude route.gpx is left out, and route.json says so. Except for route.json no
    file depends on the time or on folder names.

    Parameters
    ----------
    routes : sequence of Route
        At least one, all on the grid of ``source``; the picture holds the profile of the first.
    source : MapSource
        The map that they were planned on.
    out : Path
        The folder, which is created if it is missing, or one file: see `check_route_out`.
    manifest : mapping
        The run's own entries for route.json, such as settings.
    overwrite : bool
        Allow files of an earlier run to be replaced.

    Returns
    -------
    list of Path
        What was written, in the order of ``ROUTE_NAMES``.

    Raises
    ------
    UsageError, OutputError
        See `check_route_out`; or a file cannot be written.
    BadInputError
        A layer cannot be read, or the routes have no longitude and latitude and ``out`` is a GPX file.
    """
    place = RouteCoordinates.of(routes)
    writers: dict[str, Writer] = {
        "route.geojson": partial(write_route_geojson, routes),
        "route.gpx": partial(write_gpx, routes),
        "profile.csv": partial(write_profile, routes),
        "route.png": partial(write_route_picture, routes, source),
    }
    own = {**manifest, **_describe_layers(source), "routes": [_describe(route, place) for route in routes]}
    output = _RouteOutput(writers, ROUTE_KINDS, own)
    if not place.has_degrees and not is_one_file(out, ROUTE_KINDS):
        del writers["route.gpx"]
        output.notes.append("route.gpx was not written: the layers have no CRS, so longitude and latitude are unknown")
    return _write(output, out, overwrite=overwrite)


def write_reach_files(
    reach: ReachField,
    source: MapSource,
    out: Path,
    *,
    levels: ReachLevels | None = None,
    manifest: Mapping[str, Any],
    overwrite: bool = False,
) -> list[Path]:
    """Write reach.tif, reach_back.tif (with back-links), isochrones.geojson (with levels) and route.json to a folder.

    ``out`` may be one file instead, .tif for the cost or .geojson for the isochrones. For the other parameters, the
    result and errors see `write_routes`.
    """
    vehicle = next((entry.get("vehicle") for entry in source.manifests), None)
    name = vehicle.get("name") if isinstance(vehicle, Mapping) else vehicle
    about = {"vehicle": name} if isinstance(name, str) else {}
    writers: dict[str, Writer] = {"reach.tif": partial(write_reach, reach, about=about)}
    if reach.back is not None:
        writers["reach_back.tif"] = partial(write_reach_back, reach, about=about)
    if levels is not None:
        write = partial(write_isochrones, reach, levels.values, by=levels.by, about=about)
        writers["isochrones.geojson"] = write
    own = {**manifest, **_describe_layers(source)}
    return _write(_RouteOutput(writers, REACH_KINDS, own), out, overwrite=overwrite)


def _write(output: _RouteOutput, out: Path, *, overwrite: bool) -> list[Path]:
    """Write all files to the folder ``out``, or the one that its suffix names."""
    check_out(out, output.kinds, overwrite=overwrite)
    for note in output.notes:
        _log.warning(note)
    if is_one_file(out, output.kinds):
        name = output.kinds[out.suffix.lower()]
        if name not in output.writers:
            raise UsageError(
                f"{out} would hold {name}, which needs levels. Give the levels of the isochrones too, or a folder"
            )
        output.writers[name](out)
        return [out]

    def describe(_: Path, files: list[dict[str, Any]]) -> dict[str, Any]:
        head = {"format": ROUTE_MANIFEST_FORMAT, "version": _VERSION, **output.manifest}
        return head | {"versions": software_versions(), "notes": output.notes, "files": files}

    return write_own_folder(out, ROUTE_NAMES, ROUTE_MANIFEST_NAME, output.writers, describe, overwrite=overwrite)


def _describe_layers(source: MapSource) -> dict[str, Any]:
    """Return the layers that routes were planned on: their folders, the checksum of each run.json, the calibration."""
    folders = [
        {"path": str(folder), "run_sha256": describe_file(folder / MANIFEST_NAME)["sha256"]}
        for folder in source.folders
    ]
    first = next(iter(source.manifests), {})
    return {"layers": folders} | {
        name: first[name] for name in ("vehicle", "calibration", "cost", "crs") if name in first
    }


def _describe(route: Route, place: RouteCoordinates) -> dict[str, Any]:
    """Return figures, stops and corners of a route."""
    stops = zip(stop_names(len(route.stops)), place.in_crs(route.stops), place.in_file(route.stops), strict=True)
    return {
        **route_properties(route),
        "stops": [
            {"name": name, "x": x, "y": y, **({"lon": lon, "lat": lat} if place.has_degrees else {})}
            for name, (x, y), (lon, lat) in stops
        ],
        "corners": len(route.line),
    }
