"""COPC: LAZ files whose chunks are the nodes of an octree.

The layout follows the COPC 1.0 specification. Nodes are read depth first, a node before its children, and children with
the same x and y consecutively. A square of ground is therefore complete once the traversal has left it, except for the
points of the few ancestors, which come before.

laspy is not used: it follows cyclic pages forever, and creates a Python object for each node.
"""

import struct
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError
from bumpymap.readers.conversion import RecordLayout
from bumpymap.readers.las_header import RawHeader
from bumpymap.readers.laz_table import ChunkTable, refuse_density
from bumpymap.readers.point_stats import OUTSIDE
from bumpymap.readers.source import Location
from bumpytiles import Bounds, Scaling

__all__ = ["count_points_outside_node", "read_octree"]

_ENTRY = np.dtype(
    [("level", "<i4"), ("x", "<i4"), ("y", "<i4"), ("z", "<i4"), ("offset", "<u8"), ("size", "<i4"), ("points", "<i4")]
)
_ON_ANOTHER_PAGE = -1
"""Value of ``points`` in an entry that refers to another page instead of a node."""
_DEEPEST = 30
"""Levels of the octree at most."""
_MOST_PAGES = 100_000
_REBUILD = "Rebuild the file, for example with: pdal translate IN.laz OUT.copc.laz"


def read_octree(stream: BinaryIO, path: Location, header: RawHeader, metres_per_unit: float | None) -> ChunkTable:
    """Read all pages of the hierarchy; ``metres_per_unit`` is None if the bounds of the nodes are to be ignored.

    Raises
    ------
    BadInputError
        Pages or nodes lie outside of the file, overlap or occur twice, or the number of points differs from that of
        the header.
    """
    info = header.records[b"copc", 1]
    if len(info) < 56:
        raise BadInputError(f"the COPC record of {path} is {len(info)} bytes long, not 160. {_REBUILD}")
    x, y, _, half, _, page_at, page_size = struct.unpack_from("<5d2Q", info)
    if not (np.isfinite([x, y, half]).all() and half > 0):
        raise BadInputError(
            f"the octree of {path} has its centre at {x:g}, {y:g} and a half-width of {half:g}. {_REBUILD}"
        )
    nodes = _read_nodes(stream, path, header, page_at, page_size)
    counted = int(nodes["points"].sum(dtype=np.int64))
    if counted != header.point_count:
        raise BadInputError(
            f"{path} declares {header.point_count:,} points in its header but {counted:,} in its octree: damaged. "
            f"{_REBUILD}"
        )
    nodes = nodes[_depth_first_order(nodes)]
    sizes, counts = nodes["size"].astype(np.int64), nodes["points"].astype(np.int64)
    refuse_density(path, counts, sizes)
    starts = nodes["offset"].astype(np.int64)
    if metres_per_unit is None:
        return ChunkTable(counts, starts, sizes)
    side = 2 * half / np.exp2(nodes["level"])
    west, south = x - half + nodes["x"] * side, y - half + nodes["y"] * side
    boxes = np.column_stack([west, south, west + side, south + side]) * metres_per_unit
    return ChunkTable(counts, starts, sizes, boxes)


def _read_nodes(
    stream: BinaryIO, path: Location, header: RawHeader, page_at: int, page_size: int
) -> NDArray[np.void]:  # fmt: skip
    """Return all entries with points."""
    waiting, seen = [(page_at, page_size)], {page_at}
    found: list[NDArray[np.void]] = []
    while waiting:
        page = _read_page(stream, path, header, *waiting.pop())
        further = page[page["points"] == _ON_ANOTHER_PAGE]
        pages = [(int(at), int(size)) for at, size in zip(further["offset"], further["size"], strict=True)]
        offsets = {at for at, _ in pages}
        if len(offsets) < len(pages) or offsets & seen or len(seen) + len(pages) > _MOST_PAGES:
            raise BadInputError(f"the octree of {path} contains a cycle: damaged. {_REBUILD}")
        seen |= offsets
        waiting += pages
        found.append(page[page["points"] > 0])
    nodes = np.concatenate(found)
    _refuse_nodes(path, header, nodes)
    return nodes


