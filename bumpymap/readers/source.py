"""Where a survey lies: a file of this machine, or an fsspec URL such as ``s3://bucket/site.laz``.

Readers ask for byte ranges and nothing else, so that a file on a server is never fetched whole. fsspec is imported for
URLs alone.
"""

import hashlib
import io
import os
import stat
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, BumpymapError, Place, UsageError
from bumpymap.readers._decoder_child import Source
from bumpymap.readers.web import StalledServerError, is_web, read_web, web_info

__all__ = [
    "Location",
    "OpenFile",
    "Version",
    "file_changed",
    "identity",
    "is_folder",
    "is_url",
    "list_folder",
    "open_source",
    "pinned_version",
    "place_of",
    "read_into",
    "read_range",
    "require_unchanged",
    "size_of",
    "version_of",
]

Location = Path | str
"""A path, or the text of a URL."""
Version = dict[str, Any]
"""What tells a file from its own earlier version without reading it: ``size`` in bytes; ``mtime_ns`` of a local file,
``version`` as the server of a URL gives it (empty where it gives none), both as text."""

_HEAD_BYTES = 65_536
"""So many bytes at each end of a file tell it from another."""
_BLOCK = 1 << 18
"""Bytes that a header is read in, from a server."""
_LARGEST_PAGE = 1 << 24
"""Bytes of a page that lists files."""
_VERSIONS = (
    "etag", "ETag", "md5Hash", "last-modified", "LastModified", "last_modified", "mtime", "updated", "created",
)  # fmt: skip
"""Names under which servers tell one version of a file from the next."""
_PINNED: ContextVar[tuple[Location, Version] | None] = ContextVar("_PINNED", default=None)
"""See `pinned_version`."""


def is_url(location: object) -> bool:
    """Whether this is the text of a URL."""
    return isinstance(location, str) and "://" in location


def open_source(location: Location) -> BinaryIO:
    """Open for reading and seeking.

    Raises
    ------
    BadInputError
        It is not there, is no regular file (a pipe would be waited for), or may not be read.
    UsageError
        What the URL needs is not installed.
    """
    stream: BinaryIO
    with _reading(location):
        if isinstance(location, str):
            size = size_of(location)
            stream = io.BufferedReader(Source(partial(_read_remote, location), size), _BLOCK)
        else:
            _refuse_special(location)
            stream = location.open("rb")
    return stream


class OpenFile:
    """The bytes of a file for its readers: anew by path or URL each time, or from a stream that is open already.

    Parameters
    ----------
    path : Path or str
    stream : binary file, optional
        The file, opened. One reader at a time then.
    """

    def __init__(self, path: Location, stream: BinaryIO | None = None) -> None:
        self.path, self._stream = path, stream

    def open(self) -> BinaryIO:
        """Give a stream at the start of the file, to be closed after use. Raises as `open_source`."""
        if self._stream is None:
            return open_source(self.path)
        stream = os.fdopen(os.dup(self._stream.fileno()), "rb")
        stream.seek(0)
        return stream

    def read(self, start: int, size: int) -> NDArray[np.uint8]:
        """Read ``size`` bytes from ``start`` on; fewer where the file ends."""
        if self._stream is None:
            return read_range(self.path, start, size)
        data = np.empty(size, np.uint8)
        with _reading(self.path), self.open() as stream:
            stream.seek(start)
            return data[: _fill(stream, data)]


def read_range(location: Location, start: int, size: int) -> NDArray[np.uint8]:
    """Read ``size`` bytes from ``start`` on; fewer where the file ends."""
    data = np.empty(size, np.uint8)
    return data[: read_into(location, start, data)]


def read_into(location: Location, start: int, data: NDArray[np.uint8]) -> int:
    """Fill an array with the bytes from ``start`` on; gives how many there were."""
    with _reading(location):
        if isinstance(location, str):
            return _from_server(location, start, data)
        with location.open("rb", buffering=0) as stream:
            stream.seek(start)
            return _fill(stream, data)


