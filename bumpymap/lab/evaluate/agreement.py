"""Statistics of the agreement between predictions and drives, on plain arrays.

Patches are rows. Arrays of C_r must not contain NaN; the caller drops such patches.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import PatchStack
from bumpymap.lab.evaluate.rated_survey import Verdict
from bumpymap.lab.simulate.drive import PatchDrives

__all__ = [
    "ClassTable",
    "Comparison",
    "DriveStats",
    "VehicleOrder",
    "class_table",
    "compare",
    "compare_order",
    "confusion",
    "plain_predictors",
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


MOST_FAILED = 0.25
"""If a larger share of the drives failed, C_r is not compared, because it comes from the completed drives only."""


@dataclass(frozen=True, slots=True)
class DriveStats:
    """Statistics of the drives over n patches."""

    c_r: Floats
    """(n,) mean C_r over the completed drives, rad/m; NaN if there are none."""
    error: Floats
    """(n,) standard error of that mean, rad/m; NaN with fewer than two."""
    completed: NDArray[np.int64]
    """(n,) number of completed drives."""
    failed: NDArray[np.int64]
    """(n,) number of failed drives."""

    @classmethod
    def of(cls, drives: Sequence[PatchDrives]) -> "DriveStats":
        """Summarise the drives of each patch."""
        return cls(
            np.array([math.nan if patch.mean_c_r is None else patch.mean_c_r for patch in drives]),
            np.array([math.nan if patch.standard_error is None else patch.standard_error for patch in drives]),
            np.array([len(patch.completed) for patch in drives], np.int64),
            np.array([patch.failed for patch in drives], np.int64),
        )

    @property
    def failed_share(self) -> Floats:
        """(n,) share of failed drives, 0..1."""
        share: Floats = self.failed / (self.failed + self.completed)
        return share

    @property
    def comparable(self) -> NDArray[np.bool_]:
        """(n,) True if enough drives were completed to compare C_r."""
        good: NDArray[np.bool_] = (self.failed_share <= MOST_FAILED) & (self.c_r > 0)
        return good

    def take(self, rows: NDArray[np.integer] | NDArray[np.bool_]) -> "DriveStats":
        """Select patches."""
        return DriveStats(*(getattr(self, f.name)[rows] for f in fields(self)))


RISING = ("variance_median", "residual_median", "c_r_median", "variance_mean", "residual_mean")


@dataclass(frozen=True, slots=True)
class ClassRow:
    """Statistics of the tiles of one class; NaN without tiles."""

    class_id: int
    tiles: int
    share: float
    """Share of the classified tiles, 0..1."""
    variance_mean: float
    """z_variance, m2."""
    variance_median: float
    residual_mean: float
    """ransac_residual, m."""
    residual_median: float
    c_r_median: float
    """Predicted, rad/m."""


@dataclass(frozen=True, slots=True)
class ClassTable:
    """Table I of one rating."""

    rows: list[ClassRow]
    rises: dict[str, bool]
    """Column -> whether it rises from class to class; classes without tiles are skipped."""


def class_table(verdict: Verdict, z_variance: Floats, ransac_residual: Floats) -> ClassTable:
    """Summarise classified tiles (n,) by class."""
    rows = []
    for class_id in range(4):
        own = verdict.class_id == class_id
        rows.append(
            ClassRow(
                class_id=class_id,
                tiles=int(own.sum()),
                share=float(own.mean()),
                variance_mean=_of(np.mean, z_variance[own]),
                variance_median=_of(np.median, z_variance[own]),
                residual_mean=_of(np.mean, ransac_residual[own]),
                residual_median=_of(np.median, ransac_residual[own]),
                c_r_median=_of(np.median, verdict.c_r[own]),
            )
        )
    present = [row for row in rows if row.tiles]
    rises = {name: all(getattr(a, name) < getattr(b, name) for a, b in pairwise(present)) for name in RISING}
    return ClassTable(rows, rises)


def _of(sum_up: Callable[[Floats], np.floating], values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(sum_up(known)) if len(known) else float("nan")


CLASSES = 4


@dataclass(frozen=True, slots=True)
class FailAgreement:
    """Agreement of p_fail with the failed drives; all patches have the same weight."""

    auc: float
    auc_below_limit: float
    """AUC over patches within the vehicle's slope limit; beyond it p_fail is 1 by definition."""
    reliability: list[ReliabilityBin]


@dataclass(frozen=True, slots=True)
class Agreement:
    """Agreement of one predictor with the drives."""

    spearman: float
    median_error: float
    """Median of abs(predicted - driven) / driven."""
    median_ratio: float
    """Median of predicted / driven."""
    steps: ClassShift
    confusion: list[list[int]]
    """``[driven class][predicted class]``, patches within the vehicle's slope limit."""
    coverage: Coverage | None
    """Coverage of the 80 % interval; None without an interval."""
    fail: FailAgreement | None
    """None if the predictor has no p_fail."""
    fitted_error: float = float("nan")
    """Only for plain predictors: median error after the best fit to all compared patches, without cross-validation."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """All predictors on the same driven patches."""

    patches: int
    drives: int
    failed: int
    left_out: int
    """Patches whose C_r is not compared because too many drives failed."""
    beyond_limit: int
    """Patches steeper than the vehicle's limit."""
    label_error: float
    """Median standard error of the driven mean C_r, as a share of it."""
    label_error_over: int
    """Compared patches whose standard error stayed above 5 %."""
    auc_most: float
    """AUC of the driven shares themselves, the upper bound for any p_fail per patch."""
    auc_most_below_limit: float
    """The same within the vehicle's slope limit."""
    agreement: dict[str, Agreement]
    """Name of the predictor -> agreement."""


