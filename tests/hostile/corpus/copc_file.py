"""A tiny COPC file (specification 1.0): info record, LAZ chunk a node, a hierarchy of two pages."""

import struct
from dataclasses import dataclass

import numpy as np

from .las_file import ORIGIN, SIDE, Vlr, las_file, layout_of

__all__ = ["ENTRY", "Copc", "copc_file"]

ENTRY = struct.Struct("<iiiiQii")
"""Level, x, y, z, offset, bytes, points; -1 points: the entry stands for another page."""
_INFO = struct.Struct("<5dQQdd88x")
_HALF = 4.0


@dataclass(frozen=True, slots=True)
class Copc:
    """Bytes of a file and where its own parts lie."""

    data: bytes
    info_at: int
    """Data of the info record."""
    pages_at: int
    """Data of the hierarchy record: the root page, then the second page."""
    root_entries: int
    """Entries of the root page; the last one stands for the second page."""
    entries: int
    """Of both pages."""


def copc_file(xyz, vlrs=()):
    """Write the points as a COPC file, at least 40 of them: a quarter in the root, the rest in its children."""
    xyz = np.asarray(xyz, float)
    order, nodes = _octree(xyz)
    sizes = [size for _, size in nodes]
    pages = bytes(ENTRY.size * (len(nodes) + 1))
    data = bytearray(
        las_file(
            xyz[order],
            minor=4,
            fmt=7,
            chunks=sizes,
            vlrs=[Vlr(b"copc", 1, bytes(_INFO.size)), *vlrs],
            evlrs=[Vlr(b"copc", 1000, pages)],
        )
    )
    layout = layout_of(bytes(data))
    info_at, pages_at = layout.vlrs[0][1], layout.evlrs[0][1]
    held = [
        ENTRY.pack(*key, start, end - start, size)
        for (key, size), (start, end, _) in zip(nodes, layout.chunks, strict=True)
    ]
    # The last node and nothing else lies in a page of its own.
    root_entries, last = len(nodes), nodes[-1][0]
    second_at = pages_at + ENTRY.size * root_entries
    held.insert(-1, ENTRY.pack(*last, second_at, ENTRY.size, -1))
    data[pages_at : pages_at + len(pages)] = b"".join(held)
    _INFO.pack_into(
        data, info_at, *_centre(), _HALF, 0.5, pages_at, ENTRY.size * root_entries, 0.0, 1e-4 * (len(xyz) - 1)
    )
    return Copc(bytes(data), info_at, pages_at, root_entries, len(nodes) + 1)


def _centre():
    return (ORIGIN[0] + SIDE / 2, ORIGIN[1] + SIDE / 2, ORIGIN[2] + _HALF - 1)


def _octree(xyz):
    """Order of the points by node, and each node's key with its number of points."""
    rest = np.arange(len(xyz) // 4, len(xyz))
    octant = (xyz >= _centre()) @ np.array([1, 2, 4])
    order, nodes = [np.arange(len(xyz) // 4)], [((0, 0, 0, 0), len(xyz) // 4)]
    for index in range(8):
        inside = rest[octant[rest] == index]
        if len(inside):
            order.append(inside)
            nodes.append(((1, index & 1, index >> 1 & 1, index >> 2), len(inside)))
    return np.concatenate(order), nodes
