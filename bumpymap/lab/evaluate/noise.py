"""Test predictions from noisy surveys of ground with known noise-free C_r."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import FeatureSettings, Progress
from bumpymap.lab.evaluate.agreement import coverage
from bumpymap.lab.evaluate.library import flat_terrains, measure_all
from bumpymap.lab.evaluate.subject import Subject, Verdict
from bumpymap.lab.simulate import relief_and_slope, survey_terrains
from bumpymap.lab.worlds import ScanEffects, Terrain
from bumpymap.rating import RideModel, roll_over

__all__ = ["DENSITIES", "NOISE_M", "NoiseRow", "noise_sweep", "perfect_c_r"]

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
