"""The planner of routes, as the evaluation asks it."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bumpymap.route import CostSettings, Planner

if TYPE_CHECKING:
    from bumpymap.layers import RouteMap

__all__ = ["RoutePlanner"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class RoutePlanner:
    """Plans the cheapest way as ``bumpymap route`` does; a `PlanWay`."""

    planner: Planner

    @classmethod
    def of(cls, route_map: "RouteMap") -> "RoutePlanner":
        """Return the planner of a map, with the settings of its vehicle."""
        return cls(Planner(route_map, CostSettings(), route_map.window.cols * route_map.window.rows))

    def __call__(self, start: Floats, goal: Floats) -> Floats | None:
        """Plan a way; see `PlanWay`. None too if the vehicle does not fit where it begins or ends."""
        window = self.planner.site.window
        ends = np.array([self.planner.at(place, window) for place in (start, goal)])
        line = self.planner.line(*ends)
        if line is None:
            return None
        placed = np.array([self.planner.place(corner, window) for corner in line])
        placed[0], placed[-1] = start, goal
        return placed
