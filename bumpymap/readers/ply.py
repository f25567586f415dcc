"""The reader of PLY files, text and binary, in chunks."""

import io
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import BinaryIO, NamedTuple

import numpy as np

from bumpymap.core import PLY_TYPES, BadInputError
from bumpymap.readers.point_table import PointTable, TableInfo, TextRows, Wanted
from bumpymap.readers.source import Location, decoding, open_source, refuse_count

__all__ = ["PlyTable"]

_LINE_LIMIT, _HEADER_LIMIT = 4096, 4096
_BYTE_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True, slots=True)
class PlyElement:
    """An element as declared in the header."""

    name: str
    count: int
    properties: dict[str, str | None] = field(default_factory=dict)
    """Name -> NumPy type code of its values, without byte order; None for a list. Lists make rows differ in size."""

    @property
    def lists(self) -> list[str]:
        """Names of the properties that are lists."""
        return [name for name, code in self.properties.items() if code is None]

    def dtype(self, byte_order: str) -> np.dtype[np.void]:
        """Return the dtype of its rows, without lists."""
        return np.dtype([(name, byte_order + code) for name, code in self.properties.items() if code is not None])

    def least_bytes(self, byte_order: str) -> int:
        """Return the minimum size of a row in bytes."""
        return max(2 * len(self.properties) - 1 if byte_order == "=" else self.dtype(byte_order).itemsize, 1)


class PlyHeader(NamedTuple):
    """The contents of a PLY header that are needed to read its vertices."""

    byte_order: str
    """``<`` or ``>``; ``=`` for text."""
    data_at: int
    """Offset of the data, bytes."""
    vertex: PlyElement
    before: tuple[PlyElement, ...]
    """Elements whose data precedes the vertices."""
    columns: tuple[str, str, str]
    """Names of the x, y and z properties."""


def read_ply_header(stream: BinaryIO, path: Location) -> PlyHeader:
    """Read the header of a PLY file from the start of ``stream``.

    Raises
    ------
    BadInputError
        Not a PLY header, or without vertex element or x, y and z.
    """
    lines, data_at = _lines(stream, path)
    with decoding(path, "the header"):
        byte_order, elements = _parse([line.decode("ascii") for line in lines])
    place = next((i for i, head in enumerate(elements) if head.name.lower() in {"vertex", "vertices"}), None)
    if place is None:
        held = ", ".join(head.name for head in elements) or "nothing"
        raise BadInputError(f"{path} is a PLY file without a 'vertex' element (it holds {held}): no points to map")
    vertex = elements[place]
    names = {name.lower(): name for name in reversed(vertex.properties)}
    missing = [axis for axis in "xyz" if axis not in names or vertex.properties[names[axis]] is None]
    if missing:
        held = ", ".join(vertex.properties) or "no properties"
        raise BadInputError(
            f"the vertices of {path} have no {', '.join(missing)}; they have {held}. bumpymap needs the properties "
            "x, y and z"
        )
    if vertex.count == 0:
        raise BadInputError(f"{path} holds no points (0 vertices): nothing to map. Was it exported fully?")
    listed = [head for head in elements[:place] if head.lists and byte_order != "="] + [vertex] * bool(vertex.lists)
    if listed:
        where = "" if listed[0] is vertex else f" of its element '{listed[0].name}', before its vertices,"
        raise BadInputError(
            f"{path} has lists ({', '.join(listed[0].lists)}){where} and is not read: rows of vertices must be of one "
            "size and come before lists. Export it again with vertices first, and without lists in them"
        )
    return PlyHeader(byte_order, data_at, vertex, tuple(elements[:place]), (names["x"], names["y"], names["z"]))


def _lines(stream: BinaryIO, path: Location) -> tuple[list[bytes], int]:
    """Return the lines of the header without comments, and the offset of its end."""
    lines: list[bytes] = []
    while len(lines) < _HEADER_LIMIT:
        line = stream.readline(_LINE_LIMIT)
        if not line:
            break
        line = line.strip()
        if line and not line.startswith((b"comment", b"obj_info")):
            lines.append(line)
        if line == b"end_header":
            return lines, stream.tell()
    raise BadInputError(f"the header of {path} has no end (no line 'end_header'): truncated? Copy or download it again")


