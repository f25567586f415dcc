"""Packs: files of array columns grouped by block, written atomically.

A run writes waiting points and finished tiles to packs. A pack is data (the columns of one block, block after block),
then an index with a checksum, then a trailer with the position of the index. It is written under a temporary name and
renamed, so a file with its final name is complete.

Arrow IPC files were tried instead. Their footer has no checksum (of 639 bytes changed one at a time outside the
columns, 4 gave other data without an error), it is not possible to read only some rows of a large block, and small
blocks take 1.6 times as long to write.
"""

import json
import math
import os
import struct
import zlib
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from io import FileIO
from itertools import groupby
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

__all__ = ["BlockKey", "Column", "JoinedPack", "MemoryPack", "Pack", "PackError", "PackWriter", "read_joined"]

_MAGIC = b"BUMPPACK"
_SPAN = 4 << 20
"""Most bytes that are read at once of blocks that follow each other in a file."""
_SMALL = 1 << 16
"""Up to this size, bytes, a block is read as a whole: the time of a read counts more than what is not needed of it."""
_TRAILER = struct.Struct("<QQI8s")

BlockKey = tuple[int, int]
"""Row and column of a block; rows grow to the north."""


class PackError(Exception):
    """A file is not a pack, or is damaged."""


@dataclass(frozen=True)
class Column:
    """One column: ``(n, *tail)`` values of ``dtype`` in a block of n rows."""

    name: str
    dtype: str
    """As NumPy writes it, such as ``<f8``."""
    tail: tuple[int, ...] = ()

    @cached_property
    def row_bytes(self) -> int:
        """Bytes of one row."""
        return math.prod(self.tail, start=np.dtype(self.dtype).itemsize)


class PackWriter:
    """Writes a pack as a context manager: the file appears if the body succeeds, and is deleted if it fails.

    Parameters
    ----------
    path : Path
        File to write.
    columns : sequence of Column
    meta : mapping
        JSON-serialisable; read back as ``Pack.meta``.
    """

    def __init__(self, path: Path, columns: Sequence[Column], meta: Mapping[str, Any]) -> None:
        self._path = path
        self._temporary = path.with_name(f".{path.name}.part")
        self._columns = tuple(columns)
        self._meta = dict(meta)
        self._index: list[tuple[int, int, int, int]] = []
        self._file: BinaryIO

    def __enter__(self) -> Self:
        self._file = self._temporary.open("wb")
        self._file.write(_MAGIC)
        self._at = len(_MAGIC)
        return self

    def add(self, key: BlockKey, rows: int, columns: Mapping[str, Iterable[NDArray[Any]]]) -> None:
        """Write a block of ``rows`` rows; each column is given as arrays to be concatenated."""
        self._index.append((*key, rows, self._at))
        for column in self._columns:
            size = 0
            for array in columns[column.name]:
                size += self._file.write(_bytes(np.ascontiguousarray(array, dtype=column.dtype)))
            if size != rows * column.row_bytes:
                raise ValueError(f"column {column.name} holds {size} bytes; {rows} rows need {rows * column.row_bytes}")
            self._at += size

    def add_blocks(self, keys: Sequence[BlockKey], rows: Sequence[int], columns: Mapping[str, NDArray[Any]]) -> None:
        """Write blocks of few rows at once; each column holds the rows of all of them, block after block."""
        counts = np.array(rows, np.int64)
        sizes = counts * sum(column.row_bytes for column in self._columns)
        starts = np.cumsum(sizes) - sizes
        span = np.empty(int(sizes.sum()), np.uint8)
        for column, places in _row_places(self._columns, counts, starts, columns):
            values = np.ascontiguousarray(columns[column.name], dtype=column.dtype)
            if values.shape != (len(places), *column.tail):
                raise ValueError(f"column {column.name} has shape {values.shape}, not {(len(places), *column.tail)}")
            pieces = values.reshape(-1).view(np.uint8).reshape(len(places), column.row_bytes)
            sliding_window_view(span, column.row_bytes, writeable=True)[places] = pieces
        self._index += [(*key, n, self._at + at) for key, n, at in zip(keys, rows, starts.tolist(), strict=True)]
        self._at += self._file.write(span.data)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self._finish()
            self._file.close()
            if kind is None:
                os.replace(self._temporary, self._path)  # noqa: PTH105 (the name says that it replaces)
        finally:
            self._file.close()
            self._temporary.unlink(missing_ok=True)

    def _finish(self) -> None:
        head = {
            "columns": [[column.name, column.dtype, list(column.tail)] for column in self._columns],
            "blocks": len(self._index),
            "meta": self._meta,
        }
        text = json.dumps(head).encode()
        entries = np.array(self._index, dtype="<i8").reshape(-1, 4).tobytes()
        index = struct.pack("<Q", len(text)) + text + entries
        self._file.write(index)
        self._file.write(_TRAILER.pack(self._at, len(index), zlib.crc32(index), _MAGIC))


