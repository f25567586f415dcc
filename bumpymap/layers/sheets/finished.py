"""Recognise sheets that are complete: those that a killed run has finished, and those of a complete map."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bumpymap.core import BadInputError, OutputError, read_record
from bumpymap.layers.completed_run import verified_record
from bumpymap.layers.manifest import MANIFEST_NAME, SHEETS_FORMAT, describe_file
from bumpymap.layers.products import (
    EVERY_NAME,
    SHEET_TABLE_NAME,
    SPEEDS_NAME,
    SPEEDS_VIRTUAL_NAME,
    VIRTUAL_NAMES,
)
from bumpymap.layers.sheets.folders import sheet_folders

__all__ = ["is_finished", "made_names", "require_whole", "virtual_names"]


def made_names(record: dict[str, Any] | None) -> tuple[str, ...]:
    """Return the names of the files that a map with this manifest has beside it, which it lists with checksums."""
    in_sheets = (record or {}).get("format") == SHEETS_FORMAT
    return (*virtual_names(record or {}), SHEET_TABLE_NAME) if in_sheets else _layers(record or {})


def virtual_names(record: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the names of the virtual rasters over the sheets of a map with this manifest, or its entries."""
    return (*VIRTUAL_NAMES, SPEEDS_VIRTUAL_NAME) if _has_speeds(record) else VIRTUAL_NAMES


def _layers(record: Mapping[str, Any]) -> tuple[str, ...]:
    without = {MANIFEST_NAME} if _has_speeds(record) else {MANIFEST_NAME, SPEEDS_NAME}
    return tuple(name for name in EVERY_NAME if name not in without)


def _has_speeds(record: Mapping[str, Any]) -> bool:
    settings = record.get("settings")
    return bool(settings.get("speeds")) if isinstance(settings, Mapping) else False


def is_finished(sheet: Path, place: dict[str, Any]) -> bool:
    """Return whether a folder holds the complete sheet of this place and run, every file as it was written."""
    record = read_record(sheet / MANIFEST_NAME) or {}
    if record.get("sheet") != place:
        return False
    try:
        with verified_record(sheet, _layers(record)):
            return True
    except OutputError:
        return False


def require_whole(folder: Path, record: dict[str, Any]) -> None:
    """Raise OutputError if a sheet of a complete map is missing or has changed; do nothing if it has no sheets."""
    if record.get("format") != SHEETS_FORMAT:
        return
    try:
        sheets = sheet_folders(folder)
        sums = [describe_file(sheet / MANIFEST_NAME)["sha256"] for sheet in sheets]
    except BadInputError as error:
        raise OutputError(f"{error}. Choose another `out`, or pass `overwrite=True` to replace it") from error
    for sheet, entry, found in zip(sheets, record["sheets"], sums, strict=True):
        if entry["sha256"] != found:
            raise OutputError(
                f"{folder} already holds a complete run, but {sheet / MANIFEST_NAME} has changed since. Choose another "
                "`out`, or pass `overwrite=True` to replace it"
            )
        with verified_record(sheet, _layers(record)):
            pass
