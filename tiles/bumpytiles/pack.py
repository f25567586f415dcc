"""Packs: tables of array columns with an index of blocks, in a file that is written atomically, or in memory.

A run writes waiting points and finished tiles to packs. A file is the columns one after another, each with the rows of
all blocks, block after block; then an index with a checksum; then a trailer with the position of the index. It is
written under a temporary name and renamed, so a file with its final name is complete.

Arrow IPC files were tried instead. Their footer has no checksum (of 639 bytes changed one at a time outside the
columns, 4 gave other data without an error), and small blocks take 1.6 times as long to write.
"""

import json
import math
import os
import struct
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

_MAGIC = b"BUMPPAC2"
_TRAILER = struct.Struct("<QQI8s")

BlockKey = tuple[int, int]
"""Row and column of a block; rows grow to the north."""


class PackError(Exception):
    """A file is not a pack, or is damaged."""


@dataclass(frozen=True)
class Column:
    """One column: ``(n, *tail)`` values of ``dtype`` in a table of n rows."""

    name: str
    dtype: str
    """As NumPy writes it, such as ``<f8``."""
    tail: tuple[int, ...] = ()

    @cached_property
    def row_bytes(self) -> int:
        """Bytes of one row."""
        return math.prod(self.tail, start=np.dtype(self.dtype).itemsize)

    def empty(self, rows: int) -> NDArray[Any]:
        """Return an array for ``rows`` rows."""
        return np.empty((rows, *self.tail), self.dtype)


def write_pack(
    path: Path,
    columns: Sequence[Column],
    blocks: Mapping[BlockKey, int],
    parts_of: Callable[[Column], Iterable[NDArray[Any]]],
    meta: Mapping[str, Any],
) -> None:
    """Write a pack: the file appears whole or not at all.

    Parameters
    ----------
    path : Path
        File to write.
    columns : sequence of Column
    blocks : mapping
        The number of rows of each block, in the order of the rows.
    parts_of : callable
        Returns arrays that hold the rows of a column once they are concatenated.
    meta : mapping
        JSON-serialisable; read back as ``Pack.meta``.

    Raises
    ------
    ValueError
        A column does not hold as many rows as the blocks.
    """
    rows = sum(blocks.values())
    temporary = path.with_name(f".{path.name}.part")
    try:
        with temporary.open("wb") as file:
            file.write(_MAGIC)
            for column in columns:
                size = sum(file.write(_bytes(np.ascontiguousarray(part, column.dtype))) for part in parts_of(column))
                if size != rows * column.row_bytes:
                    needed = rows * column.row_bytes
                    raise ValueError(f"column {column.name} holds {size} bytes; {rows} rows need {needed}")
            at = file.tell()
            described = [[column.name, column.dtype, list(column.tail)] for column in columns]
            text = json.dumps({"columns": described, "meta": dict(meta)}).encode()
            entries = np.array([(*key, n) for key, n in blocks.items()], "<i8").reshape(-1, 3)
            index = struct.pack("<Q", len(text)) + text + entries.tobytes()
            file.write(index)
            file.write(_TRAILER.pack(at, len(index), zlib.crc32(index), _MAGIC))
        os.replace(temporary, path)  # noqa: PTH105 (the name says that it replaces)
    finally:
        temporary.unlink(missing_ok=True)


def _bytes(array: NDArray[Any]) -> memoryview:
    """Return the bytes of a contiguous array without a copy."""
    flat: Any = array.reshape(-1).view(np.uint8) if array.size else b""
    return memoryview(flat)


