"""A run of the engine, on one machine or many: read, decide which points to use, rate every block.

The plan is always the same: ranges of chunks are read, a catalogue says which packs hold the points of which blocks,
groups of blocks are rated, and one collector saves the results. An executor does the tasks with workers. On one machine
a single worker keeps points in memory between tasks. In a cluster each task uses a new `Worker`, which writes what
other tasks need to packs.
"""

import logging
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from shutil import rmtree
from typing import Any, Protocol
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import GROUND_SOURCE, NO_CLASS, BadInputError, Mask, Progress, Stopwatch, decide_ground
from bumpymap.rating import is_rateable
from bumpymap.readers import BLANK, GROUND, REACH, Chunk, Lowest, SurveyReader, UnclassifiedPart, tile_marks
from bumpymap.survey.engine.block_work import (
    ALL_POINTS,
    GROUND_POINTS,
    JOINED_POINTS,
    BlockWork,
    MeasuredTiles,
    TileSink,
    engine_errors,
    finished_tiles,
)
from bumpymap.survey.engine.budget import Budget, Workspace
from bumpymap.survey.engine.collector import (
    BlockCatalogue,
    BlockGroup,
    Checkpoints,
    ChunkRange,
    ReadResult,
    ResultCollector,
)
from bumpymap.survey.engine.reading import OpenRange, RangeReader, ReadTask, blocks_of, cut_ranges, refuse_no_points
from bumpymap.survey.inputs import SurveyInputs
from bumpytiles import BlockKey, MemoryLimits, Pack, TileBuckets, TileTable, run_blocks


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
    tiles: Sequence[Path] = ()
    """Packs of tiles that it has finished, measured from all points."""


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

    def mark_tiles(self, groups: Iterator[BlockGroup]) -> Generator[dict[BlockKey, NDArray[np.uint8]], None, None]:
        """Yield the marks of the tiles of each block of each group, see `tile_marks`."""

    def finish(
        self, groups: Iterator[BlockGroup], kinds: Sequence[str]
    ) -> Generator[Sequence[Sequence[Path]], None, None]:
        """Rate the blocks of each group; yield packs of their tiles, for each kind."""


def run_engine(
    inputs: SurveyInputs, work: BlockWork, space: Workspace, budget: Budget, executor: Executor, progress: Progress,
    clock: Stopwatch,
) -> MeasuredTiles:  # fmt: skip
    """Read and rate what an earlier run has not finished.

    Raises BadInputError: a file is bad and may not be skipped, or no point is left; OutputError: the disk is full, or a
    worker does not see the folders; UsageError: workers died, differ from this process, or do not see the inputs.
    """
    noted = space.skipped()
    for reader in inputs.readers:
        if (why := noted.get(str(reader.info.path))) is not None:
            inputs.skip(reader, BadInputError(str(why)))
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
    for reader, stats in zip(inputs.readers, collector.stats, strict=True):
        if doubt := reader.header_doubt(stats):
            logging.getLogger(__name__).warning("%s: %s", reader.info.path, doubt)
    inputs.check_window(work.grid, collector.window())
    with clock.stage("measure"):
        ground_only, from_all = _measure(work, collector, space, executor, progress)
    counted = sum(stats.points - sum(stats.dropped.values()) for stats in collector.stats)
    of_files = zip(inputs.readers, collector.stats, strict=True)
    dropped = [None if str(reader.info.path) in inputs.skipped else stats.dropped for reader, stats in of_files]
    coloured = sum(stats.coloured for stats in collector.stats)
    lines = collector.lines.to_record()
    checksums = [None if str(reader.info.path) in inputs.skipped else reader.checksum() for reader in inputs.readers]
    which = {"ground_only": ground_only, "from_all": from_all}
    return which | {"dropped": dropped, "points": counted, "lines": lines, "checksums": checksums, "coloured": coloured}


