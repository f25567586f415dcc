"""Many jobs in few processes: in order, noted in a journal, and gone on with after an interruption.

The physics engine holds the interpreter lock, so jobs go to processes. A job has its own random streams, so neither the
number of workers nor an interruption changes a bit of the results.
"""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import wait
from typing import Protocol, TypeVar

from bumpymap.errors import BumpymapError
from bumpymap.vehicle.journal import Journal, Key
from bumpymap.vehicle.patch import PatchDrives

__all__ = ["Job", "Progress", "drive_jobs"]

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
    with _runner(task, min(workers, max(len(left), 1))) as run:
        for job, drives in zip(left, run(left), strict=True):
            driven[job.key] = drives
            if journal:
                journal.add(job.key, drives)
            done += job.starts
            report(done, total)
    return {job.key: driven[job.key] for job in jobs}


@contextmanager
def _runner(
    task: Callable[[AnyJob], PatchDrives], workers: int
) -> Iterator[Callable[[Iterable[AnyJob]], Iterator[PatchDrives]]]:
    """Give a function that runs jobs, in this process or in a pool, and gives their results in order."""
    if workers <= 1:
        yield lambda jobs: map(task, jobs)
        return
    # Spawned, not forked: a fork of a process with threads (progress bars, numerical libraries) can hang.
    context = multiprocessing.get_context("spawn")
    others = set(multiprocessing.active_children())
    try:
        pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_prepare_worker)
    except OSError as error:  # their locks lie in shared memory
        raise BumpymapError(
            f"cannot start {workers} processes: {error.strerror}. Is shared memory (/dev/shm) full? With "
            "--workers 1 none is needed"
        ) from error
    try:
        yield lambda jobs: pool.map(task, jobs)
    except BrokenProcessPool as error:
        raise BumpymapError(
            "a simulation process died, perhaps for want of memory; run the same command again to go on, "
            "with fewer --workers if it happens again"
        ) from error
    except BaseException:
        # Nobody wants what the workers are at any more, and they would be at it for many seconds.
        for worker in set(multiprocessing.active_children()) - others:
            worker.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _prepare_worker() -> None:
    """Leave Ctrl-C to the main process, and end when it does: a worker waits for jobs for ever once that was killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    wait([sentinel])
    os._exit(1)
