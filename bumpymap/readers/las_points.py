"""Read the bytes of LAS points in chunks: uncompressed, from LAZ chunks, or from sequential LAZ."""

import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from bumpymap.readers.checks import decoding, refuse_count
from bumpymap.readers.chunking import group_laz_chunks, split_rows
from bumpymap.readers.decoder import Stream, StreamLostError, decoder
from bumpymap.readers.las_header import RawHeader
from bumpymap.readers.laz_table import ChunkTable, check_layers, refuse_density
from bumpymap.readers.protocol import Chunk
from bumpymap.readers.source import Location, read_into, read_range

__all__ = ["LazChunks", "LazStream", "PlainPoints", "PlainRecords", "RecordSource", "Records", "has_huge_chunks"]

Records = NDArray[np.uint8]
"""Point records, (n, bytes of a point)."""
HUGE_CHUNK = 1 << 28
"""A LAZ chunk of more decoded bytes than this is read sequentially, in parts."""
_CHUNK_HEAD = 1 << 19
"""Upper limit of the head of a LAZ chunk, bytes: the longest point, and four bytes for each of its layers."""
_PIECE_BYTES = 1 << 20
"""Bytes of uncompressed points that are read at a time, at most."""
_SKIPPED = 100_000
"""Points that are decoded at a time to skip them."""


_buffers = threading.local()


def _buffer(size: int) -> NDArray[np.uint8]:
    """Return at least ``size`` bytes that this thread uses again and again."""
    held: NDArray[np.uint8] | None = getattr(_buffers, "held", None)
    if held is None or held.size < size:
        held = _buffers.held = np.empty(size, np.uint8)
    return held


class RecordSource(ABC):
    """Splits the points of a file into chunks and reads them."""

    def __init__(self, path: Location, header: RawHeader) -> None:
        self._path, self._header = path, header

    def chunks(self, points: int) -> Sequence[Chunk]:
        """Split between any two points."""
        return split_rows(self._header.point_count, points, self._header.point_size)

    @abstractmethod
    def fetch(self, chunk: Chunk) -> "Records | PlainRecords":
        """Read and decode a chunk."""

    def nodes(self, chunk: Chunk) -> ChunkTable | None:
        """Return the octree nodes that hold the chunk's points, in the order of `fetch`; None if there is no octree."""
        return None


