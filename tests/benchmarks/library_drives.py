"""Evaluate ratings on terrain of the library that the calibration was not made with, where the truth is known.

    python tests/benchmarks/library_drives.py --out FOLDER [--total-patches 153] [--seed 7] [--calibration FILE]

The drives run over the terrain itself; the predictions are from a survey of 1,000 points per m2 without noise. Prints
the agreement over all terrains and by kind, the same terrain surveyed with white noise, and moved points. The drives
are kept in FOLDER, and the same command goes on with them.
"""

import argparse
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from _records import show_records
from _tile_trials import MoveRow, flat_terrains, invariance, library_terrains, measure_all, require_unseen
from numpy.typing import NDArray

from bumpymap.core import FeatureSettings, PatchStack, Progress, Reason, SilentProgress
from bumpymap.lab.evaluate.agreement import DriveStats, coverage, median_error, median_ratio
from bumpymap.lab.evaluate.rated_survey import Subject, Verdict, take_tiles
from bumpymap.lab.evaluate.report import driven_lines
from bumpymap.lab.evaluate.survey_trial import Findings, PatchTrial, TrialOptions
from bumpymap.lab.settings import EvaluateSettings
from bumpymap.lab.simulate.jobs import Key
from bumpymap.lab.simulate.ride_fit import relief_and_slope, survey_terrains
from bumpymap.lab.worlds.terrains import KINDS, ScanEffects, Terrain
from bumpymap.patches import measure
from bumpymap.rating import RideModel, TextureModel, find_calibration, roll_over
from bumpytiles import TilePoints

Floats = NDArray[np.float64]
DENSITIES = (25.0, 50.0, 100.0, 300.0, 1000.0)
NOISE_M = (0.0, 0.01, 0.03, 0.05)
FLAT_TILES = 200
_WITHOUT_NOISE = 1e3
"""Points per pixel of a practically noise-free survey."""


@dataclass(frozen=True, slots=True)
class NoiseRow:
    """Results for one density and one noise level, over the whole library."""

    density: float
    """Points per m2."""
    noise_m: float
    """Standard deviation of the heights."""
    flat: float
    """Median C_r of dead-flat ground, rad/m."""
    flat_worst: float
    """90 % quantile of C_r of dead-flat ground, rad/m."""
    flat_raw: float
    """Median C_r of dead-flat ground without noise correction, rad/m."""
    error: tuple[float, float, float]
    """Median of abs(C_r - truth) / truth over the smoothest, the middle and the roughest third of the ground; the truth
    is the ride model's prediction for the same ground without noise."""
    error_raw: tuple[float, float, float]
    """The same without noise correction."""
    ratio: float
    """Median of C_r / truth."""
    held: float
    """Share of the 80 % intervals that contain the driven C_r or, without drives, the truth as above."""
    held_thirds: tuple[float, float, float]
    """The same by thirds."""
    tiles: int
    """Number of classified tiles."""


def perfect_c_r(terrains: Sequence[Terrain], ride: RideModel) -> Floats:
    """Predict C_r by the ride model for terrain without survey errors, (n,) rad/m."""
    relief, slope = relief_and_slope(terrains)
    rides = roll_over(relief, ride.operator)
    none = np.zeros(len(terrains))
    c_r: Floats = np.exp(ride.correction.predict(rides, slope, none, np.full(len(terrains), _WITHOUT_NOISE)).log_c_r)
    return c_r


def noise_sweep(
    terrains: Sequence[Terrain],
    subject: Subject,
    ride: RideModel,
    driven_c_r: Floats | None,
    features: FeatureSettings,
    seed: int,
    progress: Progress,
) -> list[NoiseRow]:
    """Survey terrains with every noise level at every density and rate the surveys.

    Parameters
    ----------
    terrains : sequence of Terrain, length n
    subject : Subject
    ride : RideModel
        Ride model of the subject.
    driven_c_r : array (n,), optional
        rad/m; NaN if the drives do not determine C_r.
    features : FeatureSettings
    seed : int
    progress : Progress
    """
    truth = perfect_c_r(terrains, ride)
    third = np.searchsorted(np.quantile(truth, (1 / 3, 2 / 3)), truth, side="right")
    flat = flat_terrains(subject.calibration, FLAT_TILES)
    progress.start("rating noisy surveys", len(DENSITIES) * len(NOISE_M))
    rows: list[NoiseRow] = []
    for density in DENSITIES:
        for noise in NOISE_M:
            stream = seed + 1000 * len(rows)
            effects = ScanEffects(density, noise)
            clean, raw = _rated(terrains, effects, subject, features, stream)
            flat_clean, flat_raw = _rated(flat, effects, subject, features, stream + 500)
            rows.append(
                _row(
                    effects,
                    (clean, raw),
                    (flat_clean, flat_raw),
                    truth,
                    third,
                    truth if driven_c_r is None else driven_c_r,
                )
            )
            progress.advance(1)
    return rows


def _rated(
    terrains: Sequence[Terrain], effects: ScanEffects, subject: Subject, features: FeatureSettings, seed: int
) -> tuple[Verdict, Verdict]:
    """Rate a survey of terrains with and without noise correction; NaN if a tile cannot be classified."""
    patches = measure_all(survey_terrains(terrains, effects, seed), features)
    both = subject.judge(patches, ("ride", "ride_raw"))
    return both["ride"], both["ride_raw"]


