"""Fit what drives at several speeds teach: C_r at other speeds, roll and weighted acceleration, over the geometry.

``python -m bumpymap.lab.simulate.motion_fit FILE...`` drives and adds ``motion`` to calibration files.
"""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.lab.simulate.journal import JobJournal, Key
from bumpymap.lab.simulate.motion import (
    MotionEffort,
    MotionRecord,
    calibrated_settings,
    drive_library,
    motion_jobs,
    motion_journal,
)
from bumpymap.lab.simulate.plan import CalibrationSettings, library_terrain
from bumpymap.lab.simulate.pool import Progress
from bumpymap.lab.simulate.ride_fit import relief_and_slope
from bumpymap.rating import (
    QUANTITIES,
    Calibration,
    MotionFit,
    MotionModel,
    MotionOperator,
    RideOperator,
    motion_terms,
    move_over,
    plain_terms,
    roll_over,
)

__all__ = ["add_motion", "fit_motion"]

Floats = NDArray[np.float64]
SPEED_RANGE = (0.4, 2.5)
"""Speeds that may be asked for, as shares of the profile's: a quarter beyond those that are driven."""
_LEAST_C_R = 0.002
"""Below this, the simulation's contacts are felt as much as the ground, rad/m."""


def add_motion(
    calibration: Calibration,
    progress: Progress | None = None,
    *,
    effort: MotionEffort | None = None,
    workers: int = 1,
    journal: JobJournal[MotionRecord] | None = None,
    discard_other: bool = False,
) -> Calibration:
    """Return a calibration with ``motion`` added or made again, for its own vehicle, seed and tiles.

    Parameters
    ----------
    calibration : Calibration
    progress : callable, optional
        Called with (finished drives, all drives) after every terrain.
    effort : MotionEffort, optional
    workers : int
        Number of processes; the result does not depend on it.
    journal : JobJournal, optional
        Of `motion_journal`; terrains already in it are not driven again.
    discard_other : bool
        Discard a journal written with other settings instead of raising an error.
    """
    settings, effort = calibrated_settings(calibration), effort or MotionEffort()
    driven = drive_library(
        settings, effort, progress, workers=workers, journal=journal, discard_other=discard_other
    )  # fmt: skip
    return replace(calibration, motion=fit_motion(settings, effort, driven).to_record())


def fit_motion(settings: CalibrationSettings, effort: MotionEffort, driven: Mapping[Key, MotionRecord]) -> MotionModel:
    """Fit the model to drives over the library; terrains where a drive failed are left out."""
    jobs = motion_jobs(effort)
    means = np.stack([_means(driven[job.key]) for job in jobs])  # (terrains, speeds, quantities)
    own = effort.ratios.index(1.0)
    c_r = means[:, own, 0]
    used = np.isfinite(means).all(axis=(1, 2)) & (c_r > _LEAST_C_R)
    terrains = [
        library_terrain(settings, job.kind, job.index) for job, wanted in zip(jobs, used, strict=True) if wanted
    ]
    relief, _ = relief_and_slope(terrains)
    vehicle, speed = settings.profile.to_dict(), settings.profile.speed_mps
    speeds = tuple(ratio * speed for ratio in effort.ratios)
    motions = move_over(relief, MotionOperator.of(vehicle, settings.tile_size, settings.pixels, speeds))
    pitch = roll_over(relief, RideOperator.of(vehicle, settings.tile_size, settings.pixels)).pitch_change
    log_speed, c_r = np.log(np.array(effort.ratios)), c_r[used]
    ranges = tuple((float(np.log(values).min()), float(np.log(values).max())) for values in (pitch, c_r))
    terms, plain = motion_terms(motions, pitch, log_speed, ranges[0]), plain_terms(c_r, log_speed, ranges[1])
    wanted = np.log(means[used] / c_r[:, None, None])
    fits = {
        name: _fit(terms[name], plain[name], wanted[..., number], own if name == "c_r" else None)
        for number, name in enumerate(QUANTITIES)
    }
    origin = {
        "terrains": len(jobs),
        "used": int(used.sum()),
        "starts": effort.starts,
        "ratios": list(effort.ratios),
        "seed": settings.seed,
    }
    return MotionModel(speed, SPEED_RANGE, ranges[0], ranges[1], **fits, origin=origin)


def _means(record: MotionRecord) -> Floats:
    """Return the means over the starts, (speeds, quantities); NaN if one was not completed."""
    columns = [np.array(getattr(record, name), dtype=np.float64) for name in QUANTITIES]
    return np.stack([column.mean(axis=0) for column in columns], axis=-1)


def _fit(terms: Floats, plain: Floats, wanted: Floats, anchor: int | None) -> MotionFit:
    """Fit both sets of terms to logarithms (n, speeds); the speed ``anchor`` has no error and says nothing of it."""
    free = np.arange(wanted.shape[1]) != anchor
    coefficients, spread = zip(*(_least_squares(x[:, free], wanted[:, free]) for x in (terms, plain)), strict=True)
    return MotionFit(coefficients[0], coefficients[1], spread[0], spread[1])


def _least_squares(terms: Floats, wanted: Floats) -> tuple[tuple[float, ...], float]:
    flat, values = terms.reshape(-1, terms.shape[-1]), wanted.ravel()
    found, *_ = np.linalg.lstsq(flat, values, rcond=None)
    rounded = tuple(float(f"{value:.6g}") for value in found)
    left = values - flat @ np.array(rounded)
    return rounded, float(f"{np.sqrt((left**2).sum() / max(len(values) - len(rounded), 1)):.4g}")


def _main(files: Sequence[str]) -> None:
    for path in map(Path, files):
        calibration = Calibration.load(path)
        effort = MotionEffort()
        journal = motion_journal(path.with_name(f"{path.name}.motion.jsonl"), calibrated_settings(calibration), effort)
        made: Any = add_motion(calibration, effort=effort, journal=journal)
        path.write_text(made.to_json(), encoding="utf-8")
        journal.remove()


if __name__ == "__main__":
    _main(sys.argv[1:])
