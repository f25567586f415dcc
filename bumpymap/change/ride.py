"""How far two ride costs differ, in units of what their intervals leave open apart from what both have in common."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

__all__ = ["CommonError", "ride_z"]

_TAIL = float(ndtri(0.9))
"""Half the width of an 80 % interval, in standard deviations."""
_LEAST_OWN = 0.5
"""Least share of a spread that is the survey's own."""

Floats = NDArray[np.float64]
Bands = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]


@dataclass(frozen=True, slots=True)
class CommonError:
    """What two maps with one calibration have wrong in the same way: it changes no ride cost between them."""

    model_error: float = 0.0
    """Standard deviation of ln C_r by which the ride model may be off; 0 of maps whose intervals do not hold it."""
    floor: float = 0.0
    """What even ground costs the vehicle, rad/m: it is in ``c_r`` in power, but not in the model."""

    @classmethod
    def of(cls, manifest: Mapping[str, Any]) -> "CommonError":
        """Read what run.json says of the calibration; of earlier versions it says nothing."""
        known = manifest.get("calibration")
        found = known if isinstance(known, Mapping) else {}
        return cls(*(_number(found.get(name)) for name in ("model_error", "floor_radpm")))

    def log_sd(self, c_r: Floats) -> Floats:
        """Return its standard deviation in ln c_r, of ride costs [rad/m] of any shape."""
        of_ground = np.clip(1.0 - (self.floor / c_r) ** 2, 0.0, 1.0) if self.floor else np.ones_like(c_r)
        return self.model_error * of_ground


def ride_z(before: Bands, after: Bands, common: CommonError | None = None) -> Floats:
    """Return the difference of ln c_r over its combined spread; the spreads are those of the 80 % intervals of ln c_r.

    Parameters
    ----------
    before, after : three arrays each, of one shape
        ``c_r``, ``c_r_low`` and ``c_r_high``, rad/m.
    common : CommonError, optional
        Taken off both spreads.

    Returns
    -------
    float64 array of that shape
        NaN where one of the two is unknown or not positive.
    """
    shared = common or CommonError()
    with np.errstate(divide="ignore", invalid="ignore"):
        (first, of_first), (second, of_second) = (_log_and_spread(bands, shared) for bands in (before, after))
        z = (second - first) / np.hypot(of_first, of_second)
    return np.where(np.isfinite(z), z, np.nan)


def _log_and_spread(bands: Bands, common: CommonError) -> tuple[Floats, Floats]:
    """Return ln c_r and the standard deviation of the survey's own error in it, the mean of both sides."""
    c_r, low, high = (band.astype(np.float64) for band in bands)
    middle = np.log(c_r)
    shared = common.log_sd(c_r)
    sides = ((middle - np.log(low)) / _TAIL, (np.log(high) - middle) / _TAIL)
    below, above = (np.sqrt(np.maximum(side**2 - shared**2, (_LEAST_OWN * side) ** 2)) for side in sides)
    return middle, 0.5 * (below + above)


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) and 0.0 <= value < np.inf else 0.0
