"""Confusion matrix and accuracy of a network."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Score", "count_answers", "percent", "score_table"]


@dataclass(frozen=True, slots=True)
class Score:
    """Confusion matrix of a network."""

    confusion: tuple[tuple[int, ...], ...]
    """``[true class][predicted class]``, number of patches."""

    @property
    def count(self) -> int:
        """Number of patches."""
        return sum(sum(line) for line in self.confusion)

    @property
    def accuracy(self) -> float:
        """Share of right answers, 0..1."""
        return sum(line[i] for i, line in enumerate(self.confusion)) / self.count

    @property
    def balanced_accuracy(self) -> float:
        """Balanced accuracy: mean of the share of right answers over the classes that occur, 0..1."""
        shares = [line[i] / sum(line) for i, line in enumerate(self.confusion) if sum(line)]
        return sum(shares) / len(shares)


def count_answers(truth: NDArray[np.integer[Any]], answer: NDArray[np.integer[Any]], classes: int) -> Score:
    """Make the confusion matrix of classes (n,), 0..classes - 1."""
    counts = np.bincount(truth * classes + answer, minlength=classes * classes).reshape(classes, classes)
    return Score(tuple(tuple(int(n) for n in line) for line in counts))


def percent(share: float) -> str:
    """Format a share of 0..1 as per cent, for a model card."""
    return f"{100 * share:.2f} %"


def score_table(score: Score, names: Sequence[str]) -> str:
    """Return the confusion matrix as a Markdown table; ``names`` of the classes, in order."""
    head = ["| true \\ predicted | " + " | ".join(names) + " |", "|---" * (len(names) + 1) + "|"]
    lines = zip(names, score.confusion, strict=True)
    return "\n".join([*head, *(f"| {name} | " + " | ".join(map(str, line)) + " |" for name, line in lines)])
