"""Make the calibration of a vehicle: drive it over textures of each z range and over the terrain library."""

from dataclasses import replace
from functools import partial
from time import perf_counter

from bumpymap.lab.simulate.journal import Journal
from bumpymap.lab.simulate.library import FitRide, FitThin
from bumpymap.lab.simulate.model import require_dart
from bumpymap.lab.simulate.plan import CalibrationSettings, run_job
from bumpymap.lab.simulate.pool import Progress, drive_jobs
from bumpymap.lab.simulate.summary import summarise
from bumpymap.rating import Calibration

__all__ = ["calibrate_vehicle", "seconds_of_a_drive"]


def seconds_of_a_drive(settings: CalibrationSettings) -> float:
    """Return the time that one drive of a calibration takes one process, s, measured on one drive of each kind.

    Raises
    ------
    UsageError
        The extra ``sim`` is not installed.
    """
    require_dart()
    kinds = {type(job): job for job in settings.jobs()}  # the last job of each
    begin = perf_counter()
    for job in kinds.values():
        run_job(settings, replace(job, starts=1))
    return (perf_counter() - begin) / len(kinds)


def calibrate_vehicle(
    settings: CalibrationSettings,
    progress: Progress | None = None,
    *,
    workers: int = 1,
    journal: Journal | None = None,
    discard_other: bool = False,
    command: str = "",
    fit: FitRide | None = None,
    fit_thin: FitThin | None = None,
) -> Calibration:
    """Drive a vehicle over synthetic terrain and summarise the ride cost of each kind of ground.

    Parameters
    ----------
    settings : CalibrationSettings
    progress : callable, optional
        Called with (finished drives, all drives) after every patch.
    workers : int
        Number of processes; the result does not depend on it.
    journal : Journal, optional
        Records driven patches; patches already in it are not driven again.
    discard_other : bool
        Discard a journal written with other settings instead of raising an error.
    command : str
        Command line that makes the file again; stored in the calibration.
    fit : callable, optional
        Fits the ride model to the drives over the terrain library; without it the calibration has no ride model.
    fit_thin : callable, optional
        Fits the model of thin surveys to the ride model; without it the calibration has none.

    Returns
    -------
    Calibration
    """
    require_dart()
    results = drive_jobs(
        partial(run_job, settings),
        list(settings.jobs()),
        progress,
        workers=workers,
        journal=journal,
        discard_other=discard_other,
    )
    return summarise(settings, results, command, fit, fit_thin)
