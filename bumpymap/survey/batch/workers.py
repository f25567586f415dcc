"""Worker processes of a batch: each maps one survey after another, so that Python and its libraries start once.

Processes, not threads: a survey that crashes native code, or takes the last memory, ends its worker alone.
"""

from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from multiprocessing.connection import wait
from time import perf_counter

from bumpymap.core import Child, ChildDiedError, ChildError
from bumpymap.layers import SurveyRow
from bumpymap.survey.batch.one_survey import MapTask, TaskEnd
from bumpytiles import compile_packages

__all__ = ["map_tasks"]

_MODULE = "bumpymap.survey.batch.one_survey"


def map_tasks(
    tasks: Sequence[MapTask], jobs: int, started: Callable[[MapTask], None]
) -> Generator[TaskEnd, None, None]:
    """Map surveys, up to ``jobs`` at a time; yield what became of each as soon as it is known.

    Parameters
    ----------
    tasks : sequence of MapTask
        They are begun in this order.
    jobs : int
    started : callable
        Called when a task is begun.

    Raises
    ------
    UsageError
        No process can be started.
    """
    compile_packages("bumpymap", "bumpytiles", at_once=False)  # here it is told, and not done by each worker
    workers = _Workers()
    waiting = deque(tasks)
    try:
        while waiting or workers.busy:
            while waiting and len(workers.busy) < jobs:
                task = waiting.popleft()
                started(task)
                workers.begin(task)
            yield from workers.ended()
    finally:
        workers.close()  # a run that is under way is ended as by a kill; the next start continues it


class _Workers:
    """The processes, and what each of them does."""

    def __init__(self) -> None:
        self.busy: dict[Child, tuple[MapTask, float]] = {}
        self._idle: list[Child] = []

    def begin(self, task: MapTask) -> None:
        """Give a task to an idle worker, or to a new one."""
        while self._idle:
            child = self._idle.pop()
            try:
                child.begin("map_one", task)
            except ChildDiedError:  # meanwhile, of something else
                child.close()
                continue
            self.busy[child] = task, perf_counter()
            return
        child = Child("to map surveys", _MODULE)
        self.busy[child] = task, perf_counter()  # first: if it died at once, `ended` says so
        try:
            child.begin("map_one", task)
        except ChildDiedError:
            return

    def ended(self) -> Iterator[TaskEnd]:
        """Wait until at least one task has ended, and yield what became of it."""
        links = {child.link: child for child in self.busy}
        for link in wait(list(links)):
            child = links[link]  # type: ignore[index]
            task, begun = self.busy.pop(child)
            try:
                end: TaskEnd = child.finish()
                self._idle.append(child)
            except (ChildDiedError, ChildError) as error:
                child.close()
                end = _lost(task, f"its process {error}", perf_counter() - begun)
            yield end

    def close(self) -> None:
        """End all processes."""
        for child in (*self.busy, *self._idle):
            child.close()


def _lost(task: MapTask, why: str, seconds: float) -> TaskEnd:
    message = f"{why}. If memory ran out, give fewer `jobs` or less `memory`; the next start continues this survey"
    survey = " ".join(map(str, task.config.surveys))
    return TaskEnd(SurveyRow(task.name, "failed", message, seconds=round(seconds, 3), survey=survey), ())
