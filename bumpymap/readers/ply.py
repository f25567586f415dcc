"""PLY: binary is memory-mapped, text is read in blocks of lines, rows of changing length are left to plyfile."""

import io
import warnings
from collections import deque
from collections.abc import Iterator
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray
from plyfile import PlyData

from bumpymap.crs import CrsStatement, Place, georeference
from bumpymap.readers.base import Survey
from bumpymap.readers.checks import RawPoints, decoding, refuse_count
from bumpymap.readers.columns import metres, precision_note
from bumpymap.readers.ply_header import PlyHeader, read_ply_header
from bumpymap.readers.protocol import ReadOptions, SurveyInfo

__all__ = ["PlySurvey"]

_ENDIAN = {"<": "binary little endian", ">": "binary big endian", "=": "ascii"}


class PlySurvey(Survey):
    """One PLY file. Its format knows neither CRS nor units: metres, unless ``--crs`` says otherwise.

    Text is read as float64 whatever the header declares, since its digits may hold more than a float.
    """

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self._path = path
        with decoding(path, "the header"):
            self._header = header = read_ply_header(path)
            size = path.stat().st_size
        self._refuse_size(size)
        first = self._first()
        place, notes = georeference(Place(path, first), CrsStatement(), options.crs, options.z_unit)
        types = [header.vertex.element.ply_property(name).val_dtype for name in header.columns]
        if not header.text:
            notes += precision_note(first, types)
        kind = f"PLY, {_ENDIAN[header.byte_order]}, {' '.join(dict.fromkeys(np.dtype(t).name for t in types))}"
        has_classes = header.class_column is not None
        super().__init__(SurveyInfo(path, kind, size, header.vertex.count, place, None, has_classes, notes))

    def raw(self, points: int) -> Iterator[RawPoints]:
        """Give every point, at most ``points`` at a time."""
        for rows in self._rows(points):
            yield metres(rows, self._header.columns, self._header.class_column, self.info.georeference)

    def _rows(self, points: int) -> Iterator[Any]:
        """Blocks of vertices: structured arrays with at least the columns that are needed."""
        header, path = self._header, self._path
        if header.vertex.has_lists or (not header.text and any(head.has_lists for head in header.before)):
            rows = self._listed
            for start in range(0, len(rows), points):
                yield rows[start : start + points]
        elif header.text:
            yield from _text_blocks(path, header, points)
        else:
            with decoding(path, "the vertices"):
                rows = _map(path, header)
            for start in range(0, len(rows), points):
                yield rows[start : start + points]

    @cached_property
    def _listed(self) -> NDArray[np.void]:
        """All vertices, where rows differ in length; kept, since plyfile takes them one by one."""
        with decoding(self._path, "the vertices"):
            return _read_with_plyfile(self._path, self._header)

    def _first(self) -> tuple[float, float, float] | None:
        rows = next(self._rows(1), None)
        if rows is None or len(rows) == 0:
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


def _map(path: Path, header: PlyHeader) -> NDArray[np.void]:
    skipped = sum(head.count * head.element.dtype(header.byte_order).itemsize for head in header.before)
    dtype = header.vertex.element.dtype(header.byte_order)
    return np.memmap(path, dtype=dtype, mode="r", offset=header.data_at + skipped, shape=(header.vertex.count,))


def _read_with_plyfile(path: Path, header: PlyHeader) -> NDArray[np.void]:
    """Read rows of changing length; the elements behind the vertices are not looked at."""
    with path.open("rb") as stream:
        stream.seek(header.data_at)
        data = io.BytesIO(b"\n".join(header.lines) + b"\n" + stream.read())
    with warnings.catch_warnings():
        # plyfile has an empty list of a text file warned about.
        warnings.simplefilter("ignore", UserWarning)
        rows: NDArray[np.void] = PlyData.read(data, mmap=False)[header.vertex.name].data
    return rows


def _text_blocks(path: Path, header: PlyHeader, points: int) -> Iterator[NDArray[np.void]]:
    names = [prop.name for prop in header.vertex.element.properties]
    wanted = [*header.columns, *([header.class_column] if header.class_column else [])]
    dtype = np.dtype([(name, np.float64) for name in wanted])
    with path.open("rb") as binary:
        binary.seek(header.data_at)
        stream = io.TextIOWrapper(binary, "ascii", errors="replace")
        skipped = sum(head.count for head in header.before)
        deque(islice(stream, skipped), maxlen=0)
        left = header.vertex.count
        while left > 0:
            with decoding(path, f"the vertices from {header.vertex.count - left:,} on"):
                block = _load(stream, min(points, left), dtype, [names.index(name) for name in wanted])
            if len(block) == 0:
                return
            left -= len(block)
            yield block


def _load(stream: TextIO, count: int, dtype: np.dtype[np.void], columns: list[int]) -> NDArray[np.void]:
    with warnings.catch_warnings():
        # "no data": the count of points tells, at the end.
        warnings.simplefilter("ignore", UserWarning)
        return np.loadtxt(stream, dtype=dtype, comments=None, usecols=columns, max_rows=count, ndmin=1)
