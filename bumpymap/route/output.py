"""Write the files of routes, or of the reach from one start: all of them to a folder, or one of them alone."""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from os.path import lexists
from pathlib import Path
from typing import Any

from bumpymap.core import OutputError, Route, UsageError
from bumpymap.layers import (
    MANIFEST_NAME,
    OTHER_FILES,
    MapSource,
    OutputFolder,
    ReachField,
    RouteCoordinates,
    describe_file,
    refuse_present,
    require_folder,
    route_properties,
    software_versions,
    stop_names,
    write_gpx,
    write_isochrones,
    write_profile,
    write_reach,
    write_route_geojson,
)
from bumpymap.views import write_route_picture

__all__ = ["ReachLevels", "check_reach_out", "check_route_out", "write_reach_files", "write_routes"]

_log = logging.getLogger(__name__)

ROUTE_MANIFEST_NAME = "route.json"
ROUTE_KINDS = {
    ".geojson": "route.geojson",
    ".gpx": "route.gpx",
    ".csv": "profile.csv",
    ".png": "route.png",
}
REACH_KINDS = {".tif": "reach.tif", ".geojson": "isochrones.geojson"}
"""Name of the file that is written alone, by its suffix."""
ROUTE_FILES = OutputFolder(
    (*ROUTE_KINDS.values(), "reach.tif", "isochrones.geojson", ROUTE_MANIFEST_NAME),
    ROUTE_MANIFEST_NAME,
)


def check_route_out(out: Path, *, overwrite: bool) -> None:
    """Check, before anything is computed, that files of routes can be written to a folder or a file. Writes nothing.

    Parameters
    ----------
    out : Path
        A folder, or one file that ends in .geojson, .gpx, .csv or .png.
    overwrite : bool
        Allow files of an earlier run to be replaced.

    Raises
    ------
    UsageError
        ``out`` is named like a file of a kind that is not written.
    OutputError
        There are files that must not be replaced, or the place of a file is missing.
    """
    check_out(out, ROUTE_KINDS, overwrite=overwrite)


def check_reach_out(out: Path, *, overwrite: bool) -> None:
    """Check the same for the reach: a folder, or one file that ends in .tif or .geojson."""
    check_out(out, REACH_KINDS, overwrite=overwrite)


def is_one_file(out: Path, kinds: Mapping[str, str]) -> bool:
    """Return whether ``out`` names one file: by its suffix, unless it is a folder that exists."""
    return out.suffix.lower() in kinds and not (out.is_dir() and not out.is_symlink())


def check_out(out: Path, kinds: Mapping[str, str], *, overwrite: bool) -> None:
    """Check a folder, or one file with one of the suffixes of ``kinds``; errors as in `check_route_out`."""
    suffix = out.suffix.lower()
    if is_one_file(out, kinds):
        if not out.parent.is_dir():
            raise OutputError(
                f"cannot write {out}: there is no folder {out.parent}. Create it, or choose another `out`"
            )
        if lexists(out) and not overwrite:
            raise OutputError(f"{out} exists. Choose another `out`, or pass `overwrite=True` to replace it")
        return
    if suffix in OTHER_FILES and not out.is_dir():
        raise UsageError(
            f"{out} is named like a {suffix} file, which is not written here. Give a folder as `out`, or a file that "
            f"ends in {', '.join(kinds)}"
        )
    require_folder(out)
    refuse_present(out, ROUTE_FILES.names, overwrite=overwrite)


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
        What was written, the manifest last.

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
    entries = {**manifest, **_describe_layers(source), "routes": [_describe(route, place) for route in routes]}
    output = _RouteOutput(writers, ROUTE_KINDS, entries)
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
    """Write reach.tif, isochrones.geojson (with levels) and route.json to a folder.

    ``out`` may be one file instead, .tif for the cost or .geojson for the isochrones. For the other parameters, the
    result and errors see `write_routes`.
    """
    vehicle = next((entry.get("vehicle") for entry in source.manifests), None)
    name = vehicle.get("name") if isinstance(vehicle, Mapping) else vehicle
    about = {"vehicle": name} if isinstance(name, str) else {}
    writers: dict[str, Writer] = {"reach.tif": partial(write_reach, reach, about=about)}
    if levels is not None:
        write = partial(write_isochrones, reach, levels.values, by=levels.by, about=about)
        writers["isochrones.geojson"] = write
    entries = {**manifest, **_describe_layers(source)}
    return _write(_RouteOutput(writers, REACH_KINDS, entries), out, overwrite=overwrite)


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

    return ROUTE_FILES.write(out, output.writers, describe, overwrite=overwrite)


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
