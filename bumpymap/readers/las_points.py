"""The bytes of LAS points, piece by piece: as they are, from LAZ chunks, or from LAZ that must be read in order."""

from collections.abc import Sequence
from typing import Any, Protocol

import lazrs
import numpy as np
from numpy.typing import NDArray

from bumpymap.readers.checks import decoding, refuse_count
from bumpymap.readers.cut import cut_chunks, cut_rows
from bumpymap.readers.las_header import RawHeader
from bumpymap.readers.laz_table import ChunkTable, check_layers, refuse_density
from bumpymap.readers.protocol import Piece
from bumpymap.readers.source import Location, open_source, read_range

__all__ = ["LazChunks", "LazStream", "PlainPoints", "RecordSource", "decode_chunks", "has_huge_chunks"]

Records = NDArray[np.uint8]
"""(n, bytes of a point)."""
_HUGE_CHUNK = 1 << 28
"""A chunk of more bytes than this, decoded, is read in parts."""
_CHUNK_HEAD = 1 << 19
"""More bytes than the head of any chunk takes: the longest point, and four bytes for each of its layers."""
_SKIPPED = 100_000
"""Points that are decoded at once to get past them."""
_FIELDS = (
    lazrs.SELECTIVE_DECOMPRESS_XY_RETURNS_CHANNEL
    | lazrs.SELECTIVE_DECOMPRESS_Z
    | lazrs.SELECTIVE_DECOMPRESS_CLASSIFICATION
    | lazrs.SELECTIVE_DECOMPRESS_FLAGS
)
"""What is decoded of point formats 6 to 10; earlier ones are decoded whole."""


class RecordSource(Protocol):
    """How the points of a file are cut and read."""

    def pieces(self, points: int) -> Sequence[Piece]:
        """Cut the file."""

    def fetch(self, piece: Piece) -> Records:
        """Read and decode a piece."""


class PlainPoints:
    """Points that are not compressed."""

    def __init__(self, path: Location, header: RawHeader) -> None:
        self._path, self._header = path, header

    def pieces(self, points: int) -> Sequence[Piece]:
        """Cut anywhere."""
        return cut_rows(self._header.point_count, points, self._header.point_size)

    def fetch(self, piece: Piece) -> Records:
        """Read a range of bytes."""
        header = self._header
        start = header.offset_to_points + piece.first * header.point_size
        data = read_range(self._path, start, piece.points * header.point_size)
        held = data.size // header.point_size
        if held < piece.points:
            refuse_count(self._path, header.point_count, piece.first + held)
        return data.reshape(held, header.point_size)


class LazChunks:
    """LAZ with a table: any run of chunks can be decoded by itself, on all cores."""

    def __init__(self, path: Location, header: RawHeader, record: bytes, table: ChunkTable) -> None:
        self._path, self._header, self._record, self._table = path, header, record, table

    def pieces(self, points: int) -> Sequence[Piece]:
        """Cut between chunks."""
        ends = self._table.ends
        runs = cut_chunks(ends, points, self._header.point_size)
        befores = [int(ends[first - 1]) if first else 0 for first, _ in runs]
        return [
            Piece(index, before, int(ends[last - 1]) - before)
            for index, ((_, last), before) in enumerate(zip(runs, befores, strict=True))
        ]

    def fetch(self, piece: Piece) -> Records:
        """Read the bytes of some chunks and decode them."""
        chunks = self._table.find(piece)
        counts, sizes = self._table.counts[chunks].tolist(), self._table.sizes[chunks].tolist()
        data = read_range(self._path, int(self._table.starts[chunks.start]), sum(sizes))
        return decode_chunks(self._path, self._header, self._record, data, counts, sizes)


class LazStream:
    """LAZ in one stream, or in chunks too large to be decoded at once: read in order; to go back is to start again."""

    def __init__(self, path: Location, header: RawHeader, record: bytes, table: ChunkTable | None) -> None:
        self._path, self._header, self._record = path, header, record
        self._decoder: Any = None
        self._next = 0
        if table is None:
            size = header.size - header.offset_to_points
            refuse_density(path, np.array([header.point_count]), np.array([size]))
            return
        for points, start, size in zip(table.counts.tolist(), table.starts.tolist(), table.sizes.tolist(), strict=True):
            check_layers(path, header, read_range(path, start, min(size, _CHUNK_HEAD)), size, points)

    def pieces(self, points: int) -> Sequence[Piece]:
        """Cut anywhere."""
        return cut_rows(self._header.point_count, points, self._header.point_size)

    def fetch(self, piece: Piece) -> Records:
        """Decode the points that come next, or those before them first."""
        with decoding(self._path, f"points from {piece.first:,} on"):
            if self._decoder is None or piece.first < self._next:
                self._open()
            while self._next < piece.first:
                self._decode(min(_SKIPPED, piece.first - self._next))
            records = self._decode(piece.points)
        if self._next == self._header.point_count:
            self._decoder = None  # closes the file
        return records

    def _open(self) -> None:
        stream = open_source(self._path)
        stream.seek(self._header.offset_to_points)
        self._decoder = lazrs.LasZipDecompressor(stream, self._record, lazrs.DecompressionSelection(_FIELDS))
        self._next = 0

    def _decode(self, points: int) -> Records:
        records = np.empty((points, self._header.point_size), np.uint8)
        self._decoder.decompress_many(records.reshape(-1))
        self._next += points
        return records


def has_huge_chunks(table: ChunkTable, header: RawHeader) -> bool:
    """Whether a chunk takes more memory than a piece may."""
    return bool((table.counts * header.point_size > _HUGE_CHUNK).any())


def decode_chunks(
    path: Location, header: RawHeader, record: bytes, data: Records, counts: list[int], sizes: list[int]
) -> Records:  # fmt: skip
    """Decode whole LAZ chunks that lie one behind the other.

    Raises
    ------
    BadInputError
        The file ends early, the chunks hold fewer points than ``counts``, or are damaged.
    """
    refuse_count(path, sum(sizes), data.size, "bytes of LAZ chunks")
    start = 0
    for points, size in zip(counts, sizes, strict=True):
        check_layers(path, header, data[start : start + size], size, points)
        start += size
    records = np.empty((sum(counts), header.point_size), np.uint8)
    table = list(zip(counts, sizes, strict=True))
    with decoding(path, "LAZ chunks"):
        lazrs.decompress_points_with_chunk_table(
            data, record, records.reshape(-1), table, lazrs.DecompressionSelection(_FIELDS)
        )
    return records
