"""Fit the correction of the ride model to simulated drives, the last step of a calibration."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BumpymapError
from bumpymap.rating.ride.correction import NORMAL_TAIL, TAIL, Correction, fail_features, ride_features
from bumpymap.rating.ride.geometry import Rides

__all__ = ["MAX_FAILED_SHARE", "DrivenPatches", "NoisyPatches", "fit_correction"]

Floats = NDArray[np.float64]
_Table = tuple[tuple[float, ...], ...]

MAX_FAILED_SHARE = 0.25
"""Largest share of failed drives at which the C_r of a patch is used: with more, only survivors would count."""
_MIN_PATCHES = 20
_RIDGE = 1e-3
_FAIL_RIDGE = 0.3
_HUBER = 2.5
"""Standard deviations beyond which residuals get less weight (Huber)."""
_EXCESS = (0.0, 0.01, 0.03, 0.1, 0.2, 0.4, 0.7, 1.1, 1.6, 2.3)
_PIXEL_POINTS = (0.7, 1.0, 2.0, 4.0, 12.0, 40.0)
_MIN_EXCESS = 0.003
"""Excess below this is treated as equal to it."""
_MIN_NOISY = 120
"""Fewest patches that a quantile of the noise tables is computed from."""
_NOISY_SHARE = 80
"""Otherwise one of so many."""
_STRONG_EXCESS, _STRONG_TAIL = (0.1, 0.4), 0.05
"""From the first excess to the second, the probability below the low end of the interval falls from ``TAIL`` to that.
Strong noise hides how smooth the smoothest ground is: with a tenth below, four in ten of the smooth tiles would be."""
_VALIDATION_ERROR = 0.045
"""Standard error of ln C_r of a patch in the validation drives; intervals must contain means with that error."""
_MODEL_ERROR = 0.10
"""Standard deviation of ln C_r between simulations of one vehicle: root mean square over 140 pairs of means that
tests/benchmarks/second_simulator.py measured, with four kinds of wheels and tyres. A simulation of another author
differed by 12 % in the median and 5 % in bias, the scatter of both sides' drives included."""


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


@dataclass(frozen=True, slots=True)
class NoisyPatches:
    """Patches that were surveyed with simulated noise."""

    excess: Floats
    """(n,) noise excess from `subtract_noise`."""
    pixel_points: Floats
    """(n,) mean points per pixel."""
    error: Floats
    """(n,) ln (geometric C_r of the true ground / that of the denoised patch, from `subtract_noise`)."""


def fit_correction(driven: DrivenPatches, noisy: NoisyPatches) -> Correction:
    """Fit the coefficients of C_r, its spread, p_fail and the noise tables.

    Raises
    ------
    BumpymapError
        The drives were completed on too few patches.
    """
    share = driven.failed / (driven.failed + driven.completed)
    good = (share <= MAX_FAILED_SHARE) & (driven.completed >= 2) & (driven.c_r > 0) & (driven.error > 0)
    if int(good.sum()) < _MIN_PATCHES:
        raise BumpymapError(
            f"the vehicle completed its drives on {int(good.sum())} of {len(good)} terrains; a ride model needs "
            f"at least {_MIN_PATCHES}. Look for a wrong number in its profile (bumpymap calibrate --check), or drive "
            "more terrains"
        )
    log_g = np.log(driven.rides.pitch_change[good])
    features = ride_features(log_g, driven.rides, driven.slope_deg) if good.all() else _features(driven, good, log_g)
    target, error = np.log(driven.c_r[good]), driven.error[good] / driven.c_r[good]
    log_range = (float(log_g.min()), float(log_g.max()))
    coefficients, spread = _fit_c_r(features, target, error, log_g, log_range)
    # The residuals of a fit understate its error, so the intervals are based on cross-validation.
    predicted = _cross_validate(features, target, error, log_g, log_range)
    mean_error = error * student_factor(driven.completed[good])
    spread = calibrate_spread(spread, target - predicted, mean_error, log_g, log_range)
    fail = _fit_fail(fail_features(driven.rides, driven.slope_deg), driven.failed, driven.completed)
    low, middle, high = _noise_tables(noisy)
    return Correction(
        log_range=log_range,
        c_r=tuple(coefficients.tolist()),
        spread=spread,
        fail=tuple(fail.tolist()),
        excess=_EXCESS,
        pixel_points=_PIXEL_POINTS,
        noise_low=low,
        noise_middle=middle,
        noise_high=high,
        origin=_report(predicted, target, error, driven),
        model_error=_MODEL_ERROR,
    )


def _features(driven: DrivenPatches, good: NDArray[np.bool_], log_g: Floats) -> Floats:
    rides = Rides(*(getattr(driven.rides, name)[good] for name in Rides.__dataclass_fields__))
    return ride_features(log_g, rides, driven.slope_deg[good])