def _bytes(array: NDArray[Any]) -> memoryview:
    """Return the bytes of a contiguous array without a copy."""
    flat: Any = array.reshape(-1).view(np.uint8) if array.size else b""
    return memoryview(flat)


class Pack:
    """A pack on disk. Only the index is in memory; columns are read on request.

    Raises
    ------
    PackError
        The file is not a pack, or is damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            with path.open("rb") as file:
                self.columns, entries, self.meta = _read_index(path, file)
        except OSError as error:
            raise PackError(f"cannot read {path}: {error}") from error
        # Not a dict: a large survey has millions of entries, which take only 24 bytes each here.
        codes = _codes(entries[:, :2])
        order = np.argsort(codes, kind="stable")
        self._codes, self._rows, self._at = codes[order], entries[order, 2], entries[order, 3]

    @property
    def keys(self) -> list[BlockKey]:
        """The blocks, south-west first."""
        return list(zip((self._codes >> 32).tolist(), ((self._codes & 0xFFFFFFFF) - (1 << 31)).tolist(), strict=True))

    def counts(self) -> list[int]:
        """Return the rows of each of ``keys``."""
        return [int(rows) for rows in self._rows.tolist()]

    def rows(self, key: BlockKey) -> int:
        """Rows that a block has here; 0 where it is not here."""
        place = self._find(key)
        return 0 if place is None else int(self._rows[place])

    def _find(self, key: BlockKey) -> int | None:
        code = (key[0] << 32) + key[1] + (1 << 31)
        place = int(np.searchsorted(self._codes, code))
        return place if place < len(self._codes) and self._codes[place] == code else None

    def read(
        self, key: BlockKey, names: Sequence[str], start: int = 0, stop: int | None = None
    ) -> dict[str, NDArray[Any]]:
        """Read columns of a block (rows ``start:stop``), each (n, *tail).

        Raises
        ------
        PackError
            The file ends too early.
        """
        place = self._find(key)
        if place is None:
            raise KeyError(key)
        rows = int(self._rows[place])
        stop = rows if stop is None else min(stop, rows)
        found = {c.name: np.empty((max(0, stop - start), *c.tail), c.dtype) for c in self.columns if c.name in names}
        # Opened for each read: safe with any number of packs and threads, and nothing is left open.
        with self.path.open("rb", buffering=0) as file:
            self._read_one(file, place, found, start)
        return found

    def read_blocks(self, keys: Sequence[BlockKey], names: Sequence[str]) -> dict[str, NDArray[Any]]:
        """Read columns of several blocks, joined in the order of ``keys``; small ones that follow each other at once.

        Raises
        ------
        KeyError
            One of the blocks is not here.
        PackError
            The file ends too early.
        """
        codes = _codes(np.array(keys, np.int64).reshape(-1, 2))
        places = np.minimum(np.searchsorted(self._codes, codes), len(self._codes) - 1)
        if np.any(self._codes[places] != codes):
            raise KeyError(keys[int(np.argmax(self._codes[places] != codes))])
        ends = np.cumsum(self._rows[places])
        total = int(ends[-1]) if len(ends) else 0
        found = {c.name: np.empty((total, *c.tail), c.dtype) for c in self.columns if c.name in names}
        with self.path.open("rb", buffering=0) as file:
            for some in self._spans(places):
                first, last = ends[some[0]] - self._rows[places[some[0]]], ends[some]
                if len(some) == 1:
                    self._read_one(file, int(places[some[0]]), {n: a[first : last[0]] for n, a in found.items()}, 0)
                else:
                    self._read_span(file, places[some], last - self._rows[places[some]], found)
        return found

    def _spans(self, places: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
        """Yield the positions in ``places`` of blocks to read together: small ones that are near each other."""
        size = self._rows[places] * sum(column.row_bytes for column in self.columns)
        order = np.lexsort((size, self._at[places]))  # an empty block begins where the next one does
        at, end = self._at[places][order], (self._at[places] + size)[order]
        cut = (at[1:] - end[:-1] > _SMALL) | (size[order][1:] > _SMALL) | (size[order][:-1] > _SMALL)
        for run in np.split(order, np.flatnonzero(cut) + 1):
            span = (self._at[places[run]] - self._at[places[run[:1]]]) // _SPAN
            yield from np.split(run, np.flatnonzero(np.diff(span)) + 1)

    def _read_one(self, file: FileIO, place: int, found: Mapping[str, NDArray[Any]], start: int) -> None:
        """Fill arrays with columns of a block, from row ``start``."""
        rows, at = int(self._rows[place]), int(self._at[place])
        for column in self.columns:
            if column.name in found:
                self._fill(file, found[column.name], at + start * column.row_bytes)
            at += rows * column.row_bytes

    def _read_span(
        self, file: FileIO, places: NDArray[np.int64], starts: NDArray[np.int64], found: Mapping[str, NDArray[Any]]
    ) -> None:
        """Read blocks in the order of the file at once, and put their columns to rows ``starts`` of the arrays."""
        rows, at = self._rows[places], self._at[places]
        bytes_each = sum(column.row_bytes for column in self.columns)
        span = np.empty(int(at[-1] + rows[-1] * bytes_each - at[0]), np.uint8)
        self._fill(file, span, int(at[0]))
        goal = np.repeat(starts - (np.cumsum(rows) - rows), rows) + np.arange(int(rows.sum()))
        for column, begins in _row_places(self.columns, rows, at - at[0], found):
            pieces = sliding_window_view(span, column.row_bytes)[begins]
            found[column.name][goal] = pieces.view(column.dtype).reshape(len(goal), *column.tail)

    def _fill(self, file: FileIO, array: NDArray[Any], at: int) -> None:
        view, done = _bytes(array), 0
        file.seek(at)
        while done < len(view):
            got = file.readinto(view[done:])
            if not got:
                raise PackError(f"{self.path} ends inside a block")
            done += got


def _row_places(
    columns: Sequence[Column], rows: NDArray[np.int64], at: NDArray[np.int64], wanted: Container[str]
) -> Iterator[tuple[Column, NDArray[np.int64]]]:
    """Yield, for each wanted column that is not empty, where its rows begin, in blocks that begin at bytes ``at``."""
    nth = np.arange(int(rows.sum())) - np.repeat(np.cumsum(rows) - rows, rows)
    before = 0
    for column in columns:
        size = column.row_bytes
        if size and column.name in wanted:
            yield column, np.repeat(at + rows * before, rows) + nth * size
        before += size


def _codes(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return one number for each (row, column) of a block, which sorts as they do."""
    return (keys[:, 0] << 32) + keys[:, 1] + (1 << 31)


