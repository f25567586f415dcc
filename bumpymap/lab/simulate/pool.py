"""Run drive jobs in processes, return results in order and record them in a journal for resuming.

The physics engine holds the interpreter lock, so jobs run in processes. A job has its own random streams, so neither
the number of workers nor an interruption changes a bit of the results.
"""

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from multiprocessing.connection import wait
from typing import Any, Protocol, TypeVar

from bumpymap.core import BumpymapError, Child, ChildDiedError, shielded
from bumpymap.lab.simulate.journal import JobJournal, Key

__all__ = ["Job", "Progress", "attempt", "drive_jobs", "run_in_processes"]

Progress = Callable[[int, int], None]
"""Called with the number of finished drives and the number of all drives."""


class Job(Protocol):
    """A patch to drive over."""

    @property
    def key(self) -> Key:
        """Name of the job in a journal."""

    @property
    def starts(self) -> int:
        """Number of drives that it counts for in the progress."""


JobType = TypeVar("JobType", bound=Job)
Task = TypeVar("Task")
Result = TypeVar("Result")


def drive_jobs(
    task: Callable[[JobType], Result],
    jobs: Sequence[JobType],
    progress: Progress | None = None,
    *,
    workers: int = 1,
    journal: JobJournal[Result] | None = None,
    discard_other: bool = False,
) -> dict[Key, Result]:
    """Drive all jobs that are not in the journal yet.

    Parameters
    ----------
    task : callable
        Runs one job; it and the jobs must be picklable.
    jobs : sequence
        Each with its own key.
    progress : callable, optional
        Called with (finished drives, all drives) at the start and after every job.
    workers : int
        Number of processes; the result does not depend on it.
    journal : JobJournal, optional
        Records finished jobs; jobs already in it are not run again.
    discard_other : bool
        Discard a journal written with other settings instead of raising an error.

    Returns
    -------
    dict
        Key of every job -> its drives, in the order of the jobs.
    """
    driven = journal.resume(discard_other=discard_other) if journal else {}
    left = [job for job in jobs if job.key not in driven]
    total = sum(job.starts for job in jobs)
    done = total - sum(job.starts for job in left)
    report = progress or (lambda _done, _total: None)
    report(done, total)
    with _results(task, left, min(workers, len(left))) as results:
        for job, drives in zip(left, results, strict=True):
            driven[job.key] = drives
            if journal:
                journal.add(job.key, drives)
            done += job.starts
            report(done, total)
    return {job.key: driven[job.key] for job in jobs}


def _results(
    task: Callable[[JobType], Result], jobs: Sequence[JobType], workers: int
) -> AbstractContextManager[Iterator[Result]]:
    """Run jobs in this process (one worker) or in child processes; return an iterator of results in order."""
    if workers <= 1:
        return nullcontext(map(task, jobs))
    return closing(run_in_processes(task, jobs, workers))


def run_in_processes(
    task: Callable[[Task], Result], jobs: Sequence[Task], workers: int
) -> Generator[Result, None, None]:
    """Run jobs in child processes and yield their results in order; an idle worker gets the next job.

    This process uses no threads, because a thread would outlive an interruption and print a message. Closing the
    generator ends the workers.

    Parameters
    ----------
    task : callable
        Runs one job; it, the jobs and the results must be picklable.
    jobs : sequence
    workers : int

    Raises
    ------
    BumpymapError
        A worker died.
    Exception
        Whatever ``task`` raises.
    """
    children: list[Child] = []
    try:
        for _ in range(workers):
            with shielded():
                children.append(Child("for the simulation", __name__))
        finished: dict[int, Result] = {}
        wanted = 0
        for number, result in _completed_jobs(task, jobs, children):
            finished[number] = result
            while wanted in finished:
                yield finished.pop(wanted)
                wanted += 1
    except ChildDiedError as error:
        raise BumpymapError(
            f"a simulation process {error}, perhaps because memory ran out; run the same command again to continue, "
            "with fewer --workers if it happens again"
        ) from error
    finally:
        # Results of running jobs are no longer needed, and the jobs would go on for many seconds.
        with shielded():
            for child in children:
                child.close()


def _completed_jobs(
    task: Callable[[Task], Result], jobs: Sequence[Task], children: Sequence[Child]
) -> Generator[tuple[int, Result], None, None]:
    """Yield number and result of each job as it completes."""
    waiting = iter(enumerate(jobs))
    idle = list(children)
    busy: dict[Any, tuple[Child, int]] = {}
    while True:
        for child, (number, job) in zip(idle.copy(), waiting, strict=False):
            child.begin("attempt", task, job)
            idle.remove(child)
            busy[child.link] = child, number
        if not busy:
            return
        for link in wait(list(busy)):
            child, number = busy.pop(link)
            result, error = child.finish()
            if error is not None:
                raise error
            idle.append(child)
            yield number, result


def attempt(task: Callable[[Task], Result], job: Task) -> tuple[Result | None, Exception | None]:
    """Run a job in a worker; return its result, or the exception for the parent to raise."""
    try:
        return task(job), None
    except Exception as error:  # noqa: BLE001 (the parent raises it)
        return None, error
