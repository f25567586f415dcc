"""The line that a vehicle follows, as points at even distances, and how far along it the vehicle is."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import UsageError

__all__ = ["GuideLine"]

_Floats = NDArray[np.float64]
_STEP_M = 0.05
_SEARCH_M = 3.0
"""How far ahead of its last place along the line a vehicle is looked for."""
_SMOOTH_M = 1.0
"""Length over which the normal of a line that is moved sideways is averaged."""


@dataclass(frozen=True, slots=True)
class GuideLine:
    """A line as points 5 cm apart."""

    points: _Floats
    """(n, 2) easting and northing, m."""
    step: float
    """Distance between points along the line, m."""

    @classmethod
    def along(cls, corners: _Floats, offset: float = 0.0) -> "GuideLine":
        """Make the line through corners (m, 2), in m, moved to the left by ``offset`` m.

        Raises
        ------
        UsageError
            The line has no length.
        """
        distance = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
        if not distance[-1] > 0:
            raise UsageError("the way has no length: start and goal must be different places")
        count = max(math.ceil(float(distance[-1]) / _STEP_M), 2)
        at = np.linspace(0.0, distance[-1], count + 1)
        points = np.stack([np.interp(at, distance, corners[:, axis]) for axis in (0, 1)], axis=1)
        step = float(distance[-1]) / count
        return cls(points + offset * _normals(points, step) if offset else points, step)

    @property
    def length(self) -> float:
        """Length of the line, m; of the one before it was moved sideways."""
        return self.step * (len(self.points) - 1)

    @property
    def heading(self) -> float:
        """Direction in which it starts, radians from east to north."""
        (x, y), (x_1, y_1) = self.points[:2]
        return math.atan2(y_1 - y, x_1 - x)

    def progress(self, easting: float, northing: float, before: int) -> tuple[int, float]:
        """Return the number of the nearest point from ``before`` onwards, up to 3 m ahead, and its distance, m."""
        ahead = self.points[before : before + round(_SEARCH_M / self.step)]
        squared = (ahead[:, 0] - easting) ** 2 + (ahead[:, 1] - northing) ** 2
        nearest = int(squared.argmin())
        return before + nearest, math.sqrt(float(squared[nearest]))

    def ahead(self, number: int, distance: float) -> tuple[float, float]:
        """Return the place ``distance`` m after a point; the line goes on straight beyond its end."""
        wanted = number + round(distance / self.step)
        last = len(self.points) - 1
        x, y = self.points[min(wanted, last)].tolist()
        if wanted > last:
            x_0, y_0 = self.points[last - 1].tolist()
            x, y = x + (wanted - last) * (x - x_0), y + (wanted - last) * (y - y_0)
        return x, y


def _normals(points: _Floats, step: float) -> _Floats:
    """Return the unit normals (n, 2) to the left, averaged along the line: at a corner they turn gradually."""
    from scipy.ndimage import uniform_filter1d

    forward = np.gradient(points, axis=0)
    forward = uniform_filter1d(forward, max(round(_SMOOTH_M / step), 1), axis=0, mode="nearest")
    forward /= np.maximum(np.hypot(forward[:, 0], forward[:, 1]), 1e-12)[:, None]
    return np.stack([-forward[:, 1], forward[:, 0]], axis=1)