def _row(
    effects: ScanEffects,
    rated: tuple[Verdict, Verdict],
    flat: tuple[Verdict, Verdict],
    truth: Floats,
    third: NDArray[np.integer],
    target: Floats,
) -> NoiseRow:
    clean, raw = rated
    judged = np.isfinite(clean.c_r)
    sure = judged & np.isfinite(target)
    parts = [third == part for part in range(3)]

    def errors(c_r: Floats) -> tuple[float, float, float]:
        away = np.abs(c_r / truth - 1)
        low, middle, high = (_median(away[judged & part]) for part in parts)
        return low, middle, high

    held = [
        coverage(clean.c_r_low[rows], clean.c_r_high[rows], target[rows]).held
        for rows in (sure, *(sure & part for part in parts))
    ]
    return NoiseRow(
        density=effects.density,
        noise_m=effects.noise_m,
        flat=float(np.nanmedian(flat[0].c_r)),
        flat_worst=float(np.nanquantile(flat[0].c_r, 0.9)),
        flat_raw=float(np.nanmedian(flat[1].c_r)),
        error=errors(clean.c_r),
        error_raw=errors(raw.c_r),
        ratio=_median((clean.c_r / truth)[judged]),
        held=held[0],
        held_thirds=(held[1], held[2], held[3]),
        tiles=int(judged.sum()),
    )


def _median(values: Floats) -> float:
    return float(np.median(values)) if len(values) else float("nan")


@dataclass(frozen=True, slots=True)
class KindRow:
    """Agreement on one kind of ground."""

    kind: str
    patches: int
    compared: int
    """Patches with comparable C_r."""
    failed_share: float
    """Share of failed drives, 0..1."""
    median_error: float
    """Median of abs(predicted - driven) / driven; NaN without compared patches."""
    median_ratio: float
    """Median of predicted / driven."""


def by_kind(kinds: Sequence[str], verdict: Verdict, driven: DriveStats) -> list[KindRow]:
    """Compare predictions and drives for each kind of ground, in order of first appearance; all of length n."""
    rows = []
    names = np.array(kinds)
    for kind in dict.fromkeys(kinds):
        own = names == kind
        good = own & driven.comparable
        rows.append(
            KindRow(
                kind=kind,
                patches=int(own.sum()),
                compared=int(good.sum()),
                failed_share=float(driven.failed[own].sum() / (driven.failed + driven.completed)[own].sum()),
                median_error=median_error(verdict.c_r[good], driven.c_r[good]),
                median_ratio=median_ratio(verdict.c_r[good], driven.c_r[good]),
            )
        )
    return rows


def _library_trial(terrains: Sequence[Terrain], each: int, subject: Subject, settings: EvaluateSettings) -> PatchTrial:
    """Drive over the terrain itself; predict from a dense survey of it without noise."""
    patches = measure_all(survey_terrains(terrains, ScanEffects(density=1000.0), settings.seed), settings.features)
    rows = patches.col[patches.reason == Reason.OK]
    names: list[Key] = [(terrains[i].kind, int(i) % each) for i in rows]
    ground = np.stack([terrains[i].heights for i in rows])
    limit = subject.profile.slope_limit_deg
    origin = {"library": settings.seed, "wheel_radius_m": subject.profile.wheel.radius_m, "slope_limit_deg": limit}
    return PatchTrial(names, take_tiles(patches, patches.reason == Reason.OK), ground, origin)


@dataclass(frozen=True, slots=True)
class LibraryResults:
    """All results of an evaluation over the library."""

    driven: Findings
    kinds: list[KindRow]
    noise: list[NoiseRow]
    moves: list[MoveRow]


def evaluate_library(
    subject: Subject, settings: EvaluateSettings, trial: TrialOptions, *, noise: bool = True
) -> LibraryResults:
    """Drive over unseen terrain, compare, and repeat the ratings with noise and with moved points."""
    each = -(-settings.total_patches // len(KINDS))
    require_unseen(subject.calibration, settings.seed)
    terrains = library_terrains(subject.calibration, subject.profile, settings.seed, each)
    facts = {"terrains": len(terrains), "kinds": list(KINDS), "seed": settings.seed}
    findings = Findings("library", facts, [], {})
    _library_trial(terrains, each, subject, settings).run([subject], settings, trial, findings)
    driven = next(iter(findings.patches.values()))
    kinds = by_kind([str(name[0]) for name in driven.names], driven.verdicts[subject.main], driven.driven)
    c_r = np.where(driven.driven.comparable, driven.driven.c_r, np.nan)
    rows: list[NoiseRow] = []
    if noise and subject.ride is not None:
        rows = noise_sweep(terrains, subject, subject.ride, c_r, settings.features, settings.seed, trial.progress)
    blocks = survey_terrains(terrains, ScanEffects(density=100.0, noise_m=0.02), settings.seed).blocks()

    def measured(points: TilePoints) -> PatchStack:
        return measure(points, settings.features, ground_only=False)

    return LibraryResults(findings, kinds, rows, invariance(blocks, measured, subject, settings.seed))


def main() -> None:
    """Drive and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--total-patches", type=int, default=300)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--vehicle", default="warthog")
    parser.add_argument("--calibration", type=Path)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    subject = Subject.of(find_calibration(given.vehicle, given.calibration), TextureModel.shipped(), "ride")
    settings = EvaluateSettings(total_patches=given.total_patches, seed=given.seed)
    trial = TrialOptions(given.out, given.jobs, overwrite=False, progress=SilentProgress())
    found = evaluate_library(subject, settings, trial)
    for comparison in found.driven.comparisons.values():
        print("\n".join(driven_lines(comparison)), flush=True)
    show_records("By kind of ground", found.kinds)
    show_records("With scan noise", found.noise)
    show_records("Moved points", found.moves)


if __name__ == "__main__":
    main()
