"""The reader of PLY files, text and binary, in chunks."""

import io
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import BinaryIO

import numpy as np

from bumpymap.core import PLY_TYPES, BadInputError
from bumpymap.readers.point_table import PointTable, TableInfo, Wanted, refuse_missing_axes
from bumpymap.readers.source import Location, decoding, open_source, refuse_count, refuse_points

_LINE_LIMIT, _HEADER_LIMIT = 4096, 4096
"""Bytes of a line, and lines of a header, at most. Chosen: several times those of any program's files."""
_AXES = "xyz"
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
    """Return encoding and elements; raise ValueError if the lines are not a PLY header."""
    if len(lines) < 2 or lines[0] != "ply":
        raise ValueError("its first line is not 'ply'")
    match lines[1].split():
        case ["format", encoding, "1.0"] if encoding in _BYTE_ORDERS:
            pass
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
    return encoding, elements


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


class PlyTable(PointTable):
    """A PLY file. Text is read as float64 whatever the header declares, since it may have more digits than a float32.

    ``wanted``: see `Wanted`. Raises BadInputError: not a PLY header, without vertex element or x, y
    and z, or with more than the file can hold.
    """

    nan_is_no_return, searched = False, 1000

    def __init__(self, path: Location, wanted: Wanted) -> None:
        with open_source(path) as stream, decoding(path, "the header"):
            lines, data_at = _lines(stream, path)
            encoding, elements = _parse([line.decode("ascii") for line in lines])
            size = stream.seek(0, io.SEEK_END)
        vertex = _vertices(path, elements)
        before, is_text, order = elements[: elements.index(vertex)], encoding == "ascii", _BYTE_ORDERS[encoding]
        _refuse_lists(path, vertex, [] if is_text else before)
        room = size - data_at
        for element in (*before, vertex):
            row = element.dtype(order)
            least = max(2 * len(element.properties) - 1 if is_text else row.itemsize, 1)
            held = max(room // least, 0)
            if element is vertex:
                refuse_points(path, element.count, held)
            else:
                refuse_count(path, element.count, held, f"'{element.name}'")
            room -= element.count * least
        types = " ".join(dict.fromkeys(row[name].name for name in row.names or () if name.lower() in _AXES))
        kind = f"PLY, {encoding.replace('_', ' ')}, {types}"
        info = TableInfo(kind, size, vertex.count, row, 24 if is_text else row.itemsize, is_text)
        if not is_text:
            data_at += sum(element.count * element.dtype(order).itemsize for element in before)
        skipped = sum(element.count for element in before)
        super().__init__(path, info, data_at, wanted, skipped=skipped, text_type=np.float64)


def _vertices(path: Location, elements: list[PlyElement]) -> PlyElement:
    """Return the element of the vertices; refuse one without points or without x, y and z."""
    vertex = next((head for head in elements if head.name.lower() in {"vertex", "vertices"}), None)
    if vertex is None:
        held = ", ".join(head.name for head in elements) or "nothing"
        raise BadInputError(f"{path} is a PLY file without a 'vertex' element (it holds {held}): no points to map")
    refuse_missing_axes(path, [name for name, code in vertex.properties.items() if code is not None])
    return vertex


def _refuse_lists(path: Location, vertex: PlyElement, before: list[PlyElement]) -> None:
    """Refuse lists in the vertices, or before them, where rows must be of one size."""
    listed = [head for head in (*before, vertex) if head.lists]
    if listed:
        where = "" if listed[0] is vertex else f" of its element '{listed[0].name}', before its vertices,"
        raise BadInputError(
            f"{path} has lists ({', '.join(listed[0].lists)}){where} and is not read: rows of vertices must be of one "
            "size and come before lists. Export it again with vertices first, and without lists in them"
        )
