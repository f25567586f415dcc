"""Counts and medians of a map, computed in one pass over its tiles."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CLASS_NAMES, NO_CLASS, PASSABLE_COLUMNS, REASON_TEXT, CostTable, Reason

__all__ = ["MapSummary", "summarise"]

STRIP = 65_536
_BINS = 1 << 16
_STEPS = {"c_r": 1 / 8192, "slope": 1 / 512}
"""Width of a histogram bin, rad/m and degrees: an eighth of the last printed digit, up to 8 rad/m and 128 degrees."""


@dataclass(frozen=True, slots=True)
class MapSummary:
    """Numbers of tiles by class and reason, and medians.

    Medians come from histograms, so that memory does not grow with the map: those of c_r are accurate to 0.0001 rad/m,
    those of slope to 0.001 degrees; that of the point count is exact up to 65,534.
    """

    tiles: int
    """Number of tiles."""
    points: int
    """Points that were measured."""
    by_class: tuple[int, ...]
    """(4,) tiles of each class."""
    by_reason: tuple[int, ...]
    """(6,) tiles without a class, for each ``Reason``."""
    passable: int
    """Passable tiles."""
    median_c_r: tuple[float, ...]
    """(5,) rad/m, for each class, then for tiles without a class; NaN if there is no value."""
    median_slope: tuple[float, ...]
    """(5,) degrees, likewise."""
    median_count: float
    """Points per tile."""

    @classmethod
    def of(cls, counts: Mapping[str, Any]) -> Self:
        """Read the entry ``counts`` of run.json; missing medians become NaN."""
        medians = {
            name: tuple(math.nan if value is None else value for value in counts.get(name, [None] * 5))
            for name in ("median_c_r", "median_slope")
        }
        count = counts.get("median_count")
        return cls(
            tiles=counts["tiles"],
            points=counts["points"],
            by_class=tuple(counts["by_class"][name] for name in CLASS_NAMES),
            by_reason=tuple(counts["by_reason"].get(REASON_TEXT[code], 0) for code in Reason),
            passable=counts["passable"],
            median_count=math.nan if count is None else count,
            **medians,
        )

    @property
    def unknown(self) -> int:
        """Tiles without a class."""
        return self.tiles - sum(self.by_class)

    @property
    def classes(self) -> dict[str, int]:
        """Tiles of each class, by its name."""
        return dict(zip(CLASS_NAMES, self.by_class, strict=True))

    @property
    def reasons(self) -> dict[str, int]:
        """Tiles without a class, by the description of the reason; only reasons that occur."""
        return {REASON_TEXT[code]: self.by_reason[code] for code in Reason if self.by_reason[code]}


def summarise(table: CostTable) -> MapSummary:
    """Count the tiles of a map and find the medians."""
    groups = len(CLASS_NAMES) + 1
    spread = {name: np.zeros((groups, _BINS), dtype=np.int64) for name in _STEPS}
    counts = np.zeros((1, _BINS), dtype=np.int64)
    reasons = np.zeros(len(Reason), dtype=np.int64)
    classes = np.zeros(groups, dtype=np.int64)
    points = passable = 0
    for strip in table.tiles.strips(STRIP):
        found = table.tiles.read((*PASSABLE_COLUMNS, "reason", "count", *_STEPS), strip)
        passable += int(table.rule.passable(found).sum())
        group = np.where(found["class_id"] == NO_CLASS, groups - 1, found["class_id"]).astype(np.int64)
        classes += np.bincount(group, minlength=groups)
        reasons += np.bincount(found["reason"][group == groups - 1], minlength=len(Reason))
        points += int(found["count"].sum())
        _count(counts, np.zeros_like(group), found["count"].astype(np.float64))
        for name, step in _STEPS.items():
            _count(spread[name], group, found[name] / step)
    c_r, slope = (tuple((_median(row) + 0.5) * step for row in spread[name]) for name, step in _STEPS.items())
    return MapSummary(
        tiles=int(classes.sum()),
        points=points,
        by_class=tuple(classes[:-1].tolist()),
        by_reason=tuple(reasons.tolist()),
        passable=passable,
        median_c_r=c_r,
        median_slope=slope,
        median_count=_median(counts[0]),
    )


def _count(histogram: NDArray[np.int64], group: NDArray[np.int64], value: NDArray[np.floating]) -> None:
    """Add values, in units of bins, to the histogram of their group; the last bin takes those beyond it."""
    known = np.isfinite(value)
    places = group[known] * _BINS + np.minimum(value[known], _BINS - 1).astype(np.int64)
    where, how_many = np.unique(places, return_counts=True)
    histogram.reshape(-1)[where] += how_many


def _median(histogram: NDArray[np.int64]) -> float:
    """Return the bin of the median, the mean of two bins if the count is even; NaN if the histogram is empty."""
    total = np.cumsum(histogram)
    if total[-1] == 0:
        return float("nan")
    middle = np.searchsorted(total, [(total[-1] - 1) // 2, total[-1] // 2], side="right")
    return float(middle.mean())