def key_codes(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return one number for each (row, column) of a block, (n, 2), which sorts as they do."""
    return (keys[:, 0] << 32) + keys[:, 1] + (1 << 31)


def keys_of(codes: NDArray[np.int64]) -> list[BlockKey]:
    """Return the blocks of such numbers."""
    return list(zip((codes >> 32).tolist(), ((codes & 0xFFFFFFFF) - (1 << 31)).tolist(), strict=True))


def find_key(codes: NDArray[np.int64], key: BlockKey) -> int | None:
    """Return the place of a block among such numbers in increasing order; None where it is not there."""
    code = (key[0] << 32) + key[1] + (1 << 31)
    place = int(np.searchsorted(codes, code))
    return place if place < len(codes) and codes[place] == code else None


class MemoryPack:
    """A pack in memory; `Pack` reads alike.

    Parameters
    ----------
    columns : sequence of Column
    blocks : array (n, 3) int64
        Row, column and number of rows of each block, in the order of the rows.
    arrays : mapping
        The rows of each column.
    """

    def __init__(
        self, columns: Sequence[Column], blocks: NDArray[np.int64], arrays: Mapping[str, NDArray[Any]]
    ) -> None:
        self.columns, self._arrays = tuple(columns), arrays
        # Not a dict: a large survey has millions of entries, which take only 24 bytes each here.
        codes = key_codes(blocks)
        order = np.argsort(codes, kind="stable")
        self.codes = codes[order]
        """(blocks,) the blocks, south-west first, as `key_codes` numbers them."""
        self.counts = blocks[order, 2]
        """(blocks,) their numbers of rows."""
        self.starts = (np.cumsum(blocks[:, 2]) - blocks[:, 2])[order]
        """(blocks,) where their rows begin."""

    @property
    def keys(self) -> list[BlockKey]:
        """The blocks, south-west first."""
        return keys_of(self.codes)

    def rows(self, key: BlockKey) -> int:
        """Rows that a block has here; 0 where it is not here."""
        place = find_key(self.codes, key)
        return 0 if place is None else int(self.counts[place])

    def read(
        self, key: BlockKey, names: Iterable[str], start: int = 0, stop: int | None = None
    ) -> dict[str, NDArray[Any]]:
        """Read columns of a block (rows ``start:stop``), each (n, *tail).

        Raises
        ------
        KeyError
            The block is not here.
        PackError
            The file ends too early.
        """
        place = find_key(self.codes, key)
        if place is None:
            raise KeyError(key)
        rows = int(self.counts[place])
        wanted = set(names)
        found = {
            column.name: column.empty(max(0, min(rows, rows if stop is None else stop) - start))
            for column in self.columns
            if column.name in wanted
        }
        self.fill(found, int(self.starts[place]) + start)
        return found

    def fill(self, arrays: Mapping[str, NDArray[Any]], start: int) -> None:
        """Fill arrays, by column, with rows of the whole table from ``start`` on."""
        for name, array in arrays.items():
            array[:] = self._arrays[name][start : start + len(array)]


class Pack(MemoryPack):
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
                columns, blocks, self.meta = _read_index(path, file)
        except OSError as error:
            raise PackError(f"cannot read {path}: {error}") from error
        super().__init__(columns, blocks, {})
        rows, at = int(self.counts.sum()), len(_MAGIC)
        self._at: dict[str, tuple[int, int]] = {}
        """Where each column begins in the file, and the bytes of a row."""
        for column in columns:
            self._at[column.name] = at, column.row_bytes
            at += rows * column.row_bytes

    def fill(self, arrays: Mapping[str, NDArray[Any]], start: int) -> None:
        """Fill arrays, by column, with rows of the whole table from ``start`` on."""
        # Opened for each read: safe with any number of packs and threads, and nothing is left open.
        with self.path.open("rb", buffering=0) as file:
            for name, array in arrays.items():
                view, done, (at, row_bytes) = _bytes(array), 0, self._at[name]
                file.seek(at + start * row_bytes)
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
    entries = np.frombuffer(index[8 + text_bytes :], dtype="<i8").reshape(-1, 3)
    columns = tuple(Column(name, dtype, tuple(tail)) for name, dtype, tail in head["columns"])
    return columns, entries, head["meta"]
