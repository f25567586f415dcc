"""The run spec: inputs with their checksums, settings, and versions and ids of what a run computes with.

A file is cut into pieces of 1 MiB. Its checksum is the BLAKE3 of the BLAKE3 digests of the pieces, joined in file
order. A plain BLAKE3 needs all bytes in order, so a file that is read in another order (an octree, ranges read by
several workers, what a resumed run has left to read) would have to be read again for it. BLAKE3 takes a quarter of the
time of SHA-256, even on a processor with SHA instructions (measured).

Parts of a piece are kept until the piece is whole, up to a limit. Beyond that, the piece that was begun first is
forgotten and read again at the end, as are bytes that no reader has asked for.
"""

import hashlib
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from threading import Lock
from typing import Any

from blake3 import blake3

from bumpymap.core.errors import BadInputError
from bumpymap.core.files import plain_json

CHECKSUM_METHOD = "blake3-1MiB"
"""Stands before the digest in a checksum: ``blake3-1MiB:12ab...``."""
_SET_METHOD = "blake3-set"
"""Stands before the digest in a checksum of several files."""
PieceRuns = tuple[tuple[int, bytes], ...]
"""Digests of consecutive pieces, joined, each with the number of the first piece."""

PIECE = 1 << 20
_DIGEST = 32
MOST_PARTS = 16
"""Pieces at most of which parts are kept, for each file."""

Buffer = Any
"""Any object with the buffer protocol: bytes, memoryview, array of uint8."""


