"""COPC: LAZ files whose chunks are the nodes of an octree.

The layout follows the COPC 1.0 specification. Nodes are read depth first, a node before its children, and children with
the same x and y consecutively. A square of ground is therefore complete once the traversal has left it, except for the
points of the few ancestors, which come before.

laspy is not used: it follows cyclic pages forever, and creates a Python object for each node.
"""

import struct
from dataclasses import dataclass, replace
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, DecoderError, allocate_shared
from bumpymap.readers.decoder import decoder
from bumpymap.readers.las_header import LAYERED, RawHeader
from bumpymap.readers.point_stats import OUTSIDE
from bumpymap.readers.source import Location, decoding, refuse_count
from bumpytiles import Bounds, Scaling

_NOT_CHUNKED = 1
"""Value of the "compressor" word of the LASzip record for data without a chunk table (LASzip 1)."""
_LARGEST_CHUNK = 1 << 28
"""Decoded bytes of a LAZ chunk at most."""
_ITEMS = (
    (6, 20, 0, range(6)),
    (7, 8, 0, (1, 3, 4, 5)),
    (8, 6, 0, (2, 3, 5)),
    (9, 29, 0, (4, 5)),
    (10, 30, 9, range(6, 11)),
    (11, 6, 1, (7,)),
    (12, 8, 2, (8, 10)),
    (13, 29, 1, (9, 10)),
)
"""Items that points consist of: type, bytes, layers in a LAZ chunk, point formats. Extra bytes are one more item."""
_EXTRA, _EXTRA_LAYERED = 0, 14
_DENSEST = 4096
"""Points per byte at most: the cheapest symbol of LASzip's models takes 0.003 bits, and each point has at least one."""
_ANY_SIZE = 0xFFFFFFFF
"""Chunk size in a LASzip record if the sizes are in the chunk table."""
_ENTRY_BYTES = 16
"""Limit of a chunk table entry: two numbers, which take less than eight bytes each when encoded."""
_TRUNCATED = "truncated? Copy or download it again"
_WRITE_AGAIN = "Write it again with the usual codec, such as with: pdal translate IN OUT.laz"


@dataclass(frozen=True, slots=True)
class ChunkTable:
    """The LAZ chunks of a file in reading order, without empty ones."""

    counts: NDArray[np.int64]
    """(n,) number of points."""
    starts: NDArray[np.int64]
    """(n,) offset in the file, bytes."""
    sizes: NDArray[np.int64]
    """(n,) size in bytes."""
    boxes: NDArray[np.float64] | None = None
    """(n, 4) west, south, east and north of the octree nodes, m; None if there are none, or they are to be ignored."""

    def rows(self, chosen: NDArray[Any]) -> "ChunkTable":
        """Return some of the LAZ chunks."""
        boxes = None if self.boxes is None else self.boxes[chosen]
        return ChunkTable(self.counts[chosen], self.starts[chosen], self.sizes[chosen], boxes)


def laz_record(path: Location, header: RawHeader) -> bytes:
    """Return the LASzip record, after checking that it matches the point format and that lazrs supports it."""
    record = header.records.get((b"laszip encoded", 22204), b"")
    if len(record) < 34:
        raise BadInputError(f"{path} is compressed and has no LASzip record to decode it by. Copy or download it again")
    (count,) = struct.unpack_from("<H", record, 32)
    items = [struct.unpack_from("<HH", record, at) for at in range(34, len(record) - 5, 6)][:count]
    layered, extra = header.point_format >= LAYERED, header.extra_bytes
    wanted = [(kind, size) for kind, size, _, formats in _ITEMS if header.point_format in formats]
    wanted += [(_EXTRA_LAYERED if layered else _EXTRA, extra)] * (extra > 0)
    if items != wanted:
        raise BadInputError(
            f"the LASzip record of {path} does not go with its points of format {header.point_format} and "
            f"{header.point_size} bytes: the file is damaged. Copy or download it again"
        )
    if struct.unpack_from("<H", record)[0] == _NOT_CHUNKED:
        raise BadInputError(f"{path} is compressed in one stream without chunks, which is not read. {_WRITE_AGAIN}")
    try:
        decoder().check(record)
    except DecoderError as error:
        raise BadInputError(
            f"{path} is compressed in a way that cannot be decoded here ({error}). {_WRITE_AGAIN}"
        ) from error
    return record


