"""Tiny valid surveys, one of each kind, byte by byte; and damage to them: cut at every part, other numbers and words.

A file that is mapped in spite of it must give the points of the undamaged one, unless the damage is in these. Beside
them stand files that lie in good form, odd but valid ones, and files that are no point cloud.
"""

import io
import os
import socket
import struct
import sys
from dataclasses import dataclass
from functools import cache
from itertools import accumulate, pairwise
from pathlib import Path

import lazrs
import lzf
import numpy as np
from pyproj import CRS
from rasterio.io import MemoryFile
from rasterio.transform import Affine

sys.path.append(str(Path(__file__).resolve().parents[2] / "helpers"))  # for processes of their own
from point_files import ENTRY, geokeys, las_bytes, octree, packed, ply_bytes, wkt

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


_TRUSTED = {"count", "count_1_4", "point_format", "scale_z", "offset_z"}
"""Header fields that nothing else contradicts: the number of points, which numbers are heights and classes."""
_REALS = (0.0, float("nan"), float("inf"), -float("inf"), 1e300, 1e8, -4e9, 1e-300)
_XYZ = ["double x", "double y", "double z"]
_WORDS = (b"0", b"many", b"-1", b"1000000000000", b"\xff\xfe", b"99999999999999999999")


def hostile_files():
    """Every hostile file, the same bytes every time."""
    numbers = [case for name in ("las14.las", "laz12.laz", "laz14v.laz") for case in _numbers(name)]
    texts = [case for name in ("text.ply", "little.ply", "binary.pcd", "packed.pcd") for case in _words(name)]
    cuts = [case for name in bases() if name != "laz14.laz" for case in _cuts(name)]
    tables = [case for name in ("laz12.laz", "laz14v.laz") for case in _tables(name)]
    odd = [*_systems(), *_points(), *_headers(), *_rows(), *_foreign(), *_rasters()]
    return [*numbers, *texts, *cuts, *tables, _endless(), *odd]


