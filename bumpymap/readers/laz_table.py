"""Checks on LAZ data before the decoder sees it: its record, its table of chunks, the layers inside a chunk.

lazrs reserves memory for whatever these promise; a promise that no machine can keep ends the process, so each is held
against the size of the file first.
"""

import struct
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError
from bumpymap.readers.checks import decoding, refuse_count
from bumpymap.readers.decoder import DecoderError, decoder
from bumpymap.readers.las_header import LAYERED, RawHeader
from bumpymap.readers.source import Location

__all__ = ["ChunkTable", "check_layers", "is_chunked", "laz_record", "read_table", "refuse_density"]

_NOT_CHUNKED = 1
"""Value of the "compressor" word of the LASzip record for one stream without a chunk table."""
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
"""What points are made of: type, bytes, layers in a chunk, point formats. Extra bytes are one more item."""
_EXTRA, _EXTRA_LAYERED = 0, 14
_DENSEST = 4096
"""Points in a byte at most: the cheapest symbol of LASzip's models takes 0.003 bits, and a point has one at least."""
_ANY_SIZE = 0xFFFFFFFF
"""Chunk size of a LASzip record that leaves it to the table."""
_ENTRY_BYTES = 16
"""An entry of the table has two numbers, which take less than eight bytes each, coded."""
_CUT = "truncated? Copy or download it again"


@dataclass(frozen=True, slots=True)
class ChunkTable:
    """The chunks of a LAZ file in the order of reading, those without points left out."""

    counts: NDArray[np.int64]
    """(n,) points of each."""
    starts: NDArray[np.int64]
    """(n,) byte of the file where each begins."""
    sizes: NDArray[np.int64]
    """(n,) bytes."""
    boxes: NDArray[np.float64] | None = None
    """(n, 4) west, south, east and north of the cubes of an octree, m; None: no such cubes, or not to be believed."""

    def rows(self, chosen: NDArray[Any]) -> "ChunkTable":
        """Give some of the chunks."""
        boxes = None if self.boxes is None else self.boxes[chosen]
        return ChunkTable(self.counts[chosen], self.starts[chosen], self.sizes[chosen], boxes)


def laz_record(path: Location, header: RawHeader) -> bytes:
    """Give the LASzip record, once it is known to go with the points, and lazrs to decode by it."""
    record = header.records.get((b"laszip encoded", 22204), b"")
    if len(record) < 34:
        raise BadInputError(f"{path} is compressed and has no LASzip record to decode it by. Copy or download it again")
    (count,) = struct.unpack_from("<H", record, 32)
    items = [struct.unpack_from("<HH", record, at) for at in range(34, len(record) - 5, 6)][:count]
    layered, extra = header.point_format >= LAYERED, header.extra_bytes
    wanted = [(kind, size) for kind, size, _, formats in _ITEMS if header.point_format in formats]
    wanted += [(_EXTRA_LAYERED if layered else _EXTRA, extra)] * (extra > 0)
    if items != wanted or (layered and not is_chunked(record)):
        raise BadInputError(
            f"the LASzip record of {path} does not go with its points of format {header.point_format} and "
            f"{header.point_size} bytes: the file is damaged. Copy or download it again"
        )
    if not is_chunked(record):
        # The size of chunks means nothing here, yet lazrs panics on 0 and on the value for "any size".
        record = record[:12] + struct.pack("<I", _ANY_SIZE - 1) + record[16:]
    try:
        decoder().check(record)
    except DecoderError as error:
        raise BadInputError(
            f"{path} is compressed in a way that cannot be decoded here ({error}). Write it again with the usual "
            "codec, such as with: pdal translate IN OUT.laz"
        ) from error
    return record


def is_chunked(record: bytes) -> bool:
    """Whether there is a table of chunks; old files may be one stream."""
    word: int = struct.unpack_from("<H", record)[0]
    return word != _NOT_CHUNKED


