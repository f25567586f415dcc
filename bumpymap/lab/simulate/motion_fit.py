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

from bumpymap.core import BadInputError, UsageError, atomic
from bumpymap.lab.simulate.journal import JobJournal
from bumpymap.lab.simulate.motion import (
    MotionEffort,
    MotionRecord,
    drive_library,
    motion_jobs,
    motion_journal,
)
from bumpymap.lab.simulate.plan import CalibrationSettings, calibrated_settings, library_terrain
from bumpymap.lab.simulate.pool import Progress
from bumpymap.lab.simulate.ride_fit import relief_and_slope
from bumpymap.lab.worlds import KINDS, Terrain
from bumpymap.rating import (
    QUANTITIES,
    Calibration,
    MotionFit,
    MotionModel,
    MotionOperator,
    Motions,
    RideOperator,
    motion_terms,
    move_over,
    plain_terms,
    roll_over,
)

__all__ = ["add_motion", "fit_motion", "refit_motion"]

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
    means = np.stack([_means(driven[job.key]) for job in motion_jobs(effort)])
    # As they are recorded, so that a later fit to the record gives the same bits.
    means = np.array([[[_six_digits(value) for value in row] for row in one] for one in means.tolist()], np.float64)
    return replace(calibration, motion=fit_motion(settings, effort, means).to_record())


def refit_motion(calibration: Calibration) -> Calibration:
    """Return a calibration whose ``motion`` is fitted again to the drives that it records, without driving.

    Raises
    ------
    UsageError
        It was made without other speeds.
    BadInputError
        The record is damaged.
    """
    if calibration.motion is None:
        raise UsageError(f"the calibration {calibration.id} was made without other speeds")
    try:
        effort, means = _recorded(calibration.motion["origin"])
    except (LookupError, TypeError, ValueError) as error:
        raise BadInputError(f"the drives at other speeds in {calibration.id} are damaged: {error!r}") from error
    return replace(calibration, motion=fit_motion(calibrated_settings(calibration), effort, means).to_record())


def _recorded(origin: Mapping[str, Any]) -> tuple[MotionEffort, Floats]:
    """Return the effort and the means of recorded drives; raise ValueError if they do not fit together."""
    effort = MotionEffort(origin["terrains"] // len(KINDS), origin["starts"], tuple(origin["ratios"]))
    means = np.array(origin["driven"], dtype=np.float64)
    return effort, means.reshape(len(motion_jobs(effort)), len(effort.ratios), len(QUANTITIES))


def fit_motion(settings: CalibrationSettings, effort: MotionEffort, means: Floats) -> MotionModel:
    """Fit the model to drives over the library; terrains where a drive failed are left out.

    Parameters
    ----------
    settings : CalibrationSettings
    effort : MotionEffort
    means : array (terrains, speeds, 3)
        Means over the starts of each of ``QUANTITIES``, in the order of `motion_jobs`; NaN where a drive failed.
    """
    jobs, own = motion_jobs(effort), effort.ratios.index(1.0)
    c_r = means[:, own, 0]
    used = np.isfinite(means).all(axis=(1, 2)) & (c_r > _LEAST_C_R)
    terrains = [
        library_terrain(settings, job.kind, job.index) for job, wanted in zip(jobs, used, strict=True) if wanted
    ]
    motions, pitch = _geometry(settings, effort, terrains)
    log_speed, c_r = np.log(np.array(effort.ratios)), c_r[used]
    ranges = [(float(f"{np.log(each).min():.6g}"), float(f"{np.log(each).max():.6g}")) for each in (pitch, c_r)]
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
        "driven": [[[_six_digits(value) for value in row] for row in terrain] for terrain in means.tolist()],
    }
    three = (fits["c_r"], fits["c_roll"], fits["a_w"])
    return MotionModel(settings.profile.speed_mps, SPEED_RANGE, ranges[0], ranges[1], *three, origin)


def _geometry(
    settings: CalibrationSettings, effort: MotionEffort, terrains: Sequence[Terrain]
) -> tuple[Motions, Floats]:
    """Return the geometric values of terrains at the speeds, and their geometric C_r at the profile's."""
    vehicle, speed = settings.profile.to_dict(), settings.profile.speed_mps
    relief, _ = relief_and_slope(terrains)
    speeds = tuple(ratio * speed for ratio in effort.ratios)
    operator = MotionOperator.of(vehicle, settings.tile_size, settings.pixels, speeds)
    own = RideOperator.of(vehicle, settings.tile_size, settings.pixels)
    return move_over(relief, operator), roll_over(relief, own).pitch_change


def _six_digits(value: float) -> float | None:
    return None if np.isnan(value) else float(f"{value:.6g}")


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
        made = add_motion(calibration, effort=effort, journal=journal)
        with atomic(path) as temporary:
            temporary.write_text(made.to_json(), encoding="utf-8")
        journal.remove()


if __name__ == "__main__":
    _main(sys.argv[1:])
