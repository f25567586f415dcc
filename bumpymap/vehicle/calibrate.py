"""From a vehicle profile to its calibration: drive every cell of textures x z range, then sum up.

Jobs go to a pool of processes (the engine holds the interpreter lock) and come back in order. Each job has its own
random streams, so neither the number of workers nor an interruption changes a bit of the result.
"""

import logging
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from multiprocessing.connection import wait

from bumpymap.calibration import Calibration
from bumpymap.errors import BumpymapError
from bumpymap.types import TEXTURES
from bumpymap.vehicle.journal import Cell, Journal
from bumpymap.vehicle.model import require_dart
from bumpymap.vehicle.plan import CalibrationSettings, Job, PatchDrives, run_job
from bumpymap.vehicle.summary import summarise

__all__ = ["Progress", "calibrate"]

_LOG = logging.getLogger(__name__)

Progress = Callable[[int, int], None]
"""Called with the number of finished drives and the number of all drives."""


def calibrate(
    settings: CalibrationSettings,
    progress: Progress | None = None,
    *,
    workers: int = 1,
    journal: Journal | None = None,
    discard_other: bool = False,
    command: str = "",
) -> Calibration:
    """Drive a vehicle over simulated terrain and sum up what each kind of ground costs it.

    Parameters
    ----------
    settings : CalibrationSettings
    progress : callable, optional
        Called with (finished drives, all drives) after every patch.
    workers : int
        Processes; the result does not depend on it.
    journal : Journal, optional
        Where finished cells are noted, and taken from when a run was interrupted.
    discard_other : bool
        Throw away a journal of other settings instead of refusing it.
    command : str
        How to make the file again; noted in it.

    Returns
    -------
    Calibration
    """
    require_dart()
    cells = journal.resume(discard_other=discard_other) if journal else {}
    jobs = [job for job in settings.jobs() if (job.texture, job.z) not in cells]
    done = len(cells) * settings.patches * settings.starts
    report = progress or (lambda _done, _total: None)
    report(done, settings.total_drives)
    open_cell: list[PatchDrives] = []
    with _runner(settings, min(workers, max(len(jobs), 1))) as run:
        for job, result in zip(jobs, run(jobs), strict=True):
            open_cell.append(result)
            done += settings.starts
            if len(open_cell) == settings.patches:
                _finish(cells, (job.texture, job.z), open_cell, settings, journal)
                open_cell = []
            report(done, settings.total_drives)
    return summarise(settings, cells, command)


def _finish(
    cells: dict[Cell, list[PatchDrives]],
    cell: Cell,
    drives: list[PatchDrives],
    settings: CalibrationSettings,
    journal: Journal | None,
) -> None:
    cells[cell] = drives
    if journal:
        journal.add(cell, drives)
    _LOG.info("%s at %g m: driven", TEXTURES[cell[0]], settings.z_range[cell[1]])


@contextmanager
def _runner(settings: CalibrationSettings, workers: int) -> Iterator[Callable[[Iterable[Job]], Iterator[PatchDrives]]]:
    """Give a function that runs jobs, in this process or in a pool, and gives their results in order."""
    task = partial(run_job, settings)
    if workers <= 1:
        yield lambda jobs: map(task, jobs)
        return
    # Spawned, not forked: a fork of a process with threads (progress bars, numerical libraries) can hang.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_prepare_worker)
    try:
        yield lambda jobs: pool.map(task, jobs)
    except BrokenProcessPool as error:
        raise BumpymapError(
            "a simulation process died, perhaps for want of memory; run the same command again to go on, "
            "with fewer --workers if it happens again"
        ) from error
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
