"""Fit a ride model to the drives over the terrain library, and the model of thin surveys to the ride model.

The correction of the geometry is fitted to the drives. The noise correction needs no drives: it is fitted to surveys of
the same ground at several densities and noise levels, denoised as for a map, against the ground without noise.

For thin surveys the library is surveyed with few points, several noises and holes. The truth is what the ride model
predicts for the ground without survey errors. The noise is found beside the tiles of each survey, as in a map.

Outliers are weighted down as Huber does, but with the size of the errors that each row states. scikit-learn's
HuberRegressor takes one size for all rows: on the warthog's library its C_r is off by up to 21 % (median 1.8 %); on its
thin surveys by up to 8 %, in 23 s instead of 2 s. So the weights are set here, and each fit under them is its Ridge.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import NORMAL_80, SPANNED_POINTS, THIN_POINTS, BumpymapError, FeatureSettings, Floats, Reason
from bumpymap.lab.simulate.model import relief_and_slope
from bumpymap.lab.terrains import FINE, Terrain, survey_terrain
from bumpymap.patches import measure, measure_thin
from bumpymap.rating import (
    TAIL,
    THIN_COLUMNS,
    Correction,
    DrivenTerrain,
    RideOperator,
    Rides,
    Strength,
    ThinModel,
    Vehicle,
    denoise,
    fail_features,
    find_strengths,
    log_points,
    ride_features,
    roll_over,
    subtract_noise,
    thin_columns,
    thin_terms,
)
from bumpytiles import Grid, TileBuckets, TilePoints

Table = tuple[tuple[float, ...], ...]

MAX_FAILED_SHARE = 0.25
"""Largest share of failed drives at which the C_r of a patch is used: with more, only survivors would count."""
_MIN_PATCHES = 20
"""Fewest patches that a ride model is fitted to: twice its coefficients. Chosen."""
_RIDGE, _THIN_RIDGE = 1e-3, 1e-4
"""Penalty on a coefficient over its term's scale, as a share of the weight of all rows: of ln C_r, and of thin tiles.
Chosen: it keeps terms apart that hardly differ in the library."""
_FAIL_RIDGE, _THIN_FAIL_RIDGE = 0.3, 1.0
"""The same of the logit of p_fail: from drives, in drives, and of thin tiles, in tiles. Chosen."""
_HUBER, _THIN_HUBER = 2.5, 2.0
"""Standard deviations beyond which residuals get less weight (Huber). Chosen: 1.2 % and 4.6 % of normal errors."""
_TURNS, _THIN_TURNS = 8, 6
"""Fits in turn with their weights. Chosen."""
_FOLDS, _THIN_FOLDS = 10, 5
"""Parts of the library that are predicted from the others."""
_FIRST_SPREAD = 0.08
"""Standard deviation of ln C_r before the first fit."""
_MAD_TO_SD = 1.4826
"""Standard deviation over the median absolute one, of a normal distribution."""
_LEAST_RESIDUAL = 0.02
"""Residuals of ln C_r below count as that large in the fit of their spread."""
_EXCESS = (0.0, 0.01, 0.03, 0.1, 0.2, 0.4, 0.7, 1.1, 1.6, 2.3)
"""Columns of the noise tables: noise excess. Chosen: closer where the quantiles bend."""
_PIXEL_POINTS = (0.7, 1.0, 2.0, 4.0, 12.0, 40.0)
"""Rows of the noise tables: mean points per pixel. Chosen: from the fewest that are rated to more than matters."""
_MIN_EXCESS = 0.003
"""Excess below this is treated as equal to it."""
_MIN_NOISY, _NOISY_SHARE = 120, 80
"""A quantile of the noise tables is computed from the nearest 120 patches, or the nearest 80th of all if more."""
_STRONG_EXCESS, _STRONG_TAIL = (0.1, 0.4), 0.05
"""From the first excess to the second, the probability below the low end of the interval falls from ``TAIL`` to that.
Strong noise hides how smooth the smoothest ground is: with a tenth below, four in ten of the smooth tiles would be."""
_VALIDATION_ERROR = 0.045
"""Standard error of ln C_r of a patch in the validation drives; intervals must contain means with that error."""
_MODEL_ERROR = 0.15
"""Standard deviation of ln C_r between simulations of one vehicle: of a second engine's means about the predictions,
0.11 (smooth) to 0.18 (middle third) without the scatter of its drives (docs/pages/benchmarks.md, a second simulator);
a simulation of another author differed by 12 % in the median."""
_FREEDOM = 5.0
"""Degrees of freedom of Student's distribution for errors of ln C_r: more outliers than normal errors have."""
_STUDENT_TAIL = 1.475884
"""Quantile of that distribution at ``TAIL``, absolute."""
_DENSITIES = (8.0, 16.0, 25.0, 50.0, 100.0, 300.0, 1000.0)
"""Points per m2 of the surveys for the noise tables: from where a tile is rated by its heightmap to mobile mapping."""
_NOISES_M = (0.003, 0.01, 0.02, 0.03, 0.05)
"""Noise of a point in these surveys: from terrestrial scanners to photogrammetry."""
_NOISE_SEED = 20_000
"""Seed of the first of these surveys; each has its own."""
_LEAST_C_R = 0.001
"""Relative errors are not defined below this C_r, rad/m."""
_THIN_DENSITIES = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 30.0)
"""Points per m2 of thin surveys: from four points a tile to where the heightmap alone tells."""
_THIN_NOISES_M = (0.0, 0.01, 0.03)
"""Noise of a point in them."""
_CUT_DENSITIES = (2.0, 4.0, 12.0)
"""Points per m2 of surveys that see a part of each tile alone."""
_SEED, _BARE_SEED, _LIKE_SEED = 40_000, 40_500, 41_000
"""Seeds of the first thin survey, of the first one of level ground, and of what lies beside what."""
_UNLIKE = 0.5
"""Standard deviation of ln C_r between neighbours in them. Chosen: tiles of real sites differ as much."""
_USUAL_ERROR, _CERTAIN = 0.4, 0.3
"""Error of ln of the ground's strength at which a tile weighs a quarter: a fit to what is not known is flat. Share of
the tiles, those of least error, that tell the ride over ground of one strength."""
_LOW_GROUND_M = 0.03
"""Ground below moves a vehicle little, in proportion to its strength."""
_BEYOND = 0.005
"""Share of the tiles beyond the upper end of the trained strengths."""
_BARE_TILES = 40
"""Tiles of level ground in each survey that tells what noise alone does."""
MANY_POINTS = 1e3
"""Points per pixel of a survey without errors."""