def _read_index(path: Path, file: BinaryIO) -> tuple[tuple[Column, ...], NDArray[np.int64], dict[str, Any]]:
    size = file.seek(0, os.SEEK_END)
    if size < len(_MAGIC) + _TRAILER.size:
        raise PackError(f"{path} is too short to be a pack")
    file.seek(size - _TRAILER.size)
    at, length, checksum, magic = _TRAILER.unpack(file.read())
    if magic != _MAGIC or at + length + _TRAILER.size != size:
        raise PackError(f"{path} is not a pack")
    file.seek(at)
    index = file.read(length)
    if zlib.crc32(index) != checksum:
        raise PackError(f"the index of {path} is damaged")
    (text_bytes,) = struct.unpack_from("<Q", index)
    head = json.loads(index[8 : 8 + text_bytes])
    entries = np.frombuffer(index[8 + text_bytes :], dtype="<i8").reshape(-1, 4)
    columns = tuple(Column(name, dtype, tuple(tail)) for name, dtype, tail in head["columns"])
    return columns, entries, head["meta"]


class MemoryPack:
    """A pack in memory, with the methods of `Pack` for reading."""

    def __init__(self) -> None:
        self._blocks: dict[BlockKey, dict[str, NDArray[Any]]] = {}

    def add(self, key: BlockKey, columns: Mapping[str, NDArray[Any]]) -> None:
        """Add a block."""
        self._blocks[key] = dict(columns)

    @property
    def keys(self) -> list[BlockKey]:
        """The blocks, in the order in which they were added."""
        return list(self._blocks)

    def counts(self) -> list[int]:
        """Return the rows of each of ``keys``."""
        return [self.rows(key) for key in self._blocks]

    def rows(self, key: BlockKey) -> int:
        """Rows that a block has here; 0 where it is not here."""
        columns = self._blocks.get(key)
        return len(next(iter(columns.values()))) if columns else 0

    def read(
        self, key: BlockKey, names: Sequence[str], start: int = 0, stop: int | None = None
    ) -> dict[str, NDArray[Any]]:
        """Read columns of a block (rows ``start:stop``)."""
        return {name: array[start:stop] for name, array in self._blocks[key].items() if name in names}

    def read_blocks(self, keys: Sequence[BlockKey], names: Sequence[str]) -> dict[str, NDArray[Any]]:
        """Read columns of at least one block, joined in the order of ``keys``."""
        parts = [self._blocks[key] for key in keys]
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0] if name in names}


