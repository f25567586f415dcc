"""Where a survey lies: a file of this machine, or an fsspec URL such as ``s3://bucket/site.laz``.

Readers ask for byte ranges and nothing else, so that a file on a server is never fetched whole. fsspec is imported for
URLs alone.
"""

import hashlib
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from bumpymap.crs import Place
from bumpymap.errors import BadInputError, BumpymapError, UsageError

__all__ = [
    "Location",
    "identity",
    "is_folder",
    "is_url",
    "list_folder",
    "open_source",
    "place_of",
    "read_into",
    "read_range",
    "size_of",
]

Location = Path | str
"""A path, or the text of a URL."""

_HEAD_BYTES = 65_536
"""So many bytes at each end of a file tell it from another."""
_BLOCK = 1 << 18
"""Bytes that a header is read in, from a server."""
_VERSIONS = ("ETag", "etag", "md5Hash", "mtime", "LastModified", "last_modified", "updated", "created")
"""Names under which servers tell one version of a file from the next."""


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
            files, name = _remote(location)
            stream = files.open(name, "rb", block_size=_BLOCK)
        else:
            _refuse_special(location)
            stream = location.open("rb")
    return stream


def read_range(location: Location, start: int, size: int) -> NDArray[np.uint8]:
    """Read ``size`` bytes from ``start`` on; fewer where the file ends."""
    data = np.empty(size, np.uint8)
    return data[: read_into(location, start, data)]


def read_into(location: Location, start: int, data: NDArray[np.uint8]) -> int:
    """Fill an array with the bytes from ``start`` on; gives how many there were."""
    with _reading(location):
        if isinstance(location, str):
            files, name = _remote(location)
            found = files.cat_file(name, start=start, end=start + data.size)
            if len(found) > data.size:
                raise BadInputError(
                    f"the server of {location} gives whole files alone, no ranges of bytes. Download the file first"
                )
            data[: len(found)] = np.frombuffer(found, np.uint8)
            return len(found)
        with location.open("rb", buffering=0) as stream:
            stream.seek(start)
            return _fill(stream, data)


def size_of(location: Location) -> int:
    """Bytes of a file."""
    with _reading(location):
        if not isinstance(location, str):
            return location.stat().st_size
        files, name = _remote(location)
        size = files.info(name).get("size")
    if size is None:
        raise BadInputError(f"the server of {location} does not say how long the file is. Download the file first")
    return int(size)


def identity(location: Location) -> dict[str, Any]:
    """Tell a file from another, and from its own earlier version.

    Returns
    -------
    dict
        ``size`` in bytes; ``mtime_ns`` of a local file, ``version`` as the server of a URL gives it, both as text;
        ``digest``, SHA-256 of the first and the last 64 KiB.
    """
    size = size_of(location)
    with _reading(location):
        if isinstance(location, str):
            files, name = _remote(location)
            said = files.info(name)
            version = {"version": next((str(said[key]) for key in _VERSIONS if said.get(key) is not None), "")}
        else:
            version = {"mtime_ns": str(location.stat().st_mtime_ns)}
    ends = (read_range(location, start, _HEAD_BYTES).tobytes() for start in (0, max(size - _HEAD_BYTES, 0)))
    return {"size": size, **version, "digest": hashlib.sha256(b"".join(ends)).hexdigest()}


def is_folder(url: str) -> bool:
    """Whether a URL names a folder."""
    with _reading(url):
        files, name = _remote(url)
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
            f"{url} is no URL that can be read ({error}). Such as s3://, https:// and gs:// can"
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
