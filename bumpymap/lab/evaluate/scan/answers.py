"""Agreement of classes with labels, of both methods and of answers that need no method.

A method is of use only if it beats the constant answers, and a limit on the plain spread of the heights.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CLASSES, NOT_TRAVERSABLE
from bumpymap.lab.evaluate.agreement import confusion
from bumpymap.lab.evaluate.scan.class_stats import ClassedSectorTable

__all__ = ["DEVIATION", "Accuracy", "accuracy_of", "all_answers", "best_limits"]

Ints = NDArray[np.int64]
DEVIATION = "deviation of z"
"""Name of the answers from two limits on the standard deviation of z of all points of a sector."""
_ROUGHEST = CLASSES - 1
_LIMITS = 40
"""Number of limits that are tried."""


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Agreement of classes with labels."""

    confusion: list[list[int]]
    """``[class of the label][predicted class]``, number of sectors."""
    right: float
    """Accuracy; NaN without labels."""
    even: float
    """Balanced accuracy over the classes that occur; NaN without labels."""
    recall: list[float]
    """Share of the sectors of each class that are found, 0..1; NaN for a class that does not occur."""


def all_answers(table: ClassedSectorTable) -> dict[str, Ints]:
    """Return the class (n,) of every sector by each method, and by rules that need none.

    A sector without ground is answered by the roughest class, except by the constant answers.
    """
    answers = {
        method: np.where(class_id == NOT_TRAVERSABLE, _ROUGHEST, class_id).astype(np.int64)
        for method, class_id in table.class_id.items()
    }
    for number in range(CLASSES):
        answers[f"always {number}"] = np.full(len(table.truth), number, np.int64)
    known = table.traversable & (table.truth >= 0)
    limits = best_limits(table.deviation[known], table.truth[known])
    below = np.searchsorted(limits, table.deviation, side="right")
    answers[DEVIATION] = np.where(table.traversable, below, _ROUGHEST)
    return answers


def best_limits(values: NDArray[np.float64], truth: NDArray[np.int16]) -> NDArray[np.float64]:
    """Return the two limits on values (n,) whose three classes agree best with the truth (n,), in balanced accuracy.

    They are fitted to the sectors that are judged, which no method in use can do.
    """
    if not len(values):
        return np.full(2, np.inf)
    limits = np.unique(np.quantile(values, np.linspace(0, 1, _LIMITS)))
    below = np.stack([np.searchsorted(np.sort(values[truth == k]), limits) for k in range(CLASSES)])
    share = below / np.maximum(np.bincount(truth, minlength=CLASSES), 1)[:, None]
    low, high = np.triu_indices(len(limits))
    even = share[0, low] + share[1, high] - share[1, low] - share[2, high]
    best = int(np.argmax(even))
    return limits[[low[best], high[best]]]


def accuracy_of(truth: NDArray[np.integer], answer: NDArray[np.integer]) -> Accuracy:
    """Compare answers (n,) with the truth (n,) over the sectors that have one (0 or above)."""
    known = truth >= 0
    counts = confusion(truth[known].astype(np.int64), answer[known].astype(np.int64), CLASSES)
    totals = counts.sum(axis=1)
    there = totals > 0
    recall = np.divide(np.diag(counts), totals, out=np.full(CLASSES, np.nan), where=there)
    right = float(np.trace(counts) / totals.sum()) if there.any() else float("nan")
    even = float(recall[there].mean()) if there.any() else float("nan")
    return Accuracy(counts.tolist(), right, even, recall.tolist())
