"""The number types of the PLY format, and a writer for PLY point clouds. The reader is in `bumpymap.readers`."""

from collections.abc import Sequence
from typing import Any, BinaryIO

from numpy.typing import NDArray

_NAMES = {
    "i1": ("char", "int8"),
    "u1": ("uchar", "uint8"),
    "i2": ("short", "int16"),
    "u2": ("ushort", "uint16"),
    "i4": ("int", "int32"),
    "u4": ("uint", "uint32"),
    "f4": ("float", "float32"),
    "f8": ("double", "float64"),
}
"""NumPy type code without byte order -> type name, and the name that newer files use."""
PLY_TYPES = {name: code for code, names in _NAMES.items() for name in names}
"""Type name in a header -> NumPy type code without byte order."""


def write_vertices(vertex: NDArray[Any], comments: Sequence[str], stream: BinaryIO) -> None:
    """Write points as binary little-endian PLY, one element ``vertex``.

    Parameters
    ----------
    vertex : structured array (n,)
        Each field becomes a property; its type must be one of ``PLY_TYPES``, in any byte order.
    comments : sequence of str
        One line each, ASCII.
    stream : binary file
    """
    kinds = [(name, vertex.dtype[name].str[1:]) for name in vertex.dtype.names or ()]
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {text}" for text in comments)]
    lines += [f"element vertex {len(vertex)}", *(f"property {_NAMES[code][0]} {name}" for name, code in kinds)]
    stream.write("\n".join([*lines, "end_header", ""]).encode("ascii"))
    stream.write(vertex.astype([(name, f"<{code}") for name, code in kinds], copy=False).tobytes())
