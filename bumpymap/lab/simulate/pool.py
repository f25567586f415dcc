"""Many jobs in few processes: in order, noted in a journal, and gone on with after an interruption.

The physics engine holds the interpreter lock, so jobs go to processes. A job has its own random streams, so neither the
number of workers nor an interruption changes a bit of the results.
"""

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from multiprocessing.connection import wait
from typing import Any, Protocol, TypeVar

from bumpymap.core import BumpymapError, Child, ChildDiedError, shielded
from bumpymap.lab.simulate.journal import Journal, Key
from bumpymap.lab.simulate.patch import PatchDrives

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
        """How many drives it counts for in the progress."""


AnyJob = TypeVar("AnyJob", bound=Job)
Task = TypeVar("Task")
Result = TypeVar("Result")


def drive_jobs(
    task: Callable[[AnyJob], PatchDrives],
    jobs: Sequence[AnyJob],
    progress: Progress | None = None,
    *,
    workers: int = 1,
    journal: Journal | None = None,
    discard_other: bool = False,
) -> dict[Key, PatchDrives]:
    """Drive all jobs that are not in the journal yet.

    Parameters
    ----------
    task : callable
        Drives one job; it and the jobs must be picklable.
    jobs : sequence
        With different keys.
    progress : callable, optional
        Called with (finished drives, all drives) at the start and after every job.
    workers : int
        Processes; the result does not depend on it.
    journal : Journal, optional
        Where finished jobs are noted, and taken from when a run was interrupted.
    discard_other : bool
        Throw away a journal of other settings instead of refusing it.

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
    task: Callable[[AnyJob], PatchDrives], jobs: Sequence[AnyJob], workers: int
) -> AbstractContextManager[Iterator[PatchDrives]]:
    """Run jobs, in this process or in others, and give their results in order."""
    if workers <= 1:
        return nullcontext(map(task, jobs))
    return closing(run_in_processes(task, jobs, workers))


def run_in_processes(
    task: Callable[[Task], Result], jobs: Sequence[Task], workers: int
) -> Generator[Result, None, None]:
    """Run jobs in child processes and give their results in order; a worker takes the next job when it is idle.

    This process hands the jobs out without threads of its own: one would outlive an interruption, and tell the user
    about it. To close the generator is to end the workers.

    Parameters
    ----------
    task : callable
        Does one job; it, the jobs and the results must be picklable.
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
        for number, result in _finished(task, jobs, children):
            finished[number] = result
            while wanted in finished:
                yield finished.pop(wanted)
                wanted += 1
    except ChildDiedError as error:
        raise BumpymapError(
            f"a simulation process {error}, perhaps for want of memory; run the same command again to go on, "
            "with fewer --workers if it happens again"
        ) from error
    finally:
        # Whatever the reason, nobody wants what they are at any more, and they would be at it for many seconds.
        with shielded():
            for child in children:
                child.close()


def _finished(
    task: Callable[[Task], Result], jobs: Sequence[Task], children: Sequence[Child]
) -> Generator[tuple[int, Result], None, None]:
    """Give number and result of each job as they come."""
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
    """In a worker: do a job; give its result, or what it raised, for the parent to raise."""
    try:
        return task(job), None
    except Exception as error:  # noqa: BLE001 (whatever it is)
        return None, error