def _parse(lines: list[str]) -> tuple[str, list[PlyElement]]:
    """Return byte order and elements; raise ValueError if the lines are not a PLY header."""
    if len(lines) < 2 or lines[0] != "ply":
        raise ValueError("its first line is not 'ply'")
    match lines[1].split():
        case ["format", name, "1.0"] if name in _BYTE_ORDERS:
            byte_order = _BYTE_ORDERS[name]
        case _:
            raise ValueError(f"{lines[1]!r} is not a PLY format; allowed are: {', '.join(_BYTE_ORDERS)}, each 1.0")
    elements: list[PlyElement] = []
    for line in lines[2:-1]:
        match line.split():
            case ["element", name, count] if count.isdecimal():
                known: Iterable[str] = [other.name for other in elements]
                elements.append(PlyElement(name, int(count)))
            case ["property", *words] if elements:
                name, code = _property(words, line)
                known = list(elements[-1].properties)
                elements[-1].properties[name] = code
            case _:
                raise ValueError(f"{line!r} is neither an element with a count nor a property of one")
        if name in known:
            raise ValueError(f"{line!r} declares the name {name} a second time")
    return byte_order, elements


def _property(words: list[str], line: str) -> tuple[str, str | None]:
    """Return the name, and the type code of the values; None for a list."""
    match words:
        case [kind, name] if kind in PLY_TYPES:
            return name, PLY_TYPES[kind]
        case ["list", length, kind, name] if {length, kind} <= set(PLY_TYPES):
            return name, None
    raise ValueError(
        f"{line!r} is neither 'property TYPE NAME' nor 'property list TYPE TYPE NAME'; the types are "
        f"{', '.join(PLY_TYPES)}"
    )


_ENDIAN = {"<": "binary little endian", ">": "binary big endian", "=": "ascii"}


class PlyTable(PointTable):
    """A PLY file. Text is read as float64 whatever the header declares, since it may have more digits than a float32.

    Parameters
    ----------
    path : Path or str
    wanted : dict of str to tuple of str
        See `Wanted`.
    """

    nan_is_no_return, searched = False, 1

    def __init__(self, path: Location, wanted: Wanted) -> None:
        with open_source(path) as stream, decoding(path, "the header"):
            header = read_ply_header(stream, path)
            size = stream.seek(0, io.SEEK_END)
        _refuse_size(header, path, size)
        is_text, row = header.byte_order == "=", header.vertex.dtype(header.byte_order)
        type_names = " ".join(dict.fromkeys(row[name].name for name in header.columns))
        kind = f"PLY, {_ENDIAN[header.byte_order]}, {type_names}"
        row_bytes = 8 * len(header.columns) if is_text else row.itemsize
        info, text, data_at = TableInfo(kind, size, header.vertex.count, row, row_bytes, is_text), None, header.data_at
        if is_text:
            names, before = list(info.find(wanted).values()), sum(element.count for element in header.before)
            dtype, places = np.dtype([(name, np.float64) for name in names]), list(info.types)
            text = TextRows(path, data_at, before, dtype, [places.index(name) for name in names])
        else:
            data_at += sum(element.count * element.dtype(header.byte_order).itemsize for element in header.before)
        super().__init__(path, info, data_at, text)


def _refuse_size(header: PlyHeader, path: Location, size: int) -> None:
    """Check the declared counts against the size of the file, before memory is allocated for them."""
    room = size - header.data_at
    for head in (*header.before, header.vertex):
        least = head.least_bytes(header.byte_order)
        held = room // least
        if held < head.count:
            refuse_count(path, head.count, max(held, 0), "points" if head is header.vertex else f"'{head.name}'")
        room -= head.count * least
