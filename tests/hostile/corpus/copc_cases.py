"""Damage to what COPC adds: the info record and the hierarchy."""

import struct
from functools import partial

from .bases import utm
from .case import EITHER, REFUSED, Case, cut, patched
from .copc_file import ENTRY, copc_file
from .las_file import cloud, layout_of

__all__ = ["copc_cases"]

_NAN, _INF = float("nan"), float("inf")
_INFO = {
    "centre": (0, "d", {"nan": _NAN, "4e9": 4e9}),
    "half": (24, "d", {"0": 0.0, "negative": -1.0, "nan": _NAN, "inf": _INF, "1e300": 1e300}),
    "spacing": (32, "d", {"0": 0.0, "nan": _NAN}),
    "root_at": (40, "Q", {"0": 0, "points": 1500, "beyond": 2**40, "2to63": 2**63 - 1, "2to64": 2**64 - 1}),
    "root_size": (48, "Q", {"0": 0, "31": 31, "one_less": 127, "2to32": 2**32, "2to63": 2**63 - 1, "2to64": 2**64 - 1}),
}


def copc_cases():
    """Every case of COPC.

    The points of a COPC file can be read without its hierarchy, as those of any LAZ file. A reader that goes by the
    hierarchy must notice that it lies; either way no point may be lost or won.
    """
    copc = copc_file(cloud(400), [utm()])
    layout = layout_of(copc.data)
    make = partial(Case, exits=EITHER, base="copc.copc.laz")
    made = [
        make(f"copc-info-{field}-{word}.copc.laz", patched(copc.data, copc.info_at + place, form, value))
        for field, (place, form, values) in _INFO.items()
        for word, value in values.items()
    ]
    made += [make(f"copc-{word}.copc.laz", data) for word, data in _hierarchies(copc).items()]
    info = layout.vlrs[0][0]
    made += [
        make("copc-info-not_first.copc.laz", patched(copc.data, info + 2, "4s", b"nocc")),
        Case("copc-info-length_0.copc.laz", patched(copc.data, info + 20, "H", 0)),
        make("copc-info-length_159.copc.laz", patched(copc.data, info + 20, "H", 159)),
    ]
    start, body, end = layout.evlrs[0]
    places = {"no_evlr": start, "evlr_head": body, "mid_root_page": body + 48, "no_second_page": end - 32}
    return made + cut("copc.copc.laz", copc.data, places) + [_wild_evlr(copc.data, start)]


def _wild_evlr(data, start):
    return Case("copc-evlr_length-2to63.copc.laz", patched(data, start + 20, "Q", 2**63 - 1), REFUSED)


def _hierarchies(copc):
    """Hierarchies that lead nowhere, in circles, or to other points."""
    entry = partial(_entry, copc)
    first, page, last = 0, copc.root_entries - 1, copc.entries - 1
    root_at, root_size = copc.pages_at, copc.root_entries * ENTRY.size
    return {
        "cycle_root": entry(page, offset=root_at, size=root_size),
        "cycle_self": entry(last, offset=root_at + root_size, size=ENTRY.size, points=-1),
        "cycle_both": entry(last, offset=root_at, size=root_size, points=-1),
        "page_beyond": entry(page, offset=2**40),
        "page_at_0": entry(page, offset=0),
        "page_in_points": entry(page, offset=2000),
        "page_size_0": entry(page, size=0),
        "page_size_negative": entry(page, size=-1),
        "page_size_31": entry(page, size=31),
        "page_size_2to31": entry(page, size=2**31 - 1),
        "node_beyond": entry(first, offset=2**40),
        "node_at_2to64": entry(first, offset=2**64 - 1),
        "node_in_header": entry(first, offset=0),
        "node_of_another": entry(first, offset=_offset(copc, 1)),
        "node_size_0": entry(first, size=0),
        "node_size_negative": entry(first, size=-1),
        "node_size_2to31": entry(first, size=2**31 - 1),
        "node_size_one_less": entry(first, size=_size(copc, 0) - 1),
        "points_0": entry(first, points=0),
        "points_minus_2": entry(first, points=-2),
        "points_least": entry(first, points=-(2**31)),
        "points_largest": entry(first, points=2**31 - 1),
        "points_one_more": entry(first, points=101),
        "points_one_less": entry(first, points=99),
        "level_1000": entry(1, level=1000),
        "level_largest": entry(1, level=2**31 - 1),
        "level_negative": entry(1, level=-1),
        "key_outside": entry(1, x=5),
        "key_negative": entry(1, y=-7),
        "key_of_another": entry(2, level=0, x=0, y=0, z=0),
        "all_zeros": copc.data[:root_at] + bytes(ENTRY.size * copc.entries) + copc.data[root_at + 160 :],
        "all_ones": copc.data[:root_at] + b"\xff" * ENTRY.size * copc.entries + copc.data[root_at + 160 :],
    }


def _entry(copc, index, **changes):
    """Change fields of an entry; the second page follows the root page."""
    names = ("level", "x", "y", "z", "offset", "size", "points")
    at = copc.pages_at + ENTRY.size * index
    held = dict(zip(names, ENTRY.unpack_from(copc.data, at), strict=True)) | changes
    out = bytearray(copc.data)
    ENTRY.pack_into(out, at, *held.values())
    return bytes(out)


def _offset(copc, index):
    return struct.unpack_from("<Q", copc.data, copc.pages_at + ENTRY.size * index + 16)[0]


def _size(copc, index):
    return struct.unpack_from("<i", copc.data, copc.pages_at + ENTRY.size * index + 24)[0]
