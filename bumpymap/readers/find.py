"""Find the survey files that the user named."""

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from bumpymap.core import BadInputError
from bumpymap.readers.source import Location, is_folder, is_url, list_folder

__all__ = ["SUFFIXES", "find_surveys"]

SUFFIXES = (".las", ".laz", ".ply", ".pcd")
"""File suffixes that a folder is searched for, in any case (``.laz`` includes ``.copc.laz``)."""


def find_surveys(paths: Sequence[Location]) -> list[Location]:
    """Return the survey files at the given paths.

    Parameters
    ----------
    paths : sequence of Path or str
        Files (with any suffix) and folders, which are searched recursively for files with ``SUFFIXES``, except hidden
        ones. URLs, as str, may be files or folders too.

    Returns
    -------
    list of Path or str
        Sorted, URLs last; each file once.

    Raises
    ------
    BadInputError
        A path does not exist or cannot be listed, or a folder holds no surveys.
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
    # The server is only asked if the suffix does not decide: every request takes time.
    if url.lower().endswith(SUFFIXES) or not is_folder(url):
        return [url]
    return _some([name for name in list_folder(url) if name.lower().endswith(SUFFIXES)], url)


def _some(files: list[Any], folder: Location) -> list[Any]:
    if not files:
        raise BadInputError(
            f"the folder {folder} holds no point cloud; files ending in {', '.join(SUFFIXES)} are searched for, "
            "in its subfolders too. A file with another suffix can be given by its own path"
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
