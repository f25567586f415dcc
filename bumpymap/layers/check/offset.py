"""How far a map is off a drive on a stretch or a tile: the ratio, its kind (and colour), whether errors explain it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import DrivenStretches, DrivenTiles
from bumpymap.layers.colours import OFF_COLOURS

__all__ = ["NOT_COMPARED", "OFF_KINDS", "MapOffset"]

_EDGES = np.array([1 / 2, 1 / 1.5, 1 / 1.2, 1.2, 1.5, 2.0])
OFF_KINDS = (
    "map over 2 times too low",
    "map 1.5 to 2 times too low",
    "map 1.2 to 1.5 times too low",
    "map within a factor of 1.2",
    "map 1.2 to 1.5 times too high",
    "map 1.5 to 2 times too high",
    "map over 2 times too high",
    "not compared",
)
"""What each code of ``MapOffset.kind`` means, from too smooth to too rough."""
NOT_COMPARED = len(OFF_KINDS) - 1
_NORMAL_80 = 1.2816
"""Half width of the 80 % interval of a normal variable, in standard deviations."""
if set(OFF_COLOURS) != set(range(len(OFF_KINDS))):
    raise ValueError("every kind has a colour")


@dataclass(frozen=True, slots=True)
class MapOffset:
    """How far the map is off on some stretches or tiles; (n,) each."""

    ratio: NDArray[np.float64]
    """C_r of the map / measured; NaN where one is not known, or nothing was measured above the sensor's floor."""
    kind: NDArray[np.uint8]
    """Code of ``OFF_KINDS``."""
    beyond: NDArray[np.float64]
    """abs(ln ratio) over half the width of the interval that errors explain: above 1, they do not. NaN as ``ratio``."""

    @classmethod
    def of(cls, driven: DrivenStretches | DrivenTiles) -> "MapOffset":
        """Compare.

        Errors: the map's 80 % interval on the side of the measurement, widened to 80 % of the errors of measurement
        and place, all in logarithms and added in power.
        """
        known = (driven.measured > 0.0) & (driven.c_r > 0.0)
        measured, c_r = (np.where(known, values, np.nan) for values in (driven.measured, driven.c_r))
        ratio = c_r / measured
        kind = np.where(known, np.digitize(ratio, _EDGES), NOT_COMPARED).astype(np.uint8)
        side = np.where(ratio < 1.0, driven.c_r_high / c_r, c_r / driven.c_r_low)
        with np.errstate(invalid="ignore", divide="ignore"):
            own = np.nan_to_num(np.log(side), posinf=0.0, neginf=0.0) / _NORMAL_80
            place = np.nan_to_num(getattr(driven, "place_sd", np.zeros(len(ratio))) / c_r)
            spread = _NORMAL_80 * np.sqrt(own**2 + place**2 + np.nan_to_num(driven.measured_sd / measured) ** 2)
            beyond = np.where(spread > 0.0, np.abs(np.log(ratio)) / spread, np.inf)
        return cls(ratio, kind, np.where(known, beyond, np.nan))

    @property
    def is_off(self) -> NDArray[np.bool_]:
        """Where errors do not explain the difference."""
        return np.asarray(self.beyond > 1.0, dtype=np.bool_)