@dataclass(frozen=True, slots=True)
class DrivenPatches:
    """Patches that were driven in the simulation."""

    rides: Rides
    """(n,) geometric values."""
    slope_deg: Floats
    """(n,) slope of the patch's plane, degrees."""
    c_r: Floats
    """(n,) mean over the completed drives, rad/m; NaN where there are fewer than two."""
    error: Floats
    """(n,) standard error of that mean, rad/m."""
    completed: NDArray[np.int64]
    """(n,) number of completed drives."""
    failed: NDArray[np.int64]
    """(n,) number of failed drives."""


def fit_ride(
    profile: Vehicle, terrains: Sequence[Terrain], driven: Sequence[DrivenTerrain]
) -> tuple[Correction, list[Correction]]:
    """Fit a ride model to driven terrains and the drives over them (n each).

    Also returns a fit without each tenth of the terrains: their spread says how sure the first is.
    """
    operator = RideOperator.of(profile, terrains[0].tile_size, terrains[0].pixels)
    relief, slope = relief_and_slope([terrain.heights for terrain in terrains], terrains[0].tile_size)
    rides = roll_over(relief, operator)
    c_r, error = (np.array([getattr(each, name) for each in driven], np.float64) for name in ("c_r", "c_r_error"))
    completed, failed = (np.array([getattr(each, name) for each in driven]) for name in ("completed", "failed"))
    noisy = _noisy_patches(terrains, rides.pitch_change, operator)

    def fit(kept: NDArray[np.bool_]) -> Correction:
        own = Rides(*(getattr(rides, field.name)[kept] for field in fields(Rides)))
        drives = DrivenPatches(own, slope[kept], c_r[kept], error[kept], completed[kept], failed[kept])
        return fit_correction(drives, noisy)

    part = np.arange(len(driven)) % _FOLDS
    return fit(part >= 0), [fit(part != number) for number in range(_FOLDS)]


