"""Statistics of the agreement between predictions and drives, on plain arrays.

Patches are rows. Arrays of C_r must not contain NaN; the caller drops such patches.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "ClassShift",
    "Coverage",
    "ReliabilityBin",
    "class_shift",
    "confusion",
    "coverage",
    "cross_validated_fit",
    "driven_class",
    "fail_auc",
    "median_error",
    "median_ratio",
    "monotone_fit",
    "reliability",
    "same_order",
    "spearman",
]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def spearman(first: Floats, second: Floats) -> float:
    """Return the rank correlation of two (n,) arrays; NaN with fewer than three rows or if one is constant."""
    from scipy.stats import rankdata

    if len(first) < 3 or np.ptp(first) == 0 or np.ptp(second) == 0:
        return float("nan")
    return float(np.corrcoef(rankdata(first), rankdata(second))[0, 1])


def median_error(predicted: Floats, driven: Floats) -> float:
    """Return the median of abs(predicted - driven) / driven; NaN without rows."""
    return float(np.median(np.abs(predicted - driven) / driven)) if len(driven) else float("nan")


def median_ratio(predicted: Floats, driven: Floats) -> float:
    """Return the median of predicted / driven (above 1: the prediction is too high); NaN without rows."""
    return float(np.median(predicted / driven)) if len(driven) else float("nan")


def monotone_fit(predictor: Floats, c_r: Floats, wanted: Floats) -> Floats:
    """Predict C_r by the best monotone function of a predictor: isotonic regression on ln C_r.

    Parameters
    ----------
    predictor, c_r : array (n,)
        Data for the fit, at least one row; C_r in rad/m.
    wanted : array (m,)
        Values of the predictor to evaluate; interpolated linearly, and constant beyond the range of the fit.

    Returns
    -------
    array (m,)
        rad/m.
    """
    from scipy.optimize import isotonic_regression

    place, row, count = np.unique(predictor, return_inverse=True, return_counts=True)
    mean = np.bincount(row, np.log(c_r)) / count
    fitted = isotonic_regression(mean, weights=count.astype(np.float64)).x
    value: Floats = np.exp(np.interp(wanted, place, fitted))
    return value


def cross_validated_fit(predictor: Floats, c_r: Floats, parts: int = 10) -> Floats:
    """Predict C_r of each patch by a monotone function fitted to the other parts (cross-validation), (n,) rad/m.

    A fit that includes the patch itself would be biased towards it.
    """
    part = np.arange(len(c_r)) % parts
    fitted = np.empty(len(c_r))
    for number in np.unique(part):
        own = part == number
        rest = ~own if not own.all() else own
        fitted[own] = monotone_fit(predictor[rest], c_r[rest], predictor[own])
    return fitted


def driven_class(c_r: Floats, failed_share: Floats, limits: tuple[float, ...]) -> Ints:
    """Return the class of each patch by its drives: that of the mean C_r, or the last one if half of them failed.

    Parameters
    ----------
    c_r : array (n,)
        Mean over the completed drives, rad/m; NaN if there are none.
    failed_share : array (n,)
        0..1.
    limits : tuple
        C_r limits between the classes, rad/m.
    """
    class_id = np.searchsorted(np.array(limits), c_r, side="right")
    return np.where((failed_share >= 0.5) | np.isnan(c_r), len(limits), class_id).astype(np.int64)


def confusion(driven: Ints, predicted: Ints, classes: int) -> Ints:
    """Return the confusion matrix (classes, classes): number of patches by ``[driven][predicted]`` class."""
    table = np.zeros((classes, classes), np.int64)
    np.add.at(table, (driven, predicted), 1)
    return table


@dataclass(frozen=True, slots=True)
class ClassShift:
    """Shares of the patches by distance between predicted and driven class, 0..1."""

    same: float
    one_off: float
    further: float


def class_shift(table: Ints) -> ClassShift:
    """Summarise a confusion matrix; NaN without patches."""
    away = np.abs(np.subtract.outer(np.arange(len(table)), np.arange(len(table))))
    shares = [float(table[chosen].sum() / max(table.sum(), 1)) for chosen in (away == 0, away == 1, away > 1)]
    return ClassShift(*shares) if table.sum() else ClassShift(*(float("nan"),) * 3)


@dataclass(frozen=True, slots=True)
class Coverage:
    """Shares of the patches with a driven mean inside, below and above the predicted interval, 0..1."""

    held: float
    below: float
    above: float


def coverage(low: Floats, high: Floats, driven: Floats) -> Coverage:
    """Return the coverage of the driven means by the intervals (n,); NaN without rows."""
    if not len(driven):
        return Coverage(*(float("nan"),) * 3)
    below, above = driven < low, driven > high
    return Coverage(float(np.mean(~below & ~above)), float(np.mean(below)), float(np.mean(above)))


def fail_auc(p_fail: Floats, failed: Floats, completed: Floats) -> float:
    """Return the probability that a failed drive was on ground of higher ``p_fail`` than a completed one.

    Ties count half.

    Parameters
    ----------
    p_fail : array (n,)
        Predicted for each patch.
    failed, completed : array (n,)
        Number of its drives, or their shares, to weight all patches equally.

    Returns
    -------
    float
        Area under the ROC curve; NaN if no drive failed or all did.
    """
    pairs = float(failed.sum()) * float(completed.sum())
    if pairs == 0:
        return float("nan")
    values, row = np.unique(p_fail, return_inverse=True)
    bad, good = (np.bincount(row, drives, len(values)) for drives in (failed, completed))
    safer = np.cumsum(good) - good
    return float(np.sum(bad * (safer + good / 2)) / pairs)


@dataclass(frozen=True, slots=True)
class ReliabilityBin:
    """Patches of similar ``p_fail``; all patches have the same weight."""

    predicted: float
    """Mean p_fail; NaN without patches."""
    share_failed: float
    """Mean share of the drives that failed; NaN without patches."""
    patches: int


def reliability(p_fail: Floats, failed_share: Floats, bins: int = 5) -> list[ReliabilityBin]:
    """Compare predicted and driven failures in bins of equal width between 0 and 1."""
    place = np.minimum((p_fail * bins).astype(np.int64), bins - 1)
    found = []
    for number in range(bins):
        own = place == number
        predicted, driven = (float(v[own].mean()) if own.any() else float("nan") for v in (p_fail, failed_share))
        found.append(ReliabilityBin(predicted, driven, int(own.sum())))
    return found


def same_order(predicted: Floats, driven: Floats) -> NDArray[np.bool_]:
    """Return for each patch (column) whether the vehicles (rows) have the same order; (vehicles, n) in, (n,) out."""
    same: NDArray[np.bool_] = np.all(np.argsort(predicted, axis=0) == np.argsort(driven, axis=0), axis=0)
    return same
