"""LAS and LAZ files, and where their parts lie, so that every lie about every byte can be told.

Field places are those of LAS 1.4 R15, table 3; LAS 1.2 shares the first 227 bytes.
"""

import io
import struct
import sys
from dataclasses import dataclass
from pathlib import Path

import lazrs
import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[2] / "helpers"))  # for processes of their own
from las_files import las_bytes, packed

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
    number = np.arange(len(xyz))
    data = las_bytes(
        xyz, version=f"1.{minor}", fmt=fmt, scale=SCALE, offset=ORIGIN, records=vlrs, extended=evlrs, wkt_bit=wkt_bit,
        classification=np.full(len(xyz), class_id), withheld=np.full(len(xyz), withheld), gps_time=number * 1e-4,
        intensity=number % 997,
    )  # fmt: skip
    if chunks is None:
        return data
    return packed(data, chunk=chunks) if isinstance(chunks, int) else packed(data, counts=chunks)


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
