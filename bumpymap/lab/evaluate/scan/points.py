"""Ground and obstacles point by point, compared with the labels of the points."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CLASSES, ClassedSectors, Scan
from bumpymap.readers import LabelSet

__all__ = ["RANGE_M", "GroundScore", "ObstacleScore", "ground_score", "mean_ground", "obstacle_score", "sum_obstacles"]

RANGE_M = (4.0, 80.0)
"""Horizontal distances of the points that are judged."""
_FREE = CLASSES - 1
"""A sector of a class below this without an obstacle is called free."""


@dataclass(frozen=True, slots=True)
class GroundScore:
    """Ground points that are found in one frame."""

    frame: str
    points: int
    """Labelled points within the range."""
    precision: float
    """Share of the points found as ground that are ground, 0..1; NaN if none is found."""
    recall: float
    """Share of the ground points that are found; NaN if there are none."""
    f1: float


@dataclass(frozen=True, slots=True)
class ObstacleScore:
    """Points of obstacles that lie in sectors called free: of class 0 or 1, without an obstacle."""

    points: int
    """Points of obstacles within the range."""
    in_free: int
    in_free_low: int
    """Those of them that are not known to be higher than the vehicle."""
    in_free_class: int
    """Those in sectors of class 0 or 1, whether they have an obstacle or not."""


def _judged(scan: Scan, labels: LabelSet) -> tuple[NDArray[np.bool_], NDArray[np.uint16]]:
    """Return which points (n,) have a known label and are within the range, and all labels (n,)."""
    label = np.zeros(len(scan.points), np.uint16) if scan.label is None else scan.label
    away = np.hypot(scan.points[:, 0], scan.points[:, 1])
    return (label > 0) & labels.is_known(label) & (away >= RANGE_M[0]) & (away < RANGE_M[1]), label


def ground_score(scan: Scan, ground: NDArray[np.bool_], labels: LabelSet) -> GroundScore:
    """Compare points (n,) found as ground with the labels of a scan; points without a label are left out."""
    judged, label = _judged(scan, labels)
    truth, found = labels.is_ground(label[judged]), ground[judged]
    both, all_found, all_true = (float(part.sum()) for part in (truth & found, found, truth))
    f1 = _share(2 * both, all_found + all_true)
    return GroundScore(scan.name, int(judged.sum()), _share(both, all_found), _share(both, all_true), f1)


def _share(part: float, whole: float) -> float:
    return part / whole if whole else float("nan")


def mean_ground(scores: Sequence[GroundScore]) -> GroundScore:
    """Return the mean over the frames that have ground, of each figure."""
    known = [score for score in scores if score.points and not np.isnan(score.recall)]
    points = sum(score.points for score in known)
    if not known:
        return GroundScore("mean", points, float("nan"), float("nan"), float("nan"))
    mean = [float(np.nanmean([getattr(score, name) for score in known])) for name in ("precision", "recall", "f1")]
    return GroundScore("mean", points, *mean)


def obstacle_score(scan: Scan, classed: ClassedSectors, labels: LabelSet) -> ObstacleScore:
    """Count the points of obstacles that lie in sectors called free."""
    stack = classed.sectors
    judged, label = _judged(scan, labels)
    rows = np.flatnonzero(judged & labels.is_obstacle(label))
    smooth = classed.class_id < _FREE
    place, high = stack.point_sector[rows], stack.point_height[rows] > stack.settings.height_m
    in_class = np.append(smooth, False)[place]
    in_free = np.append(smooth & ~stack.obstacle, False)[place]
    counts = (in_free, in_free & ~high, in_class)
    return ObstacleScore(len(rows), *(int(np.count_nonzero(part)) for part in counts))


def sum_obstacles(scores: Sequence[ObstacleScore]) -> ObstacleScore:
    """Add the counts of many frames."""
    names = ("points", "in_free", "in_free_low", "in_free_class")
    return ObstacleScore(*(sum(getattr(score, name) for score in scores) for name in names))
