"""The plan of reading: which chunks each task reads, and where other tasks may add points to the same blocks.

On a cluster, neighbouring files are read by one task as far as possible: the blocks between them are then complete in
the memory of one worker, and only those along the border of the task are exchanged through the disk.
"""

from collections.abc import Collection, Generator, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Progress, Stopwatch, decide_ground
from bumpymap.readers import Chunk, SurveyReader
from bumpymap.survey.engine.block_work import BlockWork, MeasuredTiles, engine_errors
from bumpymap.survey.engine.budget import Budget, Workspace
from bumpymap.survey.engine.collector import BlockGroup, Checkpoints, FinishedTiles, ReadResult, ResultCollector
from bumpymap.survey.engine.reading import refuse_no_points
from bumpymap.survey.inputs import SurveyInputs
from bumpytiles import BLOCK_TILES, BlockKey, Bounds, Grid, Pack

__all__ = [
    "ChunkRange",
    "Executor",
    "ReadPlan",
    "ReadTask",
    "Spans",
    "cut_ranges",
    "range_points",
    "run_engine",
    "shared_tasks",
    "single_task",
]

Spans = Mapping[int, Sequence[tuple[int, int]]]
"""For each file some ranges of chunks, as (first, last + 1)."""
LEAST_POINTS, _MOST = 2_000_000, 256_000_000
_RANGES_A_WORKER = 4
"""Ranges per worker: near the end some workers idle, for at most a quarter of a worker's share."""
_TASKS_A_WORKER = 2
"""Least tasks per worker, of files that are read together."""
_TASK_POINTS = 20_000_000
"""Points in a task of files, if that still makes two to four tasks per worker."""
_MARGIN = 1.01
"""How far outside its bounds a point may lie, m; as in `BlockCompletion`."""


@dataclass(frozen=True, slots=True)
class ChunkRange:
    """Consecutive chunks of a file."""

    file: int
    """Index of its reader."""
    first: int
    """Its first chunk."""
    stop: int
    """Its last chunk + 1."""
    points: int
    bounds: Bounds | None
    """Bounds of its points, m; None if they are not known."""
    is_whole: bool
    """True if the range is the whole file."""


@dataclass(frozen=True, slots=True, eq=False)
class ReadTask:
    """Ranges to read one after the other, and what the task must know of other ranges.

    There are several ranges of a file only where an earlier run has read what lies between them.
    """

    ranges: tuple[ChunkRange, ...]
    nearby: tuple[Bounds, ...] | None
    """Bounds in which other workers have or will have points: no block there is complete. None: everywhere."""
    finished: frozenset[BlockKey] = frozenset()
    """Blocks in their bounds that an earlier run has finished: their points are dropped."""
    waiting: frozenset[BlockKey] = frozenset()
    """Blocks of which an earlier run has left points on disk: they are not complete when the ranges are read."""