def read_table(stream: BinaryIO, path: Location, header: RawHeader, record: bytes) -> ChunkTable:
    """Read the chunk table and check it against the size of the file and the point count in the header."""
    table_at, chunks = _table_place(stream, path, header)
    encoded = allocate_shared(min(header.size - table_at, 8 + _ENTRY_BYTES * (chunks + 1)))
    stream.seek(table_at)
    data = stream.read(encoded.data.size)
    refuse_count(path, encoded.data.size, len(data), "bytes of a LAZ chunk table")
    encoded.data[:] = np.frombuffer(data, np.uint8)
    with decoding(path, "the LAZ chunk table"):
        table = decoder().chunk_table(record, encoded, chunks)
    data_bytes = sum(size for _, size in table)
    if header.offset_to_points + 8 + data_bytes > table_at:
        raise BadInputError(
            f"the LAZ chunks of {path} need {data_bytes:,} bytes, more than lie before their table: {_TRUNCATED}"
        )
    (chunk,) = struct.unpack_from("<I", record, 12)
    # If all LAZ chunks have one size, the table does not contain it.
    counts = [points if chunk == _ANY_SIZE else chunk for points, _ in table]
    refuse_count(path, header.point_count, sum(counts))
    sizes = np.array([size for _, size in table], np.int64)
    starts = header.offset_to_points + 8 + np.cumsum(sizes) - sizes
    # The last LAZ chunk is shorter; points beyond the header's count are ignored.
    ends = np.cumsum([min(count, header.point_count) for count in counts], dtype=np.int64)
    held = np.diff(np.minimum(ends, header.point_count), prepend=0)
    found = ChunkTable(held, starts, sizes).rows(held > 0)
    refuse_sizes(path, header, found)
    return found


def refuse_sizes(path: Location, header: RawHeader, table: ChunkTable) -> None:
    """Refuse LAZ chunks that declare more points than their bytes can hold, or than can be decoded at once."""
    dense = table.counts - _DENSEST * table.sizes
    if (dense > 0).any():
        worst = int(np.argmax(dense))
        raise BadInputError(
            f"{path} declares {table.counts[worst]:,} points in {table.sizes[worst]:,} compressed bytes, which is "
            f"impossible: damaged or {_TRUNCATED}"
        )
    largest = int(table.counts.max(initial=0))
    decoded = largest * header.point_size
    if decoded > _LARGEST_CHUNK:
        raise BadInputError(
            f"a LAZ chunk of {path} holds {largest:,} points, {decoded / 1e6:,.0f} MB when decoded; "
            f"at most {_LARGEST_CHUNK / 1e6:,.0f} MB are decoded at once. {_WRITE_AGAIN}"
        )


def check_layers(path: Location, header: RawHeader, chunk: NDArray[np.uint8], points: int) -> None:
    """Check the head of a layered LAZ chunk against its size in bytes and its points in the chunk table.

    A layered chunk starts with its first point, its number of points and the sizes of its layers, which fill the rest:
    a layer with a wrong size would be skipped, or include bytes of the next. Chunks of point formats 0 to 5 have no
    such head.
    """
    if header.point_format < LAYERED:
        return
    layers = header.extra_bytes + sum(count for *_, count, formats in _ITEMS if header.point_format in formats)
    head = header.point_size + 4 * (layers + 1)
    size = chunk.size
    if size < head:
        raise BadInputError(f"a LAZ chunk of {path} takes {size:,} bytes and must take at least {head:,}: {_TRUNCATED}")
    held, *layer_bytes = struct.unpack(f"<{layers + 1}I", chunk[header.point_size : head].tobytes())
    refuse_count(path, points, held, "points in a LAZ chunk")
    if head + sum(layer_bytes) != size:
        raise BadInputError(
            f"the layers of a LAZ chunk of {path} take {head + sum(layer_bytes):,} bytes, and it has {size:,}: damaged "
            f"or {_TRUNCATED}"
        )


