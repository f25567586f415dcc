"""Damage to what LAZ adds: the LASzip record, the chunks, their table."""

import io

import lazrs
import numpy as np

from .bases import bases
from .case import EITHER, REFUSED, Case, field_cases, flipped, patched
from .las_file import layout_of

_RECORD = {
    "compressor": (0, "H", {"0": 0, "4": 4, "65535": 65535}),
    "one_stream": (0, "H", {"1": 1}),
    "coder": (2, "H", {"1": 1, "65535": 65535}),
    "chunk_size": (12, "I", {"0": 0, "1": 1, "2to31": 2**31}),
    "item_count": (32, "H", {"0": 0, "1": 1, "65535": 65535}),
    "item_type": (34, "H", {"5": 5, "11": 11, "99": 99, "65535": 65535}),
    "item_size": (36, "H", {"0": 0, "1": 1, "one_more": 21, "65535": 65535}),
    "item_version": (38, "H", {"0": 0, "4": 4, "65535": 65535}),
}
"""Fields of the LASzip record."""
_LOOSE = dict.fromkeys(("one_stream", "coder", "chunk_size", "item_type"), EITHER)
"""Where a decoder goes by something else than the field, the points must be the right ones."""
# Chunks of 2^32 - 1 points are the sign for chunks of any size: in a file of such, no lie. In the other, chunks of
# other sizes than the record says are one, be it by a little.
_FIXED = {"chunk_size": (12, "I", {"2to32": 2**32 - 1, "79": 79, "81": 81, "400": 400})}
_WRONG = dict.fromkeys(("chunk_size-79", "chunk_size-81", "chunk_size-400"), REFUSED)
_LAYERS = {"0": 0, "2to32": 2**32 - 1}


def laz_cases():
    """Every case of the compression."""
    made = []
    for name in ("laz12.laz", "laz14v.laz"):
        made += _record(name) + _table(name) + _entries(name) + _chunks(name)
    return [*made, _endless()]


def _record(name):
    data, stem = bases()[name], name.removesuffix(".laz")
    at = data.index(b"laszip encoded") - 2
    made = field_cases(f"{stem}-laszip.laz", data, _RECORD, at + 54, exits=_LOOSE, base=name)
    if name == "laz12.laz":
        made += field_cases(f"{stem}-laszip.laz", data, _FIXED, at + 54, exits=_LOOSE | _WRONG, base=name)
    gone = data.replace(b"laszip encoded", b"laszip nothing")
    return [
        *made,
        Case(f"{stem}-laszip-missing.laz", gone),
        Case(f"{stem}-laszip-short.laz", patched(data, at + 20, "H", 10)),
    ]


def _endless():
    """Times that go on and on: each asks the decoder of point formats 1 and 3 for one more, deeper in the stack.

    A large chunk, since how deep it goes follows the bytes of the chunk.
    """
    data = bases(20_000)["laz12.laz"]
    start, end, _ = layout_of(data).chunks[0]
    at = start + 40
    return Case("laz12-chunk_1-endless_times.laz", data[:at] + b"\xbe\x04" + b"\xff" * (end - at - 2) + data[end:])


def _table(name):
    """Tables that are not where the file says."""
    data, stem = bases()[name], name.removesuffix(".laz")
    layout = layout_of(data)
    places = {
        "0": 0,
        "minus_1": -1,
        "minus_2to63": -(2**63),
        "points": layout.points_at,
        "first_chunk": layout.points_at + 8,
        "mid_points": (layout.points_at + layout.table_at) // 2,
        "one_early": layout.table_at - 1,
        "one_late": layout.table_at + 1,
        "last_byte": len(data) - 1,
        "end": len(data),
        "beyond": 2**40,
        "2to63": 2**63 - 1,
    }
    counts = {"0": 0, "4": 4, "6": 6, "10to7": 10**7, "2to31": 2**31, "2to32": 2**32 - 1}
    fields = {"table_at": (layout.points_at, "q", places), "table_count": (layout.table_at + 4, "I", counts)}
    made = field_cases(name, data, fields)
    for seed in range(6):
        place = layout.table_at + 8 + seed % (layout.table_end - layout.table_at - 8)
        made.append(Case(f"{stem}-table-flip_{seed}.laz", flipped(data, [place], seed), EITHER, name))
    return made


def with_table(data, entries):
    """Replace the chunk table: ``entries`` of (points, bytes), with the coding of a valid table."""
    layout = layout_of(data)
    record = next(data[body:end] for start, body, end in layout.vlrs if data[start + 2 :].startswith(b"laszip"))
    out = io.BytesIO()
    lazrs.write_chunk_table(out, entries, lazrs.LazVlr(record))
    return data[: layout.table_at] + out.getvalue() + data[layout.table_end :]


def _entries(name):
    """Tables that say untruths in good form."""
    data, stem = bases()[name], name.removesuffix(".laz")
    held = [(points, end - start) for start, end, points in layout_of(data).chunks]
    (many, size), (_, after) = held[0], held[1]
    spoilt = {
        "bytes_0": [(many, 0), *held[1:]],
        "bytes_one_less": [(many, size - 1), *held[1:]],
        "bytes_swapped": [(many, after), (held[1][0], size), *held[2:]],
        "bytes_2to31": [(many, 2**31 - 1), *held[1:]],
        "bytes_2to32": [(many, 2**32 - 1), *held[1:]],
        "one_gone": held[:-1],
        "ten_thousand": held + [(1, 1)] * 10_000,
    }
    exits = {"bytes_one_less": EITHER, "bytes_swapped": EITHER}
    if name == "laz14v.laz":
        spoilt |= {
            "points_0": [(0, size), *held[1:]],
            "points_one_less": [(many - 1, size), *held[1:]],
            "points_swapped": [(held[1][0], size), (many, after), *held[2:]],
            "points_2to31": [(2**31 - 1, size), *held[1:]],
            "points_2to32": [(2**32 - 1, size), *held[1:]],
            "points_all_2to32": [(2**32 - 1, bytes_) for _, bytes_ in held],
        }
    return [
        Case(f"{stem}-entries-{word}.laz", with_table(data, entries), exits.get(word, REFUSED), name)
        for word, entries in spoilt.items()
    ]


def _chunks(name):
    """Spoil chunk 3 of 5: its first point, which is stored plainly, and seeded bytes of its coded rest."""
    data, stem = bases()[name], name.removesuffix(".laz")
    start, end, _ = layout_of(data).chunks[2]
    made = [
        Case(f"{stem}-chunk_3-far_point.laz", patched(data, start, "i", 2**31 - 1)),
        # Point formats 0 to 5 code their points without any length: zeros are coded points too.
        Case(f"{stem}-chunk_3-zeros.laz", data[:start] + bytes(end - start) + data[end:], EITHER),
        Case(f"{stem}-chunk_3-ones.laz", data[:start] + b"\xff" * (end - start) + data[end:]),
    ]
    for seed in range(6):
        places = np.random.default_rng(seed).integers(start, end, 1 + seed).tolist()
        made.append(Case(f"{stem}-chunk_3-flip_{seed}.laz", flipped(data, places, seed), EITHER))
    if name == "laz14v.laz":
        # Point formats 6 and up: a count, then the bytes of each layer, behind the first point of 36 bytes. Layers that
        # nobody decodes may lie; those that are decoded must be told from the right ones.
        fields = {f"layer_{layer}": (40 + 4 * layer, "I", _LAYERS) for layer in range(10)}
        fields["chunk_points"] = (36, "I", {"0": 0, "more": "+1", "2to32": 2**32 - 1})
        made += field_cases(name, data, fields, start, default=EITHER, base=name)
    return made
