"""Chunks of files, one after the other: fetched ahead, and converted and grouped beside that.

The decoder works in a process of its own and uses every core; conversion and grouping are compiled and hold no lock. So
all of them go on at once: one thread fetches the chunk that comes next, some convert and group the chunks before it,
and the caller takes what is ready, in order.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from bumpymap.core import BadInputError
from bumpymap.readers import Chunk, PointStats, SurveyReader, close_decoder
from bumpymap.survey.engine.plan import ChunkRange
from bumpytiles import Grid, GroupedPoints, group_points

__all__ = ["BadFile", "ChunkStream", "OpenRange", "ReadChunk"]

_LARGEST_KEPT = (1 << 25) - (1 << 16)
"""glibc's malloc keeps freed memory for the next array up to the size of the largest block that was ever freed, and to
32 MB at most. One is reserved and freed, untouched, since nothing else here is that large: without it the arrays of
every chunk and block come from the system page by page (20 million points: 250,000 page faults, 0.5 s)."""


@dataclass(frozen=True, slots=True)
class OpenRange:
    """A range of chunks, with the reader of its file."""

    range: ChunkRange
    reader: SurveyReader
    chunks: Sequence[Chunk]
    """Of the range."""


@dataclass(frozen=True, slots=True)
class ReadChunk:
    """The points of a chunk, grouped by block."""

    source: OpenRange
    chunk: Chunk
    points: GroupedPoints
    stats: PointStats
    flagged: bool
    """Whether any of them is ground."""

    @property
    def is_last(self) -> bool:
        """Whether it is the last one of its range."""
        return self.chunk.index + 1 == self.source.range.stop


@dataclass(frozen=True, slots=True)
class BadFile:
    """A file that cannot be read."""

    source: OpenRange
    error: BadInputError


_Pending = deque[tuple[OpenRange, Future[ReadChunk]]]


class ChunkStream:
    """Reads ranges in order; see `read`.

    Parameters
    ----------
    ranges : sequence of OpenRange
        One of each file at a time.
    grid : Grid
    threads : int
    """

    def __init__(self, ranges: Sequence[OpenRange], grid: Grid, threads: int) -> None:
        self._ranges, self._grid, self._threads = ranges, grid, threads
        self._skipped: set[int] = set()

    def skip(self, file: int) -> None:
        """Read no more of a file."""
        self._skipped.add(file)

    def read(self) -> Iterator[ReadChunk | BadFile]:
        """Give the chunks in order; a file that cannot be read is named once, after its chunks before the fault."""
        np.empty(_LARGEST_KEPT, np.uint8)
        pending: _Pending = deque()
        fetcher, pool = ThreadPoolExecutor(1), ThreadPoolExecutor(self._threads)
        try:
            for source, chunk, fetching in self._fetched(fetcher):
                if source.range.file in self._skipped:
                    continue  # refused while this was fetched
                try:
                    fetched = fetching.result()
                except BadInputError as error:
                    yield from self._ready(pending, 0)
                    yield from self._refused(source, error)
                    continue
                pending.append((source, pool.submit(self._grouped, source, chunk, fetched)))
                del fetched, fetching
                yield from self._ready(pending, self._threads)
            yield from self._ready(pending, 0)
        finally:
            fetcher.shutdown(cancel_futures=True)
            pool.shutdown(cancel_futures=True)
            close_decoder()

    def _fetched(self, fetcher: ThreadPoolExecutor) -> Iterator[tuple[OpenRange, Chunk, Future[Any]]]:
        """Give chunks in order, each with what is fetched of it; while one is dealt with the next is fetched."""
        ahead: deque[tuple[OpenRange, Chunk, Future[Any]]] = deque()
        for source in self._ranges:
            for chunk in source.chunks:
                if source.range.file in self._skipped:
                    break
                ahead.append((source, chunk, fetcher.submit(source.reader.fetch, chunk)))
                if len(ahead) > 1:
                    yield ahead.popleft()
        yield from ahead

    def _grouped(self, source: OpenRange, chunk: Chunk, fetched: Any) -> ReadChunk:
        batch = source.reader.convert(chunk, fetched)
        cloud = batch.cloud
        points = group_points(self._grid, cloud.easting, cloud.northing, cloud.upward, cloud.is_ground)
        return ReadChunk(source, chunk, points, batch.stats, bool(points.points["flag"].any()))

    def _ready(self, pending: _Pending, most: int) -> Iterator[ReadChunk | BadFile]:
        """Give what is ready, in order, until at most ``most`` chunks are under way."""
        while len(pending) > most:
            source, future = pending.popleft()
            if source.range.file in self._skipped:
                continue
            try:
                chunk = future.result()
            except BadInputError as error:
                yield from self._refused(source, error)
                continue
            del future
            yield chunk

    def _refused(self, source: OpenRange, error: BadInputError) -> Iterator[BadFile]:
        if source.range.file not in self._skipped:
            self.skip(source.range.file)
            yield BadFile(source, error)
