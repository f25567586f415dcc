"""A logarithmic axis for ride costs."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["LogAxis"]

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