def _fit_c_r(
    features: Floats, target: Floats, error: Floats, log_g: Floats, log_range: tuple[float, float]
) -> tuple[Floats, tuple[float, float]]:
    """Fit coefficients and spread in turns: the spread weights the patches, the residuals determine the spread."""
    spread = (np.log(0.08), np.log(0.08))
    coefficients = np.zeros(features.shape[1])
    huber = np.ones(len(target))
    for _ in range(8):
        own = np.exp(np.interp(log_g, log_range, spread))
        variance = own**2 + error**2
        weight = huber / variance
        scale = np.sqrt(np.average(features**2, axis=0))
        system = (features * weight[:, None]).T @ features / weight.sum() + np.diag(_RIDGE * scale**2)
        coefficients = np.linalg.solve(system, (features * weight[:, None]).T @ target / weight.sum())
        residual = target - features @ coefficients
        size = np.abs(residual) / np.sqrt(variance)
        huber = np.minimum(1.0, _HUBER / np.maximum(size, 1e-9))
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
        # Student's t with five degrees of freedom: there are more outliers than a normal distribution has.
        score = np.sum(np.log(variance) / 2 + 3 * np.log1p(residual**2 / (5 * variance)), axis=1)
        at = int(np.argmin(score))
        if score[at] < best:
            best, found = float(score[at]), (low, ends[at])
    # Scale of that distribution as the standard deviation of the normal one with the same 80 % interval.
    widen = np.log(1.475884 / 1.281552)
    return float(found[0] + widen), float(found[1] + widen)


def calibrate_spread(
    spread: tuple[float, float], residual: Floats, mean_error: Floats, log_g: Floats, log_range: tuple[float, float]
) -> tuple[float, float]:
    """Scale a spread so that 80 % intervals contain 80 % of the cross-validated means; add ``_VALIDATION_ERROR``.

    ``mean_error`` is the standard error of the means, widened by `_student_factor`.
    """
    own = np.exp(np.interp(log_g, log_range, spread))
    factors = np.geomspace(0.5, 3.0, 181)
    contained = np.abs(residual) <= NORMAL_TAIL * np.hypot(factors[:, None] * own, mean_error)
    factor = factors[int(np.argmin(np.abs(contained.mean(axis=1) - (1 - 2 * TAIL))))]
    low, high = (float(0.5 * np.log((factor * np.exp(side)) ** 2 + _VALIDATION_ERROR**2)) for side in spread)
    return low, high


def student_factor(drives: NDArray[np.int64]) -> Floats:
    """Return Student's t quantile over the normal one for a mean of that many drives (first Cornish-Fisher term)."""
    wider: Floats = 1 + (NORMAL_TAIL**2 + 1) / (4 * (drives.astype(np.float64) - 1))
    return wider


def _cross_validate(
    features: Floats, target: Floats, error: Floats, log_g: Floats, log_range: tuple[float, float]
) -> Floats:
    """Predict ln C_r of each tenth of the patches with a fit to the other nine tenths."""
    predicted = np.empty(len(target))
    tenth = np.arange(len(target)) % 10
    for part in range(10):
        rest = tenth != part
        coefficients, _ = _fit_c_r(features[rest], target[rest], error[rest], log_g[rest], log_range)
        predicted[~rest] = features[~rest] @ coefficients
    return predicted


def _report(predicted: Floats, target: Floats, error: Floats, driven: DrivenPatches) -> dict[str, Any]:
    order = np.argsort(np.argsort(predicted)), np.argsort(np.argsort(target))
    return {
        "patches": len(driven.c_r),
        "patches_with_c_r": len(target),
        "drives": int((driven.completed + driven.failed).sum()),
        "failed": int(driven.failed.sum()),
        "median_standard_error": round(float(np.median(error)), 4),
        "spearman": round(float(np.corrcoef(*order)[0, 1]), 4),
        "median_relative_error": round(float(np.median(np.abs(np.expm1(predicted - target)))), 4),
    }


def _fit_fail(features: Floats, failed: NDArray[np.int64], completed: NDArray[np.int64]) -> Floats:
    """Fit a logistic regression over drives by Newton's method, with a ridge penalty on all but the constant."""
    middle, scale = features.mean(axis=0), np.maximum(features.std(axis=0), 1e-9)
    middle[0], scale[0] = 0.0, 1.0
    x = (features - middle) / scale
    drives = (failed + completed).astype(np.float64)
    ridge = np.full(x.shape[1], _FAIL_RIDGE)
    ridge[0] = 1e-6
    weight = np.zeros(x.shape[1])
    for _ in range(60):
        chance = 1 / (1 + np.exp(-np.clip(x @ weight, -30, 30)))
        gradient = x.T @ (failed - drives * chance) - ridge * weight
        curvature = (x * (drives * chance * (1 - chance))[:, None]).T @ x + np.diag(ridge)
        step = np.linalg.solve(curvature, gradient)
        weight = weight + step / max(1.0, float(np.abs(step).max()) / 2)
    plain = weight / scale
    plain[0] -= float(np.sum(weight[1:] * middle[1:] / scale[1:]))
    found: Floats = plain
    return found


def _noise_tables(noisy: NoisyPatches) -> tuple[_Table, _Table, _Table]:
    """Return quantiles of the error over the patches nearest to each excess and point count, in logarithms."""
    log_excess = np.log(np.maximum(noisy.excess, _MIN_EXCESS))
    log_points = np.log(noisy.pixel_points)
    nearest = max(_MIN_NOISY, len(log_excess) // _NOISY_SHARE)
    low_tail = np.interp(_EXCESS, _STRONG_EXCESS, (TAIL, _STRONG_TAIL))
    tables = []
    for points in _PIXEL_POINTS:
        row = []
        for excess, tail in zip(_EXCESS, low_tail, strict=True):
            distance = np.hypot(log_excess - np.log(max(excess, _MIN_EXCESS)), 2 * (log_points - np.log(points)))
            near = noisy.error[np.argsort(distance, kind="stable")[:nearest]]
            row.append(np.quantile(near, (tail, 0.5, 1 - TAIL)))
        tables.append(row)
    low, middle, high = (
        tuple(tuple(float(knot[side]) for knot in row) for row in tables) for side in range(3)
    )  # fmt: skip
    return low, middle, high
