"""One hostile file, and small tools to make it from a valid one."""

import struct
from dataclasses import dataclass

import numpy as np

REFUSED = frozenset({3})
"""A lie about the structure: must be noticed."""
EITHER = frozenset({0, 3})
"""What is left may still be a survey."""
MAPPED = frozenset({0})
"""Odd, but a survey."""


@dataclass(frozen=True, slots=True)
class Case:
    """A file and what ``bumpymap map`` may make of it."""

    name: str
    """File name; tells what is wrong."""
    data: bytes
    exits: frozenset[int] = REFUSED
    base: str | None = None
    """The valid survey whose points must come out, all of them and no others, where the file is mapped at all."""


def patched(data, place, layout, *values):
    """Overwrite little-endian values at a place."""
    out = bytearray(data)
    struct.pack_into("<" + layout, out, place, *values)
    return bytes(out)


def flipped(data, places, seed):
    """Spoil bytes: each becomes another one."""
    out = bytearray(data)
    mask = np.random.default_rng(seed).integers(1, 256, len(places)).tolist()
    for place, bits in zip(places, mask, strict=True):
        out[place] ^= bits
    return bytes(out)


def renamed(name, word):
    """Give the name of a file with a word behind its stem."""
    stem, dot, suffix = name.partition(".")
    return f"{stem}-{word}{dot}{suffix}"


def field_cases(name, data, fields, at=0, *, exits=None, default=REFUSED, base=None):
    """Cases of a file with other numbers in its fields.

    ``fields`` maps a field to its place behind ``at``, its layout and values by word; a text such as ``+1`` is added to
    what stands there. ``exits`` maps fields, or ``field-word``, to what may become of them.
    """
    made, exits = [], exits or {}
    for field, (place, layout, values) in fields.items():
        own = data[at + place : at + place + struct.calcsize("<" + layout)]
        for word, value in values.items():
            told = int.from_bytes(own, "little") + int(value) if isinstance(value, str) else value
            spoilt = patched(data, at + place, layout, told)
            allowed = exits.get(f"{field}-{word}", exits.get(field, default))
            made.append(Case(renamed(name, f"{field}-{word}"), spoilt, allowed, base))
    return made


def cut(name, data, places):
    """Cases of a file that ends early; ``places`` maps a word to the length that is left."""
    return [Case(renamed(name, f"cut-{word}"), data[:length]) for word, length in places.items()]
