"""Predictions from noisy surveys of ground whose C_r without noise is known."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import FeatureSettings, Progress
from bumpymap.lab.evaluate.agreement import coverage
from bumpymap.lab.evaluate.library import dead_flat, stack_of
from bumpymap.lab.evaluate.subject import Subject, Verdict
from bumpymap.lab.simulate import relief_of, surveyed
from bumpymap.lab.worlds import ScanEffects, Terrain
from bumpymap.rating import RideModel, roll_over

__all__ = ["DENSITIES", "NOISE_M", "NoiseRow", "noise_proof", "perfect_c_r"]

Floats = NDArray[np.float64]
DENSITIES = (25.0, 50.0, 100.0, 300.0, 1000.0)
NOISE_M = (0.0, 0.01, 0.03, 0.05)
FLAT_TILES = 200
_WITHOUT_NOISE = 1e3
"""Points a pixel that stand for a survey without end."""


@dataclass(frozen=True, slots=True)
class NoiseRow:
    """One density and one noise, over the whole library."""

    density: float
    """Points per m2."""
    noise_m: float
    """Standard deviation of the heights."""
    flat: float
    """Median C_r of dead-flat ground, rad/m."""
    flat_worst: float
    """Its 90 % quantile."""
    flat_raw: float
    """The same with the noise left in."""
    error: tuple[float, float, float]
    """Median of abs(C_r - truth) / truth over the smoothest, the middle and the roughest third of the ground; the truth
    is the ride model's answer on the same ground without noise."""
    error_raw: tuple[float, float, float]
    """The same with the noise left in."""
    ratio: float
    """Median of C_r / truth."""
    held: float
    """Share of the 80 % intervals that hold the driven C_r; where nothing was driven, the truth as above."""
    held_thirds: tuple[float, float, float]
    """The same by thirds."""
    tiles: int
    """Judged."""


def perfect_c_r(terrains: Sequence[Terrain], ride: RideModel) -> Floats:
    """C_r by the ride model of terrain that is known without error, (n,) rad/m."""
    relief, slope = relief_of(terrains)
    rides = roll_over(relief, ride.operator)
    none = np.zeros(len(terrains))
    c_r: Floats = np.exp(ride.correction.predict(rides, slope, none, np.full(len(terrains), _WITHOUT_NOISE)).log_c_r)
    return c_r


def noise_proof(
    terrains: Sequence[Terrain],
    subject: Subject,
    ride: RideModel,
    driven_c_r: Floats | None,
    features: FeatureSettings,
    seed: int,
    progress: Progress,
) -> list[NoiseRow]:
    """Survey terrains with every noise at every density and rate what comes of it.

    Parameters
    ----------
    terrains : sequence of Terrain, length n
    subject : Subject
    ride : RideModel
        Its ride model.
    driven_c_r : array (n,), optional
        rad/m; NaN where the drives say nothing of C_r.
    features : FeatureSettings
    seed : int
    told : Progress
    """
    truth = perfect_c_r(terrains, ride)
    third = np.searchsorted(np.quantile(truth, (1 / 3, 2 / 3)), truth, side="right")
    flat = dead_flat(subject.calibration, FLAT_TILES)
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
    """Rate a survey of terrains with and without noise correction; NaN where a tile cannot be judged."""
    patches = stack_of(surveyed(terrains, effects, seed), features)
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
