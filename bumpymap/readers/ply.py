"""PLY: text, binary, and rows with lists, all read piece by piece."""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from bumpymap.core import CrsStatement, georeference
from bumpymap.readers.base import Survey
from bumpymap.readers.batch import Watch, batch_of_points
from bumpymap.readers.checks import decoding, refuse_count
from bumpymap.readers.columns import metres, precision_note, read_rows
from bumpymap.readers.cut import cut_rows
from bumpymap.readers.listed_rows import ListedRows, data_start
from bumpymap.readers.ply_header import PlyHeader, read_ply_header
from bumpymap.readers.protocol import CHUNK_POINTS, Chunk, ChunkPoints, ReadOptions, SurveyInfo
from bumpymap.readers.serial_rows import SerialRows
from bumpymap.readers.source import Location, place_of, size_of
from bumpymap.readers.text_rows import TextRows

__all__ = ["PlySurvey"]

_ENDIAN = {"<": "binary little endian", ">": "binary big endian", "=": "ascii"}


class PlySurvey(Survey):
    """One PLY file. Its format knows neither CRS nor units: metres, unless ``--crs`` says otherwise.

    Text is read as float64 whatever the header declares, since its digits may hold more than a float.
    """

    def __init__(self, path: Location, options: ReadOptions) -> None:
        self._path = path
        with decoding(path, "the header"):
            self._header = header = read_ply_header(path)
        size = size_of(path)
        self._refuse_size(size)
        self._serial = _serial_rows(path, header)
        first = self._first()
        place, notes = georeference(place_of(path, first), CrsStatement(), options.crs, options.z_unit)
        codes = {prop.name: prop.code for prop in header.vertex.properties}
        types = [codes[name] for name in header.columns]
        if not header.text:
            notes += precision_note(first, types)
        kind = f"PLY, {_ENDIAN[header.byte_order]}, {' '.join(dict.fromkeys(np.dtype(t).name for t in types))}"
        has_classes = header.class_column is not None
        sequential = self._serial is not None
        super().__init__(
            SurveyInfo(path, kind, size, header.vertex.count, place, None, has_classes, notes, sequential=sequential)
        )

    def chunks(self, points: int = CHUNK_POINTS) -> Sequence[Chunk]:
        """Cut anywhere."""
        vertex = self._header.vertex
        row_bytes = 8 * len(self._header.columns) if self._header.text else self._dtype.itemsize
        return cut_rows(vertex.count, points, row_bytes)

    def fetch(self, chunk: Chunk) -> Any:
        """Rows of a piece: a structured array with at least the columns that are needed."""
        return self._rows(chunk.first, chunk.points)

    def convert(self, chunk: Chunk, fetched: Any) -> ChunkPoints:
        """Points of a piece that count, in metres."""
        raw = metres(fetched, self._header.columns, self._header.class_column, self.info.georeference)
        return batch_of_points(raw, Watch(chunk.first, self.info.bounds))

    def _rows(self, first: int, count: int) -> Any:
        if self._serial is not None:
            return self._serial.read(first, count)
        return read_rows(self._path, self._vertices_at, self._dtype, first, count)

    @property
    def _dtype(self) -> np.dtype[np.void]:
        return self._header.vertex.dtype(self._header.byte_order)

    @cached_property
    def _vertices_at(self) -> int:
        return data_start(self._path, self._header)

    def _first(self) -> tuple[float, float, float] | None:
        rows = self._rows(0, 1)
        if self._serial is not None:
            self._serial.close()
        if len(rows) == 0:
            return None
        x, y, z = (float(rows[name][0]) for name in self._header.columns)
        return (x, y, z) if np.isfinite([x, y, z]).all() else None

    def _refuse_size(self, size: int) -> None:
        """Hold the promised counts against the bytes that are there, before anything is reserved for them."""
        header = self._header
        room = size - header.data_at
        for head in (*header.before, header.vertex):
            least = head.least_bytes(text=header.text)
            held = room // least
            if held < head.count:
                refuse_count(
                    self._path, head.count, max(held, 0), "points" if head is header.vertex else f"'{head.name}'"
                )
            room -= head.count * least


def _serial_rows(path: Location, header: PlyHeader) -> SerialRows | None:
    """Rows that can be read in order alone: text, and those with lists; None where each has its place."""
    if header.text:
        names = header.vertex.scalars
        wanted = [*header.columns, *([header.class_column] if header.class_column else [])]
        dtype = np.dtype([(name, np.float64) for name in wanted])
        places = [names.index(name) for name in wanted]
        return TextRows(path, header.data_at, header.lines_before, dtype, places, header.vertex.lists)
    if header.vertex.has_lists:
        return ListedRows(path, data_start(path, header), header.vertex, header.byte_order)
    return None
