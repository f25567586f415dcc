"""The bytes of LAS points, piece by piece: as they are, from LAZ chunks, or from LAZ that must be read in order."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bumpymap.readers.checks import decoding, refuse_count
from bumpymap.readers.cut import cut_chunks, cut_rows
from bumpymap.readers.decoder import Stream, StreamLostError, decoder
from bumpymap.readers.las_header import RawHeader
from bumpymap.readers.laz_table import ChunkTable, check_layers, refuse_density
from bumpymap.readers.protocol import Chunk
from bumpymap.readers.source import Location, read_into, read_range

__all__ = ["Cubes", "LazChunks", "LazStream", "PlainPoints", "RecordSource", "decode_chunks", "has_huge_chunks"]

Records = NDArray[np.uint8]
"""(n, bytes of a point)."""
_HUGE_CHUNK = 1 << 28
"""A chunk of more bytes than this, decoded, is read in parts."""
_CHUNK_HEAD = 1 << 19
"""More bytes than the head of any chunk takes: the longest point, and four bytes for each of its layers."""
_SKIPPED = 100_000
"""Points that are decoded at once to get past them."""


@dataclass(frozen=True, slots=True)
class Cubes:
    """Where the points of a piece must lie, run by run, in the order in which they are fetched."""

    counts: NDArray[np.int64]
    """(n,) points of each run."""
    sides: NDArray[np.float64]
    """(n, 4) west, south, east, north, m."""


class RecordSource(Protocol):
    """How the points of a file are cut and read."""

    def chunks(self, points: int) -> Sequence[Chunk]:
        """Cut the file."""

    def fetch(self, chunk: Chunk) -> Records:
        """Read and decode a piece."""

    def cubes(self, chunk: Chunk) -> Cubes | None:
        """Where its points must lie; None where only the file as a whole has a box."""
        return None


class PlainPoints(RecordSource):
    """Points that are not compressed."""

    def __init__(self, path: Location, header: RawHeader) -> None:
        self._path, self._header = path, header

    def chunks(self, points: int) -> Sequence[Chunk]:
        """Cut anywhere."""
        return cut_rows(self._header.point_count, points, self._header.point_size)

    def fetch(self, chunk: Chunk) -> Records:
        """Read a range of bytes."""
        header = self._header
        start = header.offset_to_points + chunk.first * header.point_size
        data = read_range(self._path, start, chunk.points * header.point_size)
        held = data.size // header.point_size
        if held < chunk.points:
            refuse_count(self._path, header.point_count, chunk.first + held)
        return data.reshape(held, header.point_size)


class LazChunks(RecordSource):
    """LAZ with a table: any run of chunks can be decoded by itself, on all cores."""

    def __init__(self, path: Location, header: RawHeader, record: bytes, table: ChunkTable) -> None:
        self._path, self._header, self._record, self._table = path, header, record, table

    def chunks(self, points: int) -> Sequence[Chunk]:
        """Cut between chunks."""
        ends = self._table.ends
        runs = cut_chunks(ends, points, self._header.point_size)
        befores = [int(ends[first - 1]) if first else 0 for first, _ in runs]
        return [
            Chunk(index, before, int(ends[last - 1]) - before)
            for index, ((_, last), before) in enumerate(zip(runs, befores, strict=True))
        ]

    def fetch(self, chunk: Chunk) -> Records:
        """Read the bytes of some chunks and decode them."""
        chunks = self._table.find(chunk)
        counts, sizes = self._table.counts[chunks].tolist(), self._table.sizes[chunks].tolist()
        ranges = [(int(self._table.starts[chunks.start]), sum(sizes))]
        return decode_chunks(self._path, self._header, self._record, ranges, list(zip(counts, sizes, strict=True)))


class LazStream(RecordSource):
    """LAZ in one stream, or in chunks too large to be decoded at once: read in order; to go back is to start again."""

    def __init__(self, path: Location, header: RawHeader, record: bytes, table: ChunkTable | None) -> None:
        self._path, self._header, self._record = path, header, record
        self._stream: Stream | None = None
        self._next = 0
        if table is None:
            size = header.size - header.offset_to_points
            refuse_density(path, np.array([header.point_count]), np.array([size]))
            return
        for points, start, size in zip(table.counts.tolist(), table.starts.tolist(), table.sizes.tolist(), strict=True):
            check_layers(path, header, read_range(path, start, min(size, _CHUNK_HEAD)), size, points)

    def chunks(self, points: int) -> Sequence[Chunk]:
        """Cut anywhere."""
        return cut_rows(self._header.point_count, points, self._header.point_size)

    def fetch(self, chunk: Chunk) -> Records:
        """Decode the points that come next, or those before them first."""
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
                return self._go_on(chunk)
            except StreamLostError:
                # The decoder was ended for another file.
                self._stream = None

    def _go_on(self, chunk: Chunk) -> Records:
        stream = self._stream
        if stream is None or chunk.first < self._next:
            self._close()
            start, size = self._header.offset_to_points, self._header.size
            stream = self._stream = decoder().stream(self._record, partial(read_into, self._path), start, size)
            self._next = 0
        while self._next < chunk.first:
            skipped = min(_SKIPPED, chunk.first - self._next)
            stream.read(skipped * self._header.point_size)
            self._next += skipped
        data = stream.read(chunk.points * self._header.point_size)
        self._next += chunk.points
        return data

    def _close(self) -> None:
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.close()


def has_huge_chunks(table: ChunkTable, header: RawHeader) -> bool:
    """Whether a chunk takes more memory than a piece may."""
    return bool((table.counts * header.point_size > _HUGE_CHUNK).any())


def decode_chunks(
    path: Location,
    header: RawHeader,
    record: bytes,
    ranges: Sequence[tuple[int, int]],
    table: Sequence[tuple[int, int]],
) -> Records:
    """Read and decode whole LAZ chunks.

    Parameters
    ----------
    path : Path or str
    header : RawHeader
    record : bytes
        The LASzip record.
    ranges : sequence of (int, int)
        Where the chunks lie in the file: first byte, bytes.
    table : sequence of (int, int)
        Points and bytes of each chunk.

    Raises
    ------
    BadInputError
        The file ends early, the chunks hold fewer points than ``table``, or are damaged.
    """
    block = decoder().take(sum(size for _, size in ranges))
    held = 0
    for start, size in ranges:
        held += read_into(path, start, block.data[held : held + size])
    refuse_count(path, block.data.size, held, "bytes of LAZ chunks")
    at = 0
    for points, size in table:
        check_layers(path, header, block.data[at : at + size], size, points)
        at += size
    points = sum(points for points, _ in table)
    with decoding(path, "LAZ chunks"):
        records = decoder().chunks(record, table, block, points * header.point_size)
    return records.reshape(points, header.point_size)
