"""Statistics of the agreement between predictions and drives, on plain arrays.

Patches are rows. Arrays of C_r must not contain NaN; the caller drops such patches. A statistic without rows is NaN.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CostMap, PatchStack
from bumpymap.lab.simulate.drive import PatchDrives

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
CLASSES = 4
MOST_FAILED = 0.25
"""If a larger share of the drives failed, C_r is not compared, because it comes from the completed drives only."""
RISING = ("variance_median", "residual_median", "c_r_median", "variance_mean", "residual_mean")


@dataclass(frozen=True, slots=True)
class Verdict:
    """Results of one rating for n tiles, with the fields of `CostMap`."""

    class_id: NDArray[np.uint8]
    c_r: NDArray[np.float64]
    c_r_low: NDArray[np.float64]
    c_r_high: NDArray[np.float64]
    p_fail: NDArray[np.float64]
    confidence: NDArray[np.float64]

    @classmethod
    def of(cls, cost_map: CostMap) -> "Verdict":
        """Copy the fields from a cost map."""
        floats = [getattr(cost_map, f.name).astype(np.float64) for f in fields(cls)[1:]]
        return cls(cost_map.class_id, *floats)

    @classmethod
    def join(cls, parts: "Sequence[Verdict]") -> "Verdict":
        """Concatenate the tiles of several verdicts."""
        return cls(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)))

    def take(self, rows: NDArray[np.integer] | NDArray[np.bool_]) -> "Verdict":
        """Select tiles."""
        return Verdict(*(getattr(self, f.name)[rows] for f in fields(self)))


def spearman(first: Floats, second: Floats) -> float:
    """Return the rank correlation of two (n,) arrays; NaN with fewer than three rows or if one is constant."""
    from scipy.stats import rankdata

    if len(first) < 3 or np.ptp(first) == 0 or np.ptp(second) == 0:
        return math.nan
    return float(np.corrcoef(rankdata(first), rankdata(second))[0, 1])


def monotone_fit(predictor: Floats, c_r: Floats, wanted: Floats) -> Floats:
    """Predict C_r [rad/m] by the best monotone function of a predictor: isotonic regression on ln C_r.

    Fitted to ``predictor`` and ``c_r`` (n,), at least one row; evaluated at ``wanted`` (m,), linear between the rows
    and constant beyond them.
    """
    from scipy.optimize import isotonic_regression

    place, row, count = np.unique(predictor, return_inverse=True, return_counts=True)
    mean = np.bincount(row, np.log(c_r)) / count
    value: Floats = np.exp(np.interp(wanted, place, isotonic_regression(mean, weights=count.astype(np.float64)).x))
    return value


def cross_validated_fit(predictor: Floats, c_r: Floats) -> Floats:
    """Predict C_r of each patch by a monotone function fitted to nine tenths without it (cross-validation), (n,) rad/m.

    A fit that includes the patch itself would be biased towards it.
    """
    part = np.arange(len(c_r)) % 10
    fitted = np.empty(len(c_r))
    for number in np.unique(part):
        own = part == number
        rest = ~own if not own.all() else own
        fitted[own] = monotone_fit(predictor[rest], c_r[rest], predictor[own])
    return fitted


def driven_class(c_r: Floats, failed_share: Floats, limits: tuple[float, ...]) -> Ints:
    """Return the class of each patch by its drives: that of the mean C_r, or the last one if half of them failed.

    ``c_r`` (n,) is the mean over the completed drives, rad/m, NaN if there are none; ``limits`` lie between the
    classes.
    """
    class_id = np.searchsorted(np.array(limits), c_r, side="right")
    return np.where((failed_share >= 0.5) | np.isnan(c_r), len(limits), class_id).astype(np.int64)


def confusion(driven: Ints, predicted: Ints, classes: int) -> Ints:
    """Return the confusion matrix (classes, classes): number of patches by ``[driven][predicted]`` class."""
    table = np.zeros((classes, classes), np.int64)
    np.add.at(table, (driven, predicted), 1)
    return table


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Agreement of classes with labels."""

    confusion: list[list[int]]
    """``[true class][predicted class]``, number of sectors or patches."""
    right: float
    """Accuracy; NaN without labels."""
    even: float
    """Balanced accuracy over the classes that occur; NaN without labels."""
    recall: list[float]
    """Share of each class that is found, 0..1; NaN for a class that does not occur."""

    @property
    def count(self) -> int:
        """Number of sectors or patches."""
        return sum(map(sum, self.confusion))


