"""The paper's Table I: whether variance, residual and C_r rise from class 0 to class 3."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bumpymap.lab.evaluate.subject import Verdict

__all__ = ["ClassRow", "ClassTable", "class_table"]

Floats = NDArray[np.float64]
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
