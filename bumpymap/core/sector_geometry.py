"""Polar bounds of the sectors of a scan."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.core.scan_types import SectorStack

__all__ = ["SectorBounds", "sector_bounds"]


@dataclass(frozen=True, slots=True)
class SectorBounds:
    """Distance and azimuth ranges of sectors."""

    near: NDArray[np.float64]
    """(n,) inner horizontal distance from the sensor, m."""
    far: NDArray[np.float64]
    """(n,) outer distance, m."""
    right: NDArray[np.float64]
    """(n,) azimuth at which the sector starts, counter-clockwise from the x axis, 0 to 2 pi, rad."""
    left: NDArray[np.float64]
    """(n,) azimuth at which it ends, greater than ``right``, rad."""


def sector_bounds(stack: SectorStack) -> SectorBounds:
    """Return the bounds of the sectors of a stack."""
    settings = stack.settings
    edges = np.array([*settings.zone_starts_m, settings.end_m])
    depth = np.diff(edges) / settings.rings
    width = 2.0 * math.pi / np.array(settings.sectors)
    near = edges[stack.zone] + stack.ring * depth[stack.zone]
    right = (stack.azimuth_start_rad + stack.sector * width[stack.zone]) % (2.0 * math.pi)
    return SectorBounds(near, near + depth[stack.zone], right, right + width[stack.zone])
