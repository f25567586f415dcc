"""Compute the outlines of sectors."""

import math

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import PolarSettings, SectorStack, sector_bounds

__all__ = ["outlines"]

_MAX_DEVIATION_M = 0.01
"""Largest distance between an arc and the line segments that approximate it."""


def outlines(stack: SectorStack) -> list[NDArray[np.float64]]:
    """Return the outline of each sector: (k, 2) x and y, m, counter-clockwise, last vertex equal to the first.

    Adjacent sectors of a zone share their vertices.
    """
    bounds = sector_bounds(stack)
    steps = _steps(stack.settings)
    found = []
    for zone, near, far, right, left in zip(
        stack.zone.tolist(), bounds.near, bounds.far, bounds.right, bounds.left, strict=True
    ):
        azimuth = np.linspace(right, left, steps[zone] + 1)
        arc = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
        inner = near * arc[::-1] if near > 0.0 else np.zeros((1, 2))
        found.append(np.concatenate([far * arc, inner, far * arc[:1]]))
    return found


def _steps(settings: PolarSettings) -> list[int]:
    """Return the number of line segments per arc in each zone."""
    ends = [*settings.zone_starts_m[1:], settings.end_m]
    pairs = zip(ends, settings.sectors, strict=True)
    return [math.ceil(math.pi / sectors / math.acos(max(1.0 - _MAX_DEVIATION_M / end, -1.0))) for end, sectors in pairs]
