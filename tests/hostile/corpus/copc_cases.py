"""Damage to what COPC adds: the info record and the hierarchy."""

import struct
from functools import partial

from .bases import bases
from .case import EITHER, REFUSED, Case, cut, field_cases, patched
from .las_file import layout_of

from las_files import ENTRY  # isort: skip (las_file finds it)


_NAN, _INF = float("nan"), float("inf")
_INFO = {
    "centre": (0, "d", {"nan": _NAN, "4e9": 4e9}),
    "half": (24, "d", {"0": 0.0, "negative": -1.0, "nan": _NAN, "inf": _INF, "1e300": 1e300}),
    "spacing": (32, "d", {"0": 0.0, "nan": _NAN}),
    "root_at": (40, "Q", {"0": 0, "points": 1500, "beyond": 2**40, "2to63": 2**63 - 1, "2to64": 2**64 - 1}),
    "root_size": (48, "Q", {"0": 0, "31": 31, "one_less": 127, "2to32": 2**32, "2to63": 2**63 - 1, "2to64": 2**64 - 1}),
}


_NAMES = ("level", "x", "y", "z", "offset", "size", "points")


def copc_cases():
    """Every case of COPC.

    The points of a COPC file can be read without its hierarchy, as those of any LAZ file. A reader that goes by the
    hierarchy must notice that it lies; either way no point may be lost or won.
    """
    data = bases()["copc.copc.laz"]
    layout = layout_of(data)
    info, info_at, _ = layout.vlrs[0]
    make = partial(Case, exits=EITHER, base="copc.copc.laz")
    made = field_cases("copc-info.copc.laz", data, _INFO, info_at, default=EITHER, base="copc.copc.laz")
    start, body, end = layout.evlrs[0]
    made += [make(f"copc-{word}.copc.laz", spoilt) for word, spoilt in _hierarchies(data, info_at, body, end).items()]
    made += [
        make("copc-info-not_first.copc.laz", patched(data, info + 2, "4s", b"nocc")),
        Case("copc-info-length_0.copc.laz", patched(data, info + 20, "H", 0)),
        make("copc-info-length_159.copc.laz", patched(data, info + 20, "H", 159)),
        Case("copc-evlr_length-2to63.copc.laz", patched(data, start + 20, "Q", 2**63 - 1), REFUSED),
    ]
    places = {"no_evlr": start, "evlr_head": body, "mid_root_page": body + 48, "no_second_page": end - 32}
    return made + cut("copc.copc.laz", data, places)


def _hierarchies(data, info_at, body, end):
    """Hierarchies that lead nowhere, in circles, or to other points.

    The root page holds the root and an entry for the page of each node below it.
    """
    (root_size,) = struct.unpack_from("<Q", data, info_at + 48)
    entries, first, node = (end - body) // ENTRY.size, 0, root_size // ENTRY.size
    page, last = node - 1, entries - 1

    def entry(index, **changes):
        at = body + ENTRY.size * index
        held = dict(zip(_NAMES, ENTRY.unpack_from(data, at), strict=True)) | changes
        return data[:at] + ENTRY.pack(*held.values()) + data[at + ENTRY.size :]

    another, (*_, root_bytes, root_points) = (ENTRY.unpack_from(data, body + ENTRY.size * at) for at in (node, first))
    return {
        "cycle_root": entry(page, offset=body, size=root_size),
        "cycle_self": entry(last, offset=end - ENTRY.size, size=ENTRY.size, points=-1),
        "cycle_both": entry(last, offset=body, size=root_size, points=-1),
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
        "node_of_another": entry(first, offset=another[4]),
        "node_size_0": entry(first, size=0),
        "node_size_negative": entry(first, size=-1),
        "node_size_2to31": entry(first, size=2**31 - 1),
        "node_size_one_less": entry(first, size=root_bytes - 1),
        "points_0": entry(first, points=0),
        "points_minus_2": entry(first, points=-2),
        "points_least": entry(first, points=-(2**31)),
        "points_largest": entry(first, points=2**31 - 1),
        "points_one_more": entry(first, points=root_points + 1),
        "points_one_less": entry(first, points=root_points - 1),
        "level_1000": entry(node, level=1000),
        "level_largest": entry(node, level=2**31 - 1),
        "level_negative": entry(node, level=-1),
        "key_outside": entry(node, x=5),
        "key_negative": entry(node, y=-7),
        "key_of_another": entry(node, level=0, x=0, y=0, z=0),
        "all_zeros": data[:body] + bytes(end - body) + data[end:],
        "all_ones": data[:body] + b"\xff" * (end - body) + data[end:],
    }
