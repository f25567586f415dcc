"""Fit a ride model to the drives over the terrain library: the correction of the geometry and the noise correction.

The correction of the geometry is fitted to the drives. The noise correction needs no drives: it is fitted to surveys of
the same ground at several densities and noise levels, denoised as for a map, against the ground without noise.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import FeatureSettings, Reason
from bumpymap.lab.simulate.terrain import fit_plane
from bumpymap.lab.worlds import ScanEffects, Terrain, survey_terrain
from bumpymap.patches import measure
from bumpymap.rating import (
    DrivenPatches,
    DrivenTerrain,
    NoisyPatches,
    RideOperator,
    Vehicle,
    denoise,
    fit_correction,
    roll_over,
    subtract_noise,
)
from bumpytiles import Grid, TileBuckets

__all__ = ["fit_ride", "relief_and_slope", "survey_terrains"]

_DENSITIES = (8.0, 16.0, 25.0, 50.0, 100.0, 300.0, 1000.0)
_NOISES_M = (0.003, 0.01, 0.02, 0.03, 0.05)
_NOISE_SEED = 20_000
_LEAST_C_R = 0.001
"""Relative errors are not defined below this C_r, rad/m."""


def fit_ride(
    profile: Vehicle, terrains: Sequence[Terrain], driven: Sequence[DrivenTerrain]
) -> dict[str, Any]:  # fmt: skip
    """Fit a ride model; see `bumpymap.lab.simulate.library.FitRide`."""
    side, pixels = terrains[0].tile_size, terrains[0].pixels
    operator = RideOperator.of(profile.to_dict(), side, pixels)
    relief, slope = relief_and_slope(terrains)
    rides = roll_over(relief, operator)
    return fit_correction(
        DrivenPatches(
            rides=rides,
            slope_deg=slope,
            c_r=_column(driven, "c_r"),
            error=_column(driven, "c_r_error"),
            completed=np.array([terrain.completed for terrain in driven], dtype=np.int64),
            failed=np.array([terrain.failed for terrain in driven], dtype=np.int64),
        ),
        _noisy_patches(terrains, rides.pitch_change, operator),
    ).to_record()


def relief_and_slope(terrains: Sequence[Terrain]) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Return relief maps (n, pixels, pixels) [m] and slopes (n,) [deg] of terrains, free of survey errors."""
    relief, slope = [], []
    for terrain in terrains:
        heights = terrain.heights
        plane, gradient = fit_plane(heights)
        relief.append((heights - plane).astype(np.float32))
        slope.append(np.degrees(np.arctan(np.hypot(*gradient) * terrain.pixels / terrain.tile_size)))
    return np.stack(relief), np.array(slope)


def survey_terrains(terrains: Sequence[Terrain], effects: ScanEffects, seed: int) -> TileBuckets:
    """Survey terrains, each as the tile ``(index, 0)`` with its own random stream."""
    buckets = TileBuckets(Grid(terrains[0].tile_size, terrains[0].pixels))
    for index, terrain in enumerate(terrains):
        points = survey_terrain(terrain, effects, np.random.default_rng([seed, index]))
        west = index * terrain.tile_size
        buckets.add(points.easting + west, points.northing, points.upward, np.zeros(len(points.upward), np.bool_))
    return buckets


def _noisy_patches(terrains: Sequence[Terrain], truth: NDArray[np.float64], operator: RideOperator) -> NoisyPatches:
    columns: list[list[NDArray[np.float64]]] = [[], [], []]
    conditions = [ScanEffects(density, noise) for density in _DENSITIES for noise in _NOISES_M]
    for number, effects in enumerate(conditions):
        for block in survey_terrains(terrains, effects, _NOISE_SEED + number).blocks():
            patches = measure(block, FeatureSettings(), ground_only=False)
            clean = denoise(patches, operator)
            found, excess = subtract_noise(roll_over(clean.relief_map, operator).pitch_change, clean.noise_felt)
            wanted = truth[patches.col]
            known = (patches.reason == Reason.OK) & np.isfinite(excess) & (wanted > _LEAST_C_R)
            error = np.log(wanted[known] / found[known])
            values = (excess[known], patches.count[known] / patches.grid.pixels**2, error)
            for column, value in zip(columns, values, strict=True):
                column.append(value)
    return NoisyPatches(*(np.concatenate(column) for column in columns))


def _column(driven: Sequence[DrivenTerrain], name: str) -> NDArray[np.float64]:
    """Return a column of the drives; NaN where a terrain has no value."""
    values = [getattr(terrain, name) for terrain in driven]
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