def size_of(location: Location) -> int:
    """Bytes of a file."""
    size: int = version_of(location)["size"]
    return size


def version_of(location: Location) -> Version:
    """Ask how long a file is and when it was written, at this moment."""
    with _reading(location):
        if not isinstance(location, str):
            # Opened, not only looked up: a network file system then asks its server.
            descriptor = os.open(location, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
            try:
                found = os.fstat(descriptor)
            finally:
                os.close(descriptor)
            return {"size": found.st_size, "mtime_ns": str(found.st_mtime_ns)}
        said = _said_of(location)
    if said.get("size") is None:
        raise BadInputError(f"the server of {location} does not report the size of the file. Download the file first")
    return {"size": int(said["size"]), "version": _version_text(said)}


@contextmanager
def pinned_version(location: Location, version: Version) -> Iterator[None]:
    """Hold what is read of a file in the body, in this thread, to one version of it.

    Every answer of a web server is held to it. Where anything else in the body finds the file bad, and it is of another
    version by then, the message says so instead: two halves of two files look damaged.

    Raises
    ------
    BadInputError
        See `require_unchanged`.
    """
    token = _PINNED.set((location, version))
    try:
        yield
    except StalledServerError:
        raise  # it would not answer the next question either
    except BadInputError as error:
        require_unchanged(location, version, error)
        raise
    finally:
        _PINNED.reset(token)


def require_unchanged(location: Location, version: Version, cause: Exception | None = None) -> None:
    """Make sure that a file is still of a version.

    A change that leaves size and time as they were goes unnoticed: one within a tick of the file system's clock (some
    milliseconds; 2 s on FAT), or one after which somebody sets the time back.

    Raises
    ------
    BadInputError
        It was changed, or is gone.
    """
    try:
        now = version_of(location)
    except BadInputError as error:
        if is_url(location):
            raise cause or error from error  # a server that does not answer says nothing about the file
        raise file_changed(location, f"it is gone ({error})") from cause or error
    if now != version:
        raise file_changed(location, _difference(version, now)) from cause


def file_changed(location: Location, how: str) -> BadInputError:
    """Give what to raise where a file does not stay the same while it is read."""
    return BadInputError(
        f"{location} changed while it was read: {how}. What was read may be a mixture, so nothing was made of it. Run "
        "again once nothing writes to it any more, or on a copy"
    )


def _difference(before: Version, now: Version) -> str:
    if before["size"] != now["size"]:
        return f"it had {before['size']:,} bytes and has {now['size']:,}"
    if "mtime_ns" in before:
        return "it has as many bytes as before, and was written again"
    return f"the server gives it as {now['version'] or 'of no version'}, and gave it as {before['version']}"


def identity(location: Location) -> dict[str, Any]:
    """Tell a file from another, and from its own earlier version. Of one that is being read, see `require_unchanged`.

    Returns
    -------
    dict
        That of `version_of` (``size`` in bytes; ``mtime_ns`` of a local file, ``version`` as the server of a URL gives
        it, both as text), and ``digest``, SHA-256 of the first and the last 64 KiB.
    """
    version = version_of(location)
    size = version["size"]
    with pinned_version(location, version):
        ends = [read_range(location, start, _HEAD_BYTES).tobytes() for start in (0, max(size - _HEAD_BYTES, 0))]
    return {**version, "digest": hashlib.sha256(b"".join(ends)).hexdigest()}


def is_folder(url: str) -> bool:
    """Whether a URL names a folder."""
    with _reading(url):
        files, name = _remote(url)
        if is_web(url):
            # fsspec would read whatever is there as a list of links.
            page = web_info(files, name)
            if "html" not in page.get("content-type", "") or not 0 < (page["size"] or 1) <= _LARGEST_PAGE:
                return False
        return bool(files.isdir(name))


def list_folder(url: str) -> list[str]:
    """URLs of all files below a URL, hidden ones left out."""
    with _reading(url):
        files, folder = _remote(url)
        found: list[str] = files.find(folder)
        shown = [name for name in found if "/." not in f"/{name.removeprefix(folder).lstrip('/')}"]
        return [files.unstrip_protocol(name) for name in shown]


def place_of(location: Location, middle: tuple[float, float, float] | None = None) -> Place:
    """Say whose coordinates a message is about."""
    return Place(location, middle)


def _from_server(url: str, start: int, data: NDArray[np.uint8]) -> int:
    files, name = _remote(url)
    if is_web(url):
        got, said = read_web(files, name, start, data)
        _require_held(url, said)
        return got
    found = files.cat_file(name, start=start, end=start + data.size)
    if len(found) > data.size:
        raise BadInputError(f"the server of {url} does not support range requests. Download the file first")
    data[: len(found)] = np.frombuffer(found, np.uint8)
    return len(found)


def _require_held(url: str, said: Mapping[str, Any]) -> None:
    """Hold an answer of a web server to the version that is being read; servers may leave out what they said before."""
    held = _PINNED.get()
    if held is None or held[0] != url:
        return
    before = held[1]
    now = {"size": before["size"] if said["size"] is None else said["size"], "version": _version_text(said)}
    key, _, value = before["version"].partition(" ")
    if now["size"] != before["size"] or (key and said.get(key, value) != value):
        raise file_changed(url, _difference(before, now))


def _said_of(url: str) -> Mapping[str, Any]:
    """Ask a server what it says of a file at this moment."""
    files, name = _remote(url)
    if is_web(url):
        return web_info(files, name)
    files.invalidate_cache(name)
    said: Mapping[str, Any] = files.info(name)
    return said


def _version_text(said: Mapping[str, Any]) -> str:
    return next((f"{key} {said[key]}" for key in _VERSIONS if said.get(key) is not None), "")


def _read_remote(url: str, start: int, buffer: memoryview) -> int:
    return read_into(url, start, np.frombuffer(buffer, np.uint8))


def _fill(stream: Any, data: NDArray[np.uint8]) -> int:
    """Read until the array is full or the file ends: one call gives at most 2 GB."""
    filled = 0
    while filled < data.size:
        got = stream.readinto(memoryview(data.data)[filled:])
        if not got:
            break
        filled += got
    return filled


def _refuse_special(path: Path) -> None:
    mode = path.stat().st_mode
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise BadInputError(f"cannot read {path}: it is a pipe or a device. Name a file of points or a folder of them")


def _remote(url: str) -> tuple[Any, str]:
    """File system and name behind a URL."""
    try:
        from fsspec.core import url_to_fs  # type: ignore[import-untyped, unused-ignore]
    except ImportError as error:
        raise UsageError(f"{url} is a URL; reading those needs: pip install 'bumpymap[remote]'") from error
    try:
        files, name = url_to_fs(url)
    except ImportError as error:
        kind = url.split("://", 1)[0]
        raise UsageError(f"{kind}:// needs more ({error}). Install it: pip install 'bumpymap[remote]'") from error
    except ValueError as error:
        raise UsageError(
            f"{url} is not a URL that can be read ({error}). Supported are s3://, https://, gs:// and other protocols "
            "of fsspec"
        ) from error
    return files, name


@contextmanager
def _reading(location: Location) -> Iterator[None]:
    """Turn what a file system or a server throws into a BadInputError; each has its own exceptions."""
    try:
        yield
    except (BumpymapError, MemoryError):
        raise
    except OSError as error:
        raise BadInputError(f"cannot read {location}: {error.strerror or error}") from error
    except Exception as error:
        if not is_url(location):
            raise
        raise BadInputError(f"cannot read {location}: {str(error).strip() or type(error).__name__}") from error
