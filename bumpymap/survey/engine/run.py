"""A run of the engine, on one machine or many: read, decide which points to use, rate every block.

The plan is always the same: ranges of chunks are read, a catalogue says which packs hold the points of which blocks,
groups of blocks are rated, and one collector saves the results. An executor does the tasks.
"""

from collections.abc import Generator, Iterator, Sequence
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from bumpymap.core import BadInputError, Progress, Stopwatch, decide_ground
from bumpymap.readers import Chunk, SurveyReader
from bumpymap.survey.engine.block_work import BlockWork, MeasuredTiles, engine_errors
from bumpymap.survey.engine.budget import Budget, Workspace
from bumpymap.survey.engine.collector import BlockGroup, Checkpoints, ReadResult, ResultCollector
from bumpymap.survey.engine.plan import ChunkRange, cut_ranges
from bumpymap.survey.engine.reading import refuse_no_points
from bumpymap.survey.inputs import SurveyInputs
from bumpytiles import BlockKey, Pack

__all__ = ["Executor", "ReadPlan", "run_engine"]


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

    def finish(self, groups: Iterator[BlockGroup], *, ground_only: bool) -> Generator[Sequence[Path], None, None]:
        """Rate the blocks of each group; yield packs of their tiles."""


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
    inputs.check_window(work.grid, collector.window())
    with clock.stage("measure"):
        ground_only = _decide(work, collector, executor)
        _finish(collector, space, executor, progress, ground_only=ground_only)
    counted = sum(stats.points - sum(stats.dropped.values()) for stats in collector.stats)
    of_files = zip(inputs.readers, collector.stats, strict=True)
    dropped = [None if str(reader.info.path) in inputs.skipped else stats.dropped for reader, stats in of_files]
    lines = collector.lines.to_record()
    checksums = [reader.checksum for reader in inputs.readers]
    return {"ground_only": ground_only, "dropped": dropped, "points": counted, "lines": lines, "checksums": checksums}


def _read(
    inputs: SurveyInputs, work: BlockWork, space: Workspace, executor: Executor, progress: Progress
) -> ResultCollector:
    """Read all points; anew, from the start, without a file that is found bad on the way and may be skipped."""
    readers = inputs.readers
    while True:
        good = [str(reader.info.path) not in inputs.skipped for reader in readers]
        chunk_points = space.run_spec["cut"]["chunk_points"]
        chunks = [
            reader.chunks(chunk_points) if kept else list[Chunk]() for reader, kept in zip(readers, good, strict=True)
        ]
        total = sum(reader.info.point_count for reader, kept in zip(readers, good, strict=True) if kept)
        checkpoints = Checkpoints(space, work.kinds)
        collector = ResultCollector(readers, [len(own) for own in chunks], checkpoints, inputs.skip)
        unread, read = cut_ranges(readers, chunks, executor.range_points(total), collector.read_spans())
        progress.start("reading points", total)
        progress.advance(sum(part.points for part in read))
        finished = collector.finished
        waiting = {(row, col) for row, col in collector.catalogue.keys().tolist()} - finished
        plan = ReadPlan(readers, chunks, unread, read, finished, waiting)
        with closing(executor.read(plan)) as results:
            while collector.all_good and (result := next(results, None)) is not None:
                collector.add(result)
        if collector.all_good:
            inputs.sort_skipped()
            return collector
        space.forget_points(inputs.skipped)


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
        for packs in results:
            collector.add_tiles(kind, packs)
