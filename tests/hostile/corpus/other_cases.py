"""Damage to PLY and PCD: headers that promise too much, rows that do not keep it; and files of other kinds."""

import io
import os
import socket
import struct
import zipfile

import numpy as np

from .files import (
    EITHER,
    MAPPED,
    REFUSED,
    Case,
    bases,
    cloud,
    cut,
    field_cases,
    patched,
    pcd_file,
    pcd_header,
    ply_file,
    ply_header,
    renamed,
)

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


_PCD = ("text.pcd", "binary.pcd", "packed.pcd")
_LINES = {
    "POINTS": {"one_more": 401, "10to12": 10**12, "2to63": 2**63, "negative": -1, "0": 0, "word": "many", "gone": None},
    "FIELDS": {"no_z": "x y w intensity", "one_less": "x y z", "x_twice": "x x y z", "empty": "", "gone": None},
    "SIZE": {"0": "0 8 8 4", "3": "3 8 8 4", "10to9": "1000000000 8 8 4", "negative": "-8 8 8 4", "gone": None},
    "TYPE": {"unknown": "Q F F F", "one_less": "F F F", "gone": None},
    "COUNT": {"0": "0 1 1 1"},
    "DATA": {"unknown": "zipped", "gone": None},
}
_COUNTS = {"text": 2**63, "binary": 10**6, "packed": 10**9}
"""Values a point in one field. One lie an encoding: the header is read by the same code."""
_LOOSE = {
    "WIDTH": {"0": 0, "10to12": 10**12, "one_less": 399, "negative": -1, "gone": None},
    "HEIGHT": {"0": 0, "2to63": 2**63, "2": 2, "gone": None},
    "VERSION": {"9": 9, "word": "new", "gone": None},
    "VIEWPOINT": {"nan": "nan 0 0 1 0 0 0", "one_less": "0 0 0 1 0 0", "words": "a b c d e f g", "gone": None},
}
"""Lines beside the points: a reader may do without them."""


def pcd_cases():
    """Every case of PCD."""
    made = [case for name in _PCD for case in _lines(name) + _pcd_cuts(name)]
    return made + _packed() + _pcd_values() + _pcd_headers()


def _lines(name):
    data, stem = bases()[name], name.removesuffix(".pcd")
    encoding = {"text": "ascii", "binary": "binary", "packed": "binary_compressed"}[stem]
    body = data[len(pcd_header(400, encoding)) :]
    wild = {"COUNT": _LINES["COUNT"] | {str(_COUNTS[stem]): f"1 1 1 {_COUNTS[stem]}"}}
    return [
        Case(f"pcd_{stem}-{line}-{word}.pcd", pcd_header(400, encoding, **{line: value}) + body, *allowed)
        for lines, allowed in ((_LINES | wild, ()), (_LOOSE if stem == "binary" else {}, (EITHER, name)))
        for line, choices in lines.items()
        for word, value in choices.items()
    ]


def _pcd_cuts(name):
    data = bases()[name]
    body = data.index(b"\n", data.index(b"DATA")) + 1
    places = {"mid_header": body // 2, "header": body, "mid_row": body + 5, "mid_data": (body + len(data)) // 2}
    if name != "text.pcd":  # without its last byte, its line end, a text is whole
        places |= {"last_byte": len(data) - 1}
    return cut(f"pcd_{name}", data, places)


def _packed():
    """Packed points: how long they are packed, and unpacked, stands before them."""
    data = bases()["packed.pcd"]
    at = len(pcd_header(400, "binary_compressed"))
    fields = {
        "packed": (0, "I", {"0": 0, "one_less": "-1", "one_more": "+1", "2to32": 2**32 - 1}),
        "plain": (4, "I", {"0": 0, "one_less": "-1", "one_more": "+1", "2to31": 2**31, "2to32": 2**32 - 1}),
        "body": (8, "8s", {"0": bytes(8), "255": b"\xff" * 8}),
    }
    # Bytes too many may be ignored, and a spoilt byte may still unpack to numbers.
    loose = ("packed-one_less", "plain-one_more", "plain-2to31", "plain-2to32", "body-0", "body-255")
    made = field_cases("pcd_packed.pcd", data, fields, at, exits=dict.fromkeys(loose, EITHER))
    # All of it claims: 2^32 - 1 bytes of 153 million points.
    head = pcd_header((2**32 - 1) // 28, "binary_compressed")
    return [*made, Case("pcd_packed-bomb.pcd", head + patched(data[at:], 4, "I", 2**32 - 1))]


def _pcd_values():
    made = []
    for word, value in {"nan": np.nan, "inf": np.inf, "1e300": 1e300, "4e9": 4e9}.items():
        made.append(Case(f"pcd_values-all-{word}.pcd", pcd_file(np.full((60, 3), value), "binary")))
    some = cloud(100)
    some[:50] = np.nan
    return [*made, Case("pcd_values-half-nan.pcd", pcd_file(some, "binary_compressed"), MAPPED)]


def _pcd_headers():
    return [
        Case("pcd_header-endless_line.pcd", b"# .PCD v0.7\nVERSION 0.7\nFIELDS " + b"x " * 5_000_000),
        Case("pcd_header-endless_lines.pcd", b"# .PCD v0.7\n" + b"VERSION 0.7\n" * 500_000),
        Case("pcd_header-zero_bytes.pcd", b"# .PCD v0.7\n" + bytes(3000)),
        Case(
            "pcd_header-not_utf8.pcd",
            pcd_header(1, "ascii").replace(b"intensity", b"\xff\xfe") + b"1 2 3 4\n",
            EITHER,
        ),
    ]


def foreign_cases():
    """Every case of a file that is no point cloud, under the name of one."""
    pointer = b"version https://git-lfs.github.com/spec/v1\noid sha256:" + b"a" * 64 + b"\nsize 132735411\n"
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr(zipfile.ZipInfo("site.las"), bases()["las12.las"])
    rng = np.random.default_rng(5)
    held = {
        "lfs_pointer.laz": pointer,
        "lfs_pointer.ply": pointer,
        "page.las": b"<!DOCTYPE html><html><body>404 Not Found</body></html>",
        "empty.laz": b"",
        "zeros_behind_signature.laz": b"LASF" + bytes(100_000),
        "ones_behind_signature.las": b"LASF" + b"\xff" * 100_000,
        "random_behind_signature.las": b"LASF" + rng.bytes(50_000),
        "random_behind_ply.ply": b"ply\n" + rng.bytes(50_000),
        "random_behind_pcd.pcd": b"# .PCD v0.7\n" + rng.bytes(50_000),
        "archive.laz": packed.getvalue(),
        "gzip.las": b"\x1f\x8b\x08\0" + rng.bytes(300),
        "table.ply": b"X Y Z\n1 2 3\n",
        "utf16.ply": "ply\nformat ascii 1.0\n".encode("utf-16"),
        "crlf_mangled.laz": bases()["laz12.laz"].replace(b"\n", b"\r\n"),
        "twice.ply": b"ply\n" * 2000,
    }
    return [Case(f"foreign-{name}", data) for name, data in held.items()]


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