def fit_correction(driven: DrivenPatches, noisy: Floats) -> Correction:
    """Fit the coefficients of C_r, its spread, p_fail and the noise tables.

    ``noisy`` (3, n): of patches that were surveyed with simulated noise: noise excess from `subtract_noise`; mean
    points per pixel; ln (geometric C_r of the true ground / that of the denoised patch, from `subtract_noise`).

    Raises BumpymapError if the drives were completed on too few patches.
    """
    drives = driven.failed + driven.completed
    good = (driven.failed / drives <= MAX_FAILED_SHARE) & (driven.completed >= 2)
    good &= (driven.c_r > 0) & (driven.error > 0)
    if int(good.sum()) < _MIN_PATCHES:
        raise BumpymapError(
            f"the vehicle completed its drives on {int(good.sum())} of {len(good)} terrains; a ride model needs "
            f"at least {_MIN_PATCHES}. Look for a wrong number in its profile, or drive more terrains"
        )
    log_g = np.log(driven.rides.pitch_change[good])
    rides = Rides(*(getattr(driven.rides, field.name)[good] for field in fields(Rides)))
    features = ride_features(log_g, rides, driven.slope_deg[good])
    target, error = np.log(driven.c_r[good]), driven.error[good] / driven.c_r[good]
    log_range = (float(log_g.min()), float(log_g.max()))
    coefficients, spread = _fit_c_r(features, target, error, log_g, log_range)
    # The residuals of a fit understate its error, so the intervals are based on cross-validation.
    predicted, fold = np.empty(len(target)), np.arange(len(target)) % _FOLDS
    for part in range(_FOLDS):
        rest = fold != part
        others, _ = _fit_c_r(features[rest], target[rest], error[rest], log_g[rest], log_range)
        predicted[~rest] = features[~rest] @ others
    residual = target - predicted
    spread = _calibrate_spread(spread, residual, error * student_factor(driven.completed[good]), log_g, log_range)
    terms = fail_features(driven.rides, driven.slope_deg)
    low, middle, high = _noise_tables(noisy)
    return Correction(
        log_range=log_range,
        c_r=tuple(coefficients.tolist()),
        spread=spread,
        fail=tuple(_fit_logistic(terms, driven.failed, driven.completed, _FAIL_RIDGE).tolist()),
        excess=_EXCESS,
        pixel_points=_PIXEL_POINTS,
        noise_low=low,
        noise_middle=middle,
        noise_high=high,
        origin={
            "patches": len(driven.c_r),
            "patches_with_c_r": len(target),
            "drives": int(drives.sum()),
            "failed": int(driven.failed.sum()),
            "median_standard_error": round(float(np.median(error)), 4),
            **_scores(predicted, target),
        },
        model_error=_MODEL_ERROR,
    )


def _scores(log_c_r: Floats, other: Floats) -> dict[str, float]:
    """Return rank correlation and median of abs(C_r / other C_r - 1), for the record."""
    from scipy.stats import spearmanr

    error = float(np.median(np.abs(np.expm1(log_c_r - other))))
    return {"spearman": round(float(spearmanr(log_c_r, other).statistic), 4), "median_relative_error": round(error, 4)}


