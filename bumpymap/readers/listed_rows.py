"""Rows of a binary PLY element with lists.

A list takes as many bytes as the number before it says, so where a row starts is known once all rows before it were
walked. The numbers in a list are passed over, and never held: a list may claim to be as long as it likes.
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
"""Rows that are Python numbers at a time."""


@dataclass(slots=True)
class ListedRows(SerialRows):
    """Columns of an element that are no lists."""

    element: PlyElement
    byte_order: str
    size: int
    """Bytes of the file."""
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
    """Find the byte where the vertices of a binary file start: elements with lists before them are walked.

    Raises
    ------
    BadInputError
        The file ends before.
    """
    path, at = file.path, header.data_at
    for element in header.before:
        if element.has_lists:
            with decoding(path, f"the element '{element.name}'"), file.open() as stream:
                stream.seek(at)
                walked = sum(1 for _ in _rows(stream, element, header.byte_order, size))
                refuse_count(path, element.count, walked, f"'{element.name}'")
                at = stream.tell()
        else:
            at += element.count * element.dtype(header.byte_order).itemsize
    return at


def _rows(stream: BinaryIO, element: PlyElement, byte_order: str, size: int) -> Iterator[tuple[Any, ...]]:
    """Walk the rows, leaving ``stream`` behind the last one; numbers that are in no list. Ends where the file ends."""
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
    """Cut a row behind each number that says how long a list is; with it, the bytes of an entry of the list."""
    runs, letters = [], ""
    for prop in element.properties:
        if prop.length_code is None:
            letters += _STRUCT[prop.code]
        else:
            runs.append((Struct(f"{byte_order}{letters}{_STRUCT[prop.length_code]}"), np.dtype(prop.code).itemsize))
            letters = ""
    return [*runs, (Struct(f"{byte_order}{letters}"), 0)] if letters else runs
