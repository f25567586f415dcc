"""The reader of PLY files: text, binary, and binary with lists, all read in chunks."""

import io
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice
from struct import Struct
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import PLY_TYPES, BadInputError
from bumpymap.readers.point_table import PointTable, SerialRows, TableInfo, TextRows, Wanted, read_rows
from bumpymap.readers.source import Location, OpenFile, decoding, refuse_count

__all__ = ["PlyTable"]

_LINE_LIMIT, _HEADER_LIMIT = 4096, 4096
_BYTE_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True, slots=True)
class PlyElement:
    """An element as declared in the header."""

    name: str
    count: int
    properties: dict[str, tuple[str, str | None]] = field(default_factory=dict)
    """Name -> NumPy type code of its values, without byte order, and that of the list length; None for a scalar."""

    @property
    def lists(self) -> tuple[bool, ...]:
        """True if each property is a list. If any is, rows differ in size."""
        return tuple(length is not None for _, length in self.properties.values())

    def dtype(self, byte_order: str) -> np.dtype[np.void]:
        """Return the dtype of its rows, without lists."""
        kinds = self.properties.items()
        return np.dtype([(name, byte_order + code) for name, (code, length) in kinds if length is None])

    def least_bytes(self, *, text: bool) -> int:
        """Return the minimum size of a row in bytes: a list has at least its length."""
        if text:
            return max(2 * len(self.properties) - 1, 1)
        return max(sum(np.dtype(length or code).itemsize for code, length in self.properties.values()), 1)


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
    missing = [axis for axis in "xyz" if axis not in names or vertex.properties[names[axis]][1] is not None]
    if missing:
        held = ", ".join(vertex.properties) or "no properties"
        raise BadInputError(
            f"the vertices of {path} have no {', '.join(missing)}; they have {held}. bumpymap needs the properties "
            "x, y and z"
        )
    if vertex.count == 0:
        raise BadInputError(f"{path} holds no points (0 vertices): nothing to map. Was it exported fully?")
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
                name, *codes = _property(words, line)
                known = list(elements[-1].properties)
                elements[-1].properties[name] = (codes[0], codes[1] if len(codes) > 1 else None)
            case _:
                raise ValueError(f"{line!r} is neither an element with a count nor a property of one")
        if name in known:
            raise ValueError(f"{line!r} declares the name {name} a second time")
    return byte_order, elements


def _property(words: list[str], line: str) -> tuple[str, ...]:
    """Return the name, and the type codes of the values and, of a list, of its length."""
    match words:
        case [kind, name] if kind in PLY_TYPES:
            return name, PLY_TYPES[kind]
        case ["list", length, kind, name] if kind in PLY_TYPES and PLY_TYPES.get(length, "f")[0] != "f":
            return name, PLY_TYPES[kind], PLY_TYPES[length]
    raise ValueError(
        f"{line!r} is neither 'property TYPE NAME' nor 'property list WHOLE_TYPE TYPE NAME'; the types are "
        f"{', '.join(PLY_TYPES)}"
    )


_STRUCT = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "f4": "f", "f8": "d"}
_BLOCK = 20_000
"""Rows held as Python numbers at a time."""


@dataclass(slots=True)
class ListedRows(SerialRows):
    """Rows of the scalar properties of an element."""

    element: PlyElement
    byte_order: str
    size: int
    """Size of the file, bytes."""
    _walk: Any = field(init=False, default=None)

    def _open(self) -> None:
        self._stream = self.file.open()
        self._stream.seek(self.data_at)
        self._walk = _rows(self._stream, self.element, self.byte_order, self.size)

    def _load(self, count: int) -> NDArray[np.void]:
        dtype = self.element.dtype(self.byte_order)
        blocks = [np.empty(0, dtype)]
        while count > 0:
            rows = list(islice(self._walk, min(count, _BLOCK)))
            if not rows:
                break
            blocks.append(np.array(rows, dtype))
            count -= len(rows)
        return np.concatenate(blocks)