def accuracy_of(truth: NDArray[np.integer], answer: NDArray[np.integer], classes: int) -> Accuracy:
    """Compare answers (n,) with the truth (n,) where it is known: 0 or above."""
    known = truth >= 0
    counts = confusion(truth[known].astype(np.int64), answer[known].astype(np.int64), classes)
    totals = counts.sum(axis=1)
    there = totals > 0
    recall = np.divide(np.diag(counts), totals, out=np.full(classes, np.nan), where=there)
    right = float(np.trace(counts) / totals.sum()) if there.any() else math.nan
    even = float(recall[there].mean()) if there.any() else math.nan
    return Accuracy(counts.tolist(), right, even, recall.tolist())


def class_shift(table: Ints) -> dict[str, float]:
    """Return the shares of the patches of a confusion matrix whose class is the same, one off, and further off."""
    away = np.abs(np.subtract.outer(np.arange(len(table)), np.arange(len(table))))
    apart = {"same": away == 0, "one_off": away == 1, "further": away > 1}
    return {name: float(table[there].sum() / table.sum()) if table.sum() else math.nan for name, there in apart.items()}


def coverage(low: Floats, high: Floats, driven: Floats) -> dict[str, float]:
    """Return the shares of the driven means (n,) inside (``held``), below and above the intervals (n,)."""
    below, above = driven < low, driven > high
    parts = {"held": ~below & ~above, "below": below, "above": above}
    return {name: float(part.mean()) if len(part) else math.nan for name, part in parts.items()}


def fail_auc(p_fail: Floats, failed: Floats, completed: Floats) -> float:
    """Return the probability that a failed drive was on ground of higher ``p_fail`` than a completed one: the ROC area.

    Ties count half. ``failed`` and ``completed`` (n,) are numbers of drives, or their shares, to weight all patches
    equally. NaN if no drive failed or all did.
    """
    pairs = float(failed.sum()) * float(completed.sum())
    if pairs == 0:
        return math.nan
    values, row = np.unique(p_fail, return_inverse=True)
    bad, good = (np.bincount(row, drives, len(values)) for drives in (failed, completed))
    safer = np.cumsum(good) - good
    return float(np.sum(bad * (safer + good / 2)) / pairs)


def reliability(p_fail: Floats, failed_share: Floats) -> list[dict[str, float]]:
    """Return mean ``predicted`` p_fail, mean ``share_failed`` and number of ``patches`` in fifths of p_fail, 0 to 1."""
    place = np.minimum((p_fail * 5).astype(np.int64), 4)
    found = []
    for number in range(5):
        own = place == number
        predicted, driven = (float(v[own].mean()) if own.any() else math.nan for v in (p_fail, failed_share))
        found.append({"predicted": predicted, "share_failed": driven, "patches": int(own.sum())})
    return found


