"""Atomic file writing: files are written under a temporary name in the target folder, synced and renamed.

Files of servers are opened by URL; fsspec is imported only if a URL is used.
"""

import errno
import hashlib
import os
import re
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from os.path import lexists
from pathlib import Path
from typing import Any, BinaryIO
from uuid import uuid4

from bumpymap.core.errors import OutputError, UsageError

__all__ = [
    "STAGED",
    "atomic",
    "move_together",
    "open_regular",
    "read_regular",
    "recorded_place",
    "remote_files",
    "remove_empty_on_error",
    "remove_path",
    "utf8_path",
    "without_keys",
    "write_together",
]

STAGED = ".bumpymap-layers-"
"""Name prefix of staging folders, from which files are moved together; one left by a killed process can be deleted."""
_SIDECAR = ".aux.xml"
"""Suffix of GDAL's sidecar file: category names, and a CRS that GeoTIFF keys cannot express."""


_MOST_READ = 1 << 28
"""Bytes; the manifest of the largest map in sheets has a tenth of them."""


def open_regular(path: Path, flags: int = 0) -> BinaryIO:
    """Open a file that a user names, to read it; ``flags`` are those of `os.open`.

    Raises
    ------
    OSError
        It cannot be read, or is a pipe or a device: that might never end. ``strerror`` says so.
    """
    more = flags | getattr(os, "O_NONBLOCK", 0)
    file = open(path, "rb", opener=lambda name, own: os.open(name, own | more))  # noqa: SIM115
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise OSError(errno.EINVAL, "it is a pipe or a device; write what it holds to a file", str(path))
    return file


def read_regular(path: Path, most: int = _MOST_READ) -> bytes:
    """Return the content of a file that a user names, of so many bytes at most; for errors see `open_regular`."""
    with open_regular(path) as file:
        content = file.read(most + 1)
    if len(content) > most:
        size = f"{most >> 20} MB" if most >= 1 << 20 else f"{most >> 10} kB"
        raise OSError(errno.EFBIG, f"it has more than {size}, the most that is read", str(path))
    return content


