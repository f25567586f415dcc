"""From what the user typed to a list of files."""

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from bumpymap.errors import BadInputError

__all__ = ["SUFFIXES", "find_surveys"]

SUFFIXES = (".las", ".laz", ".ply", ".pcd")
"""Endings that a folder is searched for, in any case (``.copc.laz`` is one of them)."""


def find_surveys(paths: Sequence[Path]) -> list[Path]:
    """List the survey files that the paths name.

    Parameters
    ----------
    paths : sequence of Path
        Files are taken whatever their ending; folders are searched with their subfolders for ``SUFFIXES``, hidden
        entries left out.

    Returns
    -------
    list of Path
        Sorted, one entry a file even where it was reached twice.

    Raises
    ------
    BadInputError
        A path that is not there or cannot be listed, or a folder without surveys.
    """
    if not paths:
        raise BadInputError("no survey was given; name a point cloud file or a folder of them")
    found: dict[Path, Path] = {}
    for path in paths:
        try:
            for file in _files_of(path):
                found.setdefault(Path(os.path.realpath(file)), file)
        except OSError as error:
            raise BadInputError(f"cannot look at {path}: {error.strerror}") from error
    return sorted(found.values())


def _files_of(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    if not path.is_dir():
        what = "is neither a file nor a folder" if path.exists() else "does not exist"
        raise BadInputError(f"{path} {what}; name a point cloud file or a folder of them")
    files = sorted(_walk(path))
    if not files:
        raise BadInputError(
            f"the folder {path} holds no point cloud; files ending in {', '.join(SUFFIXES)} are looked for, "
            "in its subfolders too. A file with another ending can be named itself"
        )
    return files


def _walk(folder: Path) -> Iterator[Path]:
    def refuse(error: OSError) -> None:
        raise BadInputError(f"cannot list the folder {error.filename}: {error.strerror}")

    for parent, folders, names in os.walk(folder, onerror=refuse):
        folders[:] = [name for name in folders if not name.startswith(".")]
        for name in names:
            if not name.startswith(".") and name.lower().endswith(SUFFIXES):
                yield Path(parent) / name
