"""Reading: which chunks each task reads, and ranges of chunks into the memory of a worker.

On a cluster, neighbouring files are read by one task as far as possible: the blocks between them are then complete in
the memory of one worker, and only those along the border of the task are exchanged through the disk.

Complete blocks are rated early, points beyond the limit go to packs. A block is complete when no unread chunk can add
points to it. The decoder runs in its own processes and uses every core; conversion and grouping are compiled and
release the GIL. One thread fetches the next chunk, or several threads the next chunks if one is too small to keep every
core busy; other threads convert and group the chunks before, and the caller receives them in order.
"""

import math
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import astuple, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import POINT_GROUND, BadInputError, Progress
from bumpymap.readers import Chunk, PointStats, SurveyReader, close_decoder
from bumpymap.survey.engine.block_work import blocks_around
from bumpymap.survey.engine.budget import requests_at_once
from bumpymap.survey.engine.collector import ChunkRange, ReadResult
from bumpytiles import BLOCK_TILES, BlockKey, Bounds, Grid, GroupedPoints, Pack, TileBuckets, run_blocks

Spans = Mapping[int, Sequence[tuple[int, int]]]
"""For each file some ranges of chunks, as (first, last + 1)."""
LEAST_POINTS, _MOST = 2_000_000, 256_000_000
"""Points of a range or of a task at least and at most."""
_RANGES_A_WORKER = 4
"""Ranges per worker: near the end some workers idle, for at most a quarter of a worker's share."""
_TASKS_A_WORKER = 2
"""Least tasks per worker, of files that are read together."""
_TASK_POINTS = 20_000_000
"""Points in a task of files, if that still makes two to four tasks per worker."""


@dataclass(frozen=True, slots=True, eq=False)
class ReadTask:
    """Ranges to read one after the other, and what the task must know of other ranges.

    There are several ranges of a file only where an earlier run has read what lies between them.
    """

    ranges: tuple[ChunkRange, ...]
    nearby: tuple[Bounds, ...] | None
    """Bounds in which other workers have or will have points: no block there is complete. None: everywhere."""
    finished: frozenset[BlockKey] = frozenset()
    """Blocks that an earlier run has finished: their points are dropped."""
    waiting: frozenset[BlockKey] = frozenset()
    """Blocks of which an earlier run has left points on disk: they are not complete when the ranges are read."""
    tiles: tuple[Path, ...] = ()
    """Packs of the tiles that an earlier run has finished, measured from all points."""