def _read(
    inputs: SurveyInputs, work: BlockWork, space: Workspace, executor: Executor, progress: Progress
) -> ResultCollector:
    """Read all points; anew, from the start, without a file that is found bad on the way and may be skipped."""
    readers = inputs.readers
    while True:
        chunk_points = space.run_spec["cut"]["chunk_points"]
        chunks = [() if str(reader.info.path) in inputs.skipped else reader.chunks(chunk_points) for reader in readers]
        total = sum(chunk.points for own in chunks for chunk in own)
        checkpoints = Checkpoints(space, work.kinds)
        collector = ResultCollector(readers, [len(own) for own in chunks], checkpoints, inputs.skip)
        unread, read = cut_ranges(readers, chunks, executor.range_points(total), collector.read_spans())
        progress.start("reading points", total)
        progress.advance(sum(part.points for part in read))
        finished = collector.finished
        waiting = {(row, col) for row, col in collector.catalogue.keys().tolist()} - finished
        plan = ReadPlan(readers, chunks, unread, read, finished, waiting, space.tiles(f"{ALL_POINTS}-early"))
        with closing(executor.read(plan)) as results:
            while collector.all_good and (result := next(results, None)) is not None:
                collector.add(result)
        if collector.all_good:
            for reader in readers:  # into the order of the files, as those that could not be opened are
                if (why := inputs.skipped.pop(str(reader.info.path), None)) is not None:
                    inputs.skipped[str(reader.info.path)] = why
            return collector
        space.forget_points(inputs.skipped)


def _measure(
    work: BlockWork, collector: ResultCollector, space: Workspace, executor: Executor, progress: Progress
) -> tuple[bool, int]:
    """Rate all blocks; return whether only ground is measured, and how many tiles from all points nevertheless.

    Tiles of a part that may never have been classified are measured in both ways, and what they show decides. So are
    all tiles if it depends on that part whether the others are classified.
    """
    waiting = {(row, col) for row, col in collector.catalogue.keys().tolist()} - collector.finished
    tiles, with_ground, part = 1, int(collector.flagged), None
    if work.ground == "auto" and collector.flagged:
        marks = collector.marks
        groups = collector.catalogue.groups(collector.finished, single=executor.one_group)
        with closing(executor.mark_tiles(groups)) as found_marks:
            for own in found_marks:
                marks |= own
        tiles, with_ground = (sum(int((own >= least).sum()) for own in marks.values()) for least in (BLANK, GROUND))
        part = UnclassifiedPart.find(marks, work.grid.tile_size)
    ground_only = decide_ground(work.ground, tiles, with_ground)
    if part is None or not decide_ground(work.ground, tiles - part.tiles, with_ground):
        kind = GROUND_POINTS if ground_only else ALL_POINTS
        _finish(collector, space, executor, progress, {(kind,): waiting})
        return ground_only, 0
    kinds = GROUND_POINTS, ALL_POINTS
    both = waiting & part.blocks(1) if ground_only else waiting
    _finish(collector, space, executor, progress, {kinds: both, kinds[:1]: waiting - both})
    ground, every = (finished_tiles(work, space, kind) for kind in kinds)

    def lowest_points() -> Iterator[Lowest]:
        for table, of_ground in ((ground, True), (every, False)):
            for key in filter(table.count, part.blocks(REACH if of_ground else 0)):
                own = table.read_blocks([key], ("row", "col", "z_min"))
                yield own["row"], own["col"], own["z_min"], of_ground

    found = part.never_classified(lowest_points())
    if not decide_ground(work.ground, tiles - int(found.sum()), with_ground):
        return False, 0
    return True, _save_joined(part, found, ground, every, work, space) if found.any() else 0


def _finish(
    collector: ResultCollector,
    space: Workspace,
    executor: Executor,
    progress: Progress,
    waiting: Mapping[tuple[str, ...], set[BlockKey]],
) -> None:
    """Rate the blocks that wait for each choice of kinds, but for those that an earlier run has rated."""
    every, tiles = set[BlockKey]().union(*waiting.values()), BlockCatalogue()
    if any(ALL_POINTS in kinds for kinds in waiting):
        for path in (*space.tiles(f"{ALL_POINTS}-early"), *space.tiles(ALL_POINTS)):
            tiles.add(path, blocks_of(Pack(path)))
    progress.start("measuring blocks of tiles", len(every))
    for kinds, keys in waiting.items():
        before = set.intersection(*({key for path in space.tiles(kind) for key in Pack(path).keys} for kind in kinds))
        progress.advance(len(keys & before))
        others = collector.finished | before | (every - keys)
        groups = collector.catalogue.groups(others, tiles, single=executor.one_group)
        with closing(executor.finish(groups, kinds)) as results:
            for packs in results:
                for kind, own in zip(kinds, packs, strict=True):
                    collector.add_tiles(kind, own)


