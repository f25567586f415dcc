"""Tiny valid surveys, one of each kind, byte by byte, and where their parts lie; hostile files are made from them."""

import io
import struct
import sys
from dataclasses import dataclass
from functools import cache
from itertools import accumulate
from pathlib import Path

import lazrs
import lzf
import numpy as np
from pyproj import CRS

sys.path.append(str(Path(__file__).resolve().parents[2] / "helpers"))  # for processes of their own
from las_files import ENTRY, geokeys, las_bytes, octree, packed, wkt
from point_files import ply_bytes

ORIGIN = (500_001.0, 4_000_001.0, 100.0)
"""South-west corner of the survey and its lowest height, m; inside UTM zone 14 north."""
SIDE = 5.5
"""Of the square that the points fill, m: four tiles of 3 m."""
SCALE = 0.001
VLR_HEAD, EVLR_HEAD = 54, 60


def _placed(fields, at=0):
    """Name of a header field to its place and its layout (little endian); each begins where the one before ends."""
    pairs = [field.split() for field in fields.split(",")]
    ends = accumulate((struct.calcsize("<" + layout) for _, layout in pairs), initial=at)
    return {name: (place, layout) for (name, layout), place in zip(pairs, ends, strict=False)}


HEADER = _placed(
    "signature 4s, source_id H, global_encoding H, guid 16s, version_major B, version_minor B, system 32s,"
    "software 32s, day H, year H, header_size H, offset_to_points I, vlr_count I, point_format B, record_length H,"
    "count I, by_return 5I, scale_x d, scale_y d, scale_z d, offset_x d, offset_y d, offset_z d,"
    "max_x d, min_x d, max_y d, min_y d, max_z d, min_z d"
)
HEADER_1_4 = _placed("waveform_at Q, evlr_at Q, evlr_count I, count_1_4 Q, by_return_1_4 15Q", at=227)
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


def number_fields(data):
    """Yield place and layout (little endian) of the numbers that the structure of a LAS or LAZ file is made of."""
    layout = layout_of(data)
    known = HEADER | (HEADER_1_4 if data[25] >= 4 else {})
    yield from ((place, form) for place, form in known.values() if form[-1] in "BHIQd" and form[0] not in "123456789")
    for start, body, end in layout.vlrs:
        yield from ((start + 2, "B"), (start + 18, "H"), (start + 20, "H"))
        yield from ((place, "H") for place in range(body, min(end, body + 64) - 1, 2))
    for start, body, end in layout.evlrs:
        yield from ((start + 2, "B"), (start + 18, "H"), (start + 20, "Q"))
        for entry in range(body, end - ENTRY.size + 1, ENTRY.size):
            yield from ((entry + at, form) for at, form in zip((0, 4, 8, 12, 16, 24, 28), "IIIIQII", strict=True))
    if not layout.chunks:
        yield from ((layout.points_at + at, "I") for at in range(0, 68, 4))
        return
    yield layout.points_at, "Q"
    yield from ((layout.table_at + at, "I") for at in (0, 4))
    yield from ((place, "B") for place in range(layout.table_at + 8, layout.table_end))
    for start, _, _ in layout.chunks:
        yield from ((start + at, "I") for at in (0, 4, 8, 30, 34, 38, *range(36, 80, 4)))


_FORMATS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}


def ply_header(form, elements):
    """Header of a PLY file; ``elements`` is a list of (name, count, property lines)."""
    lines = ["ply", f"format {form} 1.0", "comment made by the tests of bumpymap"]
    for name, count, properties in elements:
        lines += [f"element {name} {count}", *(f"property {line}" for line in properties)]
    return ("\n".join([*lines, "end_header"]) + "\n").encode()


def ply_file(xyz, form):
    """Bytes of a valid PLY file with double coordinates, rounded to millimetres in a text."""
    axes = np.round(np.asarray(xyz, float), 3) if form == "ascii" else np.asarray(xyz, float)
    rows = np.rec.fromarrays([*axes.T, np.full(len(axes), 2, np.uint8)], names="x,y,z,class")
    return ply_bytes([("vertex", rows)], _FORMATS[form])


