"""Fit a ride model to the drives over the terrain library, and the model of thin surveys to the ride model.

The correction of the geometry is fitted to the drives. The noise correction needs no drives: it is fitted to surveys of
the same ground at several densities and noise levels, denoised as for a map, against the ground without noise.

For thin surveys the library is surveyed with few points, several noises and holes. The truth is what the ride model
predicts for the ground without survey errors. The noise of each survey is pooled from its tiles, as in a map.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import SPANNED_POINTS, THIN_POINTS, FeatureSettings, Reason
from bumpymap.lab.simulate.model import relief_and_slope
from bumpymap.lab.terrains import FINE, ScanEffects, Terrain, survey_terrain
from bumpymap.patches import measure, measure_thin
from bumpymap.rating import (
    THIN_COLUMNS,
    Correction,
    DrivenPatches,
    DrivenTerrain,
    NoisyPatches,
    RideOperator,
    ThinSurveys,
    Vehicle,
    denoise,
    fit_correction,
    fit_thin,
    pool_noise,
    roll_over,
    subtract_noise,
    thin_columns,
)
from bumpytiles import Grid, TileBuckets, TilePoints

_DENSITIES = (8.0, 16.0, 25.0, 50.0, 100.0, 300.0, 1000.0)
_NOISES_M = (0.003, 0.01, 0.02, 0.03, 0.05)
_NOISE_SEED = 20_000
_LEAST_C_R = 0.001
"""Relative errors are not defined below this C_r, rad/m."""


def fit_ride(
    profile: Vehicle, terrains: Sequence[Terrain], driven: Sequence[DrivenTerrain]
) -> dict[str, Any]:  # fmt: skip
    """Fit a ride model to driven terrains and the drives over them (n each); the calibration's ``ride`` as JSON."""
    side, pixels = terrains[0].tile_size, terrains[0].pixels
    operator = RideOperator.of(profile.to_dict(), side, pixels)
    relief, slope = relief_and_slope([terrain.heights for terrain in terrains], terrains[0].tile_size)
    rides = roll_over(relief, operator)
    return fit_correction(
        DrivenPatches(
            rides=rides,
            slope_deg=slope,
            c_r=np.array([terrain.c_r for terrain in driven], dtype=np.float64),
            error=np.array([terrain.c_r_error for terrain in driven], dtype=np.float64),
            completed=np.array([terrain.completed for terrain in driven], dtype=np.int64),
            failed=np.array([terrain.failed for terrain in driven], dtype=np.int64),
        ),
        _noisy_patches(terrains, rides.pitch_change, operator),
    ).to_record()


def survey_terrains(terrains: Sequence[Terrain], effects: ScanEffects, seed: int) -> TileBuckets:
    """Survey terrains, each as the tile ``(index, 0)`` with its own random stream."""
    buckets = TileBuckets(Grid(terrains[0].tile_size, terrains[0].pixels))
    for index, terrain in enumerate(terrains):
        x, y, z = survey_terrain(terrain, effects, np.random.default_rng([seed, index]))
        buckets.add(x + index * terrain.tile_size, y, z, np.zeros(len(z), np.bool_))
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


Floats = NDArray[np.float64]
_THIN_DENSITIES = (0.5, 0.75, 1.0, 1.3, 1.7, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 20.0, 30.0)
_THIN_NOISES_M = (0.0, 0.005, 0.01, 0.02, 0.04)
_CUT_DENSITIES = (2.0, 4.0, 12.0)
"""Surveys that see a part of each tile alone."""
_SEED = 40_000
_GROUPS = 2
"""Parts of the library that pool their noise, each about as large as a block of tiles."""
_FLOOR = 0.05
"""C_r below this share of the first class limit is raised to it: smoother ground is of no use to tell apart."""
_BARE_TILES = 40
_WITHOUT_NOISE = 1e3


def fit_thin_surveys(
    profile: Vehicle, terrains: Sequence[Terrain], ride: dict[str, Any], first_limit: float
) -> dict[str, Any]:
    """Fit the model of thin surveys of a vehicle; returns plain JSON for the calibration's ``thin`` entry.

    Parameters
    ----------
    profile : Vehicle
    terrains : sequence of Terrain
        The ground of the library.
    ride : dict
        The calibration's ride model.
    first_limit : float
        C_r between class 0 and 1, rad/m.
    """
    operator = RideOperator.of(profile.to_dict(), terrains[0].tile_size, terrains[0].pixels)
    correction = Correction.from_record(ride)
    relief, slope = relief_and_slope([terrain.heights for terrain in terrains], terrains[0].tile_size)
    none = np.zeros(len(terrains))
    truth = correction.predict(roll_over(relief, operator), slope, none, none + _WITHOUT_NOISE)
    log_c_r = np.maximum(truth.log_c_r, np.log(_FLOOR * first_limit))
    columns, noise, terrain = (np.concatenate(part) for part in zip(*_surveys(terrains, operator), strict=True))
    usual = float(np.hypot(np.exp(np.mean(correction.spread)), correction.model_error))
    surveys = ThinSurveys(
        columns, noise, terrain, log_c_r[terrain], truth.p_fail[terrain], _bare(terrains[0], operator), usual
    )
    return fit_thin(surveys).to_record()


