"""PLY: binary and text are read piece by piece, rows of changing length are left to plyfile."""

import io
import warnings
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from plyfile import PlyData

from bumpymap.crs import CrsStatement, georeference
from bumpymap.readers.base import Survey
from bumpymap.readers.batch import Watch, batch_of_points
from bumpymap.readers.checks import decoding, refuse_count
from bumpymap.readers.columns import metres, precision_note, read_rows
from bumpymap.readers.cut import cut_rows
from bumpymap.readers.ply_header import PlyHeader, read_ply_header
from bumpymap.readers.protocol import PIECE_POINTS, Batch, Piece, ReadOptions, SurveyInfo
from bumpymap.readers.source import Location, open_source, place_of, size_of
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
        self._text = _text_rows(path, header) if header.text and not header.vertex.has_lists else None
        first = self._first()
        place, notes = georeference(place_of(path, first), CrsStatement(), options.crs, options.z_unit)
        types = [header.vertex.element.ply_property(name).val_dtype for name in header.columns]
        if not header.text:
            notes += precision_note(first, types)
        kind = f"PLY, {_ENDIAN[header.byte_order]}, {' '.join(dict.fromkeys(np.dtype(t).name for t in types))}"
        has_classes = header.class_column is not None
        super().__init__(SurveyInfo(path, kind, size, header.vertex.count, place, None, has_classes, notes))

    def pieces(self, points: int = PIECE_POINTS) -> Sequence[Piece]:
        """Cut anywhere."""
        vertex = self._header.vertex
        row_bytes = 8 * len(self._header.columns) if self._header.text or vertex.has_lists else self._dtype.itemsize
        return cut_rows(vertex.count, points, row_bytes)

    def fetch(self, piece: Piece) -> Any:
        """Rows of a piece: a structured array with at least the columns that are needed."""
        return self._rows(piece.first, piece.points)

    def convert(self, piece: Piece, fetched: Any) -> Batch:
        """Points of a piece that count, in metres."""
        raw = metres(fetched, self._header.columns, self._header.class_column, self.info.georeference)
        return batch_of_points(raw, Watch(piece.first, self.info.bounds))

    def _rows(self, first: int, count: int) -> Any:
        header = self._header
        if self._text is not None:
            return self._text.read(first, count)
        if header.vertex.has_lists or any(head.has_lists for head in header.before):
            return self._listed[first : first + count]
        skipped = sum(head.count * head.element.dtype(header.byte_order).itemsize for head in header.before)
        return read_rows(self._path, header.data_at + skipped, self._dtype, first, count)

    @property
    def _dtype(self) -> np.dtype[np.void]:
        dtype: np.dtype[np.void] = self._header.vertex.element.dtype(self._header.byte_order)
        return dtype

    @cached_property
    def _listed(self) -> NDArray[np.void]:
        """All vertices, where rows differ in length; kept, since plyfile takes them one by one."""
        with decoding(self._path, "the vertices"):
            return _read_with_plyfile(self._path, self._header)

    def _first(self) -> tuple[float, float, float] | None:
        rows = self._rows(0, 1)
        if self._text is not None:
            self._text.close()
        if len(rows) == 0:
            return None
        x, y, z = (float(rows[name][0]) for name in self._header.columns)
        return (x, y, z) if np.isfinite([x, y, z]).all() else None

    def _refuse_size(self, size: int) -> None:
        """Hold the promised counts against the bytes that are there, before anything is reserved for them."""
        header = self._header
        room = size - header.data_at
        for head in (*header.before, header.vertex):
            least = _least_bytes(header, head.element)
            held = room // least
            if held < head.count:
                refuse_count(
                    self._path, head.count, max(held, 0), "points" if head is header.vertex else f"'{head.name}'"
                )
            room -= head.count * least


def _least_bytes(header: PlyHeader, element: Any) -> int:
    """Bytes that one row takes at least."""
    properties = element.properties
    if header.text:
        return max(2 * len(properties) - 1, 1)
    # A list takes at least the word that says how long it is.
    words = [getattr(prop, "len_dtype", prop.val_dtype) for prop in properties]
    return max(sum(int(np.dtype(word).itemsize) for word in words), 1)


def _read_with_plyfile(path: Location, header: PlyHeader) -> NDArray[np.void]:
    """Read rows of changing length; the elements behind the vertices are not looked at."""
    with open_source(path) as stream:
        stream.seek(header.data_at)
        data = io.BytesIO(b"\n".join(header.lines) + b"\n" + stream.read())
    with warnings.catch_warnings():
        # plyfile has an empty list of a text file warned about.
        warnings.simplefilter("ignore", UserWarning)
        rows: NDArray[np.void] = PlyData.read(data, mmap=False)[header.vertex.name].data
    return rows


def _text_rows(path: Location, header: PlyHeader) -> TextRows:
    names = [prop.name for prop in header.vertex.element.properties]
    wanted = [*header.columns, *([header.class_column] if header.class_column else [])]
    dtype = np.dtype([(name, np.float64) for name in wanted])
    skipped = sum(head.count for head in header.before)
    return TextRows(path, header.data_at, skipped, dtype, [names.index(name) for name in wanted])
