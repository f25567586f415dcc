"""The executor of a run on one machine: one worker, in this process."""

from collections.abc import Generator, Iterator
from contextlib import AbstractContextManager, nullcontext

from bumpymap.core import Progress
from bumpymap.survey.engine.block_work import BlockWork
from bumpymap.survey.engine.budget import Budget
from bumpymap.survey.engine.catalogue import BlockGroup
from bumpymap.survey.engine.chunk_stream import OpenRange
from bumpymap.survey.engine.plan import single_task
from bumpymap.survey.engine.results import FinishedTiles, ReadResult
from bumpymap.survey.engine.run import ReadPlan
from bumpymap.survey.engine.worker import Worker, new_folder
from bumpymap.survey.engine.workspace import Workspace

__all__ = ["LocalExecutor"]


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
        task = single_task(plan.unread, plan.finished, plan.waiting)
        ranges = [
            OpenRange(part, plan.readers[part.file], plan.chunks[part.file][part.first : part.stop])
            for part in plan.unread
        ]
        yield from self._worker.read(task, ranges, skip_bad=plan.skip_bad)

    def count_marks(self, groups: Iterator[BlockGroup]) -> Generator[tuple[int, int], None, None]:
        """Yield the number of tiles, and of those with ground points, for each group."""
        return (self._worker.count_marks(group) for group in groups)

    def finish(self, groups: Iterator[BlockGroup], *, ground_only: bool) -> Generator[FinishedTiles, None, None]:
        """Rate the blocks of each group."""
        for group in groups:
            yield from self._worker.finish(group, ground_only=ground_only)
