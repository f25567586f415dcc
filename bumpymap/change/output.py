"""Write what has changed between two surveys to a folder: raster, places, style, page and record, all or none."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from bumpymap.layers import (
    CHANGED_BAND,
    REPORT_NAME,
    ChangeField,
    check_own_folder,
    place_entries,
    plain_manifest,
    software_versions,
    write_change_raster,
    write_change_regions,
    write_own_folder,
)
from bumpymap.views import write_change_report, write_change_style

__all__ = ["CHANGE_NAMES", "CHANGE_VIEW_NAMES", "check_change_out", "write_change"]

_MANIFEST = "change.json"
CHANGE_NAMES = ("change.tif", "change.geojson", _MANIFEST)
CHANGE_VIEW_NAMES = ("change.qml", REPORT_NAME)
"""Files to look at the others with: a style, a page. GIS programs rewrite them, so they have no checksum."""
_NAMES = (*CHANGE_NAMES, *CHANGE_VIEW_NAMES)
_FORMAT = "bumpymap-change"
_VERSION = 1


def check_change_out(out: Path, *, overwrite: bool) -> None:
    """Check, before anything is computed, that the files can be written to a folder. Writes nothing.

    Raises
    ------
    UsageError
        ``out`` holds the layers of a survey.
    OutputError
        There are files that must not be replaced, or ``out`` is a file.
    """
    check_own_folder(out, _NAMES, overwrite=overwrite)


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
        See `check_change_out`; or a file cannot be written.
    BadInputError
        The window is too large for a raster.
    """

    def describe(staged: Path, files: list[dict[str, Any]]) -> dict[str, Any]:
        head = {"format": _FORMAT, "version": _VERSION, "versions": software_versions()}
        record = head | place_entries(field.placement) | dict(manifest) | {"files": files}
        write_change_report(staged, plain_manifest(record), staged / REPORT_NAME)
        return record

    check_change_out(out, overwrite=overwrite)
    writers: dict[str, Callable[[Path], None]] = {
        "change.tif": partial(write_change_raster, field),
        "change.geojson": partial(write_change_regions, field),
        CHANGE_VIEW_NAMES[0]: partial(write_change_style, band=CHANGED_BAND),
    }
    write_own_folder(out, _NAMES, _MANIFEST, writers, describe, views=CHANGE_VIEW_NAMES, overwrite=overwrite)
    return [out / name for name in _NAMES]
