"""Statistics of how far predictions and drives agree, on plain arrays.

Patches are rows. Where C_r is compared there must be no NaN: the caller drops such patches.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "ClassShift",
    "Coverage",
    "ReliabilityBin",
    "confusion",
    "coverage",
    "driven_class",
    "fail_auc",
    "left_out_fit",
    "median_error",
    "median_ratio",
    "monotone_fit",
    "reliability",
    "same_order",
    "spearman",
    "steps_off",
]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def spearman(first: Floats, second: Floats) -> float:
    """Rank correlation of two (n,) arrays; NaN with fewer than three rows, or where one of them is constant."""
    from scipy.stats import rankdata

    if len(first) < 3 or np.ptp(first) == 0 or np.ptp(second) == 0:
        return float("nan")
    return float(np.corrcoef(rankdata(first), rankdata(second))[0, 1])


def median_error(predicted: Floats, driven: Floats) -> float:
    """Median of abs(predicted - driven) / driven; NaN without rows."""
    return float(np.median(np.abs(predicted - driven) / driven)) if len(driven) else float("nan")


def median_ratio(predicted: Floats, driven: Floats) -> float:
    """Median of predicted / driven: above 1 the prediction is too high; NaN without rows."""
    return float(np.median(predicted / driven)) if len(driven) else float("nan")


def monotone_fit(predictor: Floats, c_r: Floats, wanted: Floats) -> Floats:
    """C_r by the best monotone function of a predictor: isotonic regression on ln C_r.

    Parameters
    ----------
    predictor, c_r : array (n,)
        What the function is fitted to, at least one row; rad/m.
    wanted : array (m,)
        Values of the predictor; straight lines between those of the fit, the nearest one beyond them.

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


def left_out_fit(predictor: Floats, c_r: Floats, parts: int = 10) -> Floats:
    """C_r of each patch by the monotone function that the other patches give, (n,) rad/m.

    A fit to the very patches it is held against passes through them where they happen to rise, and says nothing.
    """
    part = np.arange(len(c_r)) % parts
    fitted = np.empty(len(c_r))
    for number in np.unique(part):
        own = part == number
        rest = ~own if not own.all() else own
        fitted[own] = monotone_fit(predictor[rest], c_r[rest], predictor[own])
    return fitted


def driven_class(c_r: Floats, failed_share: Floats, limits: tuple[float, ...]) -> Ints:
    """Class that the drives give each patch: that of the mean C_r; the last one where half of them failed.

    Parameters
    ----------
    c_r : array (n,)
        Mean over the completed drives, rad/m; NaN without one.
    failed_share : array (n,)
        0..1.
    limits : tuple
        C_r between the classes, rad/m.
    """
    class_id = np.searchsorted(np.array(limits), c_r, side="right")
    return np.where((failed_share >= 0.5) | np.isnan(c_r), len(limits), class_id).astype(np.int64)


def confusion(driven: Ints, predicted: Ints, classes: int) -> Ints:
    """(classes, classes) number of patches: ``[driven][predicted]``."""
    table = np.zeros((classes, classes), np.int64)
    np.add.at(table, (driven, predicted), 1)
    return table


@dataclass(frozen=True, slots=True)
class ClassShift:
    """Shares of the patches by how far the predicted class is off, 0..1."""

    same: float
    one_off: float
    further: float


def steps_off(table: Ints) -> ClassShift:
    """Sum up a confusion matrix; NaN without patches."""
    away = np.abs(np.subtract.outer(np.arange(len(table)), np.arange(len(table))))
    shares = [float(table[chosen].sum() / max(table.sum(), 1)) for chosen in (away == 0, away == 1, away > 1)]
    return ClassShift(*shares) if table.sum() else ClassShift(*(float("nan"),) * 3)


@dataclass(frozen=True, slots=True)
class Coverage:
    """Shares of the patches whose driven mean lies in, below and above the predicted interval, 0..1."""

    held: float
    below: float
    above: float


def coverage(low: Floats, high: Floats, driven: Floats) -> Coverage:
    """Count intervals (n,) that hold the driven mean; NaN without rows."""
    if not len(driven):
        return Coverage(*(float("nan"),) * 3)
    below, above = driven < low, driven > high
    return Coverage(float(np.mean(~below & ~above)), float(np.mean(below)), float(np.mean(above)))


def fail_auc(p_fail: Floats, failed: Floats, completed: Floats) -> float:
    """Probability that a failed drive was over ground of higher ``p_fail`` than a completed one; ties count half.

    Parameters
    ----------
    p_fail : array (n,)
        Of each patch.
    failed, completed : array (n,)
        Its drives, or their shares: then every patch counts alike.

    Returns
    -------
    float
        Area under the ROC curve; NaN where no drive failed, or all did.
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
    """Patches of about one ``p_fail``; every patch counts alike."""

    predicted: float
    """Mean p_fail; NaN without patches."""
    share_failed: float
    """Mean share of the drives that failed; NaN without patches."""
    patches: int


def reliability(p_fail: Floats, failed_share: Floats, bins: int = 5) -> list[ReliabilityBin]:
    """Predicted against driven failures in bins of equal width between 0 and 1."""
    place = np.minimum((p_fail * bins).astype(np.int64), bins - 1)
    found = []
    for number in range(bins):
        own = place == number
        predicted, driven = (float(v[own].mean()) if own.any() else float("nan") for v in (p_fail, failed_share))
        found.append(ReliabilityBin(predicted, driven, int(own.sum())))
    return found


def same_order(predicted: Floats, driven: Floats) -> NDArray[np.bool_]:
    """Whether each patch (column) orders the vehicles (rows) as the drives do; (vehicles, n) in, (n,) out."""
    same: NDArray[np.bool_] = np.all(np.argsort(predicted, axis=0) == np.argsort(driven, axis=0), axis=0)
    return same
