"""LAS and LAZ files byte by byte, so that every lie about every byte can be told.

Field places are those of LAS 1.4 R15, table 3; LAS 1.2 shares the first 227 bytes. Only the arithmetic coding of LAZ
chunks is left to lazrs.
"""

import io
import struct
from dataclasses import dataclass

import lazrs
import numpy as np

__all__ = ["EVLR_HEAD", "HEADER", "HEADER_1_4", "ORIGIN", "Layout", "Vlr", "cloud", "las_file", "layout_of"]

ORIGIN = (500_001.0, 4_000_001.0, 100.0)
"""South-west corner of the survey and its lowest height, m; inside UTM zone 14 north."""
SIDE = 5.5
"""Of the square that the points fill, m: four tiles of 3 m."""
SCALE = 0.001
VLR_HEAD, EVLR_HEAD = 54, 60

HEADER = {
    "signature": (0, "4s"),
    "source_id": (4, "H"),
    "global_encoding": (6, "H"),
    "guid": (8, "16s"),
    "version_major": (24, "B"),
    "version_minor": (25, "B"),
    "system": (26, "32s"),
    "software": (58, "32s"),
    "day": (90, "H"),
    "year": (92, "H"),
    "header_size": (94, "H"),
    "offset_to_points": (96, "I"),
    "vlr_count": (100, "I"),
    "point_format": (104, "B"),
    "record_length": (105, "H"),
    "count": (107, "I"),
    "by_return": (111, "5I"),
    "scale_x": (131, "d"),
    "scale_y": (139, "d"),
    "scale_z": (147, "d"),
    "offset_x": (155, "d"),
    "offset_y": (163, "d"),
    "offset_z": (171, "d"),
    "max_x": (179, "d"),
    "min_x": (187, "d"),
    "max_y": (195, "d"),
    "min_y": (203, "d"),
    "max_z": (211, "d"),
    "min_z": (219, "d"),
}
"""Name of a header field to its place and its layout (little endian)."""
HEADER_1_4 = {
    "waveform_at": (227, "Q"),
    "evlr_at": (235, "Q"),
    "evlr_count": (243, "I"),
    "count_1_4": (247, "Q"),
    "by_return_1_4": (255, "15Q"),
}
"""What LAS 1.4 has behind it."""

_COMMON = [("x", "<i4"), ("y", "<i4"), ("z", "<i4"), ("intensity", "<u2")]
_COLOUR = [("red", "<u2"), ("green", "<u2"), ("blue", "<u2")]
_LEGACY = [*_COMMON, ("flags", "u1"), ("class", "u1"), ("angle", "i1"), ("user", "u1"), ("source", "<u2")]
_EXTENDED = [
    *_COMMON, ("returns", "u1"), ("flags", "u1"), ("class", "u1"), ("user", "u1"), ("angle", "<i2"), ("source", "<u2"),
    ("gps", "<f8"),
]  # fmt: skip
_POINTS = {1: [*_LEGACY, ("gps", "<f8")], 3: [*_LEGACY, ("gps", "<f8"), *_COLOUR], 6: _EXTENDED}
_POINTS[7] = [*_EXTENDED, *_COLOUR]


@dataclass(frozen=True, slots=True)
class Vlr:
    """A variable length record to write."""

    user: bytes
    number: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Layout:
    """Where the parts of a LAS file lie, in bytes from its start."""

    header_end: int
    vlrs: tuple[tuple[int, int, int], ...]
    """Start, start of the data, end."""
    points_at: int
    points_end: int
    chunks: tuple[tuple[int, int, int], ...]
    """Start, end and points of each LAZ chunk."""
    table_at: int
    """Of the LAZ chunk table; 0 where there is none."""
    table_end: int
    evlrs: tuple[tuple[int, int, int], ...]


def cloud(count, seed=0):
    """Random points of gently rolling ground: coordinates (count, 3), m."""
    rng = np.random.default_rng(seed)
    x, y = np.round(rng.uniform(0, SIDE, (2, count)), 3)
    z = np.round(0.5 + 0.2 * np.sin(x) + 0.02 * rng.standard_normal(count), 3)
    return np.column_stack([x, y, z]) + ORIGIN


def las_file(xyz, *, minor, fmt, chunks=None, vlrs=(), evlrs=(), class_id=2, withheld=False, wkt_bit=False):
    """Bytes of a valid file.

    ``chunks``: None writes LAS; a number writes LAZ in chunks of so many points; a list of numbers writes LAZ in
    chunks of those many.
    """
    body = _records(np.asarray(xyz, float), fmt, class_id, withheld=withheld)
    vlrs = list(vlrs)
    if chunks is not None:
        laz = _laszip_record(fmt, chunks)
        vlrs.append(Vlr(b"laszip encoded", 22204, laz.record_data()))
    head_size = 375 if minor >= 4 else 227
    plain = b"".join(_vlr(vlr, "<H", VLR_HEAD) for vlr in vlrs)
    points_at = head_size + len(plain)
    head = _header(np.asarray(xyz, float), minor, fmt, body.dtype.itemsize, points_at, len(vlrs), chunks is not None)
    if wkt_bit:
        struct.pack_into("<H", head, 6, 16)
    out = io.BytesIO()
    out.write(bytes(head) + plain)
    if chunks is None:
        out.write(body.tobytes())
    else:
        _compress(out, laz, body, chunks)
    if evlrs:
        out.seek(0, io.SEEK_END)
        struct.pack_into("<QI", head, 235, out.tell(), len(evlrs))
        out.write(b"".join(_vlr(vlr, "<Q", EVLR_HEAD) for vlr in evlrs))
        out.seek(0)
        out.write(head)
    return out.getvalue()


