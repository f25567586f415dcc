"""Counts and medians of a map, computed in one pass over its tiles."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    BARRED_TEXT,
    CLASS_NAMES,
    NO_CLASS,
    REASON_TEXT,
    THIN_POINTS,
    Barred,
    CostTable,
    Reason,
)

LITTLE_SEEN = "too little seen"
"""Reason why a tile with a class is not passable: too little of it was seen to tell whether there is a way."""

_STRIP = 65_536
_OBJECT_STRIP = 4_096
"""Most tiles to read at a time with their heights."""
_OBJECTS = ("judged", "layered", "tall")
_OBJECT_HEIGHT = 0.5
"""m: what is lower may be rough ground or grass."""
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
    by_bar: tuple[int, ...]
    """(6,) tiles for each `Barred`, the passable ones first."""
    median_c_r: tuple[float, ...]
    """(5,) rad/m, for each class, then for tiles without a class; NaN if there is no value. That of class 3 is over the
    tiles that their C_r puts there, without those of ``failing``."""
    median_slope: tuple[float, ...]
    """(5,) degrees, likewise."""
    median_count: float
    """Points per tile."""
    failing: int = 0
    """Tiles of class 3 although their C_r is below its limit, because they are too steep or drives fail: their C_r is
    that of the drives that got through."""
    by_holes: int = 0
    """Tiles of class 3 because too few of their pixels hold a point, by the rule of the paper, not by what was measured
    (``compat = "paper"``)."""
    judged: int = 0
    """Tiles with at least 15 points, for the next two."""
    layered: int = 0
    """Those in which the heights inside a pixel have a standard deviation above 0.5 m: layers above one another."""
    tall: int = 0
    """Those whose points are more than 0.5 m from the RANSAC plane, on average."""

    @classmethod
    def of(cls, counts: Mapping[str, Any]) -> Self:
        """Read the entry ``counts`` of run.json; medians that are null become NaN."""
        count, *medians = (
            np.array(counts[name], np.float64).tolist() for name in ("median_count", "median_c_r", "median_slope")
        )
        return cls(
            tiles=counts["tiles"],
            points=counts["points"],
            by_class=tuple(counts["by_class"][name] for name in CLASS_NAMES),
            by_reason=tuple(counts["by_reason"].get(REASON_TEXT[code], 0) for code in Reason),
            by_bar=(counts["passable"], *(counts["barred"].get(BARRED_TEXT[code], 0) for code in Barred if code)),
            median_count=count,
            median_c_r=tuple(medians[0]),
            median_slope=tuple(medians[1]),
            failing=counts["failing"],
            by_holes=counts.get("by_holes", 0),
            **counts["objects"],
        )

    @property
    def unknown(self) -> int:
        """Tiles without a class."""
        return self.tiles - sum(self.by_class)

    @property
    def passable(self) -> int:
        """Passable tiles."""
        return self.by_bar[Barred.NO]

    @property
    def bars(self) -> dict[str, int]:
        """Tiles that are not passable, by the description of what bars them; only those that occur."""
        return {BARRED_TEXT[code]: self.by_bar[code] for code in Barred if code and self.by_bar[code]}

    @property
    def crossing(self) -> dict[str, int]:
        """All tiles by what is shown of crossing them: passable, unknown, then what bars the others, if it occurs.

        Unknown are the tiles without a class, as everywhere; those with one of which too little was seen to tell
        whether there is a way are apart.
        """
        others = {BARRED_TEXT[code]: self.by_bar[code] for code in Barred if code > Barred.UNKNOWN}
        others = {LITTLE_SEEN: self.by_bar[Barred.UNKNOWN] - self.unknown} | others
        first = {BARRED_TEXT[Barred.NO]: self.passable, BARRED_TEXT[Barred.UNKNOWN]: self.unknown}
        return first | {text: count for text, count in others.items() if count > 0}

    @property
    def classes(self) -> dict[str, int]:
        """Tiles of each class, by its name."""
        return dict(zip(CLASS_NAMES, self.by_class, strict=True))

    @property
    def reasons(self) -> dict[str, int]:
        """Tiles without a class, by the description of the reason; only reasons that occur."""
        return {REASON_TEXT[code]: self.by_reason[code] for code in Reason if self.by_reason[code]}


def summarise(table: CostTable, limits: Sequence[float] | None = None) -> MapSummary:
    """Count the tiles of a map and find the medians; ``limits`` are those between the classes, rad/m."""
    groups = len(CLASS_NAMES) + 1
    spread = {name: np.zeros((groups, _BINS), dtype=np.int64) for name in _STEPS}
    counts = np.zeros((1, _BINS), dtype=np.int64)
    reasons = np.zeros(len(Reason), dtype=np.int64)
    classes = np.zeros(groups, dtype=np.int64)
    barred = np.zeros(len(Barred), dtype=np.int64)
    points = failing = by_holes = 0
    for strip in table.tiles.strips(_STRIP):
        found = table.tiles.read(("class_id", "barred", "reason", "count", "p_fail", "confidence", *_STEPS), strip)
        barred += np.bincount(found["barred"], minlength=len(Barred))
        group = np.where(found["class_id"] == NO_CLASS, groups - 1, found["class_id"]).astype(np.int64)
        classes += np.bincount(group, minlength=groups)
        reasons += np.bincount(found["reason"][group == groups - 1], minlength=len(Reason))
        by_holes += int(((found["class_id"] != NO_CLASS) & np.isnan(found["confidence"])).sum())
        points += int(found["count"].sum())
        _count(counts, np.zeros_like(group), found["count"].astype(np.float64))
        if limits is not None:
            fails = (found["class_id"] == len(limits)) & (found["c_r"] < np.float32(limits[-1]))
            failing += int(fails.sum())
            found = {**found, "c_r": np.where(fails, np.nan, found["c_r"])}
        for name, step in _STEPS.items():
            _count(spread[name], group, found[name] / step)
    c_r, slope = (tuple((_median(row) + 0.5) * step for row in spread[name]) for name, step in _STEPS.items())
    return MapSummary(
        tiles=int(classes.sum()),
        points=points,
        by_class=tuple(classes[:-1].tolist()),
        by_reason=tuple(reasons.tolist()),
        by_bar=tuple(barred.tolist()),
        median_c_r=c_r,
        median_slope=slope,
        median_count=_median(counts[0]),
        failing=failing,
        by_holes=by_holes,
        **_count_objects(table),
    )


def _count_objects(table: CostTable) -> dict[str, int]:
    """Count the tiles in which something seems to stand on the ground, see `MapSummary`.

    The variance of z inside pixels is that over the points less that of the pixels' means.
    """
    totals = np.zeros(len(_OBJECTS), dtype=np.int64)
    for strip in table.tiles.strips(_OBJECT_STRIP):
        if (table.tiles.read(("count",), strip)["count"] < THIN_POINTS).all():
            continue
        found = table.tiles.read(("count", "z_variance", "ransac_residual", "heights"), strip)
        judged = found["count"] >= THIN_POINTS
        heights = found["heights"][judged].reshape(int(judged.sum()), -1).astype(np.float64)
        known = np.isfinite(heights)
        pixels = np.maximum(known.sum(axis=1), 1)
        mean = np.where(known, heights, 0.0).sum(axis=1) / pixels
        between = (np.where(known, heights - mean[:, None], 0.0) ** 2).sum(axis=1) / pixels
        layered = found["z_variance"][judged] - between > _OBJECT_HEIGHT**2
        tall = found["ransac_residual"][judged] > _OBJECT_HEIGHT
        totals += [judged.sum(), layered.sum(), tall.sum()]
    return dict(zip(_OBJECTS, totals.tolist(), strict=True))


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
