"""Folders of a map in sheets: which they are, and how those of an earlier run are removed."""

import os
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import Any

from bumpymap.core import STAGED, BadInputError, OutputError, count_text, read_record, remove_path
from bumpymap.layers.manifest import MANIFEST_NAME, SHEETS_FORMAT
from bumpymap.layers.products import (
    CATALOG_NAME,
    EVERY_NAME,
    EVERY_VIEW_NAME,
    SHEET_FOLDER,
    SHEET_TABLE_NAME,
    SPEEDS_NAME,
    SPEEDS_STYLE_NAME,
    SPEEDS_VIRTUAL_NAME,
    VIRTUAL_NAMES,
    sheets_in,
)

__all__ = [
    "MAP_FILES",
    "SPEEDS_FILES",
    "make_sheet_folder",
    "raster_in",
    "remove_files",
    "remove_sheets",
    "sheet_folders",
    "sheets_of",
    "virtual_name",
]

_SIDECAR = ".aux.xml"
_FLAGS = os.O_RDONLY | getattr(os, "O_DIRECTORY", 0) | getattr(os, "O_NOFOLLOW", 0)


def virtual_name(raster: str) -> str:
    """Return the name of the virtual raster over the rasters of this name."""
    return raster.replace(".tif", ".vrt")


def raster_in(folder: Path, name: str) -> Path:
    """Return the path of a raster of a map: that of the virtual one if only the sheets hold such a raster."""
    virtual = folder / virtual_name(name)
    return virtual if virtual.is_file() and not (folder / name).exists() else folder / name


def sheet_folders(path: str | os.PathLike[str]) -> list[Path]:
    """Return the folders of the sheets of a map, ordered by name; a map that is not in sheets is its own.

    Whether the folders hold what they should is not checked, except for their presence.

    Raises
    ------
    BadInputError
        A sheet is missing, or the list of sheets cannot be read.
    """
    folder = Path(path)
    return sheets_of(folder, read_record(folder / MANIFEST_NAME) or {})


def sheets_of(folder: Path, record: Mapping[str, Any]) -> list[Path]:
    """Return what `sheet_folders` does, from the content of a run.json that need not be there yet."""
    if record.get("format") != SHEETS_FORMAT:
        return [folder]
    found = [folder.joinpath(*PurePosixPath(name).parts) for name in _names(record, folder)]
    missing = [sheet for sheet in found if not (sheet / MANIFEST_NAME).is_file()]
    if missing:
        more = f" and {len(missing) - 1} more are" if len(missing) > 1 else " is"
        raise BadInputError(
            f"the map in {folder} has {count_text(len(found), 'sheet')}, of which {missing[0]}{more} missing. Copy the "
            "whole folder again, or map the survey again"
        )
    return found


def _names(record: Mapping[str, Any], folder: Path) -> list[str]:
    """Return the paths of the sheets in the manifest of a map; raise BadInputError if one leads elsewhere."""
    try:
        names = [str(sheet["folder"]) for sheet in record["sheets"]]
    except (KeyError, TypeError) as error:
        raise BadInputError(f"{folder / MANIFEST_NAME} is damaged: {error!r}. Map the survey again") from error
    for name in names:
        parts = PurePosixPath(name).parts
        if len(parts) != 2 or parts[0] != SHEET_FOLDER or parts[1] == "..":
            raise BadInputError(f"{folder / MANIFEST_NAME} is damaged: {name} is not a sheet. Map the survey again")
    return names


def make_sheet_folder(folder: Path, name: str) -> Path:
    """Make the folder of a sheet, and remove what a killed run left half-written in it.

    Raises
    ------
    OutputError
        It cannot be made, or a link or a file is in its place.
    """
    sheet = folder / SHEET_FOLDER / name
    for place in (sheet.parent, sheet):
        if place.is_symlink() or (place.exists() and not place.is_dir()):
            raise OutputError(
                f"{place} is a link or a file, and was not touched: sheets are written there. Remove it, or choose "
                "another `out`"
            )
    try:
        sheet.mkdir(parents=True, exist_ok=True)
        for left in sheet.glob(f"{STAGED}*"):
            remove_path(left)
    except OSError as error:
        raise OutputError(
            f"cannot write to the folder {sheet}: {error.strerror or error}. Choose another `out`"
        ) from error
    return sheet


MAP_FILES = (*EVERY_NAME, *EVERY_VIEW_NAME)
"""Files of a map that is not in sheets."""
SPEEDS_FILES = (SPEEDS_NAME, SPEEDS_VIRTUAL_NAME, SPEEDS_STYLE_NAME)
"""The layer of other speeds and its style, which an earlier run left where the last one wrote none."""


def remove_files(folder: Path, names: Iterable[str]) -> None:
    """Remove files or links of an earlier run, and the sidecar files of rasters; others stay.

    Raises
    ------
    OutputError
        One cannot be removed.
    """
    with _removing(folder):
        _remove(folder.resolve(), names)


def remove_sheets(folder: Path, keep: Collection[str] = ()) -> None:
    """Remove the sheets of an earlier run, but for the names in ``keep``; files that no run wrote stay.

    If all are removed, the virtual rasters, the table of sheets and their catalogue are removed too. No
    link is followed but ``folder`` itself, which the user may have made one.

    Raises
    ------
    OutputError
        Something cannot be removed.
    """
    with _removing(folder):
        for name in sheets_in(folder):
            if name not in keep:
                sheet = folder / SHEET_FOLDER / name
                _remove(sheet, (MANIFEST_NAME, *MAP_FILES, *(left.name for left in sheet.glob(f"{STAGED}*"))))
                with suppress(OSError):  # not empty
                    sheet.rmdir()
        if not keep:
            own = (CATALOG_NAME,) if (folder / SHEET_TABLE_NAME).is_file() else ()  # else that of a batch
            _remove(folder.resolve(), (*own, *VIRTUAL_NAMES, SPEEDS_VIRTUAL_NAME, SHEET_TABLE_NAME))
            with suppress(OSError):  # not empty, or not there
                (folder / SHEET_FOLDER).rmdir()


def _remove(folder: Path, names: Iterable[str]) -> None:
    """Remove files or links, and the sidecar files of rasters, from a folder that is not a link."""
    descriptor = os.open(folder, _FLAGS)
    try:
        for name in names:
            for own in (name, name + _SIDECAR):
                with suppress(FileNotFoundError):
                    remove_path(Path(own), descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def _removing(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"cannot remove the layers of an earlier run from {folder}: {error.strerror or error}. Choose another `out`"
        ) from error
