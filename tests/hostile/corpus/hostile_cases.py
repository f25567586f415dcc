"""Damage to tiny valid surveys: cut at every part, other numbers in every field, other words in every text header.

A file that is mapped in spite of it must give the points of the undamaged one, unless the damage is in these. Beside
them stand files that lie in good form, odd but valid ones, and files that are no point cloud.
"""

import io
import os
import socket
import struct
from itertools import pairwise

import lazrs
import numpy as np
from las_files import geokeys, wkt
from pyproj import CRS
from rasterio.io import MemoryFile
from rasterio.transform import Affine

from .files import (
    EITHER,
    HEADER,
    HEADER_1_4,
    MAPPED,
    REFUSED,
    Case,
    bases,
    cloud,
    las_file,
    layout_of,
    number_fields,
    patched,
    pcd_header,
    ply_header,
    renamed,
)

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