def _rows(stream: BinaryIO, element: PlyElement, byte_order: str, size: int) -> Iterator[tuple[Any, ...]]:
    """Yield the scalar values of each row, up to the end of the file; ``stream`` is left after the last row."""
    runs = _runs(element, byte_order)
    at = stream.tell()
    for _ in range(element.count):
        row: tuple[Any, ...] = ()
        for run, item_bytes in runs:
            data = stream.read(run.size)
            if len(data) < run.size:
                return
            values = run.unpack(data)
            at += run.size
            if item_bytes:
                length, values = values[-1], values[:-1]
                if length < 0:
                    raise ValueError(f"a list of {length} numbers")
                at += length * item_bytes
                if at > size:
                    return
                stream.seek(at)
            row += values
        yield row


def _runs(element: PlyElement, byte_order: str) -> list[tuple[Struct, int]]:
    """Split a row after each list length; return the parts with the item size of the list that follows (0: none)."""
    runs, letters = [], ""
    for code, length in element.properties.values():
        if length is None:
            letters += _STRUCT[code]
        else:
            runs.append((Struct(f"{byte_order}{letters}{_STRUCT[length]}"), np.dtype(code).itemsize))
            letters = ""
    return [*runs, (Struct(f"{byte_order}{letters}"), 0)] if letters else runs


_ENDIAN = {"<": "binary little endian", ">": "binary big endian", "=": "ascii"}


class PlyTable(PointTable):
    """A PLY file. Text is read as float64 whatever the header declares, since it may have more digits than a float32.

    Parameters
    ----------
    file : OpenFile
    wanted : dict of str to tuple of str
        See `Wanted`.
    """

    nan_is_no_return, searched = False, 1

    def __init__(self, file: OpenFile, wanted: Wanted) -> None:
        path, self._file = file.path, file
        with file.open() as stream:
            with decoding(path, "the header"):
                self._header = header = read_ply_header(stream, path)
            size = stream.seek(0, io.SEEK_END)
        text = header.byte_order == "="
        self._dtype = header.vertex.dtype(header.byte_order)
        types = {name: self._dtype[name] for name in self._dtype.names or ()}
        _refuse_size(header, path, size)
        type_names = " ".join(dict.fromkeys(types[name].name for name in header.columns))
        row_bytes = 8 * len(header.columns) if text else self._dtype.itemsize
        kind = f"PLY, {_ENDIAN[header.byte_order]}, {type_names}"
        super().__init__(path, TableInfo(kind, size, header.vertex.count, row_bytes, types, text))
        self._serial: SerialRows | None = None  # rows of a fixed size are read anywhere
        if text:
            names, before = list(self.info.find(wanted).values()), sum(element.count for element in header.before)
            dtype = np.dtype([(name, np.float64) for name in names])
            places = [list(types).index(name) for name in names]
            self._serial = TextRows(file, header.data_at, before, dtype, places, header.vertex.lists)
        elif any(header.vertex.lists):
            self._serial = ListedRows(file, self._vertices_at, header.vertex, header.byte_order, size)

    @property
    def sequential(self) -> bool:
        """See ``PointTable.sequential``."""
        return self._serial is not None

    def rows(self, first: int, count: int) -> Any:
        """See ``PointTable.rows``."""
        if self._serial is not None:
            return self._serial.read(first, count)
        return read_rows(self._file, self._vertices_at, self._dtype, first, count)

    def close(self) -> None:
        """See ``PointTable.close``."""
        if self._serial is not None:
            self._serial.close()

    @cached_property
    def _vertices_at(self) -> int:
        """Offset of the vertices in a binary file; elements with lists that come before are read through."""
        header, at = self._header, self._header.data_at
        for element in header.before:
            if any(element.lists):
                with decoding(self.path, f"the element '{element.name}'"), self._file.open() as stream:
                    stream.seek(at)
                    rows = sum(1 for _ in _rows(stream, element, header.byte_order, self.info.size))
                    refuse_count(self.path, element.count, rows, f"'{element.name}'")
                    at = stream.tell()
            else:
                at += element.count * element.dtype(header.byte_order).itemsize
        return at


def _refuse_size(header: PlyHeader, path: Location, size: int) -> None:
    """Check the declared counts against the size of the file, before memory is allocated for them."""
    room = size - header.data_at
    for head in (*header.before, header.vertex):
        least = head.least_bytes(text=header.byte_order == "=")
        held = room // least
        if held < head.count:
            refuse_count(path, head.count, max(held, 0), "points" if head is header.vertex else f"'{head.name}'")
        room -= head.count * least
