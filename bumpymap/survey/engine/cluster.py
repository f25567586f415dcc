"""The executor of a run on the workers of dask.distributed: any worker may do any task.

Workers exchange points and finished tiles as files in folders that all of them see. This process receives only counts
and file names.
"""

import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from typing import Any
from uuid import uuid4

from bumpymap.core import Progress, UsageError
from bumpymap.readers import ReadOptions
from bumpymap.survey.engine.block_work import BlockWork
from bumpymap.survey.engine.budget import Budget
from bumpymap.survey.engine.catalogue import BlockGroup
from bumpymap.survey.engine.plan import ChunkRange, range_points, shared_tasks
from bumpymap.survey.engine.pool import TIMEOUT_S, WorkerPool, worker_errors
from bumpymap.survey.engine.results import FinishedTiles, ReadResult
from bumpymap.survey.engine.run import ReadPlan
from bumpymap.survey.engine.tasks import (
    ALIVE,
    FileSource,
    RunContext,
    busy,
    count_marks,
    finish_group,
    missing_on_worker,
    read_ranges,
)
from bumpymap.survey.engine.workspace import Workspace

__all__ = ["ClusterExecutor"]

_REMEDY = "Look at their logs. Workers that run short of memory die: give them more, or lower `memory`"


class ClusterExecutor:
    """Distributes tasks among workers; points that wait for other tasks are in packs.

    Parameters
    ----------
    work : BlockWork
    space : Workspace
        In folders that every worker sees.
    budget : Budget
        Of each worker.
    progress : Progress
    pool : WorkerPool
    options : ReadOptions
        The settings that the readers were opened with.
    versions : callable
        Returns the versions of the software on the machine that calls it.
    """

    one_group = False

    def __init__(
        self,
        work: BlockWork,
        space: Workspace,
        budget: Budget,
        progress: Progress,
        pool: WorkerPool,
        options: ReadOptions,
        versions: Callable[[], Mapping[str, str]],
    ) -> None:
        self._space, self._progress, self._pool = space, progress, pool
        self._options, self._versions = options, versions
        self._context = RunContext(work, budget.memory, pool.threads, space.points_folder, space.new_tiles, uuid4().hex)

    @contextmanager
    def running(self) -> Iterator[None]:
        """Check that every worker has the same software and sees the folders; tell the workers when the run ends."""
        folders = (self._context.points, self._context.tiles)
        for folder in folders:
            (folder / ALIVE).write_text(self._context.run_id, encoding="utf-8")
        with worker_errors(_REMEDY):
            try:
                self._check_workers()
                yield
            finally:
                for folder in folders:
                    (folder / ALIVE).unlink(missing_ok=True)
                self._wait_until_idle()

    def range_points(self, points: int) -> int | None:
        """Return the most points of a range, so that every worker gets several ranges."""
        return range_points(points, self._pool.workers.count())

    def read(self, plan: ReadPlan) -> Generator[ReadResult, None, None]:
        """Read all ranges that are unread."""
        workers = self._pool.workers.count()
        shared = list(shared_tasks(self._context.work.grid, plan.unread, plan.read, plan.finished, workers))
        tasks = (
            (self._context, [self._source(plan, part) for part in task.ranges], task, plan.skip_bad) for task in shared
        )
        with closing(self._pool.workers.run(read_ranges, tasks)) as results:
            for number, read in results:
                yield from read
                self._progress.advance(sum(part.points for part in shared[number].ranges))

    def count_marks(self, groups: Iterator[BlockGroup]) -> Generator[tuple[int, int], None, None]:
        """Yield the number of tiles, and of those with ground points, for each group."""
        yield from self._run_tasks(count_marks, ((self._context, group) for group in groups))

    def finish(self, groups: Iterator[BlockGroup], *, ground_only: bool) -> Generator[FinishedTiles, None, None]:
        """Rate the blocks of each group."""
        tasks = ((self._context, group, ground_only) for group in groups)
        for tiles in self._run_tasks(finish_group, tasks):
            yield tiles
            self._progress.advance(tiles.blocks)

    def _run_tasks(self, function: Callable[..., Any], tasks: Iterable[tuple[Any, ...]]) -> Generator[Any, None, None]:
        with closing(self._pool.workers.run(function, tasks)) as results:
            for _, result in results:
                yield result

    def _source(self, plan: ReadPlan, part: ChunkRange) -> FileSource:
        path = plan.readers[part.file].info.path
        known = self._space.run_spec["inputs"][str(path)]
        place = path if isinstance(path, str) else path.absolute()
        chunk_points = self._space.run_spec["cut"]["chunk_points"]
        return FileSource(place, self._options, (known["size"], known["digest"]), chunk_points)

    def _check_workers(self) -> None:
        """Raise UsageError if a worker lacks something that the run needs."""
        # Workers on this machine run the same software; to look it up, each would import GDAL, which no task needs.
        versions = dict[str, str] if self._pool.is_local else self._versions
        answers = self._pool.workers.each(missing_on_worker, self._context, versions, versions())
        for address, answer in answers.items():
            if isinstance(answer, BaseException):
                raise UsageError(
                    f"the worker {address} cannot run this: {answer}. Install the same bumpymap on every worker"
                )
            if answer is not None:
                raise UsageError(f"{answer} (worker {address})")

    def _wait_until_idle(self) -> None:
        """Wait until no worker is busy with the run: it must not write after the folders are removed."""
        from bumpytiles import ClusterError

        end = time.monotonic() + TIMEOUT_S
        with suppress(ClusterError):
            while time.monotonic() < end and any(answer is True for answer in self._pool.workers.each(busy).values()):
                time.sleep(0.1)
