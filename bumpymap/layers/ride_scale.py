"""The colours of the ride cost in pictures and styles: those of the classes, running into one another."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CLASS_NAMES
from bumpymap.layers.colours import CLASS_COLOURS

__all__ = ["OR_FAILS", "RideScale", "class_limits", "class_ranges", "nice_limit"]

OR_FAILS = ", or too steep, or drives fail"
"""Follows the limit of class 3: what else puts ground there."""

_CLASSES = len(CLASS_NAMES)
_ANCHORS = np.array([CLASS_COLOURS[number][:3] for number in range(_CLASSES)], np.float64)
_TINT = 0.82
"""Opacity of the colours over white."""


@dataclass(frozen=True, slots=True)
class RideScale:
    """Which ride cost has the colour of which class."""

    anchors: tuple[float, ...]
    """(4,) rising, rad/m: where each class has its own colour."""

    @classmethod
    def of(cls, manifest: Mapping[str, Any], c_r: NDArray[np.floating]) -> "RideScale":
        """Return the scale with the limits of the classes, so that pictures for one vehicle can be compared.

        A class has its own colour in the middle of its interval. If the manifest of the map has no limits, the scale
        ends at a round number that few values of ``c_r`` exceed.
        """
        limits = class_limits(manifest)
        if limits is None:
            return cls(tuple(np.linspace(0.0, nice_limit(c_r), _CLASSES).tolist()))
        edges = [0.0, *limits, 2 * limits[-1] - limits[-2]]
        return cls(tuple((low + high) / 2 for low, high in pairwise(edges)))

    @property
    def end(self) -> float:
        """Ride cost of the last colour, rad/m; what is rougher has it too."""
        return self.anchors[-1]

    def colours(self, c_r: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return colours, (..., 3) from 0 to 255, of ride costs in rad/m; NaN as 0."""
        known = np.nan_to_num(c_r)
        mixed = np.stack([np.interp(known, self.anchors, channel) for channel in _ANCHORS.T], axis=-1)
        return np.asarray(255.0 + _TINT * (mixed - 255.0), dtype=np.float64)


def nice_limit(c_r: NDArray[np.floating]) -> float:
    """Return 1, 2, 3 or 5 times a power of ten that is not below 95 % of the values, rad/m; 0.1 without values."""
    known = c_r[np.isfinite(c_r)]
    most = float(np.quantile(known, 0.95)) if len(known) else 0.1
    if not most > 1e-6:
        return 0.1
    power = 10.0 ** np.floor(np.log10(most))
    return float(next(step * power for step in (1, 2, 3, 5, 10) if step * power >= most))


def class_limits(manifest: Mapping[str, Any]) -> list[float] | None:
    """Return the three limits of the classes, rad/m, if a manifest has them."""
    calibration = manifest.get("calibration")
    found = calibration.get("class_limits") if isinstance(calibration, Mapping) else None
    if not isinstance(found, list | tuple) or len(found) != _CLASSES - 1:
        return None
    if not all(isinstance(limit, int | float) for limit in found):
        return None
    limits = [0.0, *map(float, found)]
    return limits[1:] if all(low < high < np.inf for low, high in pairwise(limits)) else None


def class_ranges(manifest: Mapping[str, Any]) -> tuple[str, ...]:
    """Return in words what is in each class, C_r in rad/m; nothing if C_r does not decide or there are no limits."""
    settings, limits = manifest.get("settings"), class_limits(manifest)
    if limits is None or (isinstance(settings, Mapping) and settings.get("compat") == "paper"):
        return ()
    first, *_, last = texts = [f"{limit:.3g}" for limit in limits]
    between = [f"{low} to {high}" for low, high in pairwise(texts)]
    return (f"under {first}", *between, f"{last} and more{OR_FAILS}")
