"""PLY files number by number, from the definition of the format: nothing of the package takes part."""

import struct

import numpy as np

__all__ = ["ply_bytes", "read_vertices", "write_ply"]

_FORMATS = {"=": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}
_KINDS = {
    "b": "char", "B": "uchar", "h": "short", "H": "ushort", "i": "int", "I": "uint", "f": "float", "d": "double",
}  # fmt: skip
"""Letter of the module struct: name in a header."""


def write_ply(path, vertex, *, order="<", before=(), after=(), name="vertex"):
    """Write a file; a column of objects holds lists of int, whose lengths are uchar."""
    path.write_bytes(ply_bytes([*before, (name, vertex), *after], order))
    return path


def ply_bytes(elements, order):
    """Bytes of a file with elements (name, structured array); order ``=`` is text."""
    lines = ["ply", f"format {_FORMATS[order]} 1.0", "comment made by hand"]
    data = []
    for name, rows in elements:
        letters = [rows.dtype[column].char for column in rows.dtype.names]
        lines.append(f"element {name} {len(rows)}")
        lines += [
            f"property {'list uchar int' if letter == 'O' else _KINDS[letter]} {column}"
            for column, letter in zip(rows.dtype.names, letters, strict=True)
        ]
        data += [_row(row, letters, order) for row in rows.tolist()]
    return "\n".join([*lines, "end_header", ""]).encode() + b"".join(data)


def read_vertices(path):
    """Rows of a binary little-endian file that holds one element, ``vertex``, without lists."""
    head, _, body = path.read_bytes().partition(b"end_header\n")
    lines = head.decode("ascii").splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    lines = [line for line in lines[2:] if not line.startswith("comment ")]
    element, vertex, count = lines[0].split()
    assert (element, vertex) == ("element", "vertex")
    letters = {name: letter for letter, name in _KINDS.items()}
    words = [line.split() for line in lines[1:]]
    assert {word for word, _, _ in words} == {"property"}
    dtype = np.dtype([(name, f"<{np.dtype(letters[kind]).str[1:]}") for _, kind, name in words])
    assert len(body) == int(count) * dtype.itemsize
    return np.frombuffer(body, dtype)


def _row(values, letters, order):
    """Text, or bytes, of one row."""
    flat, kinds = [], ""
    for value, letter in zip(values, letters, strict=True):
        entries = [len(value), *(int(entry) for entry in value)] if letter == "O" else [value]
        flat += entries
        kinds += "B" + "i" * (len(entries) - 1) if letter == "O" else letter
    if order == "=":
        return (" ".join(repr(value) for value in flat) + "\n").encode()
    return struct.pack(order + kinds, *flat)
