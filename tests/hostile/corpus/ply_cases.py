"""Damage to PLY: headers that promise too much, rows that do not keep it."""

import struct

import numpy as np

from .bases import bases
from .case import EITHER, MAPPED, REFUSED, Case, cut, renamed
from .las_file import cloud
from .text_file import ply_file, ply_header

_XYZ = ["double x", "double y", "double z"]
_COUNT = b"element vertex 400"


def ply_cases():
    """Every case of PLY."""
    return _counts() + _headers() + _rows() + _cuts() + _values()


def _counts():
    wild = {"10to12": 10**12, "2to63": 2**63, "10to30": 10**30, "one_more": 401, "negative": -5, "0": 0, "word": "many"}
    return [
        Case(renamed(name, f"count-{word}"), bases()[name].replace(_COUNT, f"element vertex {value}".encode()))
        for name in ("text.ply", "little.ply")
        for word, value in wild.items()
    ]


def _headers():
    row = struct.pack("<3d", 1.0, 2.0, 3.0)
    little, many = "binary_little_endian", [f"double x{index}" for index in range(3000)]
    headers = {
        "no_vertex": ply_header(little, [("face", 1, _XYZ)]) + row,
        "no_elements": ply_header(little, []) + row,
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
    exits = {"version_9": EITHER}
    return [Case(f"header-{word}.ply", data, exits.get(word, REFUSED)) for word, data in headers.items()]


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
        "hex": text + b"0x1 0x2 0x3\n" * 3,
        "zero_bytes": text + bytes(60),
        "not_ascii": text + "1 2 \u00b3\n".encode() * 3,
        "endless_row": text + b"1 " * 3_000_000,
        "long_number": text + b"1 2 " + b"9" * 1_000_000 + b"\n1 2 3\n1 2 3\n",
    }
    return made + [Case(f"rows-{word}.ply", data) for word, data in rows.items()]


def _cuts():
    made = []
    for name in ("text.ply", "little.ply", "big.ply"):
        data = bases()[name]
        head = data.index(b"end_header")
        body = data.index(b"\n", head) + 1
        places = {"format": 6, "mid_header": head // 2, "end_header": head, "header": body, "mid_row": body + 9}
        places |= {"mid_data": (body + len(data)) // 2}
        if name != "text.ply":  # without its last byte, its line end, a text is whole
            places |= {"last_byte": len(data) - 1}
        made += cut(name, data, places)
    return made


def _values():
    made = []
    for word, value in {"nan": np.nan, "inf": np.inf, "1e300": 1e300, "4e9": 4e9}.items():
        for axis, name in enumerate("xyz"):
            xyz = cloud(100)
            xyz[17, axis] = value
            made.append(Case(f"values-{name}-{word}.ply", ply_file(xyz, "binary_little_endian")))
        made.append(Case(f"values-all-{word}.ply", ply_file(np.full((100, 3), value), "ascii")))
    same, wide = np.tile(cloud(1), (100, 1)), cloud(100)
    wide[0, 0] += 4e8
    return [
        *made,
        Case("values-same.ply", ply_file(same, "binary_big_endian"), MAPPED),
        Case("values-one.ply", ply_file(same[:1], "ascii"), MAPPED),
        Case("values-too_wide.ply", ply_file(wide, "binary_big_endian")),
        Case("values-trailing_bytes.ply", ply_file(cloud(100), "binary_big_endian") + bytes(100), MAPPED),
        Case("values-all_noise.ply", _all_noise()),
    ]


def _all_noise():
    data = ply_file(cloud(100), "ascii")
    body = data.index(b"end_header")
    return data[:body] + data[body:].replace(b" 2\n", b" 7\n")