def _surveys(
    terrains: Sequence[Terrain], operator: RideOperator
) -> Iterator[tuple[Floats, Floats, NDArray[np.int64]]]:  # fmt: skip
    """Yield columns, pooled noise and terrain of the tiles of every survey."""
    conditions = [(density, noise, False) for density in _THIN_DENSITIES for noise in _THIN_NOISES_M]
    conditions += [(density, noise, True) for density in _CUT_DENSITIES for noise in _THIN_NOISES_M[::2]]
    for number, (density, noise, cut) in enumerate(conditions):
        columns, tile = survey_columns(terrains, ScanEffects(density, noise), _SEED + number, operator, cut=cut)
        spanned = (columns[:, 1] > 0) | (columns[:, 0] < SPANNED_POINTS)
        known = np.isfinite(columns).all(axis=1) & (columns[:, 0] >= THIN_POINTS) & spanned
        pooled = np.empty(len(tile))
        for group in range(_GROUPS):
            own = tile % _GROUPS == group
            first, pairs = THIN_COLUMNS.index("squares_1"), THIN_COLUMNS.index("pairs_1")
            measures = columns[own, first], columns[own, pairs], columns[own, 2] ** 2
            pooled[own] = pool_noise(*measures, lambda sums: sums.sum(axis=-1, keepdims=True))[1]
        yield columns[known], pooled[known], tile[known]


def survey_columns(
    terrains: Sequence[Terrain], effects: ScanEffects, seed: int, operator: RideOperator, *, cut: bool = False
) -> tuple[Floats, NDArray[np.int64]]:
    """Survey terrains; return the columns of the tiles that hold points, and the number of the terrain of each.

    Parameters
    ----------
    terrains, effects, seed
        As for `survey_terrains`.
    operator : RideOperator
        Of the vehicle.
    cut : bool
        Whether a strip on one side of each tile, up to half of it, holds no points.
    """
    settings = FeatureSettings()
    columns, tile = [], []
    for block in survey_terrains(terrains, effects, seed).blocks():
        points = _cut(block) if cut else block
        patches = measure(points, settings, ground_only=False)
        pairs, relief_map = measure_thin(points, patches, settings, ground_only=False)
        columns.append(thin_columns(pairs, relief_map, patches.count, operator).astype(np.float64))
        tile.append(patches.col)
    return np.concatenate(columns), np.concatenate(tile)


def _cut(points: TilePoints) -> TilePoints:
    """Drop the points of a strip of each tile: another side and width from tile to tile."""
    count = np.diff(points.starts)
    tile = np.repeat(points.col, count)
    side = points.grid.tile_size
    east = points.easting / side - tile
    north = points.northing / side - np.repeat(points.row, count)
    across = np.choose(tile % 4, (east, 1 - east, north, 1 - north))
    kept = across < 0.5 + 0.1 * (tile % 5)
    return replace(
        points,
        starts=np.concatenate(([0], np.cumsum(kept)))[points.starts],
        easting=points.easting[kept],
        northing=points.northing[kept],
        upward=points.upward[kept],
        flag=points.flag[kept],
    )


def _bare(like: Terrain, operator: RideOperator) -> tuple[Floats, Floats, Floats]:
    """Return points, noise and pitch change of noisy surveys of level ground."""
    side = like.pixels * FINE
    level = [Terrain("level", np.zeros((side, side)), like.tile_size)] * _BARE_TILES
    found = []
    for number, density in enumerate(_THIN_DENSITIES):
        columns, _ = survey_columns(level, ScanEffects(density, _THIN_NOISES_M[-1]), _SEED + 500 + number, operator)
        rolled = columns[np.isfinite(columns).all(axis=1) & (columns[:, 5] > 0)]
        found.append((rolled[:, 0], np.full(len(rolled), _THIN_NOISES_M[-1]), rolled[:, 5]))
    points, noise, ride = (np.concatenate(part) for part in zip(*found, strict=True))
    return points, noise, ride