def _table_place(stream: BinaryIO, path: Location, header: RawHeader) -> tuple[int, int]:
    """Return the offset of the chunk table and its number of entries, after checking both against the file size."""
    size, place = header.size, -1
    # A writer that cannot seek stores -1 there, and the offset in the last eight bytes of the file.
    for at in (header.offset_to_points, size - 8):
        if place == -1 and header.offset_to_points <= at <= size - 8:
            stream.seek(at)
            (place,) = struct.unpack("<q", stream.read(8))
    if not header.offset_to_points + 8 <= place <= size - 8:
        raise BadInputError(
            f"{path} has no LAZ chunk table where its header says (byte {place} of {size:,}): {_TRUNCATED}"
        )
    stream.seek(place + 4)
    (chunks,) = struct.unpack("<I", stream.read(4))
    # A LAZ chunk holds its first point uncompressed.
    room = (place - header.offset_to_points) // header.point_size
    if chunks > room or (chunks == 0 and header.point_count):
        raise BadInputError(
            f"{path} declares {chunks:,} LAZ chunks, which the file cannot hold: damaged or {_TRUNCATED}"
        )
    return place, chunks


_ENTRY = np.dtype(
    [("level", "<i4"), ("x", "<i4"), ("y", "<i4"), ("z", "<i4"), ("offset", "<u8"), ("size", "<i4"), ("points", "<i4")]
)
_ON_ANOTHER_PAGE = -1
"""Value of ``points`` in an entry that refers to another page instead of a node."""
DEEPEST = 30
"""Levels of the octree at most."""
_MOST_PAGES = 100_000
_REBUILD = "Rebuild the file, for example with: pdal translate IN.laz OUT.copc.laz"


def read_octree(
    stream: BinaryIO, path: Location, header: RawHeader, chunks: ChunkTable, metres_per_unit: float | None
) -> ChunkTable:
    """Return the LAZ chunks depth first by the hierarchy: each node must be a chunk, and each chunk a node.

    ``metres_per_unit`` is None if the bounds of the nodes are to be ignored.

    Raises
    ------
    BadInputError
        Pages lie outside of the file or lead in a circle, or the nodes are not those of an octree or not the chunks.
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
    level = nodes["level"].astype(np.int64)
    sound = (level >= 0) & (level <= DEEPEST)
    for axis in "xyz":
        sound &= (nodes[axis] >= 0) & (nodes[axis] < 1 << np.clip(level, 0, DEEPEST))
    held = np.column_stack([chunks.starts, chunks.sizes, chunks.counts])
    told = np.column_stack([nodes[name].astype(np.int64) for name in ("offset", "size", "points")])
    if not (sound.all() and np.array_equal(told[np.argsort(told[:, 0])], held)):
        raise BadInputError(
            f"the octree of {path} has {nodes.size:,} nodes with {told[:, 2].sum():,} points, which are not its "
            f"{len(held):,} LAZ chunks with {held[:, 2].sum():,} points: damaged. {_REBUILD}"
        )
    nodes = nodes[depth_first_order(nodes)]
    chosen = chunks.rows(np.searchsorted(chunks.starts, nodes["offset"].astype(np.int64)))
    root = np.array([x - half, y - half, x + half, y + half])
    return replace(chosen, boxes=node_boxes(nodes, root, metres_per_unit))


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
    return np.concatenate(found)


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


def node_boxes(
    nodes: NDArray[np.void], root: NDArray[np.float64], metres_per_unit: float | None
) -> NDArray[np.float64] | None:
    """Return west, south, east and north of nodes, (n, 4), m, from those of the root, (4,), in the unit of the file.

    None if there is no ``metres_per_unit``: the bounds of the nodes are to be ignored.
    """
    if metres_per_unit is None:
        return None
    sides = (root[2:] - root[:2]) / np.exp2(nodes["level"])[:, None]
    corners = root[:2] + sides * np.column_stack([nodes["x"], nodes["y"]])
    return np.column_stack([corners, corners + sides]) * metres_per_unit


def depth_first_order(nodes: NDArray[np.void]) -> NDArray[np.int64]:
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


def count_points_outside_node(records: NDArray[np.uint8], scaling: Scaling, box: Bounds, nodes: ChunkTable) -> int:
    """Count points inside the file's bounds, but more than ``OUTSIDE`` outside the cube of their node.

    Checked by node, so that the result does not depend on the chunks. Only nodes whose minimum or maximum lies outside
    are checked point by point.
    """

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
