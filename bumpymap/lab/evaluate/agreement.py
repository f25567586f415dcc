"""Statistics of predictions, on plain arrays: ranks, classes against labels, the paper's Table I."""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
CLASSES = 4
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

    def take(self, rows: NDArray[np.integer] | NDArray[np.bool_]) -> "Verdict":
        """Select tiles."""
        return Verdict(*(getattr(self, f.name)[rows] for f in fields(self)))


def spearman(first: Floats, second: Floats) -> float:
    """Return the rank correlation of two (n,) arrays; NaN with fewer than three rows or if one is constant."""
    from scipy.stats import rankdata

    if len(first) < 3 or np.ptp(first) == 0 or np.ptp(second) == 0:
        return math.nan
    return float(np.corrcoef(rankdata(first), rankdata(second))[0, 1])


def confusion(truth: Ints, predicted: Ints, classes: int) -> Ints:
    """Return the confusion matrix (classes, classes): number of patches by ``[true][predicted]`` class."""
    table = np.zeros((classes, classes), np.int64)
    np.add.at(table, (truth, predicted), 1)
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