def read_table(stream: BinaryIO, path: Location, header: RawHeader, record: bytes) -> ChunkTable:
    """Read the chunk table and check it against the file and the number of points in the header."""
    table_at, chunks = _table_place(stream, path, header)
    block = decoder().allocate(min(header.size - table_at, 8 + _ENTRY_BYTES * (chunks + 1)))
    stream.seek(table_at)
    data = stream.read(block.data.size)
    refuse_count(path, block.data.size, len(data), "bytes of a LAZ chunk table")
    block.data[:] = np.frombuffer(data, np.uint8)
    with decoding(path, "the LAZ chunk table"):
        table = decoder().chunk_table(record, block, chunks)
    data_bytes = sum(size for _, size in table)
    if header.offset_to_points + 8 + data_bytes > table_at:
        raise BadInputError(
            f"the LAZ chunks of {path} need {data_bytes:,} bytes, more than lie before their table: {_CUT}"
        )
    (chunk,) = struct.unpack_from("<I", record, 12)
    # The table of chunks of one size does not repeat it.
    counts = [points if chunk == _ANY_SIZE else chunk for points, _ in table]
    refuse_count(path, header.point_count, sum(counts))
    sizes = np.array([size for _, size in table], np.int64)
    starts = header.offset_to_points + 8 + np.cumsum(sizes) - sizes
    # The last chunk is shorter than the others; behind the last point of the header there is nothing to read.
    ends = np.cumsum([min(count, header.point_count) for count in counts], dtype=np.int64)
    held = np.diff(np.minimum(ends, header.point_count), prepend=0)
    found = ChunkTable(held, starts, sizes).rows(held > 0)
    refuse_density(path, found.counts, found.sizes)
    return found


def refuse_density(path: Location, counts: NDArray[np.int64], sizes: NDArray[np.int64]) -> None:
    """Raise BadInputError where chunks promise more points than any compression could put into them."""
    if (counts > _DENSEST * sizes).any():
        worst = int(np.argmax(counts - _DENSEST * sizes))
        raise BadInputError(
            f"{path} declares {counts[worst]:,} points in {sizes[worst]:,} compressed bytes, which cannot be: damaged "
            f"or {_CUT}"
        )


def check_layers(path: Location, header: RawHeader, chunk: NDArray[np.uint8], size: int, points: int) -> None:
    """Hold what a chunk of layers says of itself to its size in bytes and to the points that the table promises.

    It starts with its first point, the number of its points and the sizes of its layers, which fill the rest: a layer
    whose size is a lie would be left out, or take bytes of the next. Chunks of earlier point formats say nothing of
    themselves. ``chunk`` is the start of the chunk, or all of it.
    """
    if header.point_format < LAYERED:
        return
    layers = header.extra_bytes + sum(count for *_, count, formats in _ITEMS if header.point_format in formats)
    head = header.point_size + 4 * (layers + 1)
    if min(size, chunk.size) < head:
        raise BadInputError(f"a LAZ chunk of {path} takes {size:,} bytes and must take {head:,} at least: {_CUT}")
    held, *layer_bytes = struct.unpack(f"<{layers + 1}I", chunk[header.point_size : head].tobytes())
    refuse_count(path, points, held, "points in a LAZ chunk")
    if head + sum(layer_bytes) != size:
        raise BadInputError(
            f"the layers of a LAZ chunk of {path} take {head + sum(layer_bytes):,} bytes, and it has {size:,}: damaged "
            f"or {_CUT}"
        )


def _table_place(stream: BinaryIO, path: Location, header: RawHeader) -> tuple[int, int]:
    """Where the chunk table is and how many chunks it has, once both are known to fit."""
    size, place = header.size, -1
    # A writer that could not seek back leaves -1 there, and the place in the last eight bytes.
    for at in (header.offset_to_points, size - 8):
        if place == -1 and header.offset_to_points <= at <= size - 8:
            stream.seek(at)
            (place,) = struct.unpack("<q", stream.read(8))
    if not header.offset_to_points + 8 <= place <= size - 8:
        raise BadInputError(f"{path} has no LAZ chunk table where its header says (byte {place} of {size:,}): {_CUT}")
    stream.seek(place + 4)
    (chunks,) = struct.unpack("<I", stream.read(4))
    # A chunk holds its first point as it is.
    room = (place - header.offset_to_points) // header.point_size
    if chunks > room or (chunks == 0 and header.point_count):
        raise BadInputError(f"{path} declares {chunks:,} LAZ chunks, which the file cannot hold: damaged or {_CUT}")
    return place, chunks
