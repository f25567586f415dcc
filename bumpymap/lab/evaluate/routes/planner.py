"""The planner of `bumpymap.route` for an evaluation."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import RouteVehicle
from bumpymap.route import find_way

__all__ = ["RoutePlanner"]

_BESIDE_M = 0.1
"""Room between vehicle and closed tiles, m: as between vehicle and obstacles where tiles are judged passable."""
_MOST_MARGIN = 0.45
"""Largest margin, tiles: a way through a corridor of one tile must stay possible."""


@dataclass(frozen=True, slots=True)
class RoutePlanner:
    """Plans the cheapest way; a `Planner`."""

    margin: float
    """Distance that a way keeps from closed tiles, tiles."""

    @classmethod
    def of(cls, vehicle: RouteVehicle, tile_size: float) -> "RoutePlanner":
        """Return the planner of a vehicle: ways keep half its width and 0.1 m from closed tiles."""
        return cls(min((vehicle.width_m / 2 + _BESIDE_M) / tile_size, _MOST_MARGIN))

    def __call__(
        self, cost: NDArray[np.float64], start: NDArray[np.float64], goal: NDArray[np.float64]
    ) -> NDArray[np.float64] | None:
        """Plan a way; see `Planner`."""
        ends = [(float(place[0]), float(place[1])) for place in (start, goal)]
        way = find_way(cost.astype(np.float32), *ends, margin=self.margin)
        return None if way is None else way.line
