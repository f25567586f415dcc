"""Many jobs in few processes: in order, noted in a journal, and gone on with after an interruption.

The physics engine holds the interpreter lock, so jobs go to processes. A job has its own random streams, so neither the
number of workers nor an interruption changes a bit of the results.
"""

import multiprocessing
import os
import threading
from collections.abc import Callable, Generator, Sequence
from contextlib import closing, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from multiprocessing.util import Finalize
from typing import Protocol, TypeVar

from bumpymap.core import BumpymapError, shielded
from bumpymap.lab.simulate.journal import Journal, Key
from bumpymap.lab.simulate.patch import PatchDrives
from bumpytiles import blocked_signals

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
    with closing(_run(task, left, min(workers, len(left)))) as results:
        for job, drives in zip(left, results, strict=True):
            driven[job.key] = drives
            if journal:
                journal.add(job.key, drives)
            done += job.starts
            report(done, total)
    return {job.key: driven[job.key] for job in jobs}


def _run(
    task: Callable[[AnyJob], PatchDrives], jobs: Sequence[AnyJob], workers: int
) -> Generator[PatchDrives, None, None]:
    """Run jobs, in this process or in others, and give their results in order."""
    if workers <= 1:
        yield from map(task, jobs)
        return
    started: list[SpawnProcess] = []
    try:
        results: dict[int, PatchDrives] = {}
        wanted = 0
        for number, result in _results(jobs, [_start(task, started) for _ in range(workers)]):
            results[number] = result
            while wanted in results:
                yield results.pop(wanted)
                wanted += 1
    finally:
        # Whatever the reason, nobody wants what they are at any more, and they would be at it for many seconds.
        with shielded():
            for worker in started:
                worker.kill()
            for worker in started:
                worker.join()


def _start(task: Callable[[AnyJob], PatchDrives], started: list[SpawnProcess]) -> Connection:
    # Spawned, not forked: a fork of a process with threads (progress bars, numerical libraries) can hang.
    context = multiprocessing.get_context("spawn")
    resource_tracker.ensure_running()  # or it starts with the first worker, and unblocks the signals
    ours, theirs = context.Pipe()
    with shielded(), theirs, blocked_signals():
        worker = context.Process(target=_work, args=(task, theirs), daemon=True)
        worker.start()
        started.append(worker)
        # At its end the interpreter asks what is left of its children to go, to which these are deaf, and waits: so a
        # signal just before the clearing up in `_run` would leave it waiting for ever.
        Finalize(None, worker.kill, exitpriority=0)
    return ours


def _results(jobs: Sequence[AnyJob], idle: list[Connection]) -> Generator[tuple[int, PatchDrives], None, None]:
    """Hand jobs out one by one; give number and result of each as they come.

    This process does that without threads of its own: one would outlive an interruption, and tell the user about it.
    """
    waiting = iter(enumerate(jobs))
    busy: list[Connection] = []
    try:
        while True:
            for link, (number, job) in zip(idle.copy(), waiting, strict=False):
                link.send((number, job))
                idle.remove(link)
                busy.append(link)
            if not busy:
                return
            ready = wait(busy)
            for link in [link for link in busy if link in ready]:
                number, result, error = link.recv()
                if error is not None:
                    raise error
                busy.remove(link)
                idle.append(link)
                yield number, result
    except (EOFError, ConnectionError) as error:
        raise BumpymapError(
            "a simulation process died, perhaps because memory ran out; run the same command again to continue, "
            "with fewer --workers if it happens again"
        ) from error


def _work(task: Callable[[AnyJob], PatchDrives], link: Connection) -> None:
    """Do jobs until the other end closes; end with the main process even in the middle of one."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()
    with suppress(EOFError, ConnectionError):
        while True:
            number, job = link.recv()
            answer: list[object] = [number, None, None]
            try:
                answer[1] = task(job)
            except Exception as error:  # noqa: BLE001 (whatever it is, the main process raises it)
                answer[2] = error
            link.send(answer)


def _end_with(sentinel: int) -> None:
    wait([sentinel])
    os._exit(1)
