"""From what the user typed to a list of files."""

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from bumpymap.core import BadInputError
from bumpymap.readers.source import Location, is_folder, is_url, list_folder

__all__ = ["SUFFIXES", "find_surveys"]

SUFFIXES = (".las", ".laz", ".ply", ".pcd")
"""Endings that a folder is searched for, in any case (``.copc.laz`` is one of them)."""


def find_surveys(paths: Sequence[Location]) -> list[Location]:
    """List the survey files that the paths name.

    Parameters
    ----------
    paths : sequence of Path or str
        Files are taken whatever their ending; folders are searched with their subfolders for ``SUFFIXES``, hidden
        entries left out. The text of a URL may name a file or a folder too.

    Returns
    -------
    list of Path or str
        Sorted, URLs last; one entry a file even where it was reached twice.

    Raises
    ------
    BadInputError
        A path that is not there or cannot be listed, or a folder without surveys.
    """
    if not paths:
        raise BadInputError("no survey was given; name a point cloud file or a folder of them")
    found: dict[Path, Path] = {}
    remote: set[str] = set()
    for path in paths:
        if isinstance(path, str) and is_url(path):
            remote.update(_urls_of(path))
            continue
        try:
            for file in _files_of(Path(path)):
                found.setdefault(Path(os.path.realpath(file)), file)
        except OSError as error:
            raise BadInputError(f"cannot access {path}: {error.strerror}") from error
    return [*sorted(found.values()), *sorted(remote)]


def _urls_of(url: str) -> list[str]:
    # Asked only where the name leaves it open: every question to a server takes time.
    if url.lower().endswith(SUFFIXES) or not is_folder(url):
        return [url]
    return _some([name for name in list_folder(url) if name.lower().endswith(SUFFIXES)], url)


def _some(files: list[Any], folder: Location) -> list[Any]:
    if not files:
        raise BadInputError(
            f"the folder {folder} holds no point cloud; files ending in {', '.join(SUFFIXES)} are looked for, "
            "in its subfolders too. A file with another ending can be named itself"
        )
    return files


def _files_of(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    if not path.is_dir():
        what = "is neither a file nor a folder" if path.exists() else "does not exist"
        raise BadInputError(f"{path} {what}; name a point cloud file or a folder of them")
    return _some(sorted(_walk(path)), path)


def _walk(folder: Path) -> Iterator[Path]:
    def refuse(error: OSError) -> None:
        raise BadInputError(f"cannot list the folder {error.filename}: {error.strerror}")

    for parent, folders, names in os.walk(folder, onerror=refuse):
        folders[:] = [name for name in folders if not name.startswith(".")]
        for name in names:
            if not name.startswith(".") and name.lower().endswith(SUFFIXES):
                yield Path(parent) / name
