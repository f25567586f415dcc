"""Read the rows of a binary PLY element that has list properties.

The size of a list depends on the length stored before it, so the offset of a row is known only after all rows before it
have been read. The values of lists are skipped without loading them, since a damaged file may declare any length.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from struct import Struct
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from bumpymap.readers.checks import decoding, refuse_count
from bumpymap.readers.ply_header import PlyElement, PlyHeader
from bumpymap.readers.serial_rows import SerialRows
from bumpymap.readers.source import OpenFile

__all__ = ["ListedRows", "data_start"]

_STRUCT = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "f4": "f", "f8": "d"}
_BLOCK = 20_000
"""Rows held as Python numbers at a time."""


@dataclass(slots=True)
class ListedRows(SerialRows):
    """Rows of the scalar properties of an element."""

    element: PlyElement
    byte_order: str
    size: int
    """Size of the file, bytes."""
    _walk: Any = field(init=False, default=None)

    def _open(self) -> None:
        self._stream = self.file.open()
        self._stream.seek(self.data_at)
        self._walk = _rows(self._stream, self.element, self.byte_order, self.size)

    def _load(self, count: int) -> NDArray[np.void]:
        dtype = self.element.dtype(self.byte_order)
        blocks = [np.empty(0, dtype)]
        while count > 0:
            rows = list(islice(self._walk, min(count, _BLOCK)))
            if not rows:
                break
            blocks.append(np.array(rows, dtype))
            count -= len(rows)
        return np.concatenate(blocks)


def data_start(file: OpenFile, header: PlyHeader, size: int) -> int:
    """Return the offset of the vertices in a binary file; elements with lists that come before are read through.

    Raises
    ------
    BadInputError
        The file ends before the vertices.
    """
    path, at = file.path, header.data_at
    for element in header.before:
        if element.has_lists:
            with decoding(path, f"the element '{element.name}'"), file.open() as stream:
                stream.seek(at)
                rows = sum(1 for _ in _rows(stream, element, header.byte_order, size))
                refuse_count(path, element.count, rows, f"'{element.name}'")
                at = stream.tell()
        else:
            at += element.count * element.dtype(header.byte_order).itemsize
    return at


def _rows(stream: BinaryIO, element: PlyElement, byte_order: str, size: int) -> Iterator[tuple[Any, ...]]:
    """Yield the scalar values of each row, up to the end of the file; ``stream`` is left after the last row."""
    runs = _runs(element, byte_order)
    at = stream.tell()
    for _ in range(element.count):
        row: tuple[Any, ...] = ()
        for run, item_bytes in runs:
            data = stream.read(run.size)
            if len(data) < run.size:
                return
            values = run.unpack(data)
            at += run.size
            if item_bytes:
                length, values = values[-1], values[:-1]
                if length < 0:
                    raise ValueError(f"a list of {length} numbers")
                at += length * item_bytes
                if at > size:
                    return
                stream.seek(at)
            row += values
        yield row


def _runs(element: PlyElement, byte_order: str) -> list[tuple[Struct, int]]:
    """Split a row after each list length; return the parts with the item size of the list that follows (0: none)."""
    runs, letters = [], ""
    for prop in element.properties:
        if prop.length_code is None:
            letters += _STRUCT[prop.code]
        else:
            runs.append((Struct(f"{byte_order}{letters}{_STRUCT[prop.length_code]}"), np.dtype(prop.code).itemsize))
            letters = ""
    return [*runs, (Struct(f"{byte_order}{letters}"), 0)] if letters else runs
