"""Read byte ranges of files, of one version each."""

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, BumpymapError, file_checksum, free_memory, missing_resource, refused_write
from bumpytiles import Bounds

Location = Path
Version = dict[str, Any]
"""Distinguishes versions of a file without reading it: ``size`` in bytes, and ``mtime_ns`` as str."""


def file_changed(location: Location, how: str) -> BadInputError:
    """Return the error to raise for a file that changed while it was read; ``how`` continues the message."""
    return BadInputError(
        f"{location} changed while it was read: {how}. What was read may be a mixture of both versions and was "
        "discarded. Run again once no program writes to it any more, or on a copy"
    )


EPT_NAME = "ept.json"


def open_source(location: Location) -> BinaryIO:
    """Open a file for reading and seeking.

    Raises BadInputError: it does not exist, is not a regular file (reading a pipe might never end),
    or cannot be read.
    """
    with _reading(location):
        _refuse_special(location)
        return location.open("rb")


def read_range(location: Location, start: int, size: int) -> NDArray[np.uint8]:
    """Read ``size`` bytes from offset ``start``; fewer at the end of the file."""
    data = np.empty(size, np.uint8)
    return data[: read_into(location, start, data)]


def read_into(location: Location, start: int, data: NDArray[np.uint8]) -> int:
    """Read bytes from offset ``start`` into an array; return their number."""
    filled = 0
    with _reading(location), location.open("rb", buffering=0) as stream:
        stream.seek(start)
        # One call reads at most 2 GB.
        while filled < data.size and (got := stream.readinto(memoryview(data.data)[filled:])):
            filled += got
    return filled


def size_of(location: Location) -> int:
    """Return the size of a file in bytes."""
    return int(version_of(location)["size"])


def hash_survey(location: Location) -> str:
    """Return the checksum of a survey, see `bumpymap.core.file_checksum`; raise BadInputError if it cannot be read."""
    with _reading(location):
        _refuse_special(location)
        return file_checksum(location)


def version_of(location: Location) -> Version:
    """Return the current version of a file."""
    with _reading(location):
        _refuse_special(location)
        # Opening makes a network file system ask its server, which stat alone may not do.
        descriptor = os.open(location, os.O_RDONLY | os.O_NONBLOCK)
        try:
            found = os.fstat(descriptor)
        finally:
            os.close(descriptor)
        return {"size": found.st_size, "mtime_ns": str(found.st_mtime_ns)}


@contextmanager
def pinned_version(location: Location, version: Version) -> Iterator[None]:
    """Require that what the body reads of a file is of one version; raise BadInputError as `require_unchanged` does.

    If the body raises BadInputError for another reason and the file has changed by then, the error says so instead,
    since a mixture of two versions looks like a damaged file.
    """
    try:
        yield
    except BadInputError as error:
        require_unchanged(location, version, error)
        raise
    require_unchanged(location, version)


def require_unchanged(location: Location, version: Version, cause: Exception | None = None) -> None:
    """Raise BadInputError unless a file is still of a version.

    A change that keeps size and time is not detected: one within the time resolution of the file system (some
    milliseconds; 2 s on FAT), or one after which the time is set back.

    Raises BadInputError: the file was changed or removed.
    """
    try:
        now = version_of(location)
    except BadInputError as error:
        raise file_changed(location, f"it was removed ({error})") from cause or error
    if now["size"] != version["size"]:
        raise file_changed(location, f"it had {version['size']:,} bytes and has {now['size']:,}") from cause
    if now != version:
        raise file_changed(location, "it has the same size, but was written again") from cause


def _refuse_special(path: Path) -> None:
    mode = path.stat().st_mode
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise BadInputError(f"cannot read {path}: it is a pipe or a device. Name a file of points or a folder of them")


@contextmanager
def _reading(location: Location) -> Iterator[None]:
    """Turn the exceptions of file systems into BadInputError."""
    try:
        yield
    except OSError as error:
        raise BadInputError(f"cannot read {location}: {error.strerror or error}") from error


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


def asks_too_much(error: BaseException, path: Path) -> bool:
    """Return whether memory ran out that a file, or folder, of that size, intact, would not need: a length is wrong."""
    if missing_resource(error) != "memory":
        return False
    files = path.iterdir() if path.is_dir() else [path]
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


def box_text(bounds: Bounds) -> str:
    """Return bounds as text for messages."""
    sides = (bounds.west, bounds.east, bounds.south, bounds.north)
    west, east, south, north = (f"{side:,.2f}" if abs(side) < 1e12 else f"{side:g}" for side in sides)
    return f"easting {west} to {east} m, northing {south} to {north} m"
