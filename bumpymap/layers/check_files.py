"""Write the files of a check to a folder: all of them, or none."""

from collections.abc import Callable, Mapping
from functools import partial
from os.path import lexists
from pathlib import Path
from typing import Any

from bumpymap.core import (
    CheckResult,
    locked,
    remove_empty_on_error,
    remove_path,
    write_together,
    writing_to,
)
from bumpymap.layers.check.record import (
    CHECK_FORMAT,
    CHECK_MANIFEST_NAME,
    CHECK_NAMES,
    CHECK_VIEW_NAMES,
    check_check_out,
    check_entries,
)
from bumpymap.layers.check.vectors import (
    CheckGround,
    CheckPlaces,
    write_driven_tiles,
    write_stretch_table,
    write_stretches,
)
from bumpymap.layers.gis.styles import write_check_style
from bumpymap.layers.manifest import (
    MANIFEST_NAME,
    describe_file,
    place_entries,
    software_versions,
    write_manifest,
)
from bumpymap.layers.products import check_folder, refuse_present
from bumpymap.layers.report.map_page import write_check_page

__all__ = ["write_check"]

_VERSION = 1
Writer = Callable[[Path], None]


def write_check(
    result: CheckResult,
    out: Path,
    *,
    ground: CheckGround | None = None,
    manifest: Mapping[str, Any] | None = None,
    overwrite: bool = False,
) -> list[Path]:
    """Write what drives show of a map to a folder, which is created if it is missing.

    All files appear or none; links are replaced, never followed. Files of an earlier check that this one does not
    write are removed: without positions on a map there is nothing for GIS. Except for check.json no file depends on
    the time or on folder names.

    Parameters
    ----------
    result : CheckResult
        With at least one drive.
    out : Path
        The folder.
    ground : CheckGround, optional
        The map that the drives were checked against, such as `open_map` returns it; None without a map.
    manifest : mapping, optional
        The run's own entries for check.json, such as settings.
    overwrite : bool
        Allow files of an earlier check to be replaced.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    UsageError, OutputError
        See `check_check_out`; or a file cannot be written.
    BadInputError
        The layers cannot be read, or positions have no longitude and latitude.
    """
    check_check_out(out, overwrite=overwrite)
    places = None if ground is None else CheckPlaces.of(result.stretches, result.tiles, ground)
    writers = _writers(result, ground, places)
    with remove_empty_on_error(out), locked(out):
        check_folder(out, overwrite=True)
        refuse_present(out, (*CHECK_NAMES, *CHECK_VIEW_NAMES), overwrite=overwrite)
        with write_together(out, CHECK_MANIFEST_NAME) as staged:
            for name, write in writers.items():
                write(staged / name)
            files = [describe_file(staged / name) | {"path": name} for name in writers if name in CHECK_NAMES]
            record = {
                "format": CHECK_FORMAT,
                "version": _VERSION,
                **(manifest or {}),
                "versions": software_versions(),
                **_describe_ground(ground, places),
                "files": files,
                **check_entries(result),
            }
            write_manifest(record, staged / CHECK_MANIFEST_NAME)
        with writing_to(out):
            for name in (*CHECK_NAMES, *CHECK_VIEW_NAMES):
                if name != CHECK_MANIFEST_NAME and name not in writers and lexists(out / name):
                    remove_path(out / name)
    return [out / name for name in (*writers, CHECK_MANIFEST_NAME)]


def _writers(result: CheckResult, ground: CheckGround | None, places: CheckPlaces | None) -> dict[str, Writer]:
    """Return how each file is written, by name."""
    writers: dict[str, Writer] = {
        "check.html": partial(write_check_page, result, ground if places is not None else None),
        "stretches.csv": partial(write_stretch_table, result, places),
    }
    if places is not None:
        writers["check.geojson"] = partial(write_stretches, result, places)
        writers["check.qml"] = partial(write_check_style, areas=False)
        if result.tiles is not None and len(result.tiles.col):
            writers["check_tiles.geojson"] = partial(write_driven_tiles, result.tiles, places)
            writers["check_tiles.qml"] = partial(write_check_style, areas=True)
    return writers


def _describe_ground(ground: CheckGround | None, places: CheckPlaces | None) -> dict[str, Any]:
    """Return the layers that drives were checked against: their folders, checksums, place and calibration."""
    if ground is None:
        return {}
    folders = [
        {"path": str(folder), "run_sha256": describe_file(folder / MANIFEST_NAME)["sha256"]}
        for folder in ground.folders
    ]
    first: Mapping[str, Any] = next(iter(ground.manifests), {})
    known = {name: first[name] for name in ("vehicle", "calibration") if name in first}
    return {"layers": folders, **known, **({} if places is None else place_entries(places.placement))}