class PlainRecords:
    """Uncompressed records of a chunk, read piece by piece into one buffer while they are iterated over.

    A piece is still in the processor's cache when it is used, and memory for the whole chunk is not needed.
    """

    def __init__(self, path: Location, header: RawHeader, chunk: Chunk) -> None:
        self._path, self._header, self._chunk = path, header, chunk

    def __iter__(self) -> Iterator[Records]:
        """Yield pieces, (n, bytes of a point) each; a piece is only valid until the next is taken.

        Reads end where multiples of ``_PIECE_BYTES`` do, as the pieces of the checksum of the file.
        """
        header, size = self._header, self._header.point_size
        at = header.offset_to_points + self._chunk.first * size
        end = at + self._chunk.points * size
        buffer = _buffer(_PIECE_BYTES + size)
        held = 0  # bytes of a record that the last read cut
        while at < end:
            wanted = min(_PIECE_BYTES - at % _PIECE_BYTES, end - at)
            got = read_into(self._path, at, buffer[held : held + wanted])
            at += got
            if got < wanted:
                refuse_count(self._path, header.point_count, (at - header.offset_to_points) // size)
            whole, rest = divmod(held + got, size)
            if whole:
                yield buffer[: whole * size].reshape(whole, size)
            buffer[:rest] = buffer[whole * size : whole * size + rest].copy()
            held = rest


class PlainPoints(RecordSource):
    """Uncompressed points."""

    def fetch(self, chunk: Chunk) -> Records | PlainRecords:
        """Return the records of a chunk: to be read when they are used, or from a server at once."""
        header = self._header
        if not isinstance(self._path, str):
            return PlainRecords(self._path, header, chunk)
        start = header.offset_to_points + chunk.first * header.point_size
        data = read_range(self._path, start, chunk.points * header.point_size)
        held = data.size // header.point_size
        if held < chunk.points:
            refuse_count(self._path, header.point_count, chunk.first + held)
        return data.reshape(held, header.point_size)


class LazChunks(RecordSource):
    """LAZ with a chunk table: LAZ chunks (octree nodes are such too) are decoded independently, on all cores."""

    def __init__(self, path: Location, header: RawHeader, record: bytes, table: ChunkTable) -> None:
        super().__init__(path, header)
        self._record, self._table, self._ends = record, table, np.cumsum(table.counts)

    def chunks(self, points: int) -> Sequence[Chunk]:
        """Split between LAZ chunks; if these are octree nodes, chunks have bounds."""
        return group_laz_chunks(self._ends, points, self._header.point_size, self._table.boxes)

    def fetch(self, chunk: Chunk) -> Records:
        """Read the bytes of the LAZ chunks, adjacent ones with one request, and decode them."""
        part = self._part(chunk)
        compressed = decoder().allocate(int(part.sizes.sum()))
        held = 0
        gaps = np.flatnonzero(part.starts[1:] != part.starts[:-1] + part.sizes[:-1]) + 1
        for starts, sizes in zip(np.split(part.starts, gaps), np.split(part.sizes, gaps), strict=True):
            held += read_into(self._path, int(starts[0]), compressed.data[held : held + int(sizes.sum())])
        refuse_count(self._path, compressed.data.size, held, "bytes of LAZ chunks")
        table = list(zip(part.counts.tolist(), part.sizes.tolist(), strict=True))
        at = 0
        for points, size in table:
            check_layers(self._path, self._header, compressed.data[at : at + size], size, points)
            at += size
        with decoding(self._path, "LAZ chunks"):
            records = decoder().chunks(self._record, table, compressed, chunk.points * self._header.point_size)
        return records.reshape(chunk.points, self._header.point_size)

    def nodes(self, chunk: Chunk) -> ChunkTable | None:
        """See ``RecordSource.nodes``."""
        return None if self._table.boxes is None else self._part(chunk)

    def _part(self, chunk: Chunk) -> ChunkTable:
        """Return the LAZ chunks of a chunk, by their offsets in the file."""
        last = chunk.first + chunk.points - 1
        first, end = np.searchsorted(self._ends, (chunk.first, last), side="right").tolist()
        return self._table.rows(first + np.argsort(self._table.starts[first : end + 1], kind="stable"))


class LazStream(RecordSource):
    """LAZ without a chunk table, or with LAZ chunks too large to decode at once: decoded from the start in order."""

    def __init__(self, path: Location, header: RawHeader, record: bytes, table: ChunkTable | None) -> None:
        super().__init__(path, header)
        self._record, self._next = record, 0
        self._stream: Stream | None = None
        if table is None:
            size = header.size - header.offset_to_points
            refuse_density(path, np.array([header.point_count]), np.array([size]))
            return
        for points, start, size in zip(table.counts.tolist(), table.starts.tolist(), table.sizes.tolist(), strict=True):
            check_layers(path, header, read_range(path, start, min(size, _CHUNK_HEAD)), size, points)

    def fetch(self, chunk: Chunk) -> Records:
        """Decode the points of a chunk, skipping those before it if necessary."""
        try:
            with decoding(self._path, f"points from {chunk.first:,} on"):
                data = self._read(chunk)
        except BaseException:
            self._close()
            raise
        if self._next == self._header.point_count:
            self._close()
        return data.reshape(chunk.points, self._header.point_size)

    def _read(self, chunk: Chunk) -> Records:
        while True:
            try:
                return self._read_once(chunk)
            except StreamLostError:
                # The decoder process was restarted because of another file.
                self._stream = None

    def _read_once(self, chunk: Chunk) -> Records:
        stream = self._stream
        if stream is None or chunk.first < self._next:
            self._close()
            start, size = self._header.offset_to_points, self._header.size
            stream = self._stream = decoder().stream(self._record, self._supply, start, size)
            self._next = 0
        while self._next < chunk.first:
            skipped = min(_SKIPPED, chunk.first - self._next)
            stream.read(skipped * self._header.point_size)
            self._next += skipped
        data = stream.read(chunk.points * self._header.point_size)
        self._next += chunk.points
        return data

    def _supply(self, start: int, buffer: NDArray[np.uint8]) -> int:
        """Read bytes into a buffer that is used again, so that threads cannot hash what is in it; see `read_into`."""
        data = read_range(self._path, start, buffer.size)
        buffer[: data.size] = data
        return data.size

    def _close(self) -> None:
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.close()


def has_huge_chunks(table: ChunkTable, header: RawHeader) -> bool:
    """Return whether a LAZ chunk is too large to be decoded at once."""
    return bool((table.counts * header.point_size > HUGE_CHUNK).any())
