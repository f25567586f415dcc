"""PCD: text, binary (memory-mapped) and compressed; pypcd4 reads the header and unpacks. Scans, mostly."""

import struct
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from pypcd4 import Encoding, MetaData, PointCloud

from bumpymap.crs import CrsStatement, Place, georeference
from bumpymap.errors import BadInputError
from bumpymap.readers.base import Survey
from bumpymap.readers.checks import RawPoints, decoding, refuse_count
from bumpymap.readers.columns import CLASS_COLUMNS, metres, precision_note
from bumpymap.readers.protocol import ReadOptions, SurveyInfo

__all__ = ["PcdSurvey"]

_LINE_LIMIT, _HEADER_LINES = 65_536, 200
_AT_REST = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


class PcdSurvey(Survey):
    """One PCD file. Metres; a row with NaN is a beam without return, and does not count."""

    nan_is_no_return = True

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self._path = path
        with decoding(path, "the header"), path.open("rb") as stream:
            self._head = head = _read_header(stream, path)
            self._data_at = stream.tell()
            size = path.stat().st_size
            self._columns = _columns(head, path)
            _refuse_size(stream, path, head, size - self._data_at)
        names = {name.lower(): name for name in reversed(self._dtype.names or ())}
        self._class_column = next((names[name] for name in CLASS_COLUMNS if name in names), None)
        first = self._first()
        place, notes = georeference(Place(path, first), CrsStatement(), options.crs, options.z_unit)
        if head.data is not Encoding.ASCII:
            notes += precision_note(first, [self._dtype[name] for name in self._columns])
        if head.viewpoint != _AT_REST:
            notes += ("its header gives the pose of the sensor (VIEWPOINT), which is not applied",)
        kind = f"PCD {head.version}, {head.data.value}"
        has_classes = self._class_column is not None
        super().__init__(SurveyInfo(path, kind, size, head.points, place, None, has_classes, notes))

    def raw(self, points: int) -> Iterator[RawPoints]:
        """Give every point, at most ``points`` at a time."""
        rows = self._rows
        for start in range(0, len(rows), points):
            yield metres(rows[start : start + points], self._columns, self._class_column, self.info.georeference)

    @property
    def _dtype(self) -> np.dtype[np.void]:
        dtype: np.dtype[np.void] = self._head.build_dtype()
        return dtype

    @cached_property
    def _rows(self) -> NDArray[np.void]:
        """All rows; only binary ones stay on disk."""
        with decoding(self._path, "the points"):
            if self._head.data is Encoding.BINARY:
                shape = (self._head.points,)
                return np.memmap(self._path, dtype=self._dtype, mode="r", offset=self._data_at, shape=shape)
            if self._head.data is Encoding.ASCII:
                with self._path.open("rb") as stream:
                    stream.seek(self._data_at)
                    return np.loadtxt(stream, dtype=self._dtype, comments=None, ndmin=1, max_rows=self._head.points)
            rows: NDArray[np.void] = PointCloud.from_path(self._path).pc_data
            return rows

    def _first(self) -> tuple[float, float, float] | None:
        """Give the first point that is one, looking at the first block alone."""
        rows = self._rows[:100_000]
        table = np.column_stack([np.asarray(rows[name], dtype=np.float64) for name in self._columns])
        good = np.isfinite(table).all(axis=1)
        if not good.any():
            return None
        x, y, z = table[int(good.argmax())].tolist()
        return x, y, z


def _read_header(stream: BinaryIO, path: Path) -> Any:
    lines: list[str] = []
    for _ in range(_HEADER_LINES):
        line = stream.readline(_LINE_LIMIT).decode("utf-8", "replace").strip()
        lines.append(line)
        if line.startswith("DATA"):
            break
    else:
        raise BadInputError(f"the header of {path} has no line DATA: truncated? Copy or download it again")
    if not any(line.startswith("COUNT") for line in lines):
        # The line may be left out: one value a field.
        fields = next((len(line.split()) - 1 for line in lines if line.startswith("FIELDS")), 0)
        lines.insert(-1, "COUNT " + " ".join(["1"] * fields))
    head = MetaData.parse_header(lines)
    if not len(head.fields) == len(head.size) == len(head.type) == len(head.count):
        raise BadInputError(f"the header of {path} has FIELDS, SIZE, TYPE and COUNT of different length")
    if head.points == 0:
        raise BadInputError(f"{path} holds no points (its header promises 0): nothing to map. Was it exported fully?")
    return head


def _columns(head: Any, path: Path) -> tuple[str, str, str]:
    dtype = head.build_dtype()
    names = {name.lower(): name for name in reversed(dtype.names)}
    missing = [axis for axis in "xyz" if axis not in names]
    if missing:
        raise BadInputError(
            f"the points of {path} have no {', '.join(missing)}; they have {', '.join(head.fields)}. bumpymap needs "
            "the fields x, y and z"
        )
    return names["x"], names["y"], names["z"]


def _refuse_size(stream: BinaryIO, path: Path, head: Any, room: int) -> None:
    """Hold the promised count against the bytes that are there, before anything is reserved for it."""
    row = head.build_dtype().itemsize
    if head.data is Encoding.ASCII:
        refuse_count(path, head.points, (room + 1) // (2 * sum(head.count)))
    elif head.data is Encoding.BINARY:
        refuse_count(path, head.points, room // row)
    else:
        packed, unpacked = struct.unpack("<II", stream.read(8)) if room >= 8 else (0, 0)
        refuse_count(path, packed, max(room - 8, 0), "bytes of packed points")
        refuse_count(path, head.points, unpacked // row)