def _header(xyz, minor, fmt, record_length, points_at, vlr_count, compressed):
    head = bytearray(375 if minor >= 4 else 227)
    struct.pack_into("<4sHH", head, 0, b"LASF", 0, 0)
    struct.pack_into("<BB32s32sHH", head, 24, 1, minor, b"bumpymap tests", b"bumpymap tests", 1, 2024)
    many = len(xyz)
    struct.pack_into("<HIIBH", head, 94, len(head), points_at, vlr_count, fmt | 0x80 * compressed, record_length)
    struct.pack_into("<II", head, 107, many if fmt < 6 else 0, many if fmt < 6 else 0)
    low, high = xyz.min(axis=0), xyz.max(axis=0)
    struct.pack_into("<6d", head, 131, SCALE, SCALE, SCALE, *ORIGIN)
    struct.pack_into("<6d", head, 179, *(side[axis] for axis in range(3) for side in (high, low)))
    if minor >= 4:
        struct.pack_into("<QQ", head, 247, many, many)
    return head


def _records(xyz, fmt, class_id, *, withheld):
    points = np.zeros(len(xyz), np.dtype(_POINTS[fmt]))
    for axis, name in enumerate("xyz"):
        points[name] = np.round((xyz[:, axis] - ORIGIN[axis]) / SCALE)
    points["intensity"] = points["x"] % 997
    points["class"] = class_id
    points["gps"] = np.arange(len(xyz)) * 1e-4
    if fmt in {3, 7}:
        points["red"] = points["z"] % 251
    if fmt >= 6:
        points["returns"] = 0x11
        points["flags"] = 4 * withheld
    else:
        points["flags"] = 0x09
        points["class"] |= 128 * withheld
    return points


def _laszip_record(fmt, chunks):
    fixed = isinstance(chunks, int)
    record = bytearray(lazrs.LazVlr.new_for_compression(fmt, 0, not fixed).record_data())
    if fixed:
        struct.pack_into("<I", record, 12, chunks)
    return lazrs.LazVlr(bytes(record))


def _compress(out, laz, body, chunks):
    compressor = lazrs.LasZipCompressor(out, laz)
    sizes = [len(body)] if isinstance(chunks, int) else chunks
    ends = np.cumsum(sizes)
    if ends[-1] != len(body):
        raise ValueError(f"chunks of {list(chunks)} points do not make {len(body)} points")
    for start, end in zip([0, *ends[:-1]], ends, strict=True):
        if start:
            compressor.finish_current_chunk()
        compressor.compress_many(body[start:end].tobytes())
    compressor.done()


def _vlr(vlr, length, head_size):
    head = bytearray(head_size)
    struct.pack_into("<16sH", head, 2, vlr.user, vlr.number)
    struct.pack_into(length, head, 20, len(vlr.data))
    return bytes(head) + vlr.data


def layout_of(data):
    """Find the parts of a valid file."""
    minor, compressed = data[25], bool(data[104] & 0x80)
    header_size, points_at, vlr_count = struct.unpack_from("<HII", data, 94)
    evlr_at, evlr_count = struct.unpack_from("<QI", data, 235) if minor >= 4 else (0, 0)
    vlrs = _walk(data, header_size, vlr_count, "<H", VLR_HEAD)
    evlrs = _walk(data, evlr_at, evlr_count, "<Q", EVLR_HEAD)
    end = evlr_at if evlr_count else len(data)
    if not compressed:
        return Layout(header_size, vlrs, points_at, end, (), 0, 0, evlrs)
    (table_at,) = struct.unpack_from("<q", data, points_at)
    record = next(data[start:stop] for _, start, stop in vlrs if data[start - 52 :].startswith(b"laszip encoded"))
    stream = io.BytesIO(data)
    stream.seek(points_at)
    laz = lazrs.LazVlr(record)
    chunks, place = [], points_at + 8
    for points, size in lazrs.read_chunk_table(stream, laz):
        chunks.append((place, place + size, points if laz.uses_variable_size_chunks() else laz.chunk_size()))
        place += size
    return Layout(header_size, vlrs, points_at, table_at, tuple(chunks), table_at, end, evlrs)


def _walk(data, place, count, length, head_size):
    found = []
    for _ in range(count):
        (size,) = struct.unpack_from(length, data, place + 20)
        found.append((place, place + head_size, place + head_size + size))
        place += head_size + size
    return tuple(found)
