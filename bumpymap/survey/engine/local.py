"""The executor of a run on one machine: one worker, in this process."""

from collections.abc import Generator, Iterator
from contextlib import AbstractContextManager, nullcontext

from bumpymap.core import Progress
from bumpymap.survey.engine.block_work import BlockWork
from bumpymap.survey.engine.budget import Budget
from bumpymap.survey.engine.catalogue import BlockGroup
from bumpymap.survey.engine.chunk_stream import OpenRange
from bumpymap.survey.engine.plan import single_tasks
from bumpymap.survey.engine.results import FinishedTiles, ReadResult
from bumpymap.survey.engine.run import ReadPlan
from bumpymap.survey.engine.worker import Worker, own_folder
from bumpymap.survey.engine.workspace import Workspace

__all__ = ["LocalExecutor"]


class LocalExecutor:
    """Does every task here, file after file; points stay in memory as long as there is room.

    Parameters
    ----------
    work : BlockWork
    space : Workspace
    budget : Budget
    told : Progress
    """

    one_group = True

    def __init__(self, work: BlockWork, space: Workspace, budget: Budget, progress: Progress) -> None:
        self._work, self._space, self._budget, self._told = work, space, budget, progress
        self._worker: Worker

    def range_points(self, _: int) -> int | None:
        """Leave every file whole."""
        return None

    def running(self) -> AbstractContextManager[None]:
        """Do nothing: this process runs."""
        return nullcontext()

    def read(self, plan: ReadPlan) -> Generator[ReadResult, None, None]:
        """Read all that is unread; the worker keeps what it has read."""
        points, tiles = own_folder(self._space.points_folder), own_folder(self._space.new_tiles)
        self._worker = Worker(self._work, self._budget, points, tiles, self._told)
        tasks = list(single_tasks(plan.unread, plan.read, plan.finished))
        ranges = [
            OpenRange(part, plan.readers[part.file], plan.chunks[part.file][part.first : part.stop])
            for part in plan.unread
        ]
        yield from self._worker.read(tasks, ranges, skip_bad=plan.skip_bad)

    def count_marks(self, groups: Iterator[BlockGroup]) -> Generator[tuple[int, int], None, None]:
        """Count tiles, and those with ground points."""
        return (self._worker.count_marks(group) for group in groups)

    def finish(self, groups: Iterator[BlockGroup], *, ground_only: bool) -> Generator[FinishedTiles, None, None]:
        """Finish blocks."""
        for group in groups:
            yield from self._worker.finish(group, ground_only=ground_only)