class JoinedPack:
    """Blocks of several packs with further columns from one pack, read as one; of two columns the added one counts.

    Parameters
    ----------
    base : mapping of BlockKey to Pack
        Where each block of ``added`` is, with its rows in the same order.
    added : Pack
    """

    def __init__(self, base: "Mapping[BlockKey, Pack | MemoryPack | JoinedPack]", added: Pack) -> None:
        self._base, self._added = base, added
        self._own = {column.name for column in added.columns}

    @property
    def keys(self) -> list[BlockKey]:
        """The blocks of the added pack, south-west first."""
        return self._added.keys

    def counts(self) -> list[int]:
        """Return the rows of each of ``keys``."""
        return self._added.counts()

    def rows(self, key: BlockKey) -> int:
        """Rows that a block has here; 0 where it is not here."""
        return self._added.rows(key)

    def read(
        self, key: BlockKey, names: Sequence[str], start: int = 0, stop: int | None = None
    ) -> dict[str, NDArray[Any]]:
        """Read columns of a block (rows ``start:stop``)."""
        own = [name for name in names if name in self._own]
        others = [name for name in names if name not in self._own]
        found = self._base[key].read(key, others, start, stop) if others else {}
        return found | (self._added.read(key, own, start, stop) if own else {})

    def read_blocks(self, keys: Sequence[BlockKey], names: Sequence[str]) -> dict[str, NDArray[Any]]:
        """Read columns of at least one block, joined in the order of ``keys``."""
        own = [name for name in names if name in self._own]
        others = [name for name in names if name not in self._own]
        found = read_joined(self._base, keys, others) if others else {}
        return found | (self._added.read_blocks(keys, own) if own else {})


def read_joined(
    packs: "Mapping[BlockKey, Pack | MemoryPack | JoinedPack]", keys: Sequence[BlockKey], names: Sequence[str]
) -> dict[str, NDArray[Any]]:
    """Read columns of at least one block, each from its pack, joined in the order of ``keys``."""
    runs = [(pack, list(run)) for pack, run in groupby(keys, key=lambda key: packs[key])]
    parts = [pack.read_blocks(run, names) for pack, run in runs]
    if len(parts) == 1:
        return parts[0]
    # Each part is released as soon as it is joined: the parts take most of the memory.
    return {name: np.concatenate([part.pop(name) for part in parts]) for name in list(parts[0])}