def plain_predictors(patches: PatchStack) -> dict[str, Floats]:
    """Return measures of roughness that do not depend on a vehicle, (n,) each."""
    return {
        "z_variance": patches.z_variance,
        "ransac_residual": patches.ransac_residual,
        "slope_free_sd": patches.relief_map.std(axis=(1, 2), dtype=np.float64),
    }


def compare(
    verdicts: Mapping[str, Verdict],
    plain: Mapping[str, Floats],
    driven: DriveStats,
    too_steep: NDArray[np.bool_],
    limits: tuple[float, ...],
) -> Comparison:
    """Compare predictors with the drives over n patches.

    Parameters
    ----------
    verdicts : mapping
        Name of the rating -> its results.
    plain : mapping
        Name -> predictor (n,); its C_r is the best monotone function of it, fitted to the other patches.
    driven : DriveStats
    too_steep : array (n,)
        True beyond the vehicle's slope limit; such patches have the last class by definition and are not compared.
    limits : tuple
        C_r limits between the classes, rad/m.
    """
    good, level = driven.comparable, ~too_steep
    class_id = driven_class(driven.c_r, driven.failed_share, limits)[level]
    found = {}
    for name, verdict in verdicts.items():
        table = confusion(class_id, verdict.class_id[level].astype(np.int64), CLASSES)
        held = coverage(verdict.c_r_low[good], verdict.c_r_high[good], driven.c_r[good])
        fail = _fail_agreement(verdict.p_fail, driven, too_steep)
        found[name] = _agreement(verdict.c_r, verdict.c_r, driven, table, held, fail)
    for name, predictor in plain.items() if good.any() else ():
        fitted = monotone_fit(predictor[good], driven.c_r[good], predictor)
        best = median_error(fitted[good], driven.c_r[good])
        fitted[good] = cross_validated_fit(predictor[good], driven.c_r[good])
        table = confusion(class_id, np.searchsorted(np.array(limits), fitted[level], side="right"), CLASSES)
        found[name] = replace(_agreement(predictor, fitted, driven, table, None, None), fitted_error=best)
    relative = driven.error[good] / driven.c_r[good]
    most = _fail_agreement(driven.failed_share, driven, too_steep)
    return Comparison(
        patches=len(good),
        drives=int((driven.completed + driven.failed).sum()),
        failed=int(driven.failed.sum()),
        left_out=int((~good).sum()),
        beyond_limit=int(too_steep.sum()),
        label_error=float(np.nanmedian(relative)) if np.isfinite(relative).any() else float("nan"),
        label_error_over=int((relative > 0.05).sum()),
        auc_most=most.auc,
        auc_most_below_limit=most.auc_below_limit,
        agreement=found,
    )


def _agreement(
    predictor: Floats,
    c_r: Floats,
    driven: DriveStats,
    table: NDArray[np.int64],
    held: Coverage | None,
    fail: FailAgreement | None,
) -> Agreement:
    good = driven.comparable
    return Agreement(
        spearman=spearman(predictor[good], driven.c_r[good]),
        median_error=median_error(c_r[good], driven.c_r[good]),
        median_ratio=median_ratio(c_r[good], driven.c_r[good]),
        steps=class_shift(table),
        confusion=table.tolist(),
        coverage=held,
        fail=fail,
    )


def _fail_agreement(p_fail: Floats, driven: DriveStats, too_steep: NDArray[np.bool_]) -> FailAgreement:
    share, level = driven.failed_share, ~too_steep
    return FailAgreement(
        auc=fail_auc(p_fail, share, 1 - share),
        auc_below_limit=fail_auc(p_fail[level], share[level], 1 - share[level]),
        reliability=reliability(p_fail, share),
    )


@dataclass(frozen=True, slots=True)
class VehicleOrder:
    """Agreement of the predicted order of vehicles with the driven order."""

    rating: str
    vehicles: tuple[str, ...]
    patches: int
    """Patches on which every vehicle has a comparable C_r."""
    same: float
    """Share of them with the same order; NaN without patches."""
    clear_patches: int
    """Patches on which neighbours in the driven order differ by more than two standard errors."""
    clear_same: float
    """Share of these with the same order; NaN without patches."""


def compare_order(rating: str, verdicts: Mapping[str, Verdict], driven: Mapping[str, DriveStats]) -> VehicleOrder:
    """Compare the order of two or more vehicles' C_r on the same patches; both mappings by name of the vehicle."""
    names = tuple(driven)
    good = np.all([driven[name].comparable for name in names], axis=0)
    truth, error = (np.stack([getattr(driven[name], kind)[good] for name in names]) for kind in ("c_r", "error"))
    same = same_order(np.stack([verdicts[name].c_r[good] for name in names]), truth)
    place = np.argsort(truth, axis=0)
    ranked, spread = np.take_along_axis(truth, place, 0), np.take_along_axis(error, place, 0)
    clear = np.all(np.diff(ranked, axis=0) > 2 * np.hypot(spread[1:], spread[:-1]), axis=0)
    return VehicleOrder(rating, names, int(good.sum()), _share(same), int(clear.sum()), _share(same[clear]))


def _share(right: NDArray[np.bool_]) -> float:
    return float(right.mean()) if len(right) else float("nan")
