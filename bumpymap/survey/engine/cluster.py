"""The executor of a run on the workers of dask.distributed: each task may be done by any of them.

Workers hand each other points and finished tiles as files in folders that all of them see. This process sees counts and
names of files alone.
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
from bumpymap.survey.engine.plan import ReadTask, range_points, shared_tasks
from bumpymap.survey.engine.pool import PATIENCE_S, WorkerPool, worker_losses
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
    read_range,
)
from bumpymap.survey.engine.workspace import Workspace

__all__ = ["ClusterExecutor"]

_REMEDY = "Look at their logs. Workers that run short of memory die: give them more, or lower `memory`"


class ClusterExecutor:
    """Shares tasks out among workers; points that wait for others are in packs.

    Parameters
    ----------
    work : BlockWork
    space : Workspace
        In folders that every worker sees.
    budget : Budget
        Of each worker.
    told : Progress
    pool : WorkerPool
    options : ReadOptions
        With which the readers were opened.
    versions : callable
        Gives the versions of the software where it is called.
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
        self._space, self._told, self._pool = space, progress, pool
        self._options, self._versions = options, versions
        self._context = RunContext(work, budget.memory, pool.threads, space.points_folder, space.new_tiles, uuid4().hex)

    @contextmanager
    def running(self) -> Iterator[None]:
        """See that every worker fits and sees the folders; tell the workers when the run ends."""
        folders = (self._context.points, self._context.tiles)
        for folder in folders:
            (folder / ALIVE).write_text(self._context.run_id, encoding="utf-8")
        with worker_losses(_REMEDY):
            try:
                self._look()
                yield
            finally:
                for folder in folders:
                    (folder / ALIVE).unlink(missing_ok=True)
                self._wait()

    def range_points(self, points: int) -> int | None:
        """Share the points out among the workers."""
        return range_points(points, self._pool.workers.count())

    def read(self, plan: ReadPlan) -> Generator[ReadResult, None, None]:
        """Read all that is unread."""
        shared = shared_tasks(self._context.work.grid, plan.unread, plan.read, plan.finished)
        tasks = ((self._context, self._source(plan, task), task) for task in shared)
        with closing(self._pool.workers.run(read_range, tasks)) as results:
            for number, result in results:
                yield result
                self._told.advance(plan.unread[number].points)

    def count_marks(self, groups: Iterator[BlockGroup]) -> Generator[tuple[int, int], None, None]:
        """Count tiles, and those with ground points."""
        yield from self._done(count_marks, ((self._context, group) for group in groups))

    def finish(self, groups: Iterator[BlockGroup], *, ground_only: bool) -> Generator[FinishedTiles, None, None]:
        """Finish blocks."""
        tasks = ((self._context, group, ground_only) for group in groups)
        for tiles in self._done(finish_group, tasks):
            yield tiles
            self._told.advance(tiles.blocks)

    def _done(self, function: Callable[..., Any], tasks: Iterable[tuple[Any, ...]]) -> Generator[Any, None, None]:
        with closing(self._pool.workers.run(function, tasks)) as results:
            for _, result in results:
                yield result

    def _source(self, plan: ReadPlan, task: ReadTask) -> FileSource:
        path = plan.readers[task.range.file].info.path
        known = self._space.run_spec["inputs"][str(path)]
        place = path if isinstance(path, str) else path.absolute()
        chunk_points = self._space.run_spec["cut"]["chunk_points"]
        return FileSource(place, self._options, (known["size"], known["digest"]), chunk_points)

    def _look(self) -> None:
        """Ask every worker what it lacks."""
        answers = self._pool.workers.each(missing_on_worker, self._context, self._versions, self._versions())
        for address, answer in answers.items():
            if isinstance(answer, BaseException):
                raise UsageError(
                    f"the worker {address} cannot run this: {answer}. Install the same bumpymap on every worker"
                )
            if answer is not None:
                raise UsageError(f"{answer} (worker {address})")

    def _wait(self) -> None:
        """Wait until no worker is at it any more: what it writes must not come after the folders are gone."""
        from bumpytiles import ClusterError

        end = time.monotonic() + PATIENCE_S
        with suppress(ClusterError):
            while time.monotonic() < end and any(answer is True for answer in self._pool.workers.each(busy).values()):
                time.sleep(0.1)
