"""Fit the model of thin surveys to simulated ones, the last step of a calibration."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.rating.ride.correction import NORMAL_TAIL, TAIL
from bumpymap.rating.ride.thin import THIN_COLUMNS, ThinModel, fail_terms, log_points, ride_terms, spread_terms

__all__ = ["ThinSurveys", "fit_thin"]

Floats = NDArray[np.float64]
_RIDGE = 1e-4
_FAIL_RIDGE = 1.0
_HUBER = 2.0
_PARTS = 5
_LEAST_ERROR = 0.02
_BEYOND = 0.005
"""Share of the tiles beyond either end of the trained relief."""


@dataclass(frozen=True, slots=True)
class ThinSurveys:
    """Tiles of thin simulated surveys, and the truth of their ground."""

    columns: Floats
    """(n, 20) of `thin_columns`."""
    noise: Floats
    """(n,) standard deviation of the height of a point, as pooled from the tiles of its survey, m."""
    terrain: NDArray[np.int64]
    """(n,) number of the terrain: all surveys of one are on the same side of a cross-validation."""
    log_c_r: Floats
    """(n,) ln of the C_r [rad/m] of the ground without survey errors."""
    p_fail: Floats
    """(n,) p_fail of the same."""
    bare: tuple[Floats, Floats, Floats]
    """(m,) points, noise [m] and pitch change [rad/m] of surveys of level ground."""
    own_spread: float
    """Standard deviation of ln C_r in the drives about what the ride model predicts."""


def fit_thin(surveys: ThinSurveys) -> ThinModel:
    """Fit all coefficients."""
    felt = _fit_felt(*surveys.bare)
    first = (surveys.columns, surveys.noise, felt)
    height = ride_terms(*first, (-50.0, 50.0))[:, 1]
    relief = (float(np.quantile(height, _BEYOND)), float(np.quantile(height, 1 - _BEYOND)))
    inputs = (*first, relief)
    terms = ride_terms(*inputs)
    target = surveys.log_c_r - (height - np.clip(height, *relief))
    part = surveys.terrain % _PARTS
    predicted = np.empty(len(target))
    for k in range(_PARTS):
        rest = part != k
        predicted[~rest] = terms[~rest] @ _robust_fit(terms[rest], target[rest])
    residual = target - predicted
    spread, sides = _fit_spread(spread_terms(*inputs), residual)
    fail = _fit_logistic(fail_terms(*first), surveys.p_fail)
    order = np.argsort(np.argsort(predicted)), np.argsort(np.argsort(target))
    return ThinModel(
        relief=relief,
        felt=felt,
        c_r=tuple(_robust_fit(terms, target).tolist()),
        spread=tuple(spread.tolist()),
        sides=sides,
        own_spread=surveys.own_spread,
        fail=tuple(fail.tolist()),
        origin={
            "tiles": len(target),
            "terrains": len(np.unique(surveys.terrain)),
            "columns": list(THIN_COLUMNS),
            "spearman": round(float(np.corrcoef(*order)[0, 1]), 4),
            "median_relative_error": round(float(np.median(np.abs(np.expm1(residual)))), 4),
        },
    )


def _fit_felt(points: Floats, noise: Floats, ride: Floats) -> tuple[float, float]:
    """Fit ln of the pitch change of noise over the noise, as a line over ln of the points."""
    slope, constant = np.polyfit(log_points(points), np.log(ride / noise), 1)
    return float(constant), float(slope)


def _robust_fit(terms: Floats, target: Floats) -> Floats:
    """Weighted least squares with a small ridge; outliers get less weight (Huber)."""
    scale = np.maximum(terms.std(axis=0), 1e-9)
    scale[0] = 1.0
    x = terms / scale
    weight = np.ones(len(target))
    found = np.zeros(x.shape[1])
    for _ in range(6):
        system = (x * weight[:, None]).T @ x / weight.sum() + _RIDGE * np.eye(x.shape[1])
        found = np.linalg.solve(system, (x * weight[:, None]).T @ target / weight.sum())
        size = np.abs(target - x @ found)
        weight = np.minimum(1.0, _HUBER * 1.4826 * np.median(size) / np.maximum(size, 1e-9))
    plain: Floats = found / scale
    return plain


def _fit_spread(terms: Floats, residual: Floats) -> tuple[Floats, tuple[float, float]]:
    """Fit ln of the size of the residuals; then scale both sides so that a tenth of the residuals lie beyond each."""
    size = np.log(np.maximum(np.abs(residual), _LEAST_ERROR))
    found = _robust_fit(terms, size)
    reduced = residual / np.exp(terms @ found)
    low, high = np.quantile(reduced, (TAIL, 1 - TAIL)) / NORMAL_TAIL
    return found, (float(-low), float(high))


def _fit_logistic(terms: Floats, share: Floats) -> Floats:
    """Fit a logistic regression to shares by Newton's method, with a ridge on all but the constant.

    The library holds little ground that fails, a survey may hold nothing else: failed and completed drives weigh alike,
    so that a tile about which the points say nothing is as likely to fail as not.
    """
    failing = float(np.clip(share.mean(), 1e-6, 1 - 1e-6))
    balance = 0.5 * (share / failing + (1 - share) / (1 - failing))
    middle, scale = np.average(terms, axis=0, weights=balance), np.maximum(terms.std(axis=0), 1e-9)
    middle[0], scale[0] = 0.0, 1.0
    x = (terms - middle) / scale
    ridge = np.full(x.shape[1], _FAIL_RIDGE)
    ridge[0] = 1e-6
    weight = np.zeros(x.shape[1])
    for _ in range(60):
        chance = 1 / (1 + np.exp(-np.clip(x @ weight, -30, 30)))
        gradient = x.T @ (balance * (share - chance)) - ridge * weight
        curvature = (x * (balance * chance * (1 - chance))[:, None]).T @ x + np.diag(ridge)
        step = np.linalg.solve(curvature, gradient)
        weight = weight + step / max(1.0, float(np.abs(step).max()) / 2)
    plain: Floats = weight / scale
    plain[0] -= float(np.sum(weight[1:] * middle[1:] / scale[1:]))
    return plain
