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
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

import numpy as np
from numpy.typing import NDArray

__all__ = ["BlockKey", "Column", "MemoryPack", "Pack", "PackError", "PackWriter"]

_MAGIC = b"BUMPPACK"
_TRAILER = struct.Struct("<QQI8s")

BlockKey = tuple[int, int]
"""Row and column of a block; rows grow to the north."""


class PackError(Exception):
    """A file is not a pack, or is damaged."""


@dataclass(frozen=True, slots=True)
class Column:
    """One column: ``(n, *tail)`` values of ``dtype`` in a block of n rows."""

    name: str
    dtype: str
    """As NumPy writes it, such as ``<f8``."""
    tail: tuple[int, ...] = ()

    @property
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
        self._entries = entries[np.lexsort((entries[:, 1], entries[:, 0]))]

    @property
    def keys(self) -> list[BlockKey]:
        """The blocks, south-west first."""
        return [(row, col) for row, col in self._entries[:, :2].tolist()]

    def rows(self, key: BlockKey) -> int:
        """Rows that a block has here; 0 where it is not here."""
        place = self._find(key)
        return 0 if place is None else int(self._entries[place, 2])

    def _find(self, key: BlockKey) -> int | None:
        # Not a dict: a large survey has millions of entries, which take only 32 bytes each here.
        row, col = self._entries[:, 0], self._entries[:, 1]
        first, last = np.searchsorted(row, [key[0], key[0] + 1])
        place = int(first + np.searchsorted(col[first:last], key[1]))
        return place if place < last and col[place] == key[1] else None

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
        rows, at = (int(number) for number in self._entries[place, 2:])
        stop = rows if stop is None else min(stop, rows)
        found = {}
        # Opened for each read: safe with any number of packs and threads, and nothing is left open.
        with self.path.open("rb", buffering=0) as file:
            for column in self.columns:
                if column.name in names:
                    array = np.empty((max(0, stop - start), *column.tail), column.dtype)
                    self._fill(file, array, at + start * column.row_bytes)
                    found[column.name] = array
                at += rows * column.row_bytes
        return found

    def _fill(self, file: FileIO, array: NDArray[Any], at: int) -> None:
        view, done = _bytes(array), 0
        file.seek(at)
        while done < len(view):
            got = file.readinto(view[done:])
            if not got:
                raise PackError(f"{self.path} ends inside a block")
            done += got


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

    def rows(self, key: BlockKey) -> int:
        """Rows that a block has here; 0 where it is not here."""
        columns = self._blocks.get(key)
        return len(next(iter(columns.values()))) if columns else 0

    def read(
        self, key: BlockKey, names: Sequence[str], start: int = 0, stop: int | None = None
    ) -> dict[str, NDArray[Any]]:
        """Read columns of a block (rows ``start:stop``)."""
        return {name: array[start:stop] for name, array in self._blocks[key].items() if name in names}
