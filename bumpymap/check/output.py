"""Write the files of a check to a folder: all of them, or none."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from bumpymap.core import CheckResult
from bumpymap.layers import (
    CHECK_FILES,
    CHECK_FORMAT,
    MANIFEST_NAME,
    CheckGround,
    CheckPlaces,
    check_check_out,
    check_entries,
    describe_file,
    place_entries,
    software_versions,
    write_stretch_table,
    write_stretches,
)
from bumpymap.views import write_check_page, write_check_style

__all__ = ["write_check"]

_VERSION = 1


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
    places = None if ground is None else CheckPlaces.of(result.stretches, ground)

    def describe(_: Path, files: list[dict[str, Any]]) -> dict[str, Any]:
        return {
            "format": CHECK_FORMAT,
            "version": _VERSION,
            **(manifest or {}),
            "versions": software_versions(),
            **_describe_ground(ground, places),
            "files": files,
            **check_entries(result),
        }

    writers: dict[str, Callable[[Path], None]] = {
        "check.html": partial(write_check_page, result, ground if places is not None else None),
        "stretches.csv": partial(write_stretch_table, result, places),
    }
    if places is not None:
        writers["check.geojson"] = partial(write_stretches, result, places)
        writers["check.qml"] = write_check_style
    return CHECK_FILES.write(out, writers, describe, overwrite=overwrite)


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
