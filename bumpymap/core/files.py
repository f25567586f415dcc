"""Files that appear whole or not at all: written beside their place, synced, renamed."""

import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from glob import escape
from os.path import lexists
from pathlib import Path
from uuid import uuid4

from bumpymap.core.errors import OutputError

__all__ = ["STAGED", "atomic", "move_together", "remove_empty_on_error", "remove_path", "utf8_path", "write_together"]

STAGED = ".bumpymap-layers-"
"""How the names of folders begin where files wait for each other; one that a killed process left can go."""
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
            "with `out`; nothing half-written was left there"
        ) from error
    finally:
        for left in list(target.parent.glob(f"{escape(temporary.stem)}*")) if target.parent.is_dir() else []:
            left.unlink(missing_ok=True)


@contextmanager
def write_together(folder: Path, last: str) -> Iterator[Path]:
    """Give an empty folder to write files to; all of them move to ``folder`` at the end, or none does.

    What they replace stays until all are complete. The file ``last`` moves last, and an old one goes first: whoever
    finds it finds all that belong to it, even if the process is killed between two moves. A GDAL side file of a raster
    that is replaced goes with it, since it would describe the wrong pixels.

    Parameters
    ----------
    folder : Path
        An existing folder.
    last : str
        Name of the file that says that all are there.

    Raises
    ------
    OutputError
        The files could not be moved. The folder is as it was before.
    """
    staged = folder / f"{STAGED}{uuid4().hex}"
    try:
        _make_folder(staged)
        with utf8_path(staged) as path:
            yield path
        move_together(staged, folder, last)
    finally:
        shutil.rmtree(staged, ignore_errors=True)


def remove_path(path: Path, place: int | None = None) -> None:
    """Remove a file, a folder with all that is in it, or a link: never what it points to.

    Parameters
    ----------
    path : Path
    place : int, optional
        Descriptor of the folder that ``path`` starts at.

    Raises
    ------
    OSError
        It is not there, or cannot be removed.
    """
    if stat.S_ISDIR(os.stat(path, dir_fd=place, follow_symlinks=False).st_mode):
        shutil.rmtree(path, dir_fd=place)  # it looks again, and follows no link
    else:
        os.unlink(path, dir_fd=place)


@contextmanager
def remove_empty_on_error(folder: Path) -> Iterator[None]:
    """Take a folder away that the body made and left empty when it failed."""
    fresh = not folder.exists()
    try:
        yield
    except BaseException:
        if fresh:
            with suppress(OSError):  # stays where something was written to it
                folder.rmdir()
        raise


@contextmanager
def utf8_path(folder: Path) -> Iterator[Path]:
    """Give a path to a folder that GDAL and Arrow take: they take UTF-8 alone.

    Where that of the folder has other bytes, the one that is given leads there by way of an open descriptor.
    """
    try:
        str(folder).encode()
    except UnicodeEncodeError:
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            yield Path(f"/proc/self/fd/{descriptor}")
        finally:
            os.close(descriptor)
    else:
        yield folder


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(mode=0o700)
    except OSError as error:
        raise OutputError(f"cannot write to the folder {folder.parent}: {error}. Choose another with `out`") from error


def move_together(staged: Path, folder: Path, last: str) -> None:
    """Move all that ``staged`` holds to ``folder``, or nothing; see `together`. A link is replaced, never followed."""
    names = sorted((path.name for path in staged.iterdir()), key=lambda name: (name == last, name))
    old = {target: None for name in names for target in (name, name + _SIDE) if lexists(folder / target)}
    aside = staged / "old"
    moves = [(folder / name, aside / name) for name in sorted(old, key=lambda name: name != last)]
    moves += [(staged / name, folder / name) for name in names]
    done: list[tuple[Path, Path]] = []
    try:
        aside.mkdir()
        for source, target in moves:
            os.replace(source, target)  # noqa: PTH105 (the name says that it replaces)
            done.append((source, target))
        _sync_folder(folder)
    except BaseException as error:
        for source, target in reversed(done):
            os.replace(target, source)  # noqa: PTH105
        if not isinstance(error, OSError):
            raise
        raise OutputError(
            f"cannot move the new files to {folder}: {error}. Nothing was replaced; choose another `out`"
        ) from error


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