def range_points(points: int, workers: int) -> int:
    """Return the most points of a range when ``points`` are distributed among ``workers``."""
    return max(LEAST_POINTS, min(_MOST, points // (_RANGES_A_WORKER * workers)))


def cut_ranges(
    readers: Sequence[SurveyReader], chunks: Sequence[Sequence[Chunk]], most: int | None, done: Spans
) -> tuple[list[ChunkRange], list[ChunkRange]]:
    """Cut the chunks that are not ``done`` into ranges of about ``most`` points at most; a small file is one range.

    A file that can only be decoded from its start is one range, however large it is.

    Returns
    -------
    list of ChunkRange
        Ranges to read.
    list of ChunkRange
        Ranges that are done.
    """
    unread: list[ChunkRange] = []
    read: list[ChunkRange] = []
    for file, (reader, own) in enumerate(zip(readers, chunks, strict=True)):
        at = 0
        for first, stop in [*sorted(done.get(file, ())), (len(own), len(own))]:
            limit = None if reader.info.sequential else most
            unread += (_range(file, reader, own, *span) for span in _cut(own, at, first, limit))
            if first < stop:
                read.append(_range(file, reader, own, first, stop))
            at = stop
    return unread, read


def _cut(chunks: Sequence[Chunk], first: int, stop: int, most: int | None) -> Iterator[tuple[int, int]]:
    held = 0
    for number in range(first, stop):
        if held and most is not None and held + chunks[number].points > most:
            yield first, number
            first, held = number, 0
        held += chunks[number].points
    if first < stop:
        yield first, stop


def _range(file: int, reader: SurveyReader, chunks: Sequence[Chunk], first: int, stop: int) -> ChunkRange:
    own = chunks[first:stop]
    bounds = _around([chunk.bounds for chunk in own]) or reader.info.bounds
    return ChunkRange(file, first, stop, sum(chunk.points for chunk in own), bounds, stop - first == len(chunks))


def _around(boxes: Sequence[Bounds | None]) -> Bounds | None:
    known = [box for box in boxes if box is not None]
    if not known or len(known) < len(boxes):
        return None
    return Bounds(
        min(box.west for box in known),
        min(box.south for box in known),
        max(box.east for box in known),
        max(box.north for box in known),
    )


def single_task(
    unread: Sequence[ChunkRange], finished: Collection[BlockKey], waiting: Collection[BlockKey]
) -> ReadTask:
    """Return the task of a worker that reads everything; see `ReadTask`."""
    return ReadTask(tuple(unread), (), frozenset(finished), frozenset(waiting))


def shared_tasks(
    grid: Grid, unread: Sequence[ChunkRange], read: Sequence[ChunkRange], finished: Collection[BlockKey], workers: int
) -> Iterator[ReadTask]:
    """Yield tasks that any worker may do: for each of them all ranges of other tasks count as others'."""
    ranges = [*unread, *read]
    all_known = all(part.bounds for part in ranges)
    boxes = [part.bounds or Bounds(0, 0, 0, 0) for part in ranges]
    sides = np.array([(box.west, box.south, box.east, box.north) for box in boxes]).reshape(-1, 4).T
    keys = np.array(list(finished), np.int64).reshape(-1, 2)
    for numbers in _together(unread, sides, workers):
        own = [unread[number] for number in numbers.tolist()]
        nearby = _nearby(grid, sides, numbers) if all_known else None
        yield ReadTask(tuple(own), nearby, frozenset().union(*(_inside(grid, part.bounds, keys) for part in own)))


def _together(unread: Sequence[ChunkRange], sides: NDArray[np.float64], workers: int) -> Iterator[NDArray[np.int64]]:
    """Yield the indices of ranges that a task reads: neighbouring files together, any other range by itself."""
    whole = np.array([part.is_whole and part.bounds is not None for part in unread], np.bool_)
    points = np.array([part.points for part in unread], np.int64)
    total = int(points[whole].sum())
    tasks = np.clip(total // _TASK_POINTS, _TASKS_A_WORKER * workers, _RANGES_A_WORKER * workers)
    tasks = max(min(int(tasks), total // LEAST_POINTS), total // _MOST, 1)
    if whole.any():
        yield from _divided(np.flatnonzero(whole), points, sides, tasks)
    yield from np.flatnonzero(~whole)[:, None]


def _divided(
    numbers: NDArray[np.int64], points: NDArray[np.int64], sides: NDArray[np.float64], tasks: int
) -> Iterator[NDArray[np.int64]]:
    """Divide files among tasks: across the longer side of their area, in halves of about equally many points."""
    west, south, east, north = sides[:, numbers]
    across = (west + east, south + north)[int(np.ptp(west + east) < np.ptp(south + north))]
    numbers = numbers[np.argsort(across, kind="stable")]
    tasks = min(tasks, len(numbers))
    if tasks < 2:
        yield numbers
        return
    ends = np.cumsum(points[numbers])
    cut = 1 + int(np.argmin(np.abs(ends[:-1] - ends[-1] * (tasks // 2) / tasks)))
    yield from _divided(numbers[:cut], points, sides, tasks // 2)
    yield from _divided(numbers[cut:], points, sides, tasks - tasks // 2)


def _nearby(grid: Grid, sides: NDArray[np.float64], numbers: NDArray[np.int64]) -> tuple[Bounds, ...] | None:
    """Return the bounds of other ranges near some ranges; None if each of these shares all of its blocks with one."""
    reach = BLOCK_TILES * grid.tile_size + 2 * _MARGIN
    west, south, east, north = sides
    others = np.ones(len(west), np.bool_)
    others[numbers] = False
    found, covered = np.zeros(len(west), np.bool_), True
    for number in numbers.tolist():
        own = Bounds(*sides[:, number].tolist())
        near = others & (west <= own.east + reach) & (east >= own.west - reach)
        near &= (south <= own.north + reach) & (north >= own.south - reach)
        around = near & (west <= own.west) & (south <= own.south) & (east >= own.east) & (north >= own.north)
        covered = covered and bool(around.any())
        found |= near
    return None if covered else tuple(Bounds(*box) for box in sides[:, found].T.tolist())


def _inside(grid: Grid, box: Bounds | None, keys: NDArray[np.int64]) -> frozenset[BlockKey]:
    if box is not None:
        side = BLOCK_TILES * grid.tile_size
        row, col = keys[:, 0], keys[:, 1]
        inside = ((row + 1) * side >= box.south - _MARGIN) & (row * side <= box.north + _MARGIN)
        inside &= ((col + 1) * side >= box.west - _MARGIN) & (col * side <= box.east + _MARGIN)
        keys = keys[inside]
    return frozenset((row, col) for row, col in keys.tolist())


@dataclass(frozen=True, slots=True)
class ReadPlan:
    """Ranges of points to read, and the work that an earlier run has done."""

    readers: Sequence[SurveyReader]
    chunks: Sequence[Sequence[Chunk]]
    """Chunks of each file."""
    unread: Sequence[ChunkRange]
    read: Sequence[ChunkRange]
    """Ranges that an earlier run has read."""
    finished: set[BlockKey]
    """Blocks that an earlier run has finished."""
    waiting: set[BlockKey]
    """Blocks of which it has left points on disk."""
    skip_bad: bool


class Executor(Protocol):
    """Does the tasks of a run. Callers must close the generators; this cancels tasks that have not started."""

    one_group: bool
    """True if one task rates all blocks."""

    def range_points(self, points: int) -> int | None:
        """Return the most points of a range, given their total number; None: each file is one range."""

    def running(self) -> AbstractContextManager[None]:
        """Check on entry that tasks can be done; stop running tasks on exit."""

    def read(self, plan: ReadPlan) -> Generator[ReadResult, None, None]:
        """Read all ranges that are unread."""

    def count_marks(self, groups: Iterator[BlockGroup]) -> Generator[tuple[int, int], None, None]:
        """Yield the number of tiles, and of those with ground points, for each group."""

    def finish(self, groups: Iterator[BlockGroup], *, ground_only: bool) -> Generator[FinishedTiles, None, None]:
        """Rate the blocks of each group."""


def run_engine(
    inputs: SurveyInputs, work: BlockWork, space: Workspace, budget: Budget, executor: Executor, progress: Progress,
    clock: Stopwatch,
) -> MeasuredTiles:  # fmt: skip
    """Read and rate what an earlier run has not finished.

    Raises
    ------
    BadInputError
        A file is bad and may not be skipped, or no point is left.
    OutputError
        The disk is full, or a worker does not see the folders.
    UsageError
        Workers died, differ from this process, or do not see the inputs.
    """
    record = space.checkpoint()
    if record is None:
        with engine_errors(budget), executor.running():
            record = _read_and_measure(inputs, work, space, executor, progress, clock)
        space.save_checkpoint(record)
    return MeasuredTiles.of(work, space, record)


def _read_and_measure(
    inputs: SurveyInputs, work: BlockWork, space: Workspace, executor: Executor, progress: Progress, clock: Stopwatch
) -> dict[str, Any]:
    with clock.stage("read"):
        collector = _read(inputs, work, space, executor, progress)
    refuse_no_points(inputs.readers, collector.stats)
    inputs.check_window(work.grid, collector.window())
    with clock.stage("measure"):
        ground_only = _decide(work, collector, executor)
        _finish(collector, space, executor, progress, ground_only=ground_only)
    counted = sum(stats.points - sum(stats.dropped.values()) for stats in collector.stats)
    dropped = [None if n in collector.skipped else stats.dropped for n, stats in enumerate(collector.stats)]
    lines = collector.lines.to_record()
    checksums = [reader.checksum for reader in inputs.readers]
    return {"ground_only": ground_only, "dropped": dropped, "points": counted, "lines": lines, "checksums": checksums}


def _read(
    inputs: SurveyInputs, work: BlockWork, space: Workspace, executor: Executor, progress: Progress
) -> ResultCollector:
    readers = inputs.readers
    chunks = [reader.chunks(space.run_spec["cut"]["chunk_points"]) for reader in readers]
    total = sum(reader.info.point_count for reader in readers)
    checkpoints = Checkpoints(space, work.kinds)
    counts = [len(own) for own in chunks]
    collector = ResultCollector(readers, counts, checkpoints, inputs.skip, skip_bad=inputs.skip_bad)
    unread, read = cut_ranges(readers, chunks, executor.range_points(total), collector.read_spans())
    progress.start("reading points", total)
    progress.advance(sum(part.points for part in read))
    finished = collector.finished
    waiting = {(row, col) for row, col in collector.catalogue.keys().tolist()} - finished
    plan = ReadPlan(readers, chunks, unread, read, finished, waiting, inputs.skip_bad)
    with closing(executor.read(plan)) as results:
        for result in results:
            collector.add(result)
    return collector


def _decide(work: BlockWork, collector: ResultCollector, executor: Executor) -> bool:
    """Decide whether only ground is measured; count tiles only if the decision depends on them."""
    if work.ground != "auto" or not collector.flagged:
        return decide_ground(work.ground, 1, int(collector.flagged))
    tiles, with_ground = collector.marks
    groups = collector.catalogue.groups(collector.finished, single=executor.one_group)
    with closing(executor.count_marks(groups)) as counts:
        for more, more_with_ground in counts:
            tiles, with_ground = tiles + more, with_ground + more_with_ground
    return decide_ground(work.ground, tiles, with_ground)


def _finish(
    collector: ResultCollector, space: Workspace, executor: Executor, progress: Progress, *, ground_only: bool
) -> None:
    kind = "ground" if ground_only else "all"
    before = {key for path in space.tiles(kind) for key in Pack(path).keys}
    waiting = {(row, col) for row, col in collector.catalogue.keys().tolist()} - collector.finished
    progress.start("measuring blocks of tiles", len(waiting))
    progress.advance(len(waiting & before))
    groups = collector.catalogue.groups(collector.finished | before, single=executor.one_group)
    with closing(executor.finish(groups, ground_only=ground_only)) as results:
        for tiles in results:
            collector.add_tiles(kind, tiles)