@contextmanager
def atomic(target: Path, failures: tuple[type[Exception], ...] = ()) -> Iterator[Path]:
    """Yield a temporary path to write to, and rename it to ``target`` if the body succeeds.

    The path lies in the same folder as ``target`` and has the same suffix. Other files whose names start with its stem
    are scratch files and are always removed. A GDAL sidecar file moves along with its raster; one that belongs to an
    earlier raster is removed, since it would describe the wrong pixels.

    Parameters
    ----------
    target : Path
        The file to create or replace.
    failures : exception types
        What the writing library raises if it cannot write, in addition to ``OSError``.

    Raises
    ------
    OutputError
        The file could not be written. ``target`` is unchanged.
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
        # Not by a pattern: Python would keep each one compiled.
        for left in list(target.parent.iterdir()) if target.parent.is_dir() else []:
            if left.name.startswith(temporary.stem):
                left.unlink(missing_ok=True)


@contextmanager
def write_together(folder: Path, last: str) -> Iterator[Path]:
    """Yield an empty folder to write files to; at the end all of them move to ``folder``, or none.

    Files that they replace stay until all are complete. The file ``last`` moves last, and an old one is removed first,
    so that its presence means that all others are there, even if the process is killed between two moves. The GDAL
    sidecar file of a replaced raster is removed too, since it would describe the wrong pixels.

    Parameters
    ----------
    folder : Path
        An existing folder.
    last : str
        Name of the file that marks the set as complete.

    Raises
    ------
    OutputError
        The files could not be moved. The folder is unchanged.
    """
    staged = folder / f"{STAGED}{uuid4().hex}"
    try:
        _make_folder(staged)
        with utf8_path(staged) as path:
            yield path
        move_together(staged, folder, last)
    finally:
        shutil.rmtree(staged, ignore_errors=True)


def remove_path(path: Path, folder: int | None = None) -> None:
    """Remove a file, a folder with its contents, or a link (never its target).

    Parameters
    ----------
    path : Path
    folder : int, optional
        Descriptor of the folder that ``path`` is relative to.

    Raises
    ------
    OSError
        It does not exist, or cannot be removed.
    """
    if stat.S_ISDIR(os.stat(path, dir_fd=folder, follow_symlinks=False).st_mode):
        shutil.rmtree(path, dir_fd=folder)  # checks again, and follows no link
    else:
        os.unlink(path, dir_fd=folder)


@contextmanager
def remove_empty_on_error(folder: Path) -> Iterator[None]:
    """Remove the folder if the body fails, provided that the body created it and left it empty."""
    created = not folder.exists()
    try:
        yield
    except BaseException:
        if created:
            with suppress(OSError):  # not empty
                folder.rmdir()
        raise


@contextmanager
def utf8_path(folder: Path) -> Iterator[Path]:
    """Yield a path to the folder that is valid UTF-8, as GDAL and Arrow require.

    If the folder's own path is not, the path goes through an open descriptor in ``/proc/self/fd``.
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
    """Move all files of ``staged`` to ``folder``, or none; see `write_together`. Links are replaced, never followed."""
    names = sorted((path.name for path in staged.iterdir()), key=lambda name: (name == last, name))
    old = {target: None for name in names for target in (name, name + _SIDECAR) if lexists(folder / target)}
    aside = staged / "old"
    moves = [(folder / name, aside / name) for name in sorted(old, key=lambda name: name != last)]
    moves += [(staged / name, folder / name) for name in names]
    done: list[tuple[Path, Path]] = []
    try:
        aside.mkdir()
        for source, target in moves:
            os.replace(source, target)  # noqa: PTH105 (os.replace says that it overwrites)
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
    side, old_side = (path.with_name(path.name + _SIDECAR) for path in (temporary, target))
    _sync(temporary)
    old_side.unlink(missing_ok=True)
    os.replace(temporary, target)  # noqa: PTH105 (os.replace says that it overwrites)
    if side.exists():
        _sync(side)
        os.replace(side, old_side)  # noqa: PTH105
    if not target.parent.name.startswith(STAGED):  # what is staged is moved, and its new folder synced
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


_INSTALL = "pip install 'bumpymap[remote]'"
_URL = re.compile(r"""(\w+://)(?:[^/\s@'"]*@)?([^\s?'"]*)(?:\?[^\s'"]*[^\s'":.,)])?""")
"""Protocol, user, server and path, query."""


def remote_files(url: str) -> tuple[Any, str]:
    """Return the fsspec file system of a URL such as ``s3://bucket/site.laz``, and the path in it.

    Raises
    ------
    UsageError
        A package that the protocol needs is not installed, or there is no such protocol.
    """
    try:
        from fsspec.core import url_to_fs  # type: ignore[import-untyped, unused-ignore]
    except ImportError as error:
        raise UsageError(f"{url} is a URL, which needs: {_INSTALL}") from error
    try:
        files, name = url_to_fs(url)
    except ImportError as error:
        kind = url.split("://", 1)[0]
        raise UsageError(f"{kind}:// needs more ({error}). Install it: {_INSTALL}") from error
    except ValueError as error:
        raise UsageError(
            f"{url} is not a URL that can be used ({error}). Supported are s3://, https://, gs:// and other protocols "
            "of fsspec"
        ) from error
    return files, name


def without_keys(text: str) -> str:
    """Return a text whose URLs have no user and no query: both may hold a key, as that of a signed link."""
    return _URL.sub(r"\1\2", text)


def recorded_place(place: Path | str) -> str:
    """Return an input as files that are handed on name it: a URL without keys, but still unlike one with others.

    ``https://host/site.laz?key=abc`` becomes ``https://host/site.laz?left-out=1f0e...``, with a digest of the whole.
    """
    text = str(place)
    plain = without_keys(text) if isinstance(place, str) and "://" in text else text
    if plain == text:
        return text
    digest = hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest()
    return f"{plain}?left-out={digest[:16]}"
