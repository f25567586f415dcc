"""Recognise sheets that are complete: those that a killed run has finished, and those of a complete map."""

from pathlib import Path
from typing import Any

from bumpymap.core import BadInputError, OutputError, read_record
from bumpymap.layers.completed_run import verified_record
from bumpymap.layers.manifest import MANIFEST_NAME, SHEETS_FORMAT, describe_file
from bumpymap.layers.products import PRODUCT_NAMES, SHEET_TABLE_NAME, VIRTUAL_NAMES
from bumpymap.layers.sheets.folders import sheet_folders

__all__ = ["is_finished", "made_names", "require_whole"]

_LAYERS = tuple(name for name in PRODUCT_NAMES if name != MANIFEST_NAME)


def made_names(record: dict[str, Any] | None) -> tuple[str, ...]:
    """Return the names of the files that a map with this manifest has beside it, which it lists with checksums."""
    in_sheets = (record or {}).get("format") == SHEETS_FORMAT
    return (*VIRTUAL_NAMES, SHEET_TABLE_NAME) if in_sheets else _LAYERS


def is_finished(sheet: Path, place: dict[str, Any]) -> bool:
    """Return whether a folder holds the complete sheet of this place and run, every file as it was written."""
    if (read_record(sheet / MANIFEST_NAME) or {}).get("sheet") != place:
        return False
    try:
        with verified_record(sheet, _LAYERS):
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
        with verified_record(sheet, _LAYERS):
            pass