def pcd_header(count, encoding, **changes):
    """Header of a PCD file; ``changes`` replace the values of lines, None leaves a line out."""
    lines = {
        "VERSION": "0.7",
        "FIELDS": "x y z intensity",
        "SIZE": "8 8 8 4",
        "TYPE": "F F F F",
        "COUNT": "1 1 1 1",
        "WIDTH": count,
        "HEIGHT": 1,
        "VIEWPOINT": "0 0 0 1 0 0 0",
        "POINTS": count,
        "DATA": encoding,
    } | changes
    held = [f"{name} {value}" for name, value in lines.items() if value is not None]
    return ("\n".join(["# .PCD v0.7 - Point Cloud Data file format", *held]) + "\n").encode()


def pcd_file(xyz, encoding):
    """Bytes of a valid PCD file with double coordinates."""
    rows = np.zeros(len(xyz), [("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("intensity", "<f4")])
    for axis, name in enumerate("xyz"):
        rows[name] = np.asarray(xyz, float)[:, axis]
    head = pcd_header(len(rows), encoding)
    if encoding == "ascii":
        return head + "".join(f"{x:.3f} {y:.3f} {z:.3f} {i:g}\n" for x, y, z, i in rows.tolist()).encode()
    if encoding == "binary":
        return head + rows.tobytes()
    # Compressed files hold column after column.
    plain = b"".join(rows[name].tobytes() for name in rows.dtype.names)
    packed = lzf.compress(plain)
    return head + struct.pack("<II", len(packed), len(plain)) + packed


def utm():
    """Record of the CRS that the LAS 1.4 surveys have."""
    return wkt(CRS.from_epsg(32614).to_wkt("WKT1_GDAL"))


@cache
def bases(count=400):
    """Name to bytes: surveys of ``count`` points, a multiple of 20 and at least 40."""
    xyz = cloud(count)
    keys = geokeys({1024: 1, 3072: 32614})
    fifth = count // 5
    uneven = [fifth // 2, fifth + fifth // 2, fifth, fifth - fifth // 4, count - 3 * fifth - (fifth - fifth // 4)]
    fixed = {"minor": 2, "fmt": 3, "vlrs": [keys]}
    varied = {"minor": 4, "wkt_bit": True}
    return {
        "las12.las": las_file(xyz, **fixed),
        "las14.las": las_file(xyz, fmt=7, vlrs=[utm()], evlrs=[("note", 7, b"n" * 40)], **varied),
        "laz12.laz": las_file(xyz, chunks=fifth, **fixed),
        "laz14.laz": las_file(xyz, fmt=6, chunks=fifth, evlrs=[utm()], **varied),
        "laz14v.laz": las_file(xyz, fmt=7, chunks=uneven, vlrs=[utm()], **varied),
        "copc.copc.laz": octree(las_file(xyz, minor=4, fmt=7, vlrs=[utm()]), levels=1, page_levels=1),
        "text.ply": ply_file(xyz, "ascii"),
        "little.ply": ply_file(xyz, "binary_little_endian"),
        "big.ply": ply_file(xyz, "binary_big_endian"),
        "text.pcd": pcd_file(xyz, "ascii"),
        "binary.pcd": pcd_file(xyz, "binary"),
        "packed.pcd": pcd_file(xyz, "binary_compressed"),
    }


REFUSED = frozenset({3})
"""A lie about the structure: must be noticed."""
EITHER = frozenset({0, 3})
"""What is left may still be a survey."""
MAPPED = frozenset({0})
"""Odd, but a survey."""


@dataclass(frozen=True, slots=True)
class Case:
    """A file and what ``bumpymap map`` may make of it."""

    name: str
    """File name; tells what is wrong."""
    data: bytes
    exits: frozenset[int] = REFUSED
    base: str | None = None
    """The valid survey whose points must come out, all of them and no others, where the file is mapped at all."""


def patched(data, place, layout, *values):
    """Overwrite little-endian values at a place."""
    out = bytearray(data)
    struct.pack_into("<" + layout, out, place, *values)
    return bytes(out)


def renamed(name, word):
    """Give the name of a file with a word behind its stem."""
    stem, dot, suffix = name.partition(".")
    return f"{stem}-{word}{dot}{suffix}"