def _weighted_ridge(terms: Floats, target: Floats, weight: Floats, scale: Floats, penalty: float) -> Floats:
    """Return the coefficients (k,) of terms (n, k) under weights (n,), with a penalty on them times ``scale`` (k,)."""
    from sklearn.linear_model import Ridge

    fit = Ridge(penalty * weight.sum(), fit_intercept=False).fit(terms / scale, target, sample_weight=weight)
    return np.asarray(fit.coef_ / scale, np.float64)


def _fit_c_r(
    features: Floats, target: Floats, error: Floats, log_g: Floats, log_range: tuple[float, float]
) -> tuple[Floats, tuple[float, float]]:
    """Fit coefficients and spread in turns: the spread weights the patches, the residuals determine the spread."""
    spread = (np.log(_FIRST_SPREAD), np.log(_FIRST_SPREAD))
    coefficients, huber = np.zeros(features.shape[1]), np.ones(len(target))
    scale = np.sqrt(np.mean(features**2, axis=0))
    for _ in range(_TURNS):
        variance = np.exp(2 * np.interp(log_g, log_range, spread)) + error**2
        coefficients = _weighted_ridge(features, target, huber / variance, scale, _RIDGE)
        residual = target - features @ coefficients
        huber = np.minimum(1.0, _HUBER / np.maximum(np.abs(residual) / np.sqrt(variance), 1e-9))
        spread = _fit_spread(residual, error, log_g, log_range)
    return coefficients, spread


def _fit_spread(
    residual: Floats, error: Floats, log_g: Floats, log_range: tuple[float, float]
) -> tuple[float, float]:  # fmt: skip
    """Find the most likely spread besides the drives' own error: ln of it at both ends of the range, on a grid."""
    ends = np.log(np.geomspace(0.01, 0.6, 40))
    place = (log_g - log_range[0]) / (log_range[1] - log_range[0])
    best, found = np.inf, (ends[0], ends[0])
    for low in ends:
        variance = np.exp(2 * (low + (ends[:, None] - low) * place)) + error**2
        tails = (_FREEDOM + 1) / 2 * np.log1p(residual**2 / (_FREEDOM * variance))
        score = np.sum(np.log(variance) / 2 + tails, axis=1)
        at = int(np.argmin(score))
        if score[at] < best:
            best, found = float(score[at]), (low, ends[at])
    # Scale of that distribution as the standard deviation of the normal one with the same 80 % interval.
    widen = np.log(_STUDENT_TAIL / NORMAL_80)
    return float(found[0] + widen), float(found[1] + widen)


def _calibrate_spread(
    spread: tuple[float, float], residual: Floats, mean_error: Floats, log_g: Floats, log_range: tuple[float, float]
) -> tuple[float, float]:
    """Scale a spread so that 80 % intervals contain 80 % of the cross-validated means; add ``_VALIDATION_ERROR``.

    ``mean_error`` is the standard error of the means, widened by `student_factor`.
    """
    own = np.exp(np.interp(log_g, log_range, spread))
    factors = np.geomspace(0.5, 3.0, 181)
    contained = np.abs(residual) <= NORMAL_80 * np.hypot(factors[:, None] * own, mean_error)
    factor = factors[int(np.argmin(np.abs(contained.mean(axis=1) - (1 - 2 * TAIL))))]
    low, high = (float(0.5 * np.log((factor * np.exp(side)) ** 2 + _VALIDATION_ERROR**2)) for side in spread)
    return low, high


def student_factor(drives: NDArray[np.int64]) -> Floats:
    """Return Student's t quantile over the normal one for a mean of that many drives (first Cornish-Fisher term)."""
    return 1 + (NORMAL_80**2 + 1) / (4 * (drives.astype(np.float64) - 1))


