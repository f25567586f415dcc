"""Read the header of a PLY file: its elements, the offset of its data, and the coordinate columns."""

from dataclasses import dataclass, field
from typing import BinaryIO

import numpy as np

from bumpymap.core import PLY_TYPES, BadInputError
from bumpymap.readers.checks import decoding
from bumpymap.readers.source import Location

__all__ = ["PlyElement", "PlyHeader", "PlyProperty", "read_ply_header"]

_LINE_LIMIT, _HEADER_LIMIT = 4096, 4096
_BYTE_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True, slots=True)
class PlyProperty:
    """A property as declared in the header."""

    name: str
    code: str
    """NumPy type code of its values, without byte order."""
    length_code: str | None = None
    """NumPy type code of the list length; None for a scalar."""


@dataclass(frozen=True, slots=True)
class PlyElement:
    """An element as declared in the header."""

    name: str
    count: int
    properties: list[PlyProperty] = field(default_factory=list)

    @property
    def lists(self) -> tuple[bool, ...]:
        """Whether each property is a list."""
        return tuple(prop.length_code is not None for prop in self.properties)

    @property
    def has_lists(self) -> bool:
        """Whether any property is a list, so that rows differ in size."""
        return any(self.lists)

    @property
    def scalars(self) -> list[str]:
        """Names of the properties that are not lists."""
        return [prop.name for prop in self.properties if prop.length_code is None]

    def dtype(self, byte_order: str) -> np.dtype[np.void]:
        """Return the dtype of its rows, without lists."""
        return np.dtype([(p.name, byte_order + p.code) for p in self.properties if p.length_code is None])

    def least_bytes(self, *, text: bool) -> int:
        """Return the minimum size of a row in bytes: a list has at least its length."""
        if text:
            return max(2 * len(self.properties) - 1, 1)
        return max(sum(np.dtype(prop.length_code or prop.code).itemsize for prop in self.properties), 1)


@dataclass(frozen=True, slots=True)
class PlyHeader:
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

    @property
    def text(self) -> bool:
        """Whether the data is text."""
        return self.byte_order == "="

    @property
    def lines_before(self) -> int:
        """Lines between the header and the vertices of a text file."""
        return sum(element.count for element in self.before)


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
    names = {prop.name.lower(): prop for prop in reversed(vertex.properties)}
    missing = [axis for axis in "xyz" if axis not in names or names[axis].length_code is not None]
    if missing:
        held = ", ".join(prop.name for prop in vertex.properties) or "no properties"
        raise BadInputError(
            f"the vertices of {path} have no {', '.join(missing)}; they have {held}. bumpymap needs the properties "
            "x, y and z"
        )
    if vertex.count == 0:
        raise BadInputError(f"{path} holds no points (0 vertices): nothing to map. Was it exported fully?")
    columns = (names["x"].name, names["y"].name, names["z"].name)
    return PlyHeader(byte_order, data_at, vertex, tuple(elements[:place]), columns)


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
                _refuse_twice(name, elements, line)
                elements.append(PlyElement(name, int(count)))
            case ["property", *words] if elements:
                prop = _property(words, line)
                _refuse_twice(prop.name, elements[-1].properties, line)
                elements[-1].properties.append(prop)
            case _:
                raise ValueError(f"{line!r} is neither an element with a count nor a property of one")
    return byte_order, elements


def _property(words: list[str], line: str) -> PlyProperty:
    match words:
        case [kind, name] if kind in PLY_TYPES:
            return PlyProperty(name, PLY_TYPES[kind])
        case ["list", length, kind, name] if kind in PLY_TYPES and PLY_TYPES.get(length, "f")[0] != "f":
            return PlyProperty(name, PLY_TYPES[kind], PLY_TYPES[length])
    raise ValueError(
        f"{line!r} is neither 'property TYPE NAME' nor 'property list WHOLE_TYPE TYPE NAME'; the types are "
        f"{', '.join(PLY_TYPES)}"
    )


def _refuse_twice(name: str, known: list[PlyElement] | list[PlyProperty], line: str) -> None:
    if any(other.name == name for other in known):
        raise ValueError(f"{line!r} declares the name {name} a second time")
