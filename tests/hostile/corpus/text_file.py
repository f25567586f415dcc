"""PLY and PCD files byte by byte."""

import struct

import lzf
import numpy as np

from .las_file import ORIGIN  # noqa: F401 (finds the helpers)

from ply_files import ply_bytes  # isort: skip


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