def _fit_logistic(terms: Floats, failed: NDArray[Any], completed: NDArray[Any], penalty: float) -> Floats:
    """Fit a logistic regression with a ridge penalty on all but the constant; return the coefficients (k,), in logits.

    ``terms`` (n, k): the first is the constant; ``failed`` and ``completed`` (n,): weights of both outcomes.
    """
    from sklearn.linear_model import LogisticRegression
    from sklearn.preprocessing import StandardScaler

    scaler = StandardScaler().fit(terms[:, 1:])
    x = np.tile(scaler.transform(terms[:, 1:]), (2, 1))
    fit = LogisticRegression(C=1 / penalty, solver="newton-cholesky", tol=1e-8).fit(
        x, np.repeat((1, 0), len(terms)), np.concatenate((failed, completed))
    )
    slopes = fit.coef_[0] / scaler.scale_
    return np.concatenate((fit.intercept_ - slopes @ scaler.mean_, slopes))


def _noise_tables(noisy: Floats) -> tuple[Table, Table, Table]:
    """Return quantiles of the error over the patches nearest to each excess and point count, in logarithms."""
    excess_of, points_of, error = noisy
    log_excess, log_points_of = np.log(np.maximum(excess_of, _MIN_EXCESS)), np.log(points_of)
    nearest = max(_MIN_NOISY, len(log_excess) // _NOISY_SHARE)
    low_tail = np.interp(_EXCESS, _STRONG_EXCESS, (TAIL, _STRONG_TAIL))
    tables = []
    for points in _PIXEL_POINTS:
        row = []
        for excess, tail in zip(_EXCESS, low_tail, strict=True):
            distance = np.hypot(log_excess - np.log(max(excess, _MIN_EXCESS)), 2 * (log_points_of - np.log(points)))
            near = error[np.argsort(distance, kind="stable")[:nearest]]
            row.append(np.quantile(near, (tail, 0.5, 1 - TAIL)))
        tables.append(row)
    low, middle, high = (
        tuple(tuple(float(knot[side]) for knot in row) for row in tables) for side in range(3)
    )  # fmt: skip
    return low, middle, high


def survey_terrains(terrains: Sequence[Terrain], density: float, noise_m: float, seed: int) -> TileBuckets:
    """Survey terrains as `survey_terrain`, each as the tile ``(index, 0)`` with its own random stream."""
    buckets = TileBuckets(Grid(terrains[0].tile_size, terrains[0].pixels))
    for index, terrain in enumerate(terrains):
        x, y, z = survey_terrain(terrain, density, noise_m, np.random.default_rng([seed, index]))
        buckets.add(x + index * terrain.tile_size, y, z, np.zeros(len(z), np.bool_))
    return buckets


def _noisy_patches(terrains: Sequence[Terrain], truth: Floats, operator: RideOperator) -> Floats:
    """Survey the library, as `fit_correction` takes it; ``truth`` (n,): geometric C_r of the terrains, rad/m."""
    found = []
    for number, condition in enumerate(product(_DENSITIES, _NOISES_M)):
        for block in survey_terrains(terrains, *condition, _NOISE_SEED + number).blocks():
            patches = measure(block, FeatureSettings(), ground_only=False)
            relief_map, (_, noise) = denoise(patches)
            c_r, excess = subtract_noise(roll_over(relief_map, operator).pitch_change, noise * operator.noise_gain)
            wanted = truth[patches.col]
            known = (patches.reason == Reason.OK) & np.isfinite(excess) & (wanted > _LEAST_C_R)
            error = np.log(wanted[known] / c_r[known])
            found.append((excess[known], patches.count[known] / patches.grid.pixels**2, error))
    return np.concatenate(found, axis=1)


def fit_thin_surveys(profile: Vehicle, terrains: Sequence[Terrain], ride: dict[str, Any]) -> dict[str, Any]:
    """Fit the model of thin surveys of a vehicle; returns plain JSON for the calibration's ``thin`` entry.

    ``terrains``: the ground of the library; ``ride``: the calibration's ride model.
    """
    operator = RideOperator.of(profile, terrains[0].tile_size, terrains[0].pixels)
    correction = Correction.from_record(ride)
    relief, slope = relief_and_slope([terrain.heights for terrain in terrains], terrains[0].tile_size)
    none = np.zeros(len(terrains))
    truth = correction.predict(roll_over(relief, operator), slope, none, none + MANY_POINTS)
    columns, strength, terrain = zip(*_surveys(terrains, truth.log_c_r, operator), strict=True)
    usual = float(np.hypot(np.exp(np.mean(correction.spread)), correction.model_error))
    felt = _noise_ride(terrains[0], operator)
    strengths, tile = Strength(*np.concatenate(strength, axis=1)), np.concatenate(terrain)
    given = np.concatenate(columns), strengths, tile, truth.log_c_r[tile], truth.p_fail[tile]
    return _fit_thin(*given, felt, usual).to_record()


def _fit_thin(
    columns: Floats, strength: Strength, terrain: NDArray[np.int64], log_c_r: Floats, p_fail: Floats,
    of_noise: tuple[float, float], own_spread: float,
) -> ThinModel:  # fmt: skip
    """Fit all coefficients to n tiles of thin surveys, in the terms of `ThinModel`.

    ``strength`` (n,): beside tiles that are alike; ``terrain`` (n,): its number, all surveys of one are on the same
    side of a cross-validation; ``log_c_r``, ``p_fail`` (n,): of the ground without survey errors.
    """
    ground, error = strength.ground, strength.ground_sd
    relief = (float(np.log(_LOW_GROUND_M)), float(np.quantile(ground, 1 - _BEYOND)))
    sure = 1.0 / (1.0 + (error / _USUAL_ERROR) ** 2) ** 2
    ride = np.log(np.maximum(columns[:, THIN_COLUMNS.index("pitch_change")], _LEAST_C_R))
    certain = error < np.quantile(error, _CERTAIN)
    felt = (*of_noise, float(np.median((ride - ground)[certain])))
    terms, widths, fails = thin_terms(columns, strength, felt, relief)
    target = log_c_r - (ground - np.clip(ground, *relief))
    predicted = np.empty(len(target))
    for part in range(_THIN_FOLDS):
        rest = terrain % _THIN_FOLDS != part
        predicted[~rest] = terms[~rest] @ _robust_fit(terms[rest], target[rest], sure[rest])
    residual = target - predicted
    # ln of the size of the residuals; then both sides are scaled so that a tenth of the residuals lie beyond each.
    spread = _robust_fit(widths, np.log(np.maximum(np.abs(residual), _LEAST_RESIDUAL)), sure)
    known = np.hypot(np.exp(widths @ spread), error)
    low, high = np.quantile(residual / known, (TAIL, 1 - TAIL)) / NORMAL_80
    # The library holds little ground that fails, a survey may hold nothing else: failed and completed drives weigh
    # alike, so that a tile about which the points say nothing is as likely to fail as not.
    failing = float(np.clip(p_fail.mean(), 1e-6, 1 - 1e-6))
    balance = 0.5 * (p_fail / failing + (1 - p_fail) / (1 - failing))
    return ThinModel(
        relief=relief,
        felt=felt,
        c_r=tuple(_robust_fit(terms, target, sure).tolist()),
        spread=tuple(spread.tolist()),
        sides=(float(-low), float(high)),
        own_spread=own_spread,
        fail=tuple(_fit_logistic(fails, balance * p_fail, balance * (1 - p_fail), _THIN_FAIL_RIDGE).tolist()),
        origin={
            "tiles": len(target),
            "terrains": len(np.unique(terrain)),
            "columns": list(THIN_COLUMNS),
            **_scores(log_c_r, predicted + log_c_r - target),
        },
    )


def _robust_fit(terms: Floats, target: Floats, sure: Floats) -> Floats:
    """Return the coefficients (k,) of terms (n, k), the first constant.

    ``sure`` (n,): weights; outliers get less, as Huber has it.
    """
    scale = np.maximum(terms.std(axis=0), 1e-9)
    scale[0] = 1.0
    weight, found = sure, np.zeros(len(scale))
    for _ in range(_THIN_TURNS):
        found = _weighted_ridge(terms, target, weight, scale, _THIN_RIDGE)
        size = np.abs(target - terms @ found)
        weight = sure * np.minimum(1.0, _THIN_HUBER * _MAD_TO_SD * np.median(size) / np.maximum(size, 1e-9))
    return found


def _surveys(
    terrains: Sequence[Terrain], log_c_r: Floats, operator: RideOperator
) -> Iterator[tuple[Floats, Strength, NDArray[np.int64]]]:  # fmt: skip
    """Yield columns, strengths and terrain of the tiles of every survey."""
    conditions = [(density, noise, False) for density in _THIN_DENSITIES for noise in _THIN_NOISES_M]
    conditions += [(density, noise, True) for density in _CUT_DENSITIES for noise in _THIN_NOISES_M[::2]]
    for number, (density, noise, cut) in enumerate(conditions):
        columns, tile = survey_columns(terrains, density, noise, _SEED + number, operator, cut=cut)
        points, seen = (columns[:, THIN_COLUMNS.index(name)] for name in ("points", "seen"))
        spanned = (seen > 0) | (points < SPANNED_POINTS)
        known = np.isfinite(columns).all(axis=1) & (points >= THIN_POINTS) & spanned
        columns, tile = columns[known], tile[known]
        yield columns, strengths_of(columns, log_c_r[tile]), tile


def strengths_of(columns: Floats, log_c_r: Floats) -> Strength:
    """Return the strengths of n tiles in a square where each lies beside such as it is, give or take `_UNLIKE`."""
    likeness = log_c_r + _UNLIKE * np.random.default_rng(_LIKE_SEED).standard_normal(len(log_c_r))
    first, side = THIN_COLUMNS.index("wave_0"), int(np.ceil(np.sqrt(len(columns))))
    place = np.arange(side**2).reshape(side, side)
    place[1::2] = place[1::2, ::-1].copy()  # to and fro: the end of a row is beside the next
    place = place.ravel().argsort()[: len(columns)]
    order = np.argsort(likeness, kind="stable")
    laid = np.full((side**2, columns.shape[1]), np.nan, np.float32)
    laid[place] = columns[order]
    square, found = laid.reshape(side, side, -1), np.empty((3, len(columns)))
    around, _ = find_strengths(square[..., first:], square[..., 3:5])
    found[:, order] = [values.ravel()[place] for values in around]
    return Strength(*found)


def survey_columns(
    terrains: Sequence[Terrain], density: float, noise_m: float, seed: int, operator: RideOperator, *, cut: bool = False
) -> tuple[Floats, NDArray[np.int64]]:
    """Survey terrains; return the columns of the tiles that hold points, and the number of the terrain of each.

    ``cut``: a strip on one side of each tile, up to half of it, holds no points.
    """
    settings = FeatureSettings()
    columns, tile = [], []
    for block in survey_terrains(terrains, density, noise_m, seed).blocks():
        points = _cut(block) if cut else block
        patches = measure(points, settings, ground_only=False)
        pairs, maps = measure_thin(points, patches, settings, ground_only=False)
        columns.append(thin_columns(pairs, maps, patches.count, operator).astype(np.float64))
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


def _noise_ride(like: Terrain, operator: RideOperator) -> tuple[float, float]:
    """Return ln of the pitch change over the noise on level ground, as the first two of `ThinModel.felt`."""
    side, noise = like.pixels * FINE, _THIN_NOISES_M[-1]
    level = [Terrain("level", np.zeros((side, side)), like.tile_size)] * _BARE_TILES
    names = [THIN_COLUMNS.index(name) for name in ("points", "pitch_change")]
    found = []
    for number, density in enumerate(_THIN_DENSITIES):
        columns, _ = survey_columns(level, density, noise, _BARE_SEED + number, operator)
        points, ride = columns[np.isfinite(columns).all(axis=1)][:, names].T
        found.append((log_points(points[ride > 0]), np.log(ride[ride > 0] / noise)))
    log_n, log_ride = (np.concatenate(part) for part in zip(*found, strict=True))
    slope, constant = np.polyfit(log_n, log_ride, 1)
    return float(constant), float(slope)
