"""How far a map is off a drive on a stretch or a tile: the ratio, its kind (and colour), whether errors explain it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import DrivenStretches, DrivenTiles
from bumpymap.layers.colours import OFF_COLOURS

__all__ = ["NOT_COMPARED", "OFF_KINDS", "LogAxis", "MapOffset"]

_STEPS = (1, 2, 5)
_ROOM = 1.15
"""Factor between the outermost value and the end of the axis."""
_LEAST_SPAN = 4.0
"""Least ratio of the ends."""


@dataclass(frozen=True, slots=True)
class LogAxis:
    """From a lowest to a highest value, both above 0."""

    low: float
    high: float

    @classmethod
    def around(cls, values: NDArray[np.float64]) -> "LogAxis":
        """Return an axis with room for values above 0, at least one."""
        low, high = float(values.min()) / _ROOM, float(values.max()) * _ROOM
        wider = float(max(1.0, np.sqrt(_LEAST_SPAN * low / high)))
        return cls(low / wider, high * wider)

    def part(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where values lie, 0 at the lower end to 1 at the upper; those beyond are at the ends."""
        share = np.log(np.clip(values, self.low, self.high) / self.low) / np.log(self.high / self.low)
        return np.asarray(share, dtype=np.float64)

    @property
    def ticks(self) -> list[float]:
        """1, 2 and 5 times powers of ten."""
        powers = range(int(np.floor(np.log10(self.low))), int(np.ceil(np.log10(self.high))) + 1)
        found = [float(f"{step}e{power}") for power in powers for step in _STEPS]
        return [value for value in found if self.low <= value <= self.high]


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
_NORMAL_80 = 1.2815515655446004
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
    """Difference of map and drive over the largest that errors explain; above 1, they do not. NaN as ``ratio``."""

    @classmethod
    def of(cls, driven: DrivenStretches | DrivenTiles) -> "MapOffset":
        """Compare.

        Errors explain a measurement in the map's 80 % interval, of which each end has been moved outwards, in
        quadrature, by 80 % of the errors of measurement and place: as `MapAgreement.inside` counts.
        """
        known = (driven.measured > 0.0) & (driven.c_r > 0.0)
        measured, c_r = (np.where(known, values, np.nan) for values in (driven.measured, driven.c_r))
        ratio = c_r / measured
        kind = np.where(known, np.digitize(ratio, _EDGES), NOT_COMPARED).astype(np.uint8)
        side = np.where(measured > c_r, driven.c_r_high - c_r, c_r - driven.c_r_low)
        place = np.nan_to_num(getattr(driven, "place_sd", np.zeros(len(ratio))))
        error = _NORMAL_80 * np.hypot(np.nan_to_num(driven.measured_sd), place)
        most = np.hypot(np.nan_to_num(side, posinf=np.inf), error)
        with np.errstate(invalid="ignore", divide="ignore"):
            beyond = np.where(most > 0.0, np.abs(measured - c_r) / most, np.inf)
        return cls(ratio, kind, np.where(known, beyond, np.nan))

    @property
    def is_off(self) -> NDArray[np.bool_]:
        """Where errors do not explain the difference."""
        return np.asarray(self.beyond > 1.0, dtype=np.bool_)
