"""Classes against labels."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


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
    """Compare answers (n,) with the truth (n,) where it is known: 0 or above.

    By numpy: `bumpymap evaluate` runs with the default install, where scikit-learn is not, and is no shorter with its
    ``confusion_matrix`` and ``recall_score``, as these refuse to count where nothing is labelled.
    """
    known = truth >= 0
    place = truth[known].astype(np.int64) * classes + answer[known]
    counts = np.bincount(place, minlength=classes**2).reshape(classes, classes)
    totals = counts.sum(axis=1)
    there = totals > 0
    recall = np.divide(np.diag(counts), totals, out=np.full(classes, np.nan), where=there)
    right = float(np.trace(counts) / totals.sum()) if there.any() else math.nan
    even = float(recall[there].mean()) if there.any() else math.nan
    return Accuracy(counts.tolist(), right, even, recall.tolist())
