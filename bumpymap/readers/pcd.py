"""PCD: text and binary are read piece by piece, compressed is unpacked whole by pypcd4. Scans, mostly."""

import io
import struct
from collections.abc import Sequence
from functools import cached_property
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from pypcd4 import Encoding, MetaData, PointCloud

from bumpymap.core import BadInputError, CrsStatement, georeference
from bumpymap.readers.base import Survey
from bumpymap.readers.batch import Watch, batch_of_points
from bumpymap.readers.checks import decoding, refuse_count
from bumpymap.readers.columns import CLASS_COLUMNS, metres, precision_note, read_rows
from bumpymap.readers.cut import cut_rows
from bumpymap.readers.protocol import CHUNK_POINTS, Chunk, ChunkPoints, ReadOptions, SurveyInfo
from bumpymap.readers.source import Location, open_source, place_of, size_of
from bumpymap.readers.text_rows import TextRows

__all__ = ["PcdSurvey"]

_LINE_LIMIT, _HEADER_LINES = 65_536, 200
_AT_REST = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
_DENSEST = 100
"""LZF packs 264 bytes into 3 at best."""
_MOST_VALUES = 10_000
"""No descriptor of a point is longer."""
_UNPACKED_COPIES, _PACKED_COPIES = 2, 3
"""How often a compressed file is held while it is unpacked."""
_LOOKED_AT = 100_000
"""Rows that are searched for a first point."""


class PcdSurvey(Survey):
    """One PCD file. Metres; a row with NaN is a beam without return, and does not count."""

    def __init__(self, path: Location, options: ReadOptions) -> None:
        self._path = path
        size = size_of(path)
        with decoding(path, "the header"), open_source(path) as stream:
            self._head = head = _read_header(stream, path)
            self._data_at = stream.tell()
            self._columns = _columns(head, path)
            _refuse_size(stream, path, head, size - self._data_at)
            _refuse_unpacking(stream, path, self._data_at, head, options.memory)
        names = {name.lower(): name for name in reversed(self._dtype.names or ())}
        self._class_column = next((names[name] for name in CLASS_COLUMNS if name in names), None)
        self._text = self._text_rows() if head.data is Encoding.ASCII else None
        first = self._first()
        place, notes = georeference(place_of(path, first), CrsStatement(), options.crs, options.z_unit)
        if head.data is not Encoding.ASCII:
            notes += precision_note(first, [self._dtype[name] for name in self._columns])
        if head.viewpoint != _AT_REST:
            notes += ("its header gives the pose of the sensor (VIEWPOINT), which is not applied",)
        kind = f"PCD {head.version}, {head.data.value}"
        has_classes = self._class_column is not None
        sequential = head.data is not Encoding.BINARY
        super().__init__(
            SurveyInfo(path, kind, size, head.points, place, None, has_classes, notes, sequential=sequential)
        )

    def chunks(self, points: int = CHUNK_POINTS) -> Sequence[Chunk]:
        """Cut anywhere."""
        return cut_rows(self._head.points, points, self._dtype.itemsize)

    def fetch(self, chunk: Chunk) -> Any:
        """Rows of a piece: a structured array with at least the columns that are needed."""
        return self._rows(chunk.first, chunk.points)

    def convert(self, chunk: Chunk, fetched: Any) -> ChunkPoints:
        """Points of a piece that count, in metres."""
        raw = metres(fetched, self._columns, self._class_column, self.info.georeference)
        return batch_of_points(raw, Watch(chunk.first, self.info.bounds, nan_is_no_return=True))

    @property
    def _dtype(self) -> np.dtype[np.void]:
        dtype: np.dtype[np.void] = self._head.build_dtype()
        return dtype

    def _rows(self, first: int, count: int) -> Any:
        if self._text is not None:
            return self._text.read(first, count)
        if self._head.data is Encoding.BINARY:
            return read_rows(self._path, self._data_at, self._dtype, first, count)
        return self._unpacked[first : first + count]

    @cached_property
    def _unpacked(self) -> NDArray[np.void]:
        """All rows; kept, since they are packed column by column."""
        with decoding(self._path, "the points"), open_source(self._path) as stream:
            stream.seek(self._data_at)
            # The header that was checked, not the one that another parser would find in the file.
            whole = io.BytesIO(self._head.compose_header().encode() + stream.read())
            rows: NDArray[np.void] = PointCloud.from_fileobj(whole).pc_data
            return rows

    def _text_rows(self) -> TextRows:
        names = list(self._dtype.names or ())
        wanted = [*self._columns, *([self._class_column] if self._class_column else [])]
        dtype = np.dtype([(name, self._dtype[name]) for name in wanted])
        return TextRows(self._path, self._data_at, 0, dtype, [names.index(name) for name in wanted])

    def _first(self) -> tuple[float, float, float] | None:
        """Give the first point that is one, looking at the first block alone."""
        rows = self._rows(0, min(_LOOKED_AT, self._head.points))
        if self._text is not None:
            self._text.close()
        with np.errstate(invalid="ignore"):  # NaN of any kind are beams without return
            table = np.column_stack([np.asarray(rows[name], dtype=np.float64) for name in self._columns])
        good = np.isfinite(table).all(axis=1)
        if not good.any():
            return None
        x, y, z = table[int(good.argmax())].tolist()
        return x, y, z


