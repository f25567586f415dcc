"""Recognise a complete run in a folder, and whether it is the requested one; GDAL and Arrow are not needed for that."""

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from os.path import lexists
from pathlib import Path
from typing import Any

from bumpymap.core import BadInputError, OutputError, read_record
from bumpymap.layers.manifest import MANIFEST_NAME, describe_file

_REMEDY = "Choose another `out`, or pass `overwrite=True` to replace it"


def is_complete(folder: Path, manifest: str = MANIFEST_NAME) -> bool:
    """Return whether a folder holds a complete run: the manifest is the last file that a run writes."""
    return lexists(folder / manifest)


@contextmanager
def verified_record(
    folder: Path, files: Collection[str] | None, manifest: str = MANIFEST_NAME
) -> Iterator[dict[str, Any]]:
    """Read the manifest of a complete run and verify the checksums of its files.

    Errors of the body of the ``with`` that mean a key is missing or malformed become an OutputError too. ``files``:
    files that must exist; those that the manifest lists are checked in any case. None: no file is checked, since the
    manifest alone is in the folder. ``manifest``: name of the manifest. Raises OutputError: the manifest cannot be read
    as that of a run or does not list a file, or a file is missing or has changed.
    """
    record = read_record(folder / manifest)
    unreadable = f"{folder} already holds a {manifest} that cannot be read as that of a run. {_REMEDY}"
    if record is None:
        raise OutputError(unreadable)
    try:
        listed = {str(file["path"]): str(file["sha256"]) for file in record["files"]}
        for name in sorted({*files, *listed} if files is not None else ()):
            try:
                same = describe_file(folder / name)["sha256"] == listed.get(name)
            except BadInputError as error:
                raise OutputError(f"{folder} already holds a complete run, but {name} is missing. {_REMEDY}") from error
            if not same:
                raise OutputError(f"{folder} already holds a complete run, but {name} has changed since. {_REMEDY}")
        yield record
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise OutputError(unreadable) from error


def refuse_replacing(folder: Path, differences: Sequence[str]) -> None:
    """Raise OutputError if there are differences between the complete run in a folder and the requested one."""
    if differences:
        raise OutputError(
            f"{folder} already holds a complete run with other inputs or settings:",
            *(f"  {difference}" for difference in differences),
            _REMEDY,
        )
