"""A file of which one version is read: the hash that its bytes are added to, and the error if it has changed."""

import io
from collections.abc import Callable, Mapping
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError

__all__ = [
    "PINNED",
    "HashedBytes",
    "HashedFile",
    "Location",
    "PinnedFile",
    "Version",
    "add_to_hash",
    "difference",
    "file_changed",
    "is_hashed",
    "require_pinned",
    "version_text",
]

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


class HashedFile(io.FileIO):
    """A file whose bytes are hashed as they are read, see `pinned_version`."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._path = path

    def readinto(self, buffer: Any) -> int | None:
        """Read bytes into a buffer; return how many."""
        start = self.tell()
        got = super().readinto(buffer)
        # Copied: the caller reads the next bytes into the same buffer.
        add_to_hash(self._path, start, bytes(memoryview(buffer)[:got]))
        return got

    def readall(self) -> bytes:
        """Read the rest of the file."""
        start = self.tell()
        data = super().readall()
        add_to_hash(self._path, start, data)
        return data


def add_to_hash(path: Path, start: int, data: bytes | NDArray[np.uint8]) -> None:
    """Add bytes of a file to the hash of `pinned_version`."""
    pinned = PINNED.get()
    if pinned is not None and pinned.hashed is not None and pinned.location == path:
        pinned.hashed(start, data)


def is_hashed(path: Path) -> bool:
    """Return whether the bytes of a file are to be hashed."""
    pinned = PINNED.get()
    return pinned is not None and pinned.hashed is not None and pinned.location == path


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
