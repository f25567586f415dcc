"""Read byte ranges of local files and of fsspec URLs such as ``s3://bucket/site.laz``.

Readers request byte ranges only, so a file on a server is never downloaded as a whole. fsspec is imported only if a URL
is read.
"""

import io
import os
import re
import shlex
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, BumpymapError, free_memory, missing_resource, refused_write, remote_files
from bumpytiles import Bounds

Location = Path | str
"""A path, or a URL as a str."""
Version = dict[str, Any]
"""Distinguishes versions of a file without reading it: ``size`` in bytes, and ``mtime_ns`` of a local file or the
``version`` that the server of a URL reports (empty if none), both as str."""

_VERSIONS = (
    "etag", "ETag", "md5Hash", "last-modified", "LastModified", "last_modified", "mtime", "updated", "created",
)  # fmt: skip
"""Keys under which servers report the version of a file."""


@dataclass(frozen=True, slots=True)
class PinnedFile:
    """The file that the body of `pinned_version` reads."""

    location: Location
    version: Version
    hashed: "HashedBytes | None"
    """Where bytes go that are read; None: they are not hashed."""


HashedBytes = Callable[[int, Any], None]
"""Called with the offset of some bytes and a buffer that holds them."""

PINNED: ContextVar[PinnedFile | None] = ContextVar("PINNED", default=None)
"""See `bumpymap.readers.source.pinned_version`."""


def file_changed(location: Location, how: str) -> BadInputError:
    """Return the error to raise for a file that changed while it was read; ``how`` continues the message."""
    return BadInputError(
        f"{location} changed while it was read: {how}. What was read may be a mixture of both versions and was "
        "discarded. Run again once no program writes to it any more, or on a copy"
    )


def difference(before: Version, now: Version) -> str:
    """Say how two versions of a file differ."""
    if before["size"] != now["size"]:
        return f"it had {before['size']:,} bytes and has {now['size']:,}"
    if "mtime_ns" in before:
        return "it has the same size, but was written again"
    return f"the server reports version {now['version'] or '(none)'} after {before['version']}"


def require_pinned(url: str, said: Mapping[str, Any]) -> None:
    """Check a response of a web server against the version that is being read; servers may omit some headers."""
    pinned = PINNED.get()
    if pinned is None or pinned.location != url:
        return
    before = pinned.version
    now = {"size": before["size"] if said["size"] is None else said["size"], "version": version_text(said)}
    key, _, value = before["version"].partition(" ")
    if now["size"] != before["size"] or (key and said.get(key, value) != value):
        raise file_changed(url, difference(before, now))


def version_text(said: Mapping[str, Any]) -> str:
    """Return which version of a file a server reports; empty if it reports none."""
    return next((f"{key} {said[key]}" for key in _VERSIONS if said.get(key) is not None), "")


_BLOCK = 1 << 18
"""Bytes of each request while a header is read from a server."""


def is_url(location: object) -> bool:
    """Return whether this is a URL."""
    return isinstance(location, str) and "://" in location


EPT_NAME = "ept.json"


def is_ept(location: Location) -> bool:
    """Return whether a path or a URL is that of an EPT: of its file ``ept.json``."""
    return Path(str(location).partition("?")[0] if is_url(location) else location).name == EPT_NAME