def _numbers(name):
    """Cases with another number in one field each; the fields take turns at what the number is."""
    data, layout = bases()[name], layout_of(bases()[name])
    names = {place: field for field, (place, _) in (HEADER | HEADER_1_4).items()}
    first_points = {start + axis for start, _, _ in layout.chunks for axis in (0, 4, 8)}
    crs, _, crs_end = next(record for record in layout.vlrs if b"LASF_Projection" in data[record[0] : record[1]])
    for number, (place, form) in enumerate(number_fields(data)):
        if form == "d":
            value = _REALS[number % len(_REALS)]
        else:
            size = struct.calcsize(form)
            own, most = int.from_bytes(data[place : place + size], "little"), 256**size
            value = (0, own + 1, most - 1, own - 1, most // 2 - 1, 7)[number % 6] % most
        # Points that are not compressed, and the CRS, are taken for what they say.
        is_point = place in first_points or (not layout.chunks and layout.points_at <= place < layout.points_end)
        is_free = is_point or names.get(place) in _TRUSTED or crs <= place < crs_end
        word = f"{names.get(place, f'byte_{place}')}-{value:g}"
        yield Case(renamed(name, word), patched(data, place, form, value), EITHER, None if is_free else name)


def _words(name):
    """Cases without a line of a text header, with one twice, or with another word in it."""
    data = bases()[name]
    end = _header_end(data)
    lines = data[:end].splitlines(keepends=True)
    for number, line in enumerate(lines):
        words, changed = line.split(), {"gone": b"", "twice": line + line}
        for place in range(len(words)):
            other = _WORDS[(number + place) % len(_WORDS)]
            changed[f"word_{place}"] = b" ".join([*words[:place], other, *words[place + 1 :]]) + b"\n"
        for what, text in changed.items():
            damaged = b"".join([*lines[:number], text, *lines[number + 1 :]]) + data[end:]
            yield Case(renamed(name, f"line_{number}-{what}"), damaged, EITHER)


def _header_end(data):
    return data.index(b"\n", data.index(b"\nend_header" if data.startswith(b"ply") else b"\nDATA") + 1) + 1


def _cuts(name):
    """Cases that end at, and inside, every part of the file."""
    data, is_text = bases()[name], name.startswith("text")
    ends = {0, len(data)}
    if name.endswith((".las", ".laz")):
        layout = layout_of(data)
        parts = [*layout.vlrs, *layout.evlrs, *(chunk[:2] for chunk in layout.chunks)]
        ends |= {
            layout.header_end,
            layout.points_at,
            layout.points_end,
            layout.table_at,
            *(at for part in parts for at in part),
        }
    else:
        ends |= {_header_end(data)}
    lengths = {*ends, *((first + last) // 2 for first, last in pairwise(sorted(ends))), len(data) - 1} - {len(data)}
    if is_text:  # without its last byte, its line end, a text is whole
        lengths.remove(len(data) - 1)
    return [Case(renamed(name, f"cut-{length}"), data[:length]) for length in sorted(lengths)]


def with_table(data, entries):
    """Replace the chunk table: ``entries`` of (points, bytes), with the coding of a valid table."""
    layout = layout_of(data)
    record = next(data[body:end] for start, body, end in layout.vlrs if data[start + 2 :].startswith(b"laszip"))
    out = io.BytesIO()
    lazrs.write_chunk_table(out, entries, lazrs.LazVlr(record))
    return data[: layout.table_at] + out.getvalue() + data[layout.table_end :]


def _tables(name):
    """Chunk tables that say untruths in good form."""
    data, stem = bases()[name], name.removesuffix(".laz")
    held = [(points, end - start) for start, end, points in layout_of(data).chunks]
    (many, size), (_, after) = held[0], held[1]
    spoilt = {
        "bytes_0": [(many, 0), *held[1:]],
        "bytes_one_less": [(many, size - 1), *held[1:]],
        "bytes_swapped": [(many, after), (held[1][0], size), *held[2:]],
        "bytes_2to31": [(many, 2**31 - 1), *held[1:]],
        "bytes_2to32": [(many, 2**32 - 1), *held[1:]],
        "one_gone": held[:-1],
        "ten_thousand": held + [(1, 1)] * 10_000,
    }
    exits = {"bytes_one_less": EITHER, "bytes_swapped": EITHER}
    if name == "laz14v.laz":
        spoilt |= {
            "points_0": [(0, size), *held[1:]],
            "points_one_less": [(many - 1, size), *held[1:]],
            "points_swapped": [(held[1][0], size), (many, after), *held[2:]],
            "points_2to31": [(2**31 - 1, size), *held[1:]],
            "points_2to32": [(2**32 - 1, size), *held[1:]],
            "points_all_2to32": [(2**32 - 1, bytes_) for _, bytes_ in held],
        }
    return [
        Case(f"{stem}-entries-{word}.laz", with_table(data, entries), exits.get(word, REFUSED), name)
        for word, entries in spoilt.items()
    ]


def _endless():
    """Times that go on and on: each asks the decoder of point formats 1 and 3 for one more, deeper in the stack.

    A large chunk, since how deep it goes follows the bytes of the chunk.
    """
    data = bases(20_000)["laz12.laz"]
    start, end, _ = layout_of(data).chunks[0]
    at = start + 40
    return Case("laz12-chunk_1-endless_times.laz", data[:at] + b"\xbe\x04" + b"\xff" * (end - at - 2) + data[end:])


def _systems():
    """Coordinate systems that are none."""
    utm = CRS.from_epsg(32614).to_wkt("WKT1_GDAL")
    texts = {
        "garbage": (b'PROJCS[;;["x",,]]\0', REFUSED),
        "not_utf8": (b"\xff\xfe\x80PROJCS\xc3\x28", REFUSED),
        "brackets": (b"PROJCS[" * 8_000, REFUSED),
        "nan_unit": (utm.replace('UNIT["metre",1', 'UNIT["metre",nan').encode(), REFUSED),
        "unknown_authority": (utm.replace('"EPSG"', '"NOBODY"').encode(), EITHER),
    }
    keys = {
        "wild_model": ({1024: 60_000, 3072: 65_535}, EITHER),
        "unit_of_angle": ({1024: 1, 3072: 32614, 3076: 9102}, REFUSED),
    }
    xyz = cloud(100)
    made = [
        Case(f"las14-wkt-{word}.las", las_file(xyz, minor=4, fmt=6, vlrs=[wkt(text)], wkt_bit=True), exits)
        for word, (text, exits) in texts.items()
    ]
    made += [
        Case(f"las12-geokeys-{word}.las", las_file(xyz, minor=2, fmt=1, vlrs=[geokeys(held)]), exits)
        for word, (held, exits) in keys.items()
    ]
    wild = geokeys({1024: 1, 3072: 32614}, count=65_535)
    made.append(Case("las12-geokeys-wild_count.las", las_file(xyz, minor=2, fmt=1, vlrs=[wild]), EITHER))
    far = las_file(xyz, minor=4, fmt=6, evlrs=[wkt(b"B" * 1_000_000)], wkt_bit=True)
    return [*made, Case("las14-evlr_wkt-megabyte.las", far)]


def _points():
    """Points that are fine one by one and make no survey, or hardly one."""
    xyz = cloud(100)
    far, wide = xyz.copy(), xyz.copy()
    far[0, :2] += 2_000_000
    wide[:, 0] += np.arange(100) * 20_000
    kinds = {"minor": 2, "fmt": 1}
    plain = las_file(xyz, **kinds)
    return [
        Case("las12-points-one.las", las_file(xyz[:1], **kinds), MAPPED),
        Case("las12-points-same.las", las_file(np.tile(xyz[:1], (100, 1)), **kinds), MAPPED),
        Case("las12-points-trailing_bytes.las", plain + b"more", MAPPED),
        Case("las12-points-all_withheld.las", las_file(xyz, withheld=True, **kinds)),
        Case("las14-points-all_withheld.las", las_file(xyz, minor=4, fmt=6, withheld=True)),
        Case("las12-points-all_noise.las", las_file(xyz, class_id=7, **kinds)),
        Case("las14-points-all_high_noise.las", las_file(xyz, minor=4, fmt=6, class_id=18)),
        Case("las12-points-one_2000_km_away.las", las_file(far, **kinds)),
        Case("las12-points-2000_km_wide.las", las_file(wide, **kinds), EITHER),
        # The first point lies 2,147 km east of the header's box.
        Case("las12-points-largest.las", patched(plain, layout_of(plain).points_at, "i", 2**31 - 1)),
    ]


def _headers():
    row = struct.pack("<3d", 1.0, 2.0, 3.0)
    little, many = "binary_little_endian", [f"double x{index}" for index in range(3000)]
    headers = {
        "no_vertex": ply_header(little, [("face", 1, _XYZ)]) + row,
        "no_properties": ply_header(little, [("vertex", 1, [])]) + row,
        "no_z": ply_header(little, [("vertex", 1, _XYZ[:2])]) + row,
        "z_twice": ply_header(little, [("vertex", 1, [*_XYZ, "double z"])]) + row + row,
        "x_is_a_list": ply_header(little, [("vertex", 1, ["list uchar double x", *_XYZ[1:]])]) + row,
        "unknown_type": ply_header(little, [("vertex", 1, ["quad x", *_XYZ[1:]])]) + row,
        "list_of_lists": ply_header(little, [("vertex", 1, [*_XYZ, "list list uchar w"])]) + row,
        "float_list_length": ply_header(little, [("vertex", 1, [*_XYZ, "list float int w"])]) + row,
        "vertex_twice": ply_header(little, [("vertex", 1, _XYZ), ("vertex", 1, _XYZ)]) + row + row,
        "unknown_format": ply_header("binary_middle_endian", [("vertex", 1, _XYZ)]) + row,
        "no_format": b"ply\nelement vertex 1\nproperty double x\nend_header\n" + row,
        "version_9": ply_header(little, [("vertex", 1, _XYZ)]).replace(b" 1.0", b" 9.9") + row,
        "property_first": b"ply\nformat ascii 1.0\nproperty double x\nelement vertex 1\nend_header\n1\n",
        "endless_line": b"ply\nformat ascii 1.0\ncomment " + b"a" * 10_000_000,
        "endless_lines": b"ply\nformat ascii 1.0\n" + b"comment a\n" * 1_000_000,
        "endless_properties": ply_header(little, [("vertex", 1, _XYZ + many * 3)]) + row,
        "endless_elements": ply_header(little, [(f"e{index}", 0, _XYZ[:1]) for index in range(50_000)]),
        "nothing_else": b"ply\n",
        "not_ascii": b"ply\nformat ascii 1.0\nelement v\xe9rtex\xff 1\nproperty double x\nend_header\n1\n",
        "zero_bytes": b"ply\n" + bytes(5000),
    }
    exits = {"version_9.ply": EITHER, "not_utf8.pcd": EITHER}
    pcd = {
        "endless_line": b"# .PCD v0.7\nVERSION 0.7\nFIELDS " + b"x " * 5_000_000,
        "endless_lines": b"# .PCD v0.7\n" + b"VERSION 0.7\n" * 500_000,
        "zero_bytes": b"# .PCD v0.7\n" + bytes(3000),
        "not_utf8": pcd_header(1, "ascii").replace(b"intensity", b"\xff\xfe") + b"1 2 3 4\n",
        "values_2to63": pcd_header(400, "ascii", COUNT=f"1 1 1 {2**63}") + b"1 2 3 4\n" * 400,
        "values_10to6": pcd_header(400, "binary", COUNT=f"1 1 1 {10**6}") + bytes(11200),
        # All of it claims: 2^32 - 1 bytes of 153 million points.
        "bomb": pcd_header((2**32 - 1) // 28, "binary_compressed")
        + struct.pack("<II", 12000, 2**32 - 1)
        + bytes(12000),
    }
    made = {f"{word}.ply": data for word, data in headers.items()} | {f"{word}.pcd": data for word, data in pcd.items()}
    return [Case(f"header-{name}", data, exits.get(name, REFUSED)) for name, data in made.items()]


def _rows():
    """Lists whose length is wild, and rows of other things than numbers."""
    lists = ply_header("binary_little_endian", [("vertex", 2, [*_XYZ, "list uint double w"])])
    faces = ply_header("binary_big_endian", [("face", 1, ["list uint int i"]), ("vertex", 2, _XYZ)])
    made = [
        Case("list_length-2to32.ply", lists + struct.pack("<3dI", 1.0, 2.0, 3.0, 2**32 - 1) * 2),
        Case("face_length-2to32.ply", faces + struct.pack(">I", 2**32 - 1) + bytes(48)),
    ]
    text = ply_header("ascii", [("vertex", 3, _XYZ)])
    rows = {
        "words": text + b"one two three\n" * 3,
        "short_row": text + b"1 2 3\n1 2\n1 2 3\n",
        "empty_rows": text + b"\n\n\n",
        "zero_bytes": text + bytes(60),
        "not_ascii": text + "1 2 \u00b3\n".encode() * 3,
        "endless_row": text + b"1 " * 3_000_000,
        "long_number": text + b"1 2 " + b"9" * 1_000_000 + b"\n1 2 3\n1 2 3\n",
    }
    return made + [Case(f"rows-{word}.ply", data) for word, data in rows.items()]


def _foreign():
    """Files that are no point cloud behind the signature of one, or nothing at all."""
    rng = np.random.default_rng(5)
    held = {
        "empty.laz": b"",
        "ones_behind_signature.las": b"LASF" + b"\xff" * 100_000,
        "random_behind_signature.las": b"LASF" + rng.bytes(50_000),
        "random_behind_ply.ply": b"ply\n" + rng.bytes(50_000),
        "random_behind_pcd.pcd": b"# .PCD v0.7\n" + rng.bytes(50_000),
        "crlf_mangled.laz": bases()["laz12.laz"].replace(b"\n", b"\r\n"),
    }
    return [Case(f"foreign-{name}", data) for name, data in held.items()]


def _rasters():
    """Cuts of a small DSM, and other numbers in every entry of its directory and in its blocks."""
    made = {"deflate": {"compress": "deflate", "tiled": True, "blockxsize": 16, "blockysize": 16}, "strips": {}}
    for name, how in made.items():
        with MemoryFile() as memory:
            shape = {"driver": "GTiff", "width": 30, "height": 30, "count": 1, "dtype": "float32", "nodata": -9999.0}
            place = {"crs": "EPSG:32614", "transform": Affine(0.2, 0, 500_001, 0, -0.2, 4_000_007)}
            with memory.open(**shape, **place, **how) as file:
                file.write(np.linspace(100.0, 101.0, 900, dtype="float32").reshape(1, 30, 30))
            data = bytes(memory.read())
        yield from (Case(f"{name}-cut-{n}.tif", data[:n], EITHER) for n in range(4, len(data) - 1, len(data) // 12))
        (at,) = struct.unpack_from("<I", data, 4)
        (entries,) = struct.unpack_from("<H", data, at)
        for number in range(entries):
            for field, (shift, form) in enumerate(((0, "H"), (2, "H"), (4, "I"), (8, "I"))):
                value = (0, 1, 2**31 - 1, 2**32 - 1)[(number + field) % 4] % 256 ** struct.calcsize(form)
                damaged = patched(data, at + 2 + 12 * number + shift, form, value)
                yield Case(f"{name}-entry_{number}-field_{field}.tif", damaged, EITHER)
        for place in range(len(data) // 2, len(data), len(data) // 12):
            yield Case(f"{name}-bytes_{place}.tif", data[:place] + b"\xff" * 40 + data[place + 40 :], EITHER)


_LINKS = {
    "dangling_link": "nowhere.laz",
    "circular_link": "x.laz",
    "link_to_zeros": "/dev/zero",
    "link_to_terminal": "/dev/tty",
}
_NAMES = {
    "name_with_newline": "a\nb.laz",
    "name_with_markup": "[red]%s{x}[bold].laz",
    "name_not_utf8": os.fsdecode(b"caf\xe9.laz"),
    "name_like_an_option": "-v.laz",
    "longest_name": "a" * 250 + ".laz",
}
PLACES = ("folder", "folder_of_a_bad_file", "fifo", "fifo_in_folder", "socket", "missing", *_LINKS, *_NAMES)
"""What is no regular file, or has an odd name."""


def odd_place(name, folder):
    """Make one of the ``PLACES`` in a folder, the current one; return the path to give."""
    path = folder / _NAMES.get(name, "x.laz")
    if name in _NAMES:
        path.write_bytes(bases()["laz12.laz"][:1000])
    elif name in _LINKS:
        path.symlink_to(_LINKS[name])
    elif name.startswith("fifo"):
        os.mkfifo(path)
    elif name.startswith("folder"):
        path.mkdir()
    elif name == "socket":
        with socket.socket(socket.AF_UNIX) as end:
            end.bind(path.name)  # the name of a socket has at most a hundred letters
    if name == "folder_of_a_bad_file":
        (path / "inner.laz").write_bytes(b"LASF")
    return folder if name == "fifo_in_folder" else path
