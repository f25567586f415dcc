"""The reader of PCD files. Text and binary are read in chunks; compressed files are unpacked as a whole by pypcd4."""

import io
import struct
from functools import cached_property
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from pypcd4 import Encoding, MetaData, PointCloud

from bumpymap.core import BadInputError
from bumpymap.readers.point_table import PointTable, TableInfo, Wanted, refuse_missing_axes
from bumpymap.readers.source import Location, decoding, open_source, refuse_count, refuse_points

_LINE_LIMIT, _HEADER_LINES = 65_536, 200
"""Bytes of a line and lines of a header at most. Chosen: several times those of any program's files."""
_NO_POSE = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
"""Translation [m] and quaternion (w, x, y, z) of a VIEWPOINT that says nothing."""
_DENSEST = 100
"""Compression ratio at most: LZF packs 264 bytes into 3 at best."""
_PLAUSIBLE, _SMALL = 20, 1 << 28
"""Compression ratio of clouds at most (two to four are usual), and the unpacked bytes up to which more is accepted."""
_MOST_VALUES = 10_000
"""Values of a point at most; no point descriptor is longer."""
_UNPACKED_COPIES, _PACKED_COPIES = 2, 3
"""Number of copies of the unpacked and packed bytes in memory while a compressed file is unpacked."""


class PcdTable(PointTable):
    """A PCD file, in metres. A row with NaN is a beam without return, and is dropped.

    ``wanted``: see `Wanted`; ``memory``: memory limit for unpacking, bytes; ``text_type``: type of
    the numbers of a text file; None: as declared in the header.
    """

    nan_is_no_return, searched = True, 100_000

    def __init__(
        self, path: Location, wanted: Wanted, memory: int, text_type: type[np.float64] | None = None
    ) -> None:  # fmt: skip
        with decoding(path, "the header"), open_source(path) as stream:
            size = stream.seek(0, io.SEEK_END)
            stream.seek(0)
            self._head = head = _read_header(stream, path)
            data_at = stream.tell()
            row: np.dtype[np.void] = head.build_dtype()
            refuse_missing_axes(path, row.names or ())
            _refuse_size(stream, path, head, size - data_at, memory)
        is_text = head.data is Encoding.ASCII
        pose_note = ("its header gives the pose of the sensor (VIEWPOINT), which is not applied",)
        notes = pose_note if head.viewpoint != _NO_POSE else ()
        kind = f"PCD {head.version}, {head.data.value}"
        info = TableInfo(kind, size, head.points, row, row.itemsize, is_text, notes)
        super().__init__(path, info, data_at, wanted, text_type=text_type)

    @property
    def sequential(self) -> bool:
        """See ``PointTable.sequential``."""
        return self._head.data is not Encoding.BINARY

    def rows(self, first: int, count: int) -> Any:
        """See ``PointTable.rows``."""
        if self._head.data in {Encoding.ASCII, Encoding.BINARY}:
            return super().rows(first, count)
        return self._unpacked[first : first + count]

    @cached_property
    def _unpacked(self) -> NDArray[np.void]:
        """All rows; cached, since they are compressed column by column."""
        with decoding(self.path, "the points"), open_source(self.path) as stream:
            stream.seek(self._data_at)
            # Pass the header that was checked, not that of the file, which pypcd4 might parse differently.
            whole = io.BytesIO(self._head.compose_header().encode() + stream.read())
            rows: NDArray[np.void] = PointCloud.from_fileobj(whole).pc_data
            return rows


def _read_header(stream: BinaryIO, path: Location) -> Any:
    lines: list[str] = []
    for _ in range(_HEADER_LINES):
        line = stream.readline(_LINE_LIMIT).decode("utf-8", "replace").strip()
        lines.append(line)
        if line.startswith("DATA"):
            break
    else:
        raise BadInputError(f"the header of {path} has no DATA line: truncated? Copy or download it again")
    if not any(line.startswith("COUNT") for line in lines):
        # The line is optional: one value for each field.
        fields = next((len(line.split()) - 1 for line in lines if line.startswith("FIELDS")), 0)
        lines.insert(-1, "COUNT " + " ".join(["1"] * fields))
    head = MetaData.parse_header(lines)
    if not len(head.fields) == len(head.size) == len(head.type) == len(head.count):
        raise BadInputError(f"the header of {path} has FIELDS, SIZE, TYPE and COUNT of different length")
    if sum(head.count) > _MOST_VALUES:
        raise BadInputError(
            f"the header of {path} declares {sum(head.count):,} values per point (COUNT); at most {_MOST_VALUES:,} are "
            "read. The file is damaged; export it again"
        )
    return head


def _refuse_size(stream: BinaryIO, path: Location, head: Any, room: int, memory: int) -> None:
    """Check the declared point count against the size of the file and the memory, before any is allocated for it."""
    row = head.build_dtype().itemsize
    if head.data is Encoding.ASCII:
        refuse_points(path, head.points, (room + 1) // (2 * sum(head.count)))
    elif head.data is Encoding.BINARY:
        refuse_points(path, head.points, room // row)
    else:
        packed, unpacked = struct.unpack("<II", stream.read(8)) if room >= 8 else (0, 0)
        refuse_count(path, packed, max(room - 8, 0), "bytes of packed points")
        refuse_count(path, unpacked, _DENSEST * packed, "bytes of unpacked points")
        refuse_points(path, head.points, unpacked // row)
        if unpacked != head.points * row:
            raise BadInputError(
                f"{path} declares {unpacked:,} bytes of unpacked points, and {head.points:,} points of {row} bytes. "
                "The file is damaged: copy or download it again"
            )
        needed = _UNPACKED_COPIES * unpacked + _PACKED_COPIES * packed
        remedy = (
            "Write it uncompressed (DATA binary), which is read in chunks: pcl_convert_pcd_ascii_binary IN.pcd OUT.pcd "
            "1"
        )
        if needed > memory:
            raise BadInputError(
                f"{path} is compressed, so it must be unpacked as a whole, which needs {needed / 1e6:,.0f} MB; "
                f"{memory / 1e6:,.0f} MB are available. {remedy}; or raise `memory`"
            )
        if unpacked > max(_SMALL, _PLAUSIBLE * packed):
            raise BadInputError(
                f"{path} would unpack to {unpacked / 1e6:,.0f} MB, {unpacked / packed:,.0f} times its size, which no "
                f"cloud of different points does: it may be damaged, or made to fill the memory. {remedy}"
            )
