"""Write what has changed between two surveys to a folder: raster, places, style, page and record, all or none."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from bumpymap.layers import (
    CHANGED_BAND,
    REPORT_NAME,
    ChangeField,
    OutputFolder,
    place_entries,
    plain_manifest,
    software_versions,
    write_change_raster,
    write_change_regions,
)
from bumpymap.views import write_change_report, write_change_style

__all__ = ["CHANGE_FILES", "write_change"]

CHANGE_FILES = OutputFolder(
    ("change.tif", "change.geojson", "change.json", "change.qml", REPORT_NAME),
    "change.json",
    views=("change.qml", REPORT_NAME),
)
_FORMAT = "bumpymap-change"
_VERSION = 1


def write_change(field: ChangeField, out: Path, *, manifest: Mapping[str, Any], overwrite: bool = False) -> list[Path]:
    """Write the files of a comparison to a folder, which is created if it is missing.

    All files appear or none; links are replaced, never followed. Except for change.json no file depends on folder
    names.

    Parameters
    ----------
    field : ChangeField
    out : Path
        The folder.
    manifest : mapping
        The run's own entries for change.json: settings, sources, counts.
    overwrite : bool
        Allow files of an earlier run to be replaced.

    Raises
    ------
    UsageError, OutputError
        See `OutputFolder.check`; or a file cannot be written.
    BadInputError
        The window is too large for a raster.
    """

    def describe(staged: Path, files: list[dict[str, Any]]) -> dict[str, Any]:
        head = {"format": _FORMAT, "version": _VERSION, "versions": software_versions()}
        record = head | place_entries(field.placement) | dict(manifest) | {"files": files}
        write_change_report(staged, plain_manifest(record), staged / REPORT_NAME)
        return record

    CHANGE_FILES.check(out, overwrite=overwrite)
    writers: dict[str, Callable[[Path], None]] = {
        "change.tif": partial(write_change_raster, field),
        "change.geojson": partial(write_change_regions, field),
        "change.qml": partial(write_change_style, band=CHANGED_BAND),
    }
    CHANGE_FILES.write(out, writers, describe, overwrite=overwrite)
    return [out / name for name in CHANGE_FILES.names]
