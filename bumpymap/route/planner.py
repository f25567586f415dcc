"""Plan ways over a map: costs of its tiles by window, the search, and what a way costs."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CostRule, TileField
from bumpymap.layers import RouteMap, tiles_in, tiles_within
from bumpymap.route.cost_field import TileChoice, cost_of
from bumpymap.route.growing import plan_way
from bumpymap.route.measure import MeasuredWay, measure_way
from bumpymap.route.settings import CostSettings
from bumpytiles import TileWindow

__all__ = ["PlannedWay", "Planner", "WornTiles"]

Floats = NDArray[np.float64]

_ROOM_M = 0.1
"""Room between vehicle and ground that is closed to it, m, as between vehicle and obstacle."""
_MOST_MARGIN = 0.45
"""Of a tile: wider vehicles keep to the middle of corridors of one tile."""


@dataclass(frozen=True, slots=True)
class WornTiles:
    """Tiles of earlier ways and around them, which are made dearer so that another way is found."""

    tiles: NDArray[np.int64]
    """(n, 2) column and row."""
    factor: float

    def factors(self, window: TileWindow) -> NDArray[np.float32]:
        """Return the factor on the cost of each tile of a window."""
        worn = np.zeros((window.rows + 2, window.cols + 2), np.bool_)
        row = window.row + window.rows - self.tiles[:, 1]
        col = self.tiles[:, 0] - window.col + 1
        inside = (row >= 0) & (row < worn.shape[0]) & (col >= 0) & (col < worn.shape[1])
        worn[row[inside], col[inside]] = True
        for axis in (0, 1):
            worn |= np.roll(worn, 1, axis) | np.roll(worn, -1, axis)
        return np.where(worn[1:-1, 1:-1], np.float32(self.factor), np.float32(1.0))


@dataclass(frozen=True, slots=True)
class PlannedWay:
    """A way through all stops."""

    line: Floats
    """(m, 2) easting and northing of its corners, m."""
    measured: MeasuredWay

    def shared(self, other: "PlannedWay") -> float:
        """Return the share of this way's tiles that the other crosses too, or passes beside."""
        own = np.unique(self.measured.tiles, axis=0)
        beside = np.stack(np.meshgrid((-1, 0, 1), (-1, 0, 1)), axis=-1).reshape(-1, 2)
        near = (other.measured.tiles[:, None] + beside).reshape(-1, 2)
        _both, count = np.unique(np.concatenate([own, np.unique(near, axis=0)]), axis=0, return_counts=True)
        return int((count > 1).sum()) / len(own)


@dataclass(frozen=True, slots=True)
class Planner:
    """Plans ways over one map.

    Parameters
    ----------
    site : RouteMap
        The map.
    settings : CostSettings
        What makes ground dear.
    memory_tiles : int
        Most tiles of a window that the search may hold.
    avoid, only : polygons, optional
        From `bumpymap.layers.read_areas`.
    """

    site: RouteMap
    settings: CostSettings
    memory_tiles: int
    avoid: Any = None
    only: Any = None
    _legs: dict[Any, Any] = field(default_factory=dict)

    @property
    def rule(self) -> CostRule:
        """How ride and risk become cost."""
        return self.site.rule

    @property
    def risk(self) -> float:
        """Weight of the hazard, m."""
        return self.rule.fail_weight if self.settings.risk is None else self.settings.risk

    @property
    def margin(self) -> float:
        """Distance that a way keeps from closed tiles, in tiles: half the vehicle's width and 0.1 m."""
        return min((0.5 * self.site.vehicle.width_m + _ROOM_M) / self.site.grid.tile_size, _MOST_MARGIN)

    def cost(self, tiles: TileField, risk: float | None = None) -> NDArray[np.float32]:
        """Return the cost per metre of each tile of a window, inf where closed."""
        return cost_of(
            tiles,
            risk_m=self.risk if risk is None else risk,
            robust=self.settings.robust,
            unknown_cost=self.settings.unknown,
            choice=self._choice(tiles.window),
        )

    def _choice(self, window: TileWindow) -> TileChoice | None:
        """Return the tiles of a window that the areas of the settings close."""
        if self.avoid is None and self.only is None:
            return None
        grid = self.site.grid
        return TileChoice(
            None if self.avoid is None else tiles_in(self.avoid, window, grid),
            None if self.only is None else tiles_within(self.only, window, grid),
        )

    def load(self, window: TileWindow, risk: float | None = None, worn: WornTiles | None = None) -> NDArray[np.float32]:
        """Read the cost per metre of each tile of a window."""
        bands = ["c_r_high" if self.settings.robust else "c_r", "p_fail"]
        if self.settings.unknown is not None:
            bands.append("obstacle")
        cost = self.cost(self.site.read(window, bands), risk)
        if worn is not None:
            cost *= worn.factors(window)
        return cost

    def way(self, stops: Floats, risk: float | None = None, worn: WornTiles | None = None) -> PlannedWay | None:
        """Plan the cheapest way through stops in their order; None if there is none.

        Parameters
        ----------
        stops : array (k, 2)
            Easting and northing, m, at least two.
        risk : float, optional
            Weight of the hazard for this way, m; what it costs is told with the settings' own.
        worn : WornTiles, optional
            Tiles that are dearer for this way.
        """
        legs = []
        for start, goal in itertools.pairwise(stops):
            leg = self._leg(start, goal, risk, worn)
            if leg is None:
                return None
            legs.append(leg)
        line = np.concatenate([legs[0][:1], *(leg[1:] for leg in legs)])
        return PlannedWay(line, measure_way(self.site, line, stops, self.cost))

    def leg_cost(self, start: Floats, goal: Floats) -> float:
        """Return the cost of the cheapest way between two points, m; inf if there is none."""
        way = self.way(np.array([start, goal]))
        return np.inf if way is None else way.measured.figures.cost_m

    def _leg(self, start: Floats, goal: Floats, risk: float | None, worn: WornTiles | None) -> Floats | None:
        size = self.site.grid.tile_size
        key = (*start, *goal, risk, None if worn is None else id(worn))
        if key not in self._legs:
            found = plan_way(
                lambda window: self.load(window, risk, worn),
                self.site.window,
                self.place(start, self.site.window),
                self.place(goal, self.site.window),
                margin=self.margin,
                memory_tiles=self.memory_tiles,
            )
            line = None
            if found is not None:
                window = self.site.window
                east = window.col + found.line[:, 1]
                north = window.row + window.rows - found.line[:, 0]
                line = np.column_stack([east, north]) * size
                line[0], line[-1] = start, goal
            if worn is not None:
                return line
            self._legs[key] = line
        kept: Floats | None = self._legs[key]
        return kept

    def place(self, point: Floats, window: TileWindow) -> tuple[float, float]:
        """Convert easting and northing [m] to rows from the north edge and columns from the west edge of a window."""
        size = self.site.grid.tile_size
        return float(window.row + window.rows - point[1] / size), float(point[0] / size - window.col)


def in_order(stops: Sequence[Floats] | Floats, order: Sequence[int]) -> Floats:
    """Return stops in another order, (k, 2)."""
    return np.asarray([stops[at] for at in order])