def range_points(points: int, workers: int) -> int:
    """Return the most points of a range when ``points`` are distributed among ``workers``."""
    return max(LEAST_POINTS, min(_MOST, points // (_RANGES_A_WORKER * workers)))


def cut_ranges(
    readers: Sequence[SurveyReader], chunks: Sequence[Sequence[Chunk]], most: int | None, done: Spans
) -> tuple[list[ChunkRange], list[ChunkRange]]:
    """Cut the chunks that are not ``done`` into ranges of about ``most`` points at most; a small file is one range.

    A file that can only be decoded from its start is one range, however large it is. Returns ranges to read, and
    ranges that are done.
    """
    unread: list[ChunkRange] = []
    read: list[ChunkRange] = []
    for file, (reader, own) in enumerate(zip(readers, chunks, strict=True)):
        limit = math.inf if most is None or reader.info.sequential else most
        past = sorted(done.get(file, ()))
        read += (_range(file, reader, own, first, stop) for first, stop in past)
        gaps = pairwise([0, *(number for span in past for number in span), len(own)])
        for first, stop in list(gaps)[::2]:
            held, at = 0, first
            for number in range(first, stop):
                if held and held + own[number].points > limit:
                    unread.append(_range(file, reader, own, at, number))
                    at, held = number, 0
                held += own[number].points
            if at < stop:
                unread.append(_range(file, reader, own, at, stop))
    return unread, read


def _range(file: int, reader: SurveyReader, chunks: Sequence[Chunk], first: int, stop: int) -> ChunkRange:
    own = chunks[first:stop]
    points = sum(chunk.points for chunk in own)
    return ChunkRange(file, first, stop, points, reader.info.bounds, stop - first == len(chunks))


def shared_tasks(
    unread: Sequence[ChunkRange],
    read: Sequence[ChunkRange],
    finished: Collection[BlockKey],
    workers: int,
    tiles: Sequence[Path] = (),
) -> Iterator[ReadTask]:
    """Yield tasks that any worker may do: for each of them all ranges of other tasks count as others'.

    Files are divided across the longer side of their area, so that those of a task are neighbours.
    """
    whole = [part for part in unread if part.is_whole]
    boxes = np.array([astuple(part.bounds) for part in whole if part.bounds is not None]).reshape(-1, 4)
    total = sum(part.points for part in whole)
    tasks = min(max(total // _TASK_POINTS, _TASKS_A_WORKER * workers), _RANGES_A_WORKER * workers)
    tasks = max(min(tasks, total // LEAST_POINTS), total // _MOST, 1)
    if len(boxes) == len(whole) > 0:
        low, high = boxes[:, :2], boxes[:, 2:]
        width, height = high.max(axis=0) - low.min(axis=0)
        order = np.argsort((low + high)[:, 0 if width > height else 1], kind="stable")
        whole = [whole[place] for place in order]
    shares: dict[int, list[ChunkRange]] = {}
    begun = 0
    for part in whole:
        shares.setdefault((2 * begun + part.points) * tasks // (2 * total + 1), []).append(part)
        begun += part.points
    every = [*unread, *read]
    for own in (*shares.values(), *([part] for part in unread if not part.is_whole)):
        places = {(part.file, part.first) for part in own}
        others = [part.bounds for part in every if (part.file, part.first) not in places]
        nearby = tuple(box for box in others if box is not None)
        known = nearby if len(nearby) == len(others) else None
        yield ReadTask(tuple(own), known, frozenset(finished), tiles=tuple(tiles))


_MARGIN = 1.01
"""Points may lie this far outside their bounds, m (readers accept 1 m)."""
_MOST_CELLS = 4_000_000
"""In a window of more blocks nothing is counted, and no block is complete before the end."""


class BlockCompletion:
    """Counts, for each block, the unread areas that overlap it.

    ``bounds``: bounds of the points of each area, m; None if they are not known.
    """

    def __init__(self, grid: Grid, bounds: Sequence[Bounds | None]) -> None:
        self._boxes = [None if box is None else _blocks(grid, box) for box in bounds]
        known = np.array([box for box in self._boxes if box is not None], dtype=np.int64).reshape(-1, 4)
        self._unknown = len(bounds) - len(known)
        self._open_areas: NDArray[np.int32] | None = None
        if not len(known):
            return
        self._south, self._west = int(known[:, 0].min()), int(known[:, 2].min())
        rows, cols = int(known[:, 1].max()) - self._south, int(known[:, 3].max()) - self._west
        if rows * cols <= _MOST_CELLS:
            self._open_areas = np.zeros((rows, cols), np.int32)
            for box in known.tolist():
                self._open_areas[self._inside(box)] += 1

    def mark_read(self, area: int) -> None:
        """Record that all points of an area are read."""
        box = self._boxes[area]
        if box is None:
            self._unknown -= 1
        elif self._open_areas is not None:
            self._open_areas[self._inside(box)] -= 1

    def is_complete(self, key: BlockKey, around: int = 0) -> bool:
        """Return whether no unread area overlaps a block, and ``around`` blocks on each side of it."""
        if self._unknown or self._open_areas is None:
            return False
        row, col = key[0] - self._south, key[1] - self._west
        if not (0 <= row < self._open_areas.shape[0] and 0 <= col < self._open_areas.shape[1]):
            return False  # a point outside all bounds: its file will be rejected
        rows, cols = (slice(max(place - around, 0), place + around + 1) for place in (row, col))
        return not self._open_areas[rows, cols].any()

    def _inside(self, box: Sequence[int]) -> tuple[slice, slice]:
        south, north, west, east = (int(side) for side in box)
        return slice(south - self._south, north - self._south), slice(west - self._west, east - self._west)


def _blocks(grid: Grid, box: Bounds) -> tuple[int, int, int, int]:
    """Return the blocks that overlap a box: first row, last row + 1, first column, last column + 1."""
    low = grid.index(np.array([box.south, box.west]) - _MARGIN) // BLOCK_TILES
    high = grid.index(np.array([box.north, box.east]) + _MARGIN) // BLOCK_TILES + 1
    return int(low[0]), int(high[0]), int(low[1]), int(high[1])


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


_Fetching = tuple[OpenRange, Chunk, Future[Any]]


def read_chunks(
    ranges: Sequence[OpenRange], grid: Grid, threads: int
) -> Iterator[tuple[ReadResult, GroupedPoints | None]]:
    """Yield the result for each chunk of ranges, in order, with its points grouped by block; last an error, without."""

    def grouped(fetching: _Fetching) -> tuple[ReadResult, GroupedPoints | None]:
        source, chunk, future = fetching
        file = source.range.file
        try:
            batch = source.reader.convert(chunk, future.result())
        except BadInputError as error:
            return ReadResult.of_bad(source.range, error), None
        points = batch.grouped(grid)
        flagged = bool((points.points["flag"] == POINT_GROUND).any())
        span = file, chunk.index, chunk.index + 1
        return ReadResult((span,), {file: batch.stats}, flagged, batch.lines), points

    np.empty(_LARGEST_KEPT, np.uint8)
    fetchers: dict[int, ThreadPoolExecutor] = {}
    try:
        fetched = _fetched(ranges, threads, fetchers)
        with closing(run_blocks(grouped, fetched, threads, threads + 1)) as results:
            for read in results:
                yield read
                if read[0].error is not None:
                    return
                del read
    finally:
        for fetcher in fetchers.values():
            fetcher.shutdown(cancel_futures=True)
        close_decoder()


def _fetched(ranges: Sequence[OpenRange], threads: int, fetchers: dict[int, ThreadPoolExecutor]) -> Iterator[_Fetching]:
    """Yield chunks in order, each with the future of its data; one chunk or more are fetched ahead.

    ``fetchers`` receives the threads, by the number of chunks that are fetched at a time.
    """
    ahead: deque[_Fetching] = deque()
    for source in ranges:
        largest = max((chunk.points for chunk in source.chunks), default=1)
        at_once = requests_at_once(largest, threads) if source.reader.info.parallel else 1
        fetcher = fetchers.setdefault(at_once, ThreadPoolExecutor(at_once))
        for chunk in source.chunks:
            ahead.append((source, chunk, fetcher.submit(source.reader.fetch, chunk)))
            while len(ahead) > at_once:
                yield ahead.popleft()
    yield from ahead


_NAMED = 5
"""Number of files that a message names."""
_WHY = {
    "withheld": "are flagged as withheld",
    "noise": "are of class 7 or 18 (noise)",
    "not_a_number": "have no height (beams without return, pixels without data)",
}


def refuse_no_points(readers: Sequence[SurveyReader], stats: Sequence[PointStats]) -> None:
    """Raise BadInputError if no point is left in any file; skipped files have empty statistics."""
    seen, dropped = sum(own.points for own in stats), Counter[str]()
    for own in stats:
        dropped.update(own.dropped)
    if seen > dropped.total():
        return
    names = [str(reader.info.path) for reader in readers]
    files = ", ".join(names[:_NAMED]) + (f" and {len(names) - _NAMED} more" if len(names) > _NAMED else "")
    if not seen:
        raise BadInputError(f"no point is left to map: every input was skipped ({files})")
    reasons = [f"{count:,} {_WHY[reason]}" for reason, count in dropped.items() if count]
    advice = "Clear flag or class in the file if they are ground after all"
    if dropped["not_a_number"] == seen:
        advice = "Is it the right file?"
    raise BadInputError(
        f"no point is left to map: of the {seen:,} points of {files}, {' and '.join(reasons)}. {advice}"
    )


class RangeReader:
    """Reads some ranges in one pass; see `run`.

    ``task``: says where there are points of other workers or of an earlier run; ``ranges``: the ranges of the task;
    ``store``: receives the points; ``finish``: rates blocks and returns the packs of their tiles, grouped by
    `BlockWork.kinds`; ``beside``: blocks are rated with the heights of those beside them.
    """

    def __init__(
        self,
        task: ReadTask,
        ranges: Sequence[OpenRange],
        store: TileBuckets,
        finish: Callable[[Sequence[BlockKey]], tuple[tuple[Path, ...], ...]],
        threads: int,
        progress: Progress,
        beside: bool,
    ) -> None:
        self._store, self._finish, self._threads, self._beside = store, finish, threads, beside
        self._progress, self._ranges = progress, ranges
        self._whole = {source.range.file: source for source in ranges if source.range.is_whole}
        self._stats = PointStats()
        bounds = [source.reader.info.bounds for source in ranges]
        self._areas = {(part.range.file, part.range.stop - 1): area for area, part in enumerate(ranges)}
        others: Sequence[Bounds | None] = (None,) if task.nearby is None else task.nearby
        self._completion, self._elsewhere = BlockCompletion(store.grid, [*bounds, *others]), task.waiting
        self._pending: deque[tuple[int, ReadResult]] = deque()
        """Number of each chunk that is in memory or being written to disk, and not in a result yet."""
        self._next = 0
        self._spilling: ReadResult | None = None

    def is_complete(self, key: BlockKey) -> bool:
        """Return whether no unread chunk, of this worker or others, can add points to a block, and none did before.

        If it is rated with the heights around it, nor to one of the blocks around it.
        """
        near, reach = (blocks_around(key), 1) if self._beside else ([key], 0)
        return self._elsewhere.isdisjoint(near) and self._completion.is_complete(key, reach)

    def run(self) -> Iterator[ReadResult]:
        """Read all ranges; yield results as soon as their points are on disk, or last the error of a bad file."""
        for read, points in read_chunks(self._ranges, self._store.grid, self._threads):
            ((file, index, _),) = read.spans
            bad = read if points is None else self._judge(file, index, read.stats[file])
            if points is None or bad is not None:
                yield from self._spilled()
                yield bad or read
                return
            self._pending.append((self._next, read))
            self._store.add_chunk(points, self._next)
            self._next += 1
            self._progress.advance(read.stats[file].points)
            if (area := self._areas.get((file, index))) is not None:
                self._completion.mark_read(area)
            if self._store.is_full:
                yield from self._make_room()
            del points
        yield from self._spilled()

    def remainder(self) -> ReadResult | None:
        """Return the result for chunks that are still in memory at the end; None if there are none."""
        if not self._pending and self._store.is_empty:
            return None
        return replace(ReadResult.merged(self._pending_up_to(self._next)), in_memory=self._store.in_memory())

    def _judge(self, file: int, index: int, stats: PointStats) -> ReadResult | None:
        """Return an error if this is the last chunk of a whole file that is bad; else None."""
        whole = self._whole.get(file)
        if whole is None:
            return None
        self._stats = stats if index == 0 else self._stats.merge(stats)
        try:
            if index + 1 == whole.range.stop:
                whole.reader.verify(self._stats)
        except BadInputError as error:
            return ReadResult.of_bad(whole.range, error)
        return None

    def _make_room(self) -> Iterator[ReadResult]:
        """Rate complete blocks; if that does not make room, write the older half of the waiting points to disk.

        Points of a block that are on disk are read again, so that the first nodes of an octree, which reach into every
        block, do not keep the blocks from being rated.
        """
        yield from self._spilled()
        ready = [key for key in self._store.keys_in_memory() if self.is_complete(key)]
        if any(tiles := self._finish(ready)):
            waiting = self._store.chunks_in_memory()
            gone = [read for number, read in self._pending if number not in waiting]
            self._pending = deque(pending for pending in self._pending if pending[0] in waiting)
            yield ReadResult((), tiles=tiles)  # tiles are saved even if writing the points fails
            if gone:
                yield ReadResult.merged(gone)
        self._store.compact()
        if self._store.must_spill:
            _, last = self._store.spill()
            self._spilling = ReadResult.merged(self._pending_up_to(last))

    def _spilled(self) -> Iterator[ReadResult]:
        """Wait until the pack that is being written is on disk, and yield its result."""
        pack = self._store.wait()
        if pack is not None and self._spilling is not None:
            blocks = blocks_of(pack)
            result, self._spilling = self._spilling, None
            yield replace(result, packs=((pack.path, blocks),) if len(blocks) else ())

    def _pending_up_to(self, last: int) -> list[ReadResult]:
        """Take the pending chunks up to number ``last``."""
        taken = []
        while self._pending and self._pending[0][0] <= last:
            taken.append(self._pending.popleft()[1])
        return taken


def blocks_of(pack: Pack) -> NDArray[np.int64]:
    """Return row, column and number of points of the blocks of a pack, (n, 3)."""
    return np.array([(*key, pack.rows(key)) for key in pack.keys], np.int64).reshape(-1, 3)
