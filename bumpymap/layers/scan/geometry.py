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
    found: list[NDArray[np.float64]] = []
    for zone, steps in enumerate(_steps(stack.settings)):
        here = stack.zone == zone
        azimuth = np.linspace(bounds.right[here], bounds.left[here], steps + 1, axis=1)
        arc = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=2)
        near, far = bounds.near[here][:, None, None], bounds.far[here][:, None, None]
        outline = np.concatenate([far * arc, near * arc[:, ::-1], far * arc[:, :1]], axis=1)
        # A sector that starts at the sensor has one vertex there.
        tip = np.r_[: steps + 2, 2 * steps + 2]
        found += [one if start > 0.0 else one[tip] for one, start in zip(outline, bounds.near[here], strict=True)]
    return found


def _steps(settings: PolarSettings) -> list[int]:
    """Return the number of line segments per arc in each zone."""
    ends = [*settings.zone_starts_m[1:], settings.end_m]
    pairs = zip(ends, settings.sectors, strict=True)
    return [math.ceil(math.pi / sectors / math.acos(max(1.0 - _MAX_DEVIATION_M / end, -1.0))) for end, sectors in pairs]