class FileHash:
    """Computes the checksum of a file of ``size`` bytes from the ranges that are read. Thread-safe.

    Only local files have one. Bytes may be added twice, and must then be the same: the caller checks that the file
    does not change.
    """

    def __init__(self, size: int) -> None:
        self._size, self._count = size, -(-size // PIECE)
        self._lock = Lock()
        self._digests, self._known = bytearray(), bytearray()
        self._parts: dict[int, dict[int, bytes]] = {}
        self._fresh: list[int] = []
        self._checksum: str | None = None

    @property
    def checksum(self) -> str | None:
        """The checksum; None before `finish`."""
        return self._checksum

    def add(self, start: int, data: Buffer) -> None:
        """Hash bytes that were read from offset ``start``."""
        if self._checksum is not None:
            return
        view = memoryview(data).cast("B")
        for piece in range(start // PIECE, -(-(start + len(view)) // PIECE)):
            first = max(piece * PIECE - start, 0)
            part = view[first : (piece + 1) * PIECE - start]
            if not self._is_known(piece):
                self._add_part(piece, start + first - piece * PIECE, part)

    def take(self) -> PieceRuns:
        """Return the digests of the pieces that were completed since the last call, except those from `put`."""
        with self._lock:
            fresh, self._fresh = sorted(self._fresh), []
        runs: list[tuple[int, bytes]] = []
        for piece in fresh:
            digest = bytes(self._digests[piece * _DIGEST : (piece + 1) * _DIGEST])
            if runs and runs[-1][0] + len(runs[-1][1]) // _DIGEST == piece:
                runs[-1] = (runs[-1][0], runs[-1][1] + digest)
            else:
                runs.append((piece, digest))
        if self._checksum is not None:
            self._digests, self._known = bytearray(), bytearray()
        return tuple(runs)

    def put(self, runs: Iterable[tuple[int, bytes]]) -> None:
        """Add digests of pieces that another `FileHash` of this file returned from `take`."""
        for first, digests in runs:
            for number in range(len(digests) // _DIGEST):
                if self._checksum is None and first + number < self._count:
                    self._store_digest(first + number, digests[number * _DIGEST : (number + 1) * _DIGEST], fresh=False)

    def finish(self, read: Callable[[int, int], Buffer]) -> str:
        """Read the bytes that are missing, and return the checksum.

        Parameters
        ----------
        read : callable
            Called with an offset and a number of bytes; returns these bytes.

        Raises
        ------
        BadInputError
            The file ends early.
        """
        if self._checksum is None:
            for piece in range(self._count):
                if not self._is_known(piece):
                    content = memoryview(read(piece * PIECE, self._length(piece))).cast("B")
                    if len(content) < self._length(piece):
                        raise BadInputError(f"the file ends before byte {self._size:,}, its size when it was opened")
                    self._store(piece, content)
            self._checksum = f"{CHECKSUM_METHOD}:{blake3(self._digests).hexdigest()}"
        return self._checksum

    def forget_parts(self) -> None:
        """Free the parts of pieces, which are read again by `finish`."""
        with self._lock:
            self._parts.clear()

    def _is_known(self, piece: int) -> bool:
        return bool(self._known and self._known[piece])

    def _length(self, piece: int) -> int:
        return min(self._size - piece * PIECE, PIECE)

    def _add_part(self, piece: int, at: int, data: memoryview) -> None:
        """Hash a piece if this is all of it, or the last part; else keep the part by its offset in the piece."""
        length = self._length(piece)
        if len(data) == length:
            self._store(piece, data)
            return
        with self._lock:
            parts = self._parts.setdefault(piece, {})
            parts[at] = bytes(data)
            if len(self._parts) > MOST_PARTS:
                del self._parts[next(iter(self._parts))]
            size = sum(map(len, parts.values()))
            if size > length:  # they overlap: the piece is read again
                self._parts.pop(piece, None)
            ends = [begin + len(part) for begin, part in sorted(parts.items())]
        if size == length and [0, *ends[:-1]] == sorted(parts):
            self._store(piece, b"".join(part for _, part in sorted(parts.items())))

    def _store(self, piece: int, content: Buffer) -> None:
        self._store_digest(piece, blake3(content).digest(), fresh=True)

    def _store_digest(self, piece: int, digest: bytes, *, fresh: bool) -> None:
        with self._lock:
            if not self._known:
                self._digests, self._known = bytearray(self._count * _DIGEST), bytearray(self._count)
            if not self._known[piece]:
                self._digests[piece * _DIGEST : (piece + 1) * _DIGEST] = digest
                self._known[piece] = 1
                self._fresh += [piece] * fresh
            self._parts.pop(piece, None)


def join_checksums(checksums: Iterable[str]) -> str:
    """Return one checksum for a set of files: the BLAKE3 of their checksums, sorted, one a line."""
    lines = "".join(f"{checksum}\n" for checksum in sorted(checksums))
    return f"{_SET_METHOD}:{blake3(lines.encode()).hexdigest()}"


_OF_THE_MACHINE = {"out", "threads", "memory", "scratch", "scheduler", "overwrite", "page"}
"""Settings that say where and how a run is carried out, or the header of its page: no layer depends on them, and no
manifest repeats them."""

_MOST_LISTED = 8
"""Differences that a message lists at most."""
_LONGEST = 80
"""Characters of a value that a message shows at most."""
_FROM = {"calibration": ("vehicle", "calibration"), "model": ("model",), "method": ("method", "model")}
"""Settings that select something with an id of its own: they count as different only if the id differs."""


def flat_settings(config: Any, without: Collection[str]) -> dict[str, Any]:
    """Return the settings of a dataclass as JSON values; those of a nested table are named ``table.name``.

    Parameters
    ----------
    without : collection of str
        Settings to leave out, because they do not change the results, beside those of the machine.
    """
    found = config if isinstance(config, Mapping) else asdict(config)
    return {
        name: value
        for key, item in found.items()
        if key not in without and key not in _OF_THE_MACHINE
        for name, value in (
            ((f"{key}.{inner}", plain_json(own)) for inner, own in item.items())
            if isinstance(item, Mapping)
            else ((key, plain_json(item)),)
        )
    }


def recorded_settings(config: Any) -> dict[str, Any]:
    """Return the settings of a dataclass that a manifest holds, which are those of every machine."""
    return {name: value for name, value in asdict(config).items() if name not in _OF_THE_MACHINE}


def differences(
    before: Mapping[str, Any],
    now: Mapping[str, Any],
    same: Callable[[str, Mapping[str, Any], Mapping[str, Any]], bool] | None = None,
) -> list[str]:
    """Describe the differences between two run specs, one phrase each.

    Parameters
    ----------
    before, now : mapping
        ``inputs``: path -> identity of the file; ``settings``; ``made with``: name -> version or id.
    same : callable, optional
        Called with path, old and new identity of an input, returns whether it is the same file. None: compare the
        two identities.
    """
    made = [{**record.get("made with", {})} for record in (before, now)]
    settings = [{**record.get("settings", {})} for record in (before, now)]
    for name, sources in _FROM.items():
        if made[0].get(name) == made[1].get(name):
            for own in settings:
                for source in sources:
                    own.pop(source, None)
        elif any(settings[0].get(source) != settings[1].get(source) for source in sources):
            for own in made:
                own.pop(name, None)
    found = _inputs(before.get("inputs", {}), now.get("inputs", {}), same)
    for old, new in (settings, made):
        found += [
            f"{name} was {_value_text(old.get(name))}, is {_value_text(new.get(name))}"
            for name in dict.fromkeys([*old, *new])
            if old.get(name) != new.get(name)
        ]
    return found if len(found) <= _MOST_LISTED else [*found[:_MOST_LISTED], f"and {len(found) - _MOST_LISTED} more"]


def same_content(path: str, known: Mapping[str, Any], here: Mapping[str, Any], hashed: Callable[[Path], str]) -> bool:
    """Return whether an input file is unchanged: by size and time, or by its checksum if the time differs.

    Parameters
    ----------
    path : str
        Of the file.
    known : mapping
        ``bytes``, ``checksum`` (see `FileHash`; or ``sha256`` of all bytes) and, if it was recorded, ``mtime_ns``.
    here : mapping
        From `bumpymap.readers.identity`.
    hashed : callable
        Returns the checksum of an input, such as `bumpymap.readers.hash_survey`.
    """
    if known.get("bytes") is not None and known["bytes"] != here["size"]:
        return False
    if known.get("mtime_ns") and known["mtime_ns"] == here.get("mtime_ns"):
        return True
    checksum, sha256 = known.get("checksum"), known.get("sha256")
    if checksum is not None:
        return bool(str(checksum).startswith(f"{CHECKSUM_METHOD}:") and hashed(Path(path)) == checksum)
    if sha256 is None:
        return False
    with Path(path).open("rb") as file:
        return bool(hashlib.file_digest(file, "sha256").hexdigest() == sha256)


def spec_of_manifest(
    record: Mapping[str, Any], without: Collection[str], made_with: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the run spec of a complete run, from its run.json or scan.json.

    Parameters
    ----------
    without : collection of str
        Settings to leave out, because they do not change the results.
    made_with : mapping
        Ids of models and calibrations, in addition to the versions.
    """
    return {
        "inputs": {str(file["path"]): file for file in (*record["inputs"], *record.get("skipped_inputs", ()))},
        "settings": flat_settings(record["settings"], without),
        "made with": {**record["versions"], **made_with},
    }


def _inputs(
    before: Mapping[str, Any],
    now: Mapping[str, Any],
    same: Callable[[str, Mapping[str, Any], Mapping[str, Any]], bool] | None,
) -> list[str]:
    found = []
    for path in dict.fromkeys([*before, *now]):
        if path not in now:
            found.append(f"{path} was an input, but is not given now")
        elif path not in before:
            found.append(f"{path} is given now, but was not an input")
        elif before[path] is None or now[path] is None or same is None:
            found += [f"{path} has changed since"] * (before[path] != now[path])
        elif not same(path, before[path], now[path]):
            found.append(f"{path} has changed since")
    return found


def _value_text(value: Any) -> str:
    if value is None:
        return "not given"
    if isinstance(value, bool):
        return str(value).lower()
    text = ", ".join(map(str, value)) if isinstance(value, list) else str(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."
