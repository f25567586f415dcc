"""A folder that holds a complete run: what its manifest says, and whether that still holds."""

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from os.path import lexists
from pathlib import Path
from typing import Any

from bumpymap.core import BadInputError, OutputError, read_record
from bumpymap.layers.manifest import MANIFEST_NAME, describe_file

__all__ = ["complete_record", "is_complete", "refuse_replacing"]

_REMEDY = "Choose another `out`, or pass `overwrite=True` to replace it"


def is_complete(folder: Path, manifest: str = MANIFEST_NAME) -> bool:
    """Whether a run has ended here: its manifest is the last file of it."""
    return lexists(folder / manifest)


@contextmanager
def complete_record(folder: Path, files: Collection[str], manifest: str = MANIFEST_NAME) -> Iterator[dict[str, Any]]:
    """Read what a complete run noted, for the body of the ``with``, and hold its files to it.

    Parameters
    ----------
    folder : Path
    files : collection of str
        That the run must have written; the manifest names each with its checksum.
    manifest : str

    Raises
    ------
    OutputError
        The manifest is none (it lacks what the body looks for), or a file is gone or another.
    """
    record = read_record(folder / manifest)
    unreadable = f"{folder} already holds a {manifest} that cannot be read as that of a run. {_REMEDY}"
    if record is None:
        raise OutputError(unreadable)
    try:
        listed = {str(file["path"]): str(file["sha256"]) for file in record["files"]}
        _hold(folder, files, listed)
        yield record
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise OutputError(unreadable) from error


def refuse_replacing(folder: Path, differences: Sequence[str]) -> None:
    """Raise OutputError where the run that is complete in a folder differs from the one that is asked for."""
    if differences:
        raise OutputError(
            f"{folder} already holds a complete run with other inputs or settings:",
            *(f"  {difference}" for difference in differences),
            _REMEDY,
        )


def _hold(folder: Path, files: Collection[str], listed: dict[str, str]) -> None:
    for name in sorted({*files, *listed}):
        try:
            same = describe_file(folder / name)["sha256"] == listed.get(name)
        except BadInputError as error:
            raise OutputError(f"{folder} already holds a complete run, but {name} is missing. {_REMEDY}") from error
        if not same:
            raise OutputError(f"{folder} already holds a complete run, but {name} has changed since. {_REMEDY}")
