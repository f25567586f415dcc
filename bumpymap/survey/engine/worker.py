"""A worker: reads ranges of chunks, marks tiles with ground, rates blocks.

On one machine a single worker keeps points in memory between tasks. In a cluster each task uses a new `Worker`, which
writes what other tasks need to packs.
"""

from collections.abc import Generator, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from shutil import rmtree
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Progress
from bumpymap.readers import tile_marks
from bumpymap.survey.engine.block_work import BlockWork, TileSink
from bumpymap.survey.engine.budget import Budget, Workspace
from bumpymap.survey.engine.collector import BlockGroup, ReadResult
from bumpymap.survey.engine.plan import ReadTask
from bumpymap.survey.engine.reading import OpenRange, RangeReader, blocks_of
from bumpymap.survey.engine.run import ReadPlan
from bumpytiles import BlockKey, MemoryLimits, Pack, TileBuckets, run_blocks


def new_folder(parent: Path) -> Path:
    """Make a folder with a unique name and return it."""
    folder = parent / uuid4().hex
    folder.mkdir()
    return folder


class Worker:
    """Does tasks, one at a time.

    Parameters
    ----------
    work : BlockWork
    budget : Budget
    points : Path
        Folder for packs of waiting points.
    tiles : Path
        Folder for packs of finished tiles.
    progress : Progress
    """

    def __init__(self, work: BlockWork, budget: Budget, points: Path, tiles: Path, progress: Progress) -> None:
        self._work, self._threads, self._progress = work, budget.threads, progress
        self._points, self._tiles = points, tiles
        self._store = TileBuckets(work.grid, MemoryLimits(budget.waiting_bytes, budget.block_points, points))
        self._sinks = {kind: TileSink(tiles, f"{kind}-early", work.columns) for kind in work.kinds}

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
        early = reading.finish_early(ready)
        if (remainder := reading.remainder()) is not None:
            found.append(remainder)
        while not store.is_empty:
            store.spill()
            store.wait()
        tiles = _by_kind([*(result.tiles for result in found), early])
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
        for key, columns in self._work.finish(self._store, group.keys, self._threads, kinds):
            for kind, sink in sinks.items():
                sink.add(key, columns[kind])
            self._store.finish(key)
            self._progress.advance(1)
            if any(packs := [sink.new_packs() for sink in sinks.values()]):
                yield packs
        for sink in sinks.values():
            sink.flush()
        yield [sink.new_packs() for sink in sinks.values()]

    def _reading(self, task: ReadTask, ranges: Sequence[OpenRange]) -> RangeReader:
        self._store.done = set(task.finished)
        return RangeReader(task, ranges, self._store, self._work, self._sinks, self._threads, self._progress)

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


def _by_kind(packs: Sequence[tuple[tuple[Path, ...], ...]]) -> tuple[tuple[Path, ...], ...]:
    return tuple(tuple(path for paths in alike for path in paths) for alike in zip(*filter(None, packs), strict=True))


class LocalExecutor:
    """Does every task in this process, file after file; points stay in memory within the budget.

    Parameters
    ----------
    work : BlockWork
    space : Workspace
    budget : Budget
    progress : Progress
    """

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
        task = ReadTask(tuple(plan.unread), (), frozenset(plan.finished), frozenset(plan.waiting))
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
