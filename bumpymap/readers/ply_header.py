"""The header of a PLY file: its elements, where its data starts, which columns are coordinates.

plyfile parses the header; the counts are set to 0 for it, so that it reads no data and a lie costs nothing.
"""

import io
import re
from dataclasses import dataclass
from typing import Any

from plyfile import PlyData, PlyListProperty

from bumpymap.errors import BadInputError
from bumpymap.readers.checks import decoding
from bumpymap.readers.columns import CLASS_COLUMNS
from bumpymap.readers.source import Location, open_source

__all__ = ["PlyElementHead", "PlyHeader", "read_ply_header"]

_LINE_LIMIT, _HEADER_LIMIT = 4096, 4096
_ELEMENT = re.compile(rb"^element\s+(\S+)\s+(\d+)$")


@dataclass(frozen=True, slots=True)
class PlyElementHead:
    """One element as the header declares it."""

    name: str
    count: int
    element: Any
    """plyfile's description, without data."""

    @property
    def has_lists(self) -> bool:
        """Whether rows differ in length."""
        return any(isinstance(prop, PlyListProperty) for prop in self.element.properties)


@dataclass(frozen=True, slots=True)
class PlyHeader:
    """What the readers of PLY data need."""

    text: bool
    byte_order: str
    """``<`` or ``>``; ``=`` where the file is text."""
    data_at: int
    """Byte where the data starts."""
    vertex: PlyElementHead
    before: tuple[PlyElementHead, ...]
    """Elements whose data comes first."""
    columns: tuple[str, str, str]
    """Names of the x, y and z properties."""
    class_column: str | None
    lines: tuple[bytes, ...]
    """The header up to the vertex element and its properties, ``end_header`` added; comments left out."""


def read_ply_header(path: Location) -> PlyHeader:
    """Read the header of a PLY file.

    Raises
    ------
    BadInputError
        Not a PLY header, no vertex element, no x, y and z.
    """
    lines, data_at = _lines(path)
    counts = [(found[1].decode("ascii", "replace"), int(found[2])) for found in map(_ELEMENT.match, lines) if found]
    empty = [_ELEMENT.sub(rb"element \1 0", line) for line in lines]
    with decoding(path, "the header"):
        parsed = PlyData.read(io.BytesIO(b"\n".join(empty) + b"\n"))
    heads = [PlyElementHead(name, count, parsed[name]) for name, count in counts]
    place = next((i for i, head in enumerate(heads) if head.name.lower() in {"vertex", "vertices"}), None)
    if place is None:
        held = ", ".join(head.name for head in heads) or "nothing"
        raise BadInputError(f"{path} is a PLY file without a 'vertex' element (it holds {held}): no points to map")
    vertex = heads[place]
    names = {prop.name.lower(): prop for prop in reversed(vertex.element.properties)}
    missing = [axis for axis in "xyz" if axis not in names or isinstance(names[axis], PlyListProperty)]
    if missing:
        held = ", ".join(prop.name for prop in vertex.element.properties) or "no properties"
        raise BadInputError(
            f"the vertices of {path} have no {', '.join(missing)}; they have {held}. bumpymap needs the properties "
            "x, y and z"
        )
    if vertex.count == 0:
        raise BadInputError(f"{path} holds no points (0 vertices): nothing to map. Was it exported fully?")
    klass = next((names[name].name for name in CLASS_COLUMNS if name in names), None)
    return PlyHeader(
        parsed.text,
        parsed.byte_order,
        data_at,
        vertex,
        tuple(heads[:place]),
        (names["x"].name, names["y"].name, names["z"].name),
        klass,
        _up_to(lines, place),
    )


def _lines(path: Location) -> tuple[list[bytes], int]:
    lines: list[bytes] = []
    with open_source(path) as stream:
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


def _up_to(lines: list[bytes], place: int) -> tuple[bytes, ...]:
    starts = [i for i, line in enumerate(lines) if _ELEMENT.match(line)]
    end = starts[place + 1] if place + 1 < len(starts) else len(lines) - 1
    return (*lines[:end], b"end_header")
