"""The reader of PLY files: text, binary, and binary with lists, all read in chunks."""

import io
from functools import cached_property
from typing import Any

import numpy as np

from bumpymap.readers.checks import decoding, refuse_count
from bumpymap.readers.columns import read_rows
from bumpymap.readers.listed_rows import ListedRows, data_start
from bumpymap.readers.ply_header import PlyHeader, read_ply_header
from bumpymap.readers.point_table import PointTable, TableInfo, Wanted
from bumpymap.readers.serial_rows import SerialRows
from bumpymap.readers.source import Location, OpenFile
from bumpymap.readers.text_rows import TextRows

__all__ = ["PlyTable"]

_ENDIAN = {"<": "binary little endian", ">": "binary big endian", "=": "ascii"}


class PlyTable(PointTable):
    """A PLY file. Text is read as float64 whatever the header declares, since it may have more digits than a float32.

    Parameters
    ----------
    file : OpenFile
    wanted : dict of str to tuple of str
        See `Wanted`.
    """

    nan_is_no_return, searched = False, 1

    def __init__(self, file: OpenFile, wanted: Wanted) -> None:
        path, self._file = file.path, file
        with file.open() as stream:
            with decoding(path, "the header"):
                self._header = header = read_ply_header(stream, path)
            size = stream.seek(0, io.SEEK_END)
        self._dtype = header.vertex.dtype(header.byte_order)
        types = {name: self._dtype[name] for name in header.vertex.scalars}
        _refuse_size(header, path, size)
        type_names = " ".join(dict.fromkeys(types[name].name for name in header.columns))
        row_bytes = 8 * len(header.columns) if header.text else self._dtype.itemsize
        kind = f"PLY, {_ENDIAN[header.byte_order]}, {type_names}"
        super().__init__(path, TableInfo(kind, size, header.vertex.count, row_bytes, types, header.text))
        self._serial = self._serial_rows(wanted)

    @property
    def sequential(self) -> bool:
        """See ``PointTable.sequential``."""
        return self._serial is not None

    def rows(self, first: int, count: int) -> Any:
        """See ``PointTable.rows``."""
        if self._serial is not None:
            return self._serial.read(first, count)
        return read_rows(self._file, self._vertices_at, self._dtype, first, count)

    def close(self) -> None:
        """See ``PointTable.close``."""
        if self._serial is not None:
            self._serial.close()

    @cached_property
    def _vertices_at(self) -> int:
        return data_start(self._file, self._header, self.info.size)

    def _serial_rows(self, wanted: Wanted) -> SerialRows | None:
        """Return a sequential reader for text and for rows with lists; None if rows have a fixed size."""
        header = self._header
        if header.text:
            names = list(self.info.find(wanted).values())
            dtype = np.dtype([(name, np.float64) for name in names])
            places = [header.vertex.scalars.index(name) for name in names]
            return TextRows(self._file, header.data_at, header.lines_before, dtype, places, header.vertex.lists)
        if header.vertex.has_lists:
            return ListedRows(self._file, self._vertices_at, header.vertex, header.byte_order, self.info.size)
        return None


def _refuse_size(header: PlyHeader, path: Location, size: int) -> None:
    """Check the declared counts against the size of the file, before memory is allocated for them."""
    room = size - header.data_at
    for head in (*header.before, header.vertex):
        least = head.least_bytes(text=header.text)
        held = room // least
        if held < head.count:
            refuse_count(path, head.count, max(held, 0), "points" if head is header.vertex else f"'{head.name}'")
        room -= head.count * least
