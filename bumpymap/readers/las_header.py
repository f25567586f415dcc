"""What a LAS header promises, held against the size of the file before anything is allocated or decoded.

The decoders trust these numbers: four billion records are looped over, a chunk table of four billion entries ends the
process. Field offsets are those of LAS 1.4 R15, tables 3, 4 and 17; earlier versions share the first 227 bytes.
"""

import io
import struct
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from bumpymap.core import BadInputError
from bumpymap.readers.source import Location

__all__ = ["LasRecord", "RawHeader", "geokeys_of", "read_raw_header", "text_of"]

_HEADER_1_0, _HEADER_1_4 = 227, 375
_RECORD, _EXTENDED_RECORD = 54, 60
_NEEDED = {b"LASF_Projection", b"laszip encoded", b"copc"}
_LONGEST_RECORD = 1 << 20
"""Of those that are needed, bytes."""
_POINT_SIZES = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)
"""Bytes of a point of formats 0 to 10, without extra bytes."""
_AGAIN = "The file is damaged or truncated; copy or download it again"

Numbers = tuple[float, float, float]
"""One for x, one for y, one for z."""


@dataclass(frozen=True, slots=True)
class LasRecord:
    """A variable length record: who defined it, its number, its bytes."""

    user: bytes
    number: int
    data: bytes


@dataclass(frozen=True, slots=True)
class RawHeader:
    """The fields that bumpymap needs."""

    size: int
    """Bytes of the file."""
    version: str
    point_format: int
    compressed: bool
    point_size: int
    """Bytes of an uncompressed point."""
    point_count: int
    offset_to_points: int
    wkt_bit: bool
    is_copc: bool
    scales: Numbers
    offsets: Numbers
    """A coordinate is ``integer * scale + offset``, in the file's unit."""
    mins: Numbers
    maxs: Numbers
    """What the header says of the points' extent, in the file's unit."""
    records: tuple[LasRecord, ...]
    """Those of projection (extended ones too), of the LAZ decoder and of COPC."""

    @property
    def base_size(self) -> int:
        """Bytes of a point without extra bytes."""
        return _POINT_SIZES[self.point_format]

    def find(self, user: bytes, number: int) -> bytes | None:
        """Bytes of the first such record."""
        return next((r.data for r in self.records if r.user == user and r.number == number), None)


def read_raw_header(stream: BinaryIO, path: Location) -> RawHeader:
    """Read a header and refuse what cannot be.

    Raises
    ------
    BadInputError
        Truncated; an unknown version or point format; no points; more points or records than the file can hold.
    """
    size = stream.seek(0, io.SEEK_END)
    stream.seek(0)
    head = stream.read(_HEADER_1_4)
    if len(head) < _HEADER_1_0:
        raise BadInputError(f"{path} ends after {len(head)} bytes, inside the LAS header. {_AGAIN}")
    major, minor = head[24], head[25]
    if major != 1 or minor > 5 or (minor >= 4 and len(head) < _HEADER_1_4):
        raise BadInputError(
            f"{path} is LAS {major}.{minor} with {len(head)} header bytes; bumpymap reads LAS 1.0 to 1.5. {_AGAIN}"
        )
    (encoding,) = struct.unpack_from("<H", head, 6)
    header_size, offset, records, format_byte, point_size, count = struct.unpack_from("<HIIBHI", head, 94)
    first_extended, extended = 0, 0
    if minor >= 4:
        first_extended, extended, count = struct.unpack_from("<QIQ", head, 235)
    point_format = format_byte & 0x3F
    _refuse_format(path, point_format, point_size)
    if not _HEADER_1_0 <= header_size <= offset <= size:
        raise BadInputError(
            f"{path} says that its points start at byte {offset:,}, behind a header of {header_size:,} bytes, and is "
            f"{size:,} bytes long. {_AGAIN}"
        )
    if count == 0:
        raise BadInputError(f"{path} holds no points (its header declares 0): nothing to map. Was it exported fully?")
    compressed = bool(format_byte & 0xC0)
    if not compressed and (size - offset) // point_size < count:
        raise BadInputError(
            f"{path} declares {count:,} points of {point_size} bytes but can hold {(size - offset) // point_size:,}: "
            "truncated? Copy or download it again"
        )
    plain = _walk(stream, path, records, header_size, offset, extended=False)
    far = _walk(stream, path, extended, first_extended, size, extended=True) if extended else []
    scales, offsets, mins, maxs = _frame(head)
    return RawHeader(
        size, f"{major}.{minor}", point_format, compressed, point_size, count, offset,
        bool(encoding & 0x10), _is_copc(plain, header_size), scales, offsets, mins, maxs,
        tuple(record for record in plain + far if record.user in _NEEDED),
    )  # fmt: skip


def _frame(head: bytes) -> tuple[Numbers, Numbers, Numbers, Numbers]:
    """Scales, offsets, lowest and highest coordinates."""
    numbers = struct.unpack_from("<12d", head, 131)
    # The extent alternates: highest x, lowest x, highest y, ...
    return numbers[0:3], numbers[3:6], numbers[7::2], numbers[6::2]


def _is_copc(records: list[LasRecord], header_size: int) -> bool:
    """Whether the record of COPC is where it must be: first, right behind a header of LAS 1.4."""
    return header_size == _HEADER_1_4 and records[:1] != [] and (records[0].user, records[0].number) == (b"copc", 1)


def _refuse_format(path: Location, point_format: int, point_size: int) -> None:
    if point_format >= len(_POINT_SIZES):
        raise BadInputError(
            f"{path} holds points of format {point_format}; LAS defines 0 to 10, and bumpymap reads those. Write it "
            "again as LAS 1.4, such as with: pdal translate IN OUT.laz"
        )
    if point_size < _POINT_SIZES[point_format]:
        raise BadInputError(
            f"{path} gives a point {point_size} bytes, and format {point_format} needs {_POINT_SIZES[point_format]}. "
            f"{_AGAIN}"
        )


def _walk(stream: BinaryIO, path: Location, count: int, start: int, end: int, *, extended: bool) -> list[LasRecord]:
    """Read the records between two places; data of those that nobody here needs is skipped."""
    head_size = _EXTENDED_RECORD if extended else _RECORD
    found: list[LasRecord] = []
    for index in range(count):
        stream.seek(min(start, end))
        head = stream.read(head_size) if start + head_size <= end else b""
        length = struct.unpack_from("<Q" if extended else "<H", head, 20)[0] if head else 0
        if not head or start + head_size + length > end:
            raise BadInputError(
                f"{path} declares {count:,} {'extended ' if extended else ''}variable length records, and record "
                f"{index:,} does not fit in. {_AGAIN}"
            )
        user = head[2:18].split(b"\0")[0]
        needed = user in _NEEDED and length <= _LONGEST_RECORD
        found.append(LasRecord(user, struct.unpack_from("<H", head, 18)[0], stream.read(length) if needed else b""))
        start += head_size + length
    return found


def text_of(data: bytes | None) -> str:
    """Decode a text record: zero bytes end it."""
    return "" if data is None else data.split(b"\0")[0].decode("utf-8", "replace").strip()


def geokeys_of(data: bytes | None) -> dict[int, int] | None:
    """Read the GeoTIFF key directory (16-bit words, four a key); keeps the keys whose value stands in it."""
    if data is None or len(data) < 8:
        return None
    head, *entries = np.frombuffer(data[: len(data) // 8 * 8], dtype="<u2").reshape(-1, 4).tolist()
    return {key: value for key, place, _, value in entries[: head[3]] if place == 0 and key}
