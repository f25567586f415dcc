"""Files that appear whole or not at all: written beside their place, synced, renamed."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from glob import escape
from pathlib import Path
from uuid import uuid4

from bumpymap.errors import OutputError

__all__ = ["atomic"]

_SIDE = ".aux.xml"
"""What GDAL keeps beside a raster: category names, and a CRS that GeoTIFF keys cannot hold."""


@contextmanager
def atomic(target: Path, failures: tuple[type[Exception], ...] = ()) -> Iterator[Path]:
    """Give a path to write to; put what was written there in the place of ``target``.

    The path lies in the same folder and ends like ``target``. Anything else in the folder whose name starts with the
    path's stem is scratch and goes away, whatever happens. A GDAL side file moves along with its raster; one that an
    earlier raster (or a GIS) left behind is removed, since it would describe the wrong pixels.

    Parameters
    ----------
    target : Path
        The file that shall appear or be replaced.
    failures : exception types
        What the writing library raises where it cannot write; ``OSError`` is always one of them.

    Raises
    ------
    OutputError
        The file could not be written. ``target`` is as it was before.
    """
    temporary = target.with_name(f".{target.stem}.{uuid4().hex}{target.suffix}")
    try:
        yield temporary
        _move(temporary, target)
    except (OSError, *failures) as error:  # type: ignore[misc]
        raise OutputError(
            f"cannot write {target}: {error}. Free some space, or choose a folder that can be written, "
            "with --out; nothing half-written was left there"
        ) from error
    finally:
        for left in list(target.parent.glob(f"{escape(temporary.stem)}*")) if target.parent.is_dir() else []:
            left.unlink(missing_ok=True)


def _move(temporary: Path, target: Path) -> None:
    side, old_side = (path.with_name(path.name + _SIDE) for path in (temporary, target))
    _sync(temporary)
    old_side.unlink(missing_ok=True)
    os.replace(temporary, target)  # noqa: PTH105 (the name says that it replaces)
    if side.exists():
        _sync(side)
        os.replace(side, old_side)  # noqa: PTH105
    _sync_folder(target.parent)


def _sync(path: Path) -> None:
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def _sync_folder(folder: Path) -> None:
    if os.name != "posix":  # elsewhere a folder cannot be opened
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
