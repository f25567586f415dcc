"""The LAZ chunks of a file, by its chunk table, checked before they are decoded. Those of COPC are nodes of its octree.

laspy is not used: it creates a Python object for each chunk.
"""

import struct
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, DecoderError, allocate_shared
from bumpymap.readers.decoder import decoder
from bumpymap.readers.las_header import LAYERED, RawHeader
from bumpymap.readers.source import Location, decoding, refuse_count

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
"""LASzip's numbers of the item of extra bytes, point formats 0 to 5 and 6 to 10."""
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

    def rows(self, chosen: NDArray[Any] | slice) -> "ChunkTable":
        """Return some of the LAZ chunks."""
        return ChunkTable(self.counts[chosen], self.starts[chosen], self.sizes[chosen])


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
