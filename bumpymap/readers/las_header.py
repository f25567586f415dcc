"""Read a LAS header and its variable length records, and check them against the size of the file.

The checks come before anything is allocated or decoded. Offsets are those of LAS 1.4 R15, tables 3, 4 and 17; earlier
versions share the first 227 bytes. laspy is not used: it loops over as many records as a header declares (up to four
billion), and keeps the bytes of all of them.
"""

import io
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import date, timedelta
from typing import BinaryIO

import numpy as np
from pyproj import CRS

from bumpymap.core import (
    BadInputError,
    CrsStatement,
    crs_from_epsg,
    describe_crs,
    horizontal_of,
    linear_unit,
    same_crs,
    statement_from_wkt,
    vertical_of,
    with_vertical,
)
from bumpymap.readers.source import Location, refuse_points

_HEADER_1_0, _HEADER_1_4 = 227, 375
"""Bytes of a header of LAS 1.0 to 1.2, and of one of LAS 1.4 (the specifications)."""
_FIELDS = struct.Struct("<4xHH16xBB64xHHHIIBHI")
"""File source id, encoding; version; creation day and year; header size, offset to the points, number of records; point
format, point size, point count."""
_FIELDS_1_4 = struct.Struct("<QIQ")
"""Offset to the extended records, their number; point count."""
_RECORD, _EXTENDED_RECORD = struct.Struct("<2x16sHH32x"), struct.Struct("<2x16sHQ32x")
_NEEDED = {b"LASF_Projection", b"laszip encoded"}
_CLASS_LOOKUP = (b"LASF_Spec", 0)
_CLASS_NAME = struct.Struct("<B15s")
"""Entries of the lookup of classes: class, name."""
_LONGEST_RECORD = 1 << 20
"""Limit for the records that are needed, bytes."""
_POINT_SIZES = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)
"""Point size of formats 0 to 10, without extra bytes."""
_WAVEFORMS = {4, 5, 9, 10}
"""Point formats whose waveforms may stand behind the points."""
LAYERED = 6
"""First point format that LAZ compresses in layers."""
_YEARS = range(1900, 2200)
"""Years that a creation date may have; writers that know none leave 0, or count from 1900."""
_AGAIN = "The file is damaged or truncated; copy or download it again"

Numbers = tuple[float, float, float]
"""Values for x, y and z, in the file's unit."""