def _read_header(stream: BinaryIO, path: Location) -> Any:
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
    if sum(head.count) > _MOST_VALUES:
        raise BadInputError(
            f"the header of {path} gives a point {sum(head.count):,} values (COUNT); up to {_MOST_VALUES:,} are read. "
            "The file is damaged; export it again"
        )
    if head.points == 0:
        raise BadInputError(f"{path} holds no points (its header promises 0): nothing to map. Was it exported fully?")
    return head


def _columns(head: Any, path: Location) -> tuple[str, str, str]:
    dtype = head.build_dtype()
    names = {name.lower(): name for name in reversed(dtype.names)}
    missing = [axis for axis in "xyz" if axis not in names]
    if missing:
        raise BadInputError(
            f"the points of {path} have no {', '.join(missing)}; they have {', '.join(head.fields)}. bumpymap needs "
            "the fields x, y and z"
        )
    return names["x"], names["y"], names["z"]


def _refuse_size(stream: BinaryIO, path: Location, head: Any, room: int) -> None:
    """Hold the promised count against the bytes that are there, before anything is reserved for it."""
    row = head.build_dtype().itemsize
    if head.data is Encoding.ASCII:
        refuse_count(path, head.points, (room + 1) // (2 * sum(head.count)))
    elif head.data is Encoding.BINARY:
        refuse_count(path, head.points, room // row)
    else:
        packed, unpacked = struct.unpack("<II", stream.read(8)) if room >= 8 else (0, 0)
        refuse_count(path, packed, max(room - 8, 0), "bytes of packed points")
        refuse_count(path, unpacked, _DENSEST * packed, "bytes of unpacked points")
        refuse_count(path, head.points, unpacked // row)
        if unpacked != head.points * row:
            raise BadInputError(
                f"{path} promises {unpacked:,} bytes of unpacked points, and {head.points:,} points of {row} bytes. "
                "The file is damaged: copy or download it again"
            )


def _refuse_unpacking(stream: BinaryIO, path: Location, data_at: int, head: Any, memory: int) -> None:
    """Refuse a compressed file that memory cannot hold unpacked, before anything is unpacked."""
    if head.data is not Encoding.BINARY_COMPRESSED:
        return
    stream.seek(data_at)
    packed, unpacked = struct.unpack("<II", stream.read(8))
    wanted = _UNPACKED_COPIES * unpacked + _PACKED_COPIES * packed
    if wanted > memory:
        raise BadInputError(
            f"{path} is compressed, so it must be unpacked whole, which takes {wanted / 1e6:,.0f} MB; "
            f"{memory / 1e6:,.0f} MB are given. Write it uncompressed (DATA binary), which is read in pieces: "
            "pcl_convert_pcd_ascii_binary IN.pcd OUT.pcd 1; or raise --memory"
        )