def _save_joined(
    part: UnclassifiedPart, found: Mask, ground: TileTable, every: TileTable, work: BlockWork, space: Workspace
) -> int:
    """Save the blocks in which tiles are measured from all points, and which tiles these are; return their number.

    They are the ``found`` ones, (rows, cols) of the window of ``part``, and those of the others that lie beside them
    and hold too little ground to be rated from that alone.
    """
    for path in (*space.tiles(JOINED_POINTS), *space.tiles(GROUND_SOURCE.name)):
        path.unlink()  # of an earlier run, which did not come to its end
    joined = TileSink(space.folder, JOINED_POINTS, work.columns)
    source = TileSink(space.folder, GROUND_SOURCE.name, (GROUND_SOURCE,))
    names, beside, total = [column.name for column in work.columns], part.beside(found), 0
    near = part.blocks(1)
    for key in ground.keys:
        taken = np.zeros(ground.count(key), np.bool_)
        if key in near:
            own, other = (table.read_blocks([key], names) for table in (ground, every))
            at = own["row"] - part.south, own["col"] - part.west
            unknown = (own["class_id"] == NO_CLASS) & ~is_rateable(own["thin"], own["reason"])
            taken = found[at] | (beside[at] & unknown)
            for name in names:
                own[name][taken] = other[name][taken]
            joined.add(key, own)
        source.add(key, {"col": taken, GROUND_SOURCE.name: taken})
        total += int(taken.sum())
    joined.flush()
    source.flush()
    return total


def new_folder(parent: Path) -> Path:
    """Make a folder with a unique name and return it."""
    folder = parent / uuid4().hex
    folder.mkdir()
    return folder


