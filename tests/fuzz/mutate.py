"""Structure-aware damage: a valid survey and a list of edits, each "these bytes instead of those".

A list of edits can be shortened one by one, which is how a finding becomes small.
"""

import struct
from dataclasses import dataclass

import numpy as np
from corpus.files import HEADER, HEADER_1_4, bases, layout_of
from las_files import ENTRY

Edit = tuple[int, int, bytes]
"""Start, end and what stands there instead; each edit counts places in what the edits before it left."""

_INTEGERS = (0, 1, 2, 7, 100, *(2**bits - below for bits in (15, 16, 31, 32, 40, 62, 63, 64) for below in (1, 0)))
_REALS = (0.0, -0.0, 1.0, -1.0, float("nan"), float("inf"), -float("inf"), 1e300, -1e300, 1e-300, 4e9, -4e9, 1e16)
_WORDS = (
    b"0", b"1", b"-1", b"2", b"4", b"8", b"41", b"400000", b"4294967295", b"9223372036854775807", b"1e12",
    b"nan", b"inf",
    b"x", b"y", b"z", b"class", b"list", b"uchar", b"int", b"float", b"double", b"uint", b"vertex", b"face", b"ascii",
    b"binary", b"binary_compressed", b"binary_little_endian", b"binary_big_endian", b"property", b"element", b"F", b"U",
    b"I", b"", b"\xff", b"\n", b"end_header", b"DATA", b"COUNT", b"SIZE", b"POINTS", b"comment",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Start:
    """A valid survey to damage."""

    name: str
    data: bytes
    fields: tuple[tuple[int, str], ...]
    """Place and layout (little endian) of the numbers that its structure is made of."""
    text_end: int
    """Length of the header, where that is text; 0 elsewhere."""


def starts():
    """Give every valid survey, of 40 points each."""
    return [_start(name, data) for name, data in bases(40).items()]


def applied(data: bytes, edits) -> bytes:
    """Make the edits, in order; what lies behind the end is left out."""
    for start, end, new in edits:
        data = data[:start] + new + data[end:]
    return data


def mutated(start: Start, others: list[Start], rng: np.random.Generator) -> list[Edit]:
    """Return one to four edits."""
    edits, data = [], start.data
    for _ in range(int(rng.integers(1, 5))):
        edit = _edit(data, start, others, rng)
        data = applied(data, [edit])
        edits.append(edit)
    return edits


def _edit(data, start, others, rng):
    kind = rng.random()
    if start.fields and kind < 0.55:
        return _field_edit(data, start, rng)
    if start.text_end and kind < 0.6:
        return _word_edit(data, start, rng)
    if kind < 0.75:
        return _byte_edit(data, rng)
    return _block_edit(data, others, rng)


def _field_edit(data, start, rng):
    place, layout = start.fields[int(rng.integers(len(start.fields)))]
    size = struct.calcsize("<" + layout)
    if layout == "d":
        return place, place + size, struct.pack("<d", _REALS[int(rng.integers(len(_REALS)))])
    own = int.from_bytes(data[place : place + size], "little")
    near = (own + 1, own - 1, own * 2, own // 2, len(data), len(data) - 8, own ^ (1 << int(rng.integers(8 * size))))
    choices = _INTEGERS if rng.random() < 0.5 else near
    value = choices[int(rng.integers(len(choices)))] % 256**size
    return place, place + size, value.to_bytes(size, "little")


def _word_edit(data, start, rng):
    """Replace, remove or double a word or a line of a text header."""
    head = data[: start.text_end]
    line_end = rng.random() < 0.4
    ends = [i for i, byte in enumerate(head) if byte in (b"\n" if line_end else b" \n")]
    if len(ends) < 2:
        return _byte_edit(data, rng)
    which = int(rng.integers(len(ends) - 1))
    first, last = ends[which] + 1, ends[which + 1]
    kind = int(rng.integers(3))
    if kind == 0:
        return first, last, _WORDS[int(rng.integers(len(_WORDS)))]
    return (first, last + 1, b"") if kind == 1 else (first, first, data[first : last + 1])


def _byte_edit(data, rng):
    place = int(rng.integers(max(len(data), 1)))
    new = (
        bytes([int(rng.integers(256))])
        if rng.random() < 0.5
        else bytes([(data[place] if data else 0) ^ (1 << int(rng.integers(8)))])
    )
    return place, place + 1, new


def _block_edit(data, others, rng):
    """Cut the end off; remove, double, blank or exchange a block; take one from another survey."""
    place = int(rng.integers(max(len(data), 1)))
    size = int(2 ** rng.uniform(0, 9))
    kind = int(rng.integers(6))
    if kind == 0:
        return place, len(data), b""
    if kind == 1:
        return place, place + size, b""
    if kind == 2:
        return place, place, data[place : place + size]
    if kind == 3:
        return place, place + size, (b"\0", b"\xff")[int(rng.integers(2))] * size
    if kind == 4:
        source = int(rng.integers(max(len(data), 1)))
        return place, place + size, data[source : source + size]
    other = others[int(rng.integers(len(others)))].data
    source = int(rng.integers(len(other)))
    return place, place + size, other[source : source + size]


def _start(name, data):
    if not name.endswith((".las", ".laz")):
        mark = b"end_header" if name.endswith(".ply") else b"DATA"
        end = data.index(b"\n", data.index(mark)) + 1
        packed = ((end, "I"), (end + 4, "I")) if name == "packed.pcd" else ()
        return Start(name, data, packed, end)
    return Start(name, data, tuple(_las_fields(data)), 0)


def _las_fields(data):
    layout = layout_of(data)
    known = HEADER | (HEADER_1_4 if data[25] >= 4 else {})
    yield from ((place, form) for place, form in known.values() if form[-1] in "BHIQd" and form[0] not in "123456789")
    for start, body, end in layout.vlrs:
        yield from ((start + 2, "B"), (start + 18, "H"), (start + 20, "H"))
        yield from ((place, "H") for place in range(body, min(end, body + 64) - 1, 2))
    for start, body, end in layout.evlrs:
        yield from ((start + 2, "B"), (start + 18, "H"), (start + 20, "Q"))
        for entry in range(body, end - ENTRY.size + 1, ENTRY.size):
            yield from ((entry + at, form) for at, form in zip((0, 4, 8, 12, 16, 24, 28), "IIIIQII", strict=True))
    if not layout.chunks:
        yield from ((layout.points_at + at, "I") for at in range(0, 68, 4))
        return
    yield layout.points_at, "Q"
    yield from ((layout.table_at + at, "I") for at in (0, 4))
    yield from ((place, "B") for place in range(layout.table_at + 8, layout.table_end))
    for start, _, _ in layout.chunks:
        yield from ((start + at, "I") for at in (0, 4, 8, 30, 34, 38, *range(36, 80, 4)))