@dataclass(frozen=True, slots=True)
class DriveStats:
    """Statistics of the drives over n patches."""

    c_r: Floats
    """(n,) mean C_r over the completed drives, rad/m; NaN if there are none."""
    error: Floats
    """(n,) standard error of that mean, rad/m; NaN with fewer than two."""
    completed: Ints
    """(n,) number of completed drives."""
    failed: Ints
    """(n,) number of failed drives."""

    @classmethod
    def of(cls, drives: Sequence[PatchDrives]) -> "DriveStats":
        """Summarise the drives of each patch."""
        return cls(
            np.array([patch.mean_c_r for patch in drives], np.float64),
            np.array([patch.standard_error for patch in drives], np.float64),
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


def class_table(verdict: Verdict, z_variance: Floats, ransac_residual: Floats) -> dict[str, Any]:
    """Return the paper's Table I of classified tiles (n,).

    ``rows`` has for each class ``class_id``, ``tiles``, ``share`` of the tiles, mean and median of variance [m2] and of
    residual [m], and median C_r [rad/m]; ``rises`` says of each of ``RISING`` whether it rises from class to class,
    skipping classes without tiles.
    """
    rows: list[dict[str, Any]] = []
    for class_id in range(CLASSES):
        own = verdict.class_id == class_id
        row: dict[str, Any] = {"class_id": class_id, "tiles": int(own.sum()), "share": float(own.mean())}
        for name, values in (("variance", z_variance[own]), ("residual", ransac_residual[own])):
            row |= {f"{name}_mean": _known(np.mean, values), f"{name}_median": _known(np.median, values)}
        rows.append(row | {"c_r_median": _known(np.median, verdict.c_r[own])})
    present = [row for row in rows if row["tiles"]]
    return {"rows": rows, "rises": {name: all(a[name] < b[name] for a, b in pairwise(present)) for name in RISING}}


def _known(summary: Callable[[Floats], np.floating], values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(summary(known)) if len(known) else math.nan


@dataclass(frozen=True, slots=True)
class Agreement:
    """Agreement of one predictor with the drives."""

    spearman: float
    median_error: float
    """Median of abs(predicted - driven) / driven."""
    median_ratio: float
    """Median of predicted / driven; above 1, the prediction is too high."""
    steps: dict[str, float]
    """`class_shift` of the confusion matrix."""
    confusion: list[list[int]]
    """``[driven class][predicted class]``, patches within the vehicle's slope limit."""
    coverage: dict[str, float] | None = None
    """`coverage` of the 80 % interval; None without an interval."""
    fail: dict[str, Any] | None = None
    """Of p_fail: ``auc``, ``auc_below_limit`` (within the slope limit, beyond which p_fail is 1 by definition) and
    `reliability`; None if the predictor has no p_fail. All patches have the same weight."""


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
    agreement: dict[str, Agreement] = field(default_factory=dict)
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
    good, level, share = driven.comparable, ~too_steep, driven.failed_share
    class_id, truth = driven_class(driven.c_r, share, limits)[level], driven.c_r[good]

    def agreement(predictor: Floats, c_r: Floats, predicted_class: NDArray[np.integer], **more: Any) -> Agreement:
        table = confusion(class_id, predicted_class.astype(np.int64), CLASSES)
        error, ratio = np.abs(c_r[good] - truth) / truth, c_r[good] / truth
        middle, off = (float(np.median(values)) if len(values) else math.nan for values in (error, ratio))
        return Agreement(spearman(predictor[good], truth), middle, off, class_shift(table), table.tolist(), **more)

    def fail(p_fail: Floats) -> dict[str, Any]:
        return {
            "auc": fail_auc(p_fail, share, 1 - share),
            "auc_below_limit": fail_auc(p_fail[level], share[level], 1 - share[level]),
            "reliability": reliability(p_fail, share),
        }

    found = {}
    for name, own in verdicts.items():
        held = coverage(own.c_r_low[good], own.c_r_high[good], truth)
        found[name] = agreement(own.c_r, own.c_r, own.class_id[level], coverage=held, fail=fail(own.p_fail))
    for name, predictor in plain.items() if good.any() else ():
        fitted = monotone_fit(predictor[good], truth, predictor)
        fitted[good] = cross_validated_fit(predictor[good], truth)
        predicted = np.searchsorted(np.array(limits), fitted[level], side="right")
        found[name] = agreement(predictor, fitted, predicted)
    relative, most = driven.error[good] / truth, fail(share)
    return Comparison(
        patches=len(good),
        drives=int((driven.completed + driven.failed).sum()),
        failed=int(driven.failed.sum()),
        left_out=int((~good).sum()),
        beyond_limit=int(too_steep.sum()),
        label_error=float(np.nanmedian(relative)) if np.isfinite(relative).any() else math.nan,
        label_error_over=int((relative > 0.05).sum()),
        auc_most=most["auc"],
        auc_most_below_limit=most["auc_below_limit"],
        agreement=found,
    )