class Worker:
    """Does tasks, one at a time.

    ``points``: folder for packs of waiting points; ``tiles``: folder for packs of finished tiles.
    """

    def __init__(self, work: BlockWork, budget: Budget, points: Path, tiles: Path, progress: Progress) -> None:
        self._work, self._threads, self._progress = work, budget.threads, progress
        self._points, self._tiles = points, tiles
        self._store = TileBuckets(work.grid, MemoryLimits(budget.waiting_bytes, budget.block_points, points))
        self._sinks = {kind: TileSink(tiles, f"{kind}-early", work.columns) for kind in work.kinds}
        self._around = work.surroundings(budget.ahead_bytes)

    def read(self, task: ReadTask, ranges: Sequence[OpenRange]) -> Iterator[ReadResult]:
        """Read ranges; yield results whose points are on disk, last that for points in memory, or an error."""
        reading = self._reading(task, ranges)
        for result in reading.run():
            yield result
            if result.error is not None:
                return
        if (remainder := reading.remainder()) is not None:
            yield remainder

    def read_to_disk(self, task: ReadTask, ranges: Sequence[OpenRange]) -> ReadResult:
        """Read ranges; rate the blocks that no other task reaches, write the points of all others to packs."""
        reading, store = self._reading(task, ranges), self._store
        found: list[ReadResult] = []
        for result in reading.run():
            if result.error is not None:
                for folder in (self._points, self._tiles):
                    rmtree(folder, ignore_errors=True)
                return result
            found.append(result)
        ready = [key for key in store.keys() if reading.is_complete(key)]  # noqa: SIM118 (no mapping)
        early = self._finish_early(ready)
        if (remainder := reading.remainder()) is not None:
            found.append(remainder)
        while not store.is_empty:
            store.spill()
            store.wait()
        packs = filter(None, (*(result.tiles for result in found), early))
        tiles = tuple(tuple(path for paths in alike for path in paths) for alike in zip(*packs, strict=True))
        return replace(ReadResult.merged(found), packs=self._unfinished_packs(), tiles=tiles)

    def mark_tiles(self, group: BlockGroup) -> dict[BlockKey, NDArray[np.uint8]]:
        """Return the marks of the tiles of some blocks, (256,) each, see `tile_marks`."""
        self._store.packs = [Pack(path) for path in group.packs]
        marks = run_blocks(lambda key: tile_marks(self._store.flags(key)), group.keys, self._threads)
        return dict(zip(group.keys, marks, strict=True))

    def finish(self, group: BlockGroup, kinds: Sequence[str]) -> Iterator[list[list[Path]]]:
        """Rate blocks; yield the packs of their tiles, for each kind, as they are written."""
        sinks = {kind: TileSink(self._tiles, kind, self._work.columns) for kind in kinds}
        self._store.packs = [Pack(path) for path in group.packs]
        if self._around is not None:
            self._around.packs = [Pack(path) for path in group.tiles]
        for key, columns in self._work.finish(self._store, group.keys, self._threads, kinds, self._around):
            for kind, sink in sinks.items():
                sink.add(key, columns[kind])
            self._progress.advance(1)
            if any(packs := [sink.new_packs() for sink in sinks.values()]):
                yield packs
        for sink in sinks.values():
            sink.flush()
        yield [sink.new_packs() for sink in sinks.values()]

    def _reading(self, task: ReadTask, ranges: Sequence[OpenRange]) -> RangeReader:
        self._store.done = set(task.finished)
        if self._around is not None:
            self._around.packs = [Pack(path) for path in task.tiles]
        beside = self._around is not None
        return RangeReader(task, ranges, self._store, self._finish_early, self._threads, self._progress, beside)

    def _finish_early(self, keys: Sequence[BlockKey]) -> tuple[tuple[Path, ...], ...]:
        """Rate blocks for every kind, before it is known which points the run will use; return their packs by kind."""
        finished = self._work.finish(self._store, keys, self._threads, tuple(self._sinks), self._around)
        for key, columns in finished:
            marks = tile_marks(self._store.flags(key))
            for kind, sink in self._sinks.items():
                sink.add(key, columns[kind], marks)
        for sink in self._sinks.values():
            sink.flush()
        return tuple(tuple(sink.new_packs()) for sink in self._sinks.values())

    def _unfinished_packs(self) -> tuple[tuple[Path, NDArray[np.int64]], ...]:
        """Return the packs that hold points of unfinished blocks; delete the others."""
        found = []
        for pack in self._store.packs:
            blocks = blocks_of(pack)
            left = [tuple(key) not in self._store.done for key in blocks[:, :2].tolist()]
            if any(left):
                found.append((pack.path, blocks[left]))
            else:
                pack.path.unlink()
        return tuple(found)


class LocalExecutor:
    """Does every task in this process, file after file; points stay in memory within the budget."""

    one_group = True

    def __init__(self, work: BlockWork, space: Workspace, budget: Budget, progress: Progress) -> None:
        self._work, self._space, self._budget, self._progress = work, space, budget, progress
        self._worker: Worker

    def range_points(self, _: int) -> int | None:
        """Return None: each file is one range."""
        return None

    def running(self) -> AbstractContextManager[None]:
        """Return a context manager that does nothing: there are no other processes to prepare."""
        return nullcontext()

    def read(self, plan: ReadPlan) -> Generator[ReadResult, None, None]:
        """Read all ranges that are unread; the worker keeps their points for the later tasks."""
        points, tiles = new_folder(self._space.points_folder), new_folder(self._space.new_tiles)
        self._worker = Worker(self._work, self._budget, points, tiles, self._progress)
        finished, waiting = frozenset(plan.finished), frozenset(plan.waiting)
        task = ReadTask(tuple(plan.unread), (), finished, waiting, tuple(plan.tiles))
        ranges = [
            OpenRange(part, plan.readers[part.file], plan.chunks[part.file][part.first : part.stop])
            for part in plan.unread
        ]
        yield from self._worker.read(task, ranges)

    def mark_tiles(self, groups: Iterator[BlockGroup]) -> Generator[dict[BlockKey, NDArray[np.uint8]], None, None]:
        """Yield the marks of the tiles of each block of each group."""
        return (self._worker.mark_tiles(group) for group in groups)

    def finish(self, groups: Iterator[BlockGroup], kinds: Sequence[str]) -> Generator[list[list[Path]], None, None]:
        """Rate the blocks of each group; yield packs of their tiles, for each kind."""
        for group in groups:
            yield from self._worker.finish(group, kinds)
