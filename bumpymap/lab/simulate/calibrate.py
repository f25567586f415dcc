"""Make the calibration of a vehicle: drive it over textures of each z range and over the terrain library."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from bumpymap.core import TEXTURES, Progress
from bumpymap.lab.settings import CalibrationSettings
from bumpymap.lab.simulate.drive import PatchDrives, drive_patch, driven_library, library_record, library_terrain
from bumpymap.lab.simulate.jobs import DriveJob, Journal, Key, drive_jobs
from bumpymap.lab.simulate.model import require_dart
from bumpymap.lab.simulate.motion_fit import MotionRecord, fit_motion, motion_jobs, run_motion
from bumpymap.lab.simulate.refit import crossing_jobs, fit_models, fit_steps, run_crossing
from bumpymap.lab.terrains import KINDS, make_textures
from bumpymap.rating import Calibration

_LIBRARY_STREAM = len(TEXTURES)
"""First number of the random streams of library drives; no texture has this index."""


def calibration_jobs(settings: CalibrationSettings) -> list[DriveJob]:
    """Return all drives of a calibration: the table cell by cell, the library kind by kind, crossings, other speeds.

    Each cell of the table follows the paper: one of four textures, scaled to a height range.
    """
    table = product(range(len(TEXTURES)), range(len(settings.z_range)), range(settings.patches))
    library = product(KINDS, range(settings.terrains))
    return [
        *(DriveJob(("table", *place), settings.starts) for place in table),
        *(DriveJob(("library", *place), settings.terrain_starts) for place in library),
        *crossing_jobs(settings.profile),
        *motion_jobs(settings),
    ]


def run_job(settings: CalibrationSettings, job: DriveJob) -> PatchDrives | MotionRecord:
    """Make the ground of a job and drive over it.

    Ground and starts have their own random streams, derived from the seed and the job's key, so the result does not
    depend on the process or on earlier jobs.
    """
    purpose, *place = job.key
    if purpose == "crossing":
        return run_crossing(settings, job)
    if purpose == "motion":
        return run_motion(settings, job)
    if purpose == "table":
        texture, z, patch = map(int, place)
        stream: tuple[int, ...] = (texture, z, patch)
        rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=stream))
        form = make_textures(TEXTURES[texture], 1, rng, settings.pixels)[0]
        heights = form.astype(np.float64) * settings.z_range[z]
    else:
        kind, index = str(place[0]), int(place[1])
        stream = (_LIBRARY_STREAM, KINDS.index(kind), index)
        heights = library_terrain(settings, kind, index).heights
    return drive_patch(
        settings.profile, heights, settings.tile_size, settings.seed, job.starts, settings.drive, stream=stream
    )


def calibration_journal(path: Path, settings: CalibrationSettings) -> Journal[PatchDrives | MotionRecord]:
    """Return the progress file of a calibration."""

    def read(own: dict[str, Any]) -> PatchDrives | MotionRecord:
        return PatchDrives.read(own) if "outcome" in own else MotionRecord.read(own)

    return Journal(path, settings.to_dict(), read)


def summarise(
    settings: CalibrationSettings, results: Mapping[Key, Any], command: str = "", like: Calibration | None = None
) -> Calibration:
    """Compute table, ride model and classes of a calibration from the drives of its jobs (key of a job -> its drives).

    ``command`` is the command line that makes the file again; ``like`` gives the class limits, see `calibrate_vehicle`.
    """
    textures, ranges, patches = (range(count) for count in (len(TEXTURES), len(settings.z_range), settings.patches))
    table = [[[results["table", texture, z, patch] for patch in patches] for z in ranges] for texture in textures]
    means = [[[patch.mean_c_r for patch in cell] for cell in line] for line in table]

    def cells(summary: Callable[[Any], Any], of: list[list[Any]]) -> tuple[tuple[Any, ...], ...]:
        return tuple(tuple(map(summary, line)) for line in of)

    def log_sd(values: list[float]) -> float | None:
        return float(np.std([math.log(value) for value in values], ddof=1)) if len(values) > 1 else None

    driven = driven_library(settings, results)
    crossed = [[[mean for mean in cell if mean is not None] for cell in line] for line in means]
    models, said = fit_models(settings, driven, like)
    record: dict[str, Any] = {"command": command, **settings.to_dict(), **said, "patch_c_r": means}
    record["library"] = library_record(driven)
    return Calibration(
        vehicle=record.pop("vehicle"),
        tile_size=settings.tile_size,
        pixels=settings.pixels,
        textures=TEXTURES,
        z_range=settings.z_range,
        c_r=cells(lambda values: math.fsum(values) / len(values) if values else None, crossed),
        c_r_log_sd=cells(log_sd, crossed),
        p_fail=cells(lambda cell: sum(p.failed for p in cell) / sum(len(p.outcome) for p in cell), table),
        drives=cells(lambda cell: sum(len(patch.outcome) for patch in cell), table),
        settings=record,
        **models,
    )


def seconds_of_drives(settings: CalibrationSettings) -> float:
    """Return the time that all drives take one process, s, measured on one drive of each kind."""
    require_dart()
    jobs = calibration_jobs(settings)
    seconds = 0.0
    run_job(settings, replace(jobs[0], starts=1))  # loads the physics
    for purpose, job in {job.key[0]: job for job in jobs}.items():
        begin = process_time()
        run_job(settings, replace(job, starts=1))
        seconds += (process_time() - begin) * sum(each.starts for each in jobs if each.key[0] == purpose)
    return seconds


def calibrate_vehicle(
    settings: CalibrationSettings,
    progress: Progress | None = None,
    *,
    workers: int = 1,
    journal: Journal[PatchDrives | MotionRecord] | None = None,
    discard_other: bool = False,
    command: str = "",
    like: Calibration | None = None,
) -> Calibration:
    """Drive a vehicle over synthetic terrain, summarise the ride cost of each kind of ground and fit the models.

    ``progress``, ``workers``, ``discard_other``: see `drive_jobs`; ``journal``: of `calibration_journal`; ``command``:
    command line that makes the file again, stored in it; ``like``: a calibration of the same vehicle for tiles of
    another size, whose class limits are taken.
    """
    require_dart()
    results = drive_jobs(
        partial(run_job, settings),
        calibration_jobs(settings),
        progress,
        workers=workers,
        journal=journal,
        discard_other=discard_other,
    )
    made = summarise(settings, results, command, like)
    return replace(made, steps=fit_steps(made, results), motion=fit_motion(settings, results).to_record())
