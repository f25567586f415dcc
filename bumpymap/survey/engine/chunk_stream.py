"""A stream of chunks in file order: chunks are fetched ahead while earlier ones are converted and grouped.

The decoder runs in its own processes and uses every core; conversion and grouping are compiled and release the GIL. One
thread fetches the next chunk, or several threads the next chunks if one is too small to keep every core busy; other
threads convert and group the chunks before, and the caller receives them in order.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from bumpymap.core import POINT_GROUND, BadInputError
from bumpymap.readers import Chunk, LineSums, PointStats, SurveyReader, close_decoder
from bumpymap.survey.engine.budget import requests_at_once
from bumpymap.survey.engine.plan import ChunkRange
from bumpytiles import Grid, GroupedPoints

__all__ = ["BadFile", "ChunkStream", "OpenRange", "ReadChunk"]

_LARGEST_KEPT = (1 << 25) - (1 << 16)
"""glibc's malloc reuses freed memory for arrays up to the size of the largest allocation that was ever freed, at most
32 MB. So an array of this size is allocated once and freed untouched: without it the arrays of every chunk and block
come from the system page by page (20 million points: 250,000 page faults, 0.5 s)."""


@dataclass(frozen=True, slots=True)
class OpenRange:
    """A range of chunks, with the reader of its file."""

    range: ChunkRange
    reader: SurveyReader
    chunks: Sequence[Chunk]
    """The chunks of the range."""


@dataclass(frozen=True, slots=True)
class ReadChunk:
    """The points of a chunk, grouped by block."""

    source: OpenRange
    chunk: Chunk
    points: GroupedPoints
    stats: PointStats
    flagged: bool
    """Whether any point is ground."""
    lines: LineSums

    @property
    def is_last(self) -> bool:
        """Whether this is the last chunk of its range."""
        return self.chunk.index + 1 == self.source.range.stop


@dataclass(frozen=True, slots=True)
class BadFile:
    """A file that cannot be read, and why."""

    source: OpenRange
    error: BadInputError


_Pending = deque[tuple[OpenRange, Future[ReadChunk]]]


class ChunkStream:
    """Reads ranges in order; see `read`.

    Parameters
    ----------
    ranges : sequence of OpenRange
    grid : Grid
    threads : int
    """

    def __init__(self, ranges: Sequence[OpenRange], grid: Grid, threads: int) -> None:
        self._ranges, self._grid, self._threads = ranges, grid, threads
        self._skipped: set[int] = set()
        self._fetchers: dict[int, ThreadPoolExecutor] = {}
        """By the number of chunks that are fetched at a time."""

    def skip(self, file: int) -> None:
        """Stop reading a file."""
        self._skipped.add(file)

    def read(self) -> Iterator[ReadChunk | BadFile]:
        """Yield the chunks in order; for a file that cannot be read, yield one `BadFile` after its good chunks."""
        np.empty(_LARGEST_KEPT, np.uint8)
        pending: _Pending = deque()
        pool = ThreadPoolExecutor(self._threads)
        try:
            for source, chunk, fetching in self._fetched():
                if source.range.file in self._skipped:
                    continue  # found to be bad while this chunk was fetched
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
            for fetcher in self._fetchers.values():
                fetcher.shutdown(cancel_futures=True)
            pool.shutdown(cancel_futures=True)
            close_decoder()

    def _fetched(self) -> Iterator[tuple[OpenRange, Chunk, Future[Any]]]:
        """Yield chunks in order, each with the future of its data; one chunk or more are fetched ahead."""
        ahead: deque[tuple[OpenRange, Chunk, Future[Any]]] = deque()
        for source in self._ranges:
            at_once = self._at_once(source)
            fetcher = self._fetchers.setdefault(at_once, ThreadPoolExecutor(at_once))
            for chunk in source.chunks:
                if source.range.file in self._skipped:
                    break
                ahead.append((source, chunk, fetcher.submit(source.reader.fetch, chunk)))
                while len(ahead) > at_once:
                    yield ahead.popleft()
        yield from ahead

    def _at_once(self, source: OpenRange) -> int:
        """Return how many chunks of a range are fetched at a time."""
        if not source.reader.info.parallel:
            return 1
        return requests_at_once(max((chunk.points for chunk in source.chunks), default=1), self._threads)

    def _grouped(self, source: OpenRange, chunk: Chunk, fetched: Any) -> ReadChunk:
        batch = source.reader.convert(chunk, fetched)
        points = batch.grouped(self._grid)
        return ReadChunk(
            source, chunk, points, batch.stats, bool((points.points["flag"] == POINT_GROUND).any()), batch.lines
        )

    def _ready(self, pending: _Pending, most: int) -> Iterator[ReadChunk | BadFile]:
        """Yield grouped chunks in order until at most ``most`` are pending."""
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