@dataclass(frozen=True, slots=True)
class RawHeader:
    """The header fields that bumpymap needs."""

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
    """A coordinate is ``integer * scale + offset``."""
    mins: Numbers
    maxs: Numbers
    """Extent of the points as declared in the header."""
    records: dict[tuple[bytes, int], bytes]
    """By user id and record id: those of the projection (extended ones too), of LASzip, of COPC, and class names."""
    source_id: int = 0
    """The flight line of the file, if it holds one; 0: none is given."""
    surplus: int = 0
    """Whole points behind those that are declared, in a LAS file in which nothing else stands there."""
    created: date | None = None
    """Creation day: that of the flight in LAS 1.0, of the file in later versions; None if none or no valid one is
    given."""

    @property
    def extra_bytes(self) -> int:
        """Bytes of a point beyond those of its format."""
        return self.point_size - _POINT_SIZES[self.point_format]

    @property
    def class_names(self) -> dict[int, str]:
        """Names of classes that the file gives; what is no text is left out."""
        data = self.records.get(_CLASS_LOOKUP, b"")
        entries = _CLASS_NAME.iter_unpack(data[: len(data) // _CLASS_NAME.size * _CLASS_NAME.size])
        names = {code: text.split(b"\0")[0].decode("ascii", "replace").strip() for code, text in entries}
        return {code: name for code, name in names.items() if name.isprintable() and name}


def read_raw_header(stream: BinaryIO, path: Location) -> RawHeader:
    """Read a header; raise BadInputError if it is truncated, unknown, or declares more than the file can hold."""
    size = stream.seek(0, io.SEEK_END)
    stream.seek(0)
    head = stream.read(_HEADER_1_4)
    if len(head) < _HEADER_1_0:
        raise BadInputError(f"{path} ends after {len(head)} bytes, inside the LAS header. {_AGAIN}")
    source_id, encoding, major, minor, day, year, header_size, offset, records, kind, point_size, count = (
        _FIELDS.unpack_from(head)
    )
    if major != 1 or minor > 5 or (minor >= 4 and len(head) < _HEADER_1_4):
        raise BadInputError(
            f"{path} is LAS {major}.{minor} with {len(head)} header bytes; bumpymap reads LAS 1.0 to 1.5. {_AGAIN}"
        )
    first_extended, extended = 0, 0
    if minor >= 4:
        first_extended, extended, count = _FIELDS_1_4.unpack_from(head, 235)
    point_format, compressed = kind & 0x3F, bool(kind & 0xC0)
    _refuse_format(path, point_format, point_size)
    if not _HEADER_1_0 <= header_size <= offset <= size:
        raise BadInputError(
            f"{path} says that its points start at byte {offset:,}, after a header of {header_size:,} bytes, and is "
            f"{size:,} bytes long. {_AGAIN}"
        )
    held = count if compressed else (size - offset) // point_size
    alone = not extended and point_format not in _WAVEFORMS
    refuse_points(path, count, held, f"points of {point_size} bytes")
    plain = list(_walk(stream, path, records, header_size, offset))
    far = list(_walk(stream, path, extended, first_extended, size, extended=True))
    created = date(year, 1, 1) + timedelta(day - 1) if year in _YEARS and day > 0 else None  # days count from 1
    # COPC: its record is the first, directly after a header of LAS 1.4.
    is_copc = header_size == _HEADER_1_4 and [record[:2] for record in plain[:1]] == [(b"copc", 1)]
    # The extent alternates: max x, min x, max y, ...
    numbers = struct.unpack_from("<12d", head, 131)
    return RawHeader(
        size, f"{major}.{minor}", point_format, compressed, point_size, count, offset, bool(encoding & 0x10), is_copc,
        numbers[0:3], numbers[3:6], numbers[7::2], numbers[6::2],
        # Of several records with the same ids, the first is used.
        {(user, number): data for user, number, data in reversed(plain + far) if _is_needed(user, number)}, source_id,
        held - count if alone else 0, created if created is not None and created.year == year else None,
    )  # fmt: skip


def _refuse_format(path: Location, point_format: int, point_size: int) -> None:
    if point_format >= len(_POINT_SIZES):
        raise BadInputError(
            f"{path} holds points of format {point_format}; LAS defines 0 to 10, and bumpymap reads those. Write it "
            "again as LAS 1.4, such as with: pdal translate IN OUT.laz"
        )
    if point_size < _POINT_SIZES[point_format]:
        raise BadInputError(
            f"{path} declares {point_size} bytes per point, and format {point_format} needs "
            f"{_POINT_SIZES[point_format]}. {_AGAIN}"
        )


def _walk(
    stream: BinaryIO, path: Location, count: int, start: int, end: int, *, extended: bool = False
) -> Iterator[tuple[bytes, int, bytes]]:
    """Yield user id, record id and bytes of the records between two offsets; the bytes are empty if not needed."""
    head = _EXTENDED_RECORD if extended else _RECORD
    for index in range(count):
        at, start = start, start + head.size
        if start <= end:
            stream.seek(at)
            user, number, length = head.unpack(stream.read(head.size))
            start += length
        if start > end:
            raise BadInputError(
                f"{path} declares {count:,} {'extended ' if extended else ''}variable length records, and record "
                f"{index:,} exceeds the space for them. {_AGAIN}"
            )
        user = user.split(b"\0")[0]
        needed = _is_needed(user, number) and length <= _LONGEST_RECORD
        yield user, number, stream.read(length) if needed else b""


def _is_needed(user: bytes, number: int) -> bool:
    return user in _NEEDED or (user, number) == _CLASS_LOOKUP


_PROJECTION = b"LASF_Projection"
_MODEL, _GEODETIC, _PROJECTED, _LINEAR, _VERTICAL, _VERTICAL_UNIT = 1024, 2048, 3072, 3076, 4096, 4099
"""Keys of GeoTIFF that name the kind of a CRS, the CRS, and units (OGC 19-008r4)."""
_USER_DEFINED = 32767
"""Value of such a key where the CRS has no code."""
_SAME_FOOT = 1e-5
"""Relative tolerance; the two feet differ by 2e-6, and files confuse them."""


def statement_of_las(header: RawHeader) -> CrsStatement:
    """Return what the CRS records of a LAS header state.

    LAS 1.4 R15, 2.6.1: if bit 4 of the global encoding is set, the WKT record is used, otherwise the GeoTIFF keys. If
    there is only one record, it is used whatever the bit. If the keys should be used but cannot be interpreted, the
    WKT record is used, with a note.
    """
    wkt, directory, citation = (header.records.get((_PROJECTION, number), b"") for number in (2112, 34735, 34737))
    from_wkt = statement_from_wkt(_text(wkt)) if _text(wkt) else None
    from_keys = _statement_from_keys(_keys(directory), _text(citation).split("|")[0])
    if from_wkt is None or from_keys is None:
        return from_wkt or from_keys or CrsStatement()
    if not header.wkt_bit and from_keys.crs is None and from_wkt.crs is not None:
        note = "its GeoTIFF keys cannot be interpreted; the CRS was taken from its WKT record"
        return CrsStatement(from_wkt.crs, notes=(note,))
    names = ("WKT record", "GeoTIFF keys")
    if header.wkt_bit:
        return joined_statement(from_wkt, from_keys, names)
    return joined_statement(from_keys, from_wkt, names[::-1])


def joined_statement(chosen: CrsStatement, other: CrsStatement, names: Sequence[str]) -> CrsStatement:
    """Return the first of two statements of a file, with what only the other one says of heights.

    A note, with ``names`` of both, says if they differ.
    """
    unit = _height_unit(other)
    if unit is not None and _height_unit(chosen) is None:
        note = f"only one of its two CRS records states a unit of height ({unit:g} m); it is used"
        chosen = replace(chosen, metres_per_unit_z=unit, notes=(*chosen.notes, note))
    if chosen.crs is None or other.crs is None:
        return chosen
    ours, theirs = (horizontal_of(crs) or crs for crs in (chosen.crs, other.crs))
    if not same_crs(ours, theirs):
        note = f"its {names[0]} ({chosen.crs.name}) is used; its {names[1]} ({other.crs.name}) differs"
        return replace(chosen, notes=(*chosen.notes, note))
    vertical = vertical_of(other.crs)
    if vertical is None or chosen.crs.is_compound:
        return chosen
    note = f"only one of its two CRS records states a vertical CRS ({describe_crs(vertical)}); it is used"
    return replace(chosen, crs=with_vertical(ours, vertical), notes=(*chosen.notes, note))


def _text(data: bytes) -> str:
    """Decode a text record up to the first zero byte."""
    return data.split(b"\0")[0].decode("utf-8", "replace").strip()


def _keys(data: bytes) -> dict[int, int]:
    """Read the GeoTIFF key directory (16-bit words, four per key); return keys whose value is stored in it."""
    head, *entries = np.frombuffer(data[: len(data) // 8 * 8] or bytes(8), "<u2").reshape(-1, 4).tolist()
    return {key: value for key, place, _, value in entries[: head[3]] if place == 0 and key}


def _height_unit(statement: CrsStatement) -> float | None:
    axes = statement.crs.axis_info if statement.crs is not None else []
    own = axes[2].unit_conversion_factor if len(axes) > 2 else None
    return statement.metres_per_unit_z or own


def _statement_from_keys(keys: dict[int, int], citation: str) -> CrsStatement | None:
    """Interpret GeoTIFF keys: EPSG codes and units; for a user-defined projection, units and a note."""
    if not keys:
        return None
    unit_code = keys.get(_LINEAR, 0)
    unit = linear_unit(unit_code)
    if unit is None and unit_code not in {0, _USER_DEFINED}:
        named = f"its GeoTIFF keys name {unit_code} as the unit of easting and northing"
        return CrsStatement(trouble=f"{named}, which is not a unit of length")
    vertical = _coded(keys, _VERTICAL)
    if vertical is not None and not vertical.is_vertical:
        vertical = None
    own = None if vertical is None else vertical.axis_info[0].unit_conversion_factor
    unit_z = linear_unit(keys.get(_VERTICAL_UNIT, 0)) or own
    if 0 < keys.get(_PROJECTED, 0) < _USER_DEFINED:
        return _projected(keys, unit, unit_z, vertical)
    if keys.get(_MODEL) in {2, 3}:
        return CrsStatement(_coded(keys, _GEODETIC) or crs_from_epsg(4326 if keys[_MODEL] == 2 else 4978))
    notes: tuple[str, ...] = ()
    if keys.get(_MODEL) == 1 or keys.get(_PROJECTED) == _USER_DEFINED:
        named = f" ('{citation}')" if citation else ""
        notes = (f"its GeoTIFF keys describe a CRS without a code{named}; pass `crs` to place it on Earth",)
    return CrsStatement(None, unit, unit_z, notes=notes)


def _projected(keys: dict[int, int], unit: float | None, unit_z: float | None, vertical: CRS | None) -> CrsStatement:
    code, crs = keys[_PROJECTED], _coded(keys, _PROJECTED)
    if crs is None:
        return CrsStatement(trouble=f"its GeoTIFF keys name EPSG:{code}, which PROJ does not know")
    own = crs.axis_info[0].unit_conversion_factor
    if unit is not None and crs.is_projected and abs(unit / own - 1) > _SAME_FOOT:
        trouble = f"its GeoTIFF keys name EPSG:{code}, whose unit is {own:g} m, and a unit of {unit:g} m"
        return CrsStatement(trouble=trouble)
    if vertical is not None and crs.is_projected:
        crs = with_vertical(crs, vertical)
    return CrsStatement(crs, metres_per_unit_z=unit_z)


def _coded(keys: dict[int, int], key: int) -> CRS | None:
    """Return the CRS of the EPSG code in a key; None if there is none that PROJ knows."""
    code = keys.get(key, 0)
    return crs_from_epsg(code) if 0 < code < _USER_DEFINED else None