def _read_page(stream: BinaryIO, path: Location, header: RawHeader, at: int, size: int) -> NDArray[np.void]:
    if size <= 0 or size % _ENTRY.itemsize or not header.offset_to_points <= at <= header.size - size:
        raise BadInputError(
            f"the octree of {path} has a page of {size:,} bytes at byte {at:,} of {header.size:,}, which is invalid: "
            f"damaged or truncated? Copy or download it again"
        )
    stream.seek(at)
    data = stream.read(size)
    if len(data) < size:
        raise BadInputError(f"{path} ends inside its octree: truncated? Copy or download it again")
    return np.frombuffer(data, _ENTRY)


def _refuse_nodes(path: Location, header: RawHeader, nodes: NDArray[np.void]) -> None:
    level = nodes["level"].astype(np.int64)
    sound = (level >= 0) & (level <= _DEEPEST)
    for axis in "xyz":
        sound &= (nodes[axis] >= 0) & (nodes[axis] < 1 << np.clip(level, 0, _DEEPEST))
    room = header.size - nodes["size"].astype(np.int64)
    sound &= (nodes["size"] > 0) & (nodes["offset"] >= header.offset_to_points)
    sound &= nodes["offset"] <= np.maximum(room, 0).astype(np.uint64)
    if not sound.all():
        raise BadInputError(
            f"{int((~sound).sum()):,} of {nodes.size:,} nodes in the octree of {path} have no valid position in the "
            f"octree or in the file: damaged or truncated? Copy or download it again"
        )
    order = np.argsort(nodes["offset"])
    starts = nodes["offset"][order].astype(np.int64)
    if (starts[:-1] + nodes["size"][order][:-1] > starts[1:]).any():
        raise BadInputError(f"nodes in the octree of {path} share bytes of the file: damaged. {_REBUILD}")


def _depth_first_order(nodes: NDArray[np.void]) -> NDArray[np.int64]:
    """Return the depth-first order: by the path from the root, three bits a level, z last; parents before children."""
    level = nodes["level"].astype(np.int64)
    deepest = int(level.max(initial=0))
    keys: list[NDArray[np.int64]] = []
    for step in range(1, deepest + 1):
        inside = level >= step
        shift = np.maximum(level - step, 0)
        x, y, z = ((nodes[axis].astype(np.int64) >> shift) & 1 for axis in "xyz")
        keys.append(np.where(inside, 4 * y + 2 * x + z, -1))
    # The last key counts most: the first step from the root.
    return np.lexsort(keys[::-1]) if keys else np.zeros(nodes.size, np.int64).argsort(kind="stable")


def count_points_outside_node(
    records: NDArray[np.uint8], layout: RecordLayout, metres_per_unit: float, box: Bounds, nodes: ChunkTable
) -> int:
    """Count points inside the file's bounds, but more than ``OUTSIDE`` outside the cube of their node.

    Checked by node, so that the result does not depend on the chunks. Only nodes whose minimum or maximum lies outside
    are checked point by point.
    """
    scaling = Scaling(layout.scales, layout.offsets, (metres_per_unit,) * 3)

    def outside(words: NDArray[np.int32], boxes: NDArray[np.float64]) -> NDArray[np.bool_]:
        points = np.stack([scaling.coordinates(axis, words[:, axis]) for axis in range(2)], axis=1)
        beyond = (points < boxes[:, :2] - OUTSIDE) | (points > boxes[:, 2:] + OUTSIDE)
        return np.asarray(beyond.any(axis=1))

    boxes = np.empty((0, 4)) if nodes.boxes is None else nodes.boxes
    words = np.ascontiguousarray(records[:, :8]).view("<i4")
    starts = np.cumsum(nodes.counts) - nodes.counts
    suspect = outside(np.minimum.reduceat(words, starts), boxes) | outside(np.maximum.reduceat(words, starts), boxes)
    points = words[np.repeat(suspect, nodes.counts)]
    own = np.repeat(boxes[suspect], nodes.counts[suspect], axis=0)
    whole = np.array([[box.west, box.south, box.east, box.north]])
    return int(np.count_nonzero(outside(points, own) & ~outside(points, whole)))