class RangeFile(io.RawIOBase):
    """A raw stream of the bytes of a URL, which are read by `read_range`."""

    def __init__(self, url: str) -> None:
        self._url, self._size, self._at = url, size_of(url), 0

    def readable(self) -> bool:
        """Return True."""
        return True

    def seekable(self) -> bool:
        """Return True."""
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Set the position, and return it."""
        start = {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self._size}[whence]
        self._at = max(start + offset, 0)
        return self._at

    def readinto(self, buffer: Any) -> int:
        """Read bytes into a buffer, up to the end of the file; return how many."""
        data = read_range(self._url, self._at, max(min(len(buffer), self._size - self._at), 0))
        np.frombuffer(buffer, np.uint8)[: data.size] = data
        self._at += data.size
        return data.size

    def readall(self) -> bytes:
        """Read the rest of the file in one call."""
        return self.read(max(self._size - self._at, 0)) or b""


def open_source(location: Location) -> BinaryIO:
    """Open a file or URL for reading and seeking.

    Raises
    ------
    BadInputError
        It does not exist, is not a regular file (reading a pipe might never end), or cannot be read.
    UsageError
        A package that the URL's protocol needs is not installed.
    """
    with _reading(location):
        if isinstance(location, Path):
            _refuse_special(location)
            return location.open("rb")
        return io.BufferedReader(RangeFile(location), _BLOCK)


def read_range(location: Location, start: int, size: int) -> NDArray[np.uint8]:
    """Read ``size`` bytes from offset ``start``; fewer at the end of the file."""
    data = np.empty(size, np.uint8)
    return data[: read_into(location, start, data)]


def read_into(location: Location, start: int, data: NDArray[np.uint8]) -> int:
    """Read bytes from offset ``start`` into an array; return how many there were.

    `pinned_version` may pass the array on to be hashed.
    """
    with _reading(location):
        if isinstance(location, str):
            return _from_server(location, start, data)
        with location.open("rb", buffering=0) as stream:
            stream.seek(start)
            filled = _fill(stream, data)
        pinned = PINNED.get()
        if pinned is not None and pinned.hashed is not None and pinned.location == location:
            pinned.hashed(start, data[:filled])
        return filled


def size_of(location: Location) -> int:
    """Return the size of a file in bytes."""
    size: int = version_of(location)["size"]
    return size


def version_of(location: Location) -> Version:
    """Return the current version of a file."""
    with _reading(location):
        if not isinstance(location, str):
            _refuse_special(location)
            # Opening makes a network file system ask its server, which stat alone may not do.
            descriptor = os.open(location, os.O_RDONLY | os.O_NONBLOCK)
            try:
                found = os.fstat(descriptor)
            finally:
                os.close(descriptor)
            return {"size": found.st_size, "mtime_ns": str(found.st_mtime_ns)}
        files, name = remote_files(location)
        if is_web(location):
            _, said = _ask_web(files, name, 0, None)
        else:
            files.invalidate_cache(name)
            said = files.info(name)
    if said.get("size") is None:
        raise BadInputError(f"the server of {location} does not report the size of the file. Download the file first")
    return {"size": int(said["size"]), "version": version_text(said)}


@contextmanager
def pinned_version(location: Location, version: Version, hashed: HashedBytes | None = None) -> Iterator[None]:
    """Require that what the body reads of a file, in this thread, is of one version; pass its bytes to ``hashed``.

    Every response of a web server is checked. If the body raises BadInputError for another reason and the file has
    changed by then, the error says so instead, since a mixture of two versions looks like a damaged file.

    Raises
    ------
    BadInputError
        The file has changed; see `require_unchanged`.
    """
    token = PINNED.set(PinnedFile(location, version, hashed))
    try:
        yield
    except StalledServerError:
        raise  # it would not respond to the next request either
    except BadInputError as error:
        require_unchanged(location, version, error)
        raise
    finally:
        PINNED.reset(token)


def require_unchanged(location: Location, version: Version, cause: Exception | None = None) -> None:
    """Raise BadInputError unless a file is still of a version.

    A change that keeps size and time is not detected: one within the time resolution of the file system (some
    milliseconds; 2 s on FAT), or one after which the time is set back.

    Raises
    ------
    BadInputError
        The file was changed or removed.
    """
    try:
        now = version_of(location)
    except BadInputError as error:
        if is_url(location):
            raise cause or error from error  # no response: the file may be unchanged
        raise file_changed(location, f"it was removed ({error})") from cause or error
    if now != version:
        raise file_changed(location, difference(version, now)) from cause


def list_folder(url: str) -> list[str] | None:
    """Return the URLs of all files below a URL, except hidden ones; None if it is no folder: a web server has none."""
    with _reading(url):
        files, folder = remote_files(url)
        if is_web(url) or not files.isdir(folder):
            return None
        found: list[str] = files.find(folder)
        visible = [name for name in found if "/." not in f"/{name.removeprefix(folder).lstrip('/')}"]
        return [files.unstrip_protocol(name) for name in visible]


def _from_server(url: str, start: int, data: NDArray[np.uint8]) -> int:
    files, name = remote_files(url)
    if is_web(url):
        got, said = _ask_web(files, name, start, data)
        require_pinned(url, said)
        return got
    found = files.cat_file(name, start=start, end=start + data.size)
    if len(found) > data.size:
        raise BadInputError(f"the server of {url} does not support range requests. Download the file first")
    data[: len(found)] = np.frombuffer(found, np.uint8)
    return len(found)


def _fill(stream: Any, data: NDArray[np.uint8]) -> int:
    """Read until the array is full or the file ends: one call returns at most 2 GB."""
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


# fsspec reads the whole body of a response before it checks it, and waits five minutes for one. So only its session
# (URLs, proxies, passwords) is used for web servers, and the ranges are requested directly.
STALL_S = 60.0
"""Seconds that a server may send nothing."""
_WHOLE, _RANGE, _PAST_THE_END = 200, 206, 416


class StalledServerError(BadInputError):
    """A server sent nothing for ``STALL_S`` seconds."""


def is_web(url: str) -> bool:
    """Return whether a URL is http or https."""
    return url.lower().startswith(("http://", "https://"))


def _ask_web(files: Any, url: str, start: int, data: NDArray[np.uint8] | None) -> tuple[int, Mapping[str, Any]]:
    """Read bytes of a URL from offset ``start`` into an array, or request a single byte if there is none.

    Returns
    -------
    int
        Number of bytes read; fewer than the array has at the end of the file.
    mapping
        Headers of the response by name in lower case, and ``size``: bytes of the file, None if it is not reported.

    Raises
    ------
    BadInputError
        The server does not support range requests, sends other bytes, or (`StalledServerError`) sends none.
    """
    from fsspec.asyn import sync

    try:
        found: tuple[int, Mapping[str, Any]] = sync(files.loop, _request, files, url, start, data)
    except TimeoutError as error:
        raise StalledServerError(
            f"the server of {url} sent nothing for {STALL_S:g} s. Try again later, or download the file first"
        ) from error
    return found


async def _request(files: Any, url: str, start: int, data: NDArray[np.uint8] | None) -> tuple[int, Mapping[str, Any]]:
    from aiohttp import ClientTimeout

    size = 1 if data is None else data.size
    session = await files.set_session()
    wanted = {"Range": f"bytes={start}-{start + size - 1}", "Accept-Encoding": "identity"}
    options = files.kwargs | {"headers": files.kwargs.get("headers", {}) | wanted}
    timeout = ClientTimeout(total=None, connect=STALL_S, sock_connect=STALL_S, sock_read=STALL_S)
    async with session.get(files.encode_url(url), timeout=timeout, **options) as response:
        if response.status != _PAST_THE_END:
            response.raise_for_status()
        first, total = 0, response.content_length  # of a response with the whole file
        if response.status != _WHOLE:
            found = re.match(r"bytes (?:(\d+)-\d+|\*)/(\d+)", response.headers.get("Content-Range", ""))
            first, total = (int(found[1] or 0), int(found[2])) if found else (0, None)
        info = {name.lower(): value for name, value in response.headers.items()} | {"size": total}
        if data is None or response.status == _PAST_THE_END:
            return 0, info
        if response.status != _RANGE and not (start == 0 and total is not None and total <= size):
            raise BadInputError(
                f"the server of {url} does not support range requests. Download the file first, such as "
                f"with: curl -O {shlex.quote(url)}"
            )
        if first != start:
            raise BadInputError(f"the server of {url} returned byte {first:,} instead of byte {start:,}")
        got = 0
        async for part in response.content.iter_any():
            if got + len(part) > size:
                raise BadInputError(f"the server of {url} returned more bytes than requested")
            data[got : got + len(part)] = np.frombuffer(part, np.uint8)
            got += len(part)
    return got, info


@contextmanager
def _reading(location: Location) -> Iterator[None]:
    """Turn the exceptions of file systems and servers, which differ, into BadInputError."""
    try:
        yield
    except (BumpymapError, MemoryError):
        raise
    except OSError as error:
        said = error.strerror or str(error)
        if said.strip("'/") and str(location).endswith(said.strip("'/")):  # file systems of servers say the path alone
            said = "there is no such file"
        raise BadInputError(f"cannot read {location}: {said}") from error
    except Exception as error:
        if not is_url(location):
            raise
        raise BadInputError(f"cannot read {location}: {str(error).strip() or type(error).__name__}") from error


_NEEDED, _NEEDED_PER_BYTE = 512 << 20, 20
"""Memory that reading a log or bag may need, and for each byte of it."""
TRUST = "`trust_points=True` continues with the extent of the points"


@contextmanager
def decoding(path: Location, what: str) -> Iterator[None]:
    """Turn any exception of a parser into a BadInputError: the file is damaged.

    A panic of a decoder written in Rust is a ``BaseException``, not an ``Exception``.
    """
    try:
        yield
    except (BumpymapError, KeyboardInterrupt, SystemExit, GeneratorExit, MemoryError):
        raise
    except BaseException as error:
        if missing_resource(error) or refused_write(error):  # out of memory or the like: not the file's fault
            raise
        reason = str(error).strip().split("\n")[0] or type(error).__name__
        raise BadInputError(
            f"cannot read {what} of {path}: {reason}. The file is damaged or truncated; copy or download it again"
        ) from error


def asks_too_much(error: BaseException, paths: Iterable[Path]) -> bool:
    """Return whether memory ran out that files of their size, intact, would not need: a length in them is wrong."""
    if missing_resource(error) != "memory":
        return False
    files = (file for path in paths for file in (path.iterdir() if path.is_dir() else (path,)))
    return (free_memory() or 0) >= _NEEDED + _NEEDED_PER_BYTE * sum(file.stat().st_size for file in files)


def refuse_count(path: Location, declared: int, held: int, unit: str = "points") -> None:
    """Raise BadInputError if a file holds fewer points, or other units, than its header declares."""
    if held < declared:
        raise BadInputError(
            f"{path} declares {declared:,} {unit} but holds {held:,}: truncated? Copy or download it again"
        )


class NoPointsError(BadInputError):
    """A file holds no points."""


def refuse_points(path: Location, declared: int, held: int, unit: str = "points") -> None:
    """Do the same for the points of a whole file, and raise NoPointsError if its header declares none."""
    if declared == 0:
        raise NoPointsError(f"{path} holds no points (its header declares 0): nothing to map. Was it exported fully?")
    refuse_count(path, declared, held, unit)


def refuse_header_bounds(path: Location, bounds: Bounds) -> None:
    """Raise BadInputError if the bounds in a header are not finite or inverted."""
    sides = (bounds.west, bounds.south, bounds.east, bounds.north)
    if not np.isfinite(sides).all() or bounds.west > bounds.east or bounds.south > bounds.north:
        raise BadInputError(f"the header of {path} gives an impossible extent: {box_text(bounds)}. {TRUST}")


def box_text(bounds: Bounds) -> str:
    """Return bounds as text for messages."""
    return f"easting {bounds.west:,.2f} to {bounds.east:,.2f} m, northing {bounds.south:,.2f} to {bounds.north:,.2f} m"
