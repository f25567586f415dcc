"""Rotate scans to test whether the class of the ground depends on the robot's heading."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from bumpymap.core import ClassedSectors, Scan, point_classes

__all__ = ["kept_share", "turn_scan"]


def turn_scan(scan: Scan, angle: float) -> Scan:
    """Rotate a scan about z by ``angle`` radians, counter-clockwise."""
    cos, sin = math.cos(angle), math.sin(angle)
    about_z = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return replace(scan, points=(scan.points.astype(np.float64) @ about_z.T).astype(np.float32))


def kept_share(scan: Scan, classify: Callable[[Scan], ClassedSectors], angles: Sequence[float]) -> float:
    """Return the share of points that keep their class in rotated scans, mean over the angles; NaN without points."""
    if not len(scan.points):
        return float("nan")
    still = point_classes(scan, classify(scan))
    shares = []
    for angle in angles:
        other = turn_scan(scan, angle)
        shares.append(float(np.mean(point_classes(other, classify(other)) == still)))
    return float(np.mean(shares))
