"""Plan ways over a map: costs of its tiles by window, the search, and what a way costs."""

import itertools
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Barred, TileField
from bumpymap.layers import RouteMap, tiles_in, tiles_within
from bumpymap.route.ground import CostGround, TileChoice, WornTiles, cost_of, window_around
from bumpymap.route.growing import plan_way
from bumpymap.route.measure import MeasuredWay, measure_way, way_cost
from bumpymap.route.passages import way_over_areas
from bumpymap.route.places import place_in_window
from bumpymap.route.settings import CostSettings
from bumpymap.route.steering import sample_line, steer_clear
from bumpytiles import TileWindow

__all__ = ["PlannedWay", "Planner"]

Floats = NDArray[np.float64]

_ROOM_M = 0.1
"""Room between vehicle and ground that is closed to it, m, as between vehicle and obstacle."""
_NEAR_TILES = 8
"""Tiles around a way in which obstacles make it worth while to look for another one between them."""
_MOST_MARGIN = 0.45
"""Of a tile: wider vehicles keep to the middle of corridors of one tile."""


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
    _legs: dict[tuple[float, ...], Floats | None] = field(default_factory=dict, init=False, repr=False)

    @property
    def risk(self) -> float:
        """Weight of the hazard, m."""
        return self.site.rule.fail_weight if self.settings.risk is None else self.settings.risk

    @property
    def reach_m(self) -> float:
        """Distance that a way keeps from obstacles, m: half the vehicle's width and 0.1 m."""
        return 0.5 * self.site.vehicle.width_m + _ROOM_M

    @property
    def margin(self) -> float:
        """Distance that a way keeps from closed tiles, in tiles: the same, or less if the tiles are small."""
        return min(self.reach_m / self.site.grid.tile_size, _MOST_MARGIN)

    @property
    def bands(self) -> tuple[str, ...]:
        """What of the map the cost depends on, besides what bars tiles."""
        obstacle = () if self.settings.unknown is None else ("obstacle",)
        return ("c_r_high" if self.settings.robust else "c_r", "p_fail", *obstacle)

    @property
    def has_areas(self) -> bool:
        """Whether there are areas to avoid, or to stay in."""
        return self.avoid is not None or self.only is not None

    def cost(self, tiles: TileField, risk: float | None = None, *, through: bool = False) -> NDArray[np.float32]:
        """Return the cost per metre of each tile of a window, inf where closed; ``through`` as in `cost_of`."""
        return cost_of(
            tiles,
            risk_m=self.risk if risk is None else risk,
            robust=self.settings.robust,
            unknown_cost=self.settings.unknown,
            choice=self._choice(tiles.window),
            through=through,
        )

    def _choice(self, window: TileWindow) -> TileChoice | None:
        """Return the tiles of a window that the areas of the settings close."""
        if not self.has_areas:
            return None
        grid = self.site.grid
        return TileChoice(
            None if self.avoid is None else tiles_in(self.avoid, window, grid),
            None if self.only is None else tiles_within(self.only, window, grid),
        )

    def load(self, window: TileWindow) -> NDArray[np.float32]:
        """Read the cost per metre of each tile of a window, inf where closed for what reads tiles alone."""
        return CostGround(self).on_tiles(window, through=False)

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
        ground = CostGround(self)
        touched = self._touched_m(line) if self.settings.through_obstacles else 0.0
        tight = ground.tight_turns_deg(line)
        measured = measure_way(self.site, line, stops, ground.of_field, obstacle_m=touched, tight_turns_deg=tight)
        return PlannedWay(line, measured)

    def leg_cost(self, start: Floats, goal: Floats) -> float:
        """Return the cost of the cheapest way between two points, m; inf if there is none."""
        line = self._leg(start, goal, None, None)
        return np.inf if line is None else way_cost(self.site, line, CostGround(self).of_field)

    def _leg(self, start: Floats, goal: Floats, risk: float | None, worn: WornTiles | None) -> Floats | None:
        """Return the cheapest line between two points; without worn tiles, it is kept for the next question."""
        if tuple(goal) < tuple(start):  # there and back are the same line
            back = self._leg(goal, start, risk, worn)
            return None if back is None else back[::-1]
        if worn is not None:
            return self._clear_line(start, goal, risk, worn)
        key = (*start, *goal, self.risk if risk is None else risk)
        if key not in self._legs:
            self._legs[key] = self._clear_line(start, goal, risk, None)
        return self._legs[key]

    def _clear_line(self, start: Floats, goal: Floats, risk: float | None, worn: WornTiles | None) -> Floats | None:
        """Return the cheapest line on which the vehicle fits throughout; None if there is none.

        The cheapest way over whole tiles is steered past obstacles on pixels. Where obstacles close tiles nearby, or
        there is no such way, the areas of tiles are searched as well, and the cheaper of both is returned.
        """
        ground = CostGround(self, risk, worn)
        over_tiles = self._tile_line(ground, start, goal)
        steered = None if over_tiles is None else steer_clear(ground, over_tiles)
        if steered is not None and not self._may_pass_between(steered):
            return steered
        lines = [line for line in (steered, way_over_areas(ground, start, goal)) if line is not None]
        if not lines and self.settings.through_obstacles:
            touching = replace(ground, touching=True)
            over_tiles = self._tile_line(touching, start, goal)
            return None if over_tiles is None else steer_clear(touching, over_tiles)
        return min(lines, key=partial(way_cost, self.site, cost_of=ground.of_field), default=None)

    def _touched_m(self, line: Floats) -> float:
        """Return the length of a line on which the vehicle touches obstacles, m."""
        points, step = sample_line(line, self.site.grid)
        return float((~CostGround(self).clear_at(points)).sum()) * step

    def _may_pass_between(self, line: Floats) -> bool:
        """Return whether obstacles close tiles near a line."""
        barred = self.site.read(window_around(self.site, line, _NEAR_TILES), ()).barred
        return bool(np.isin(barred, (Barred.OBSTACLE, Barred.SPLIT)).any())

    def _tile_line(self, ground: CostGround, start: Floats, goal: Floats) -> Floats | None:
        """Return the cheapest line over whole tiles, (m, 2) easting and northing, m."""
        window = self.site.window
        ends = (self.place(point, window) for point in (start, goal))
        load = partial(ground.on_tiles, through=False)
        found = plan_way(load, window, *ends, margin=self.margin, memory_tiles=self.memory_tiles)
        if found is None:
            return None
        east, north = window.col + found.line[:, 1], window.row + window.rows - found.line[:, 0]
        line = np.column_stack([east, north]) * self.site.grid.tile_size
        line[0], line[-1] = start, goal
        return line

    def line(self, start: Floats, goal: Floats) -> Floats | None:
        """Plan the cheapest line between two points, (m, 2) easting and northing, m; None if there is none."""
        return self._leg(start, goal, None, None)

    def at(self, place: Floats, window: TileWindow) -> Floats:
        """Convert rows from the north edge and columns from the west edge of a window to easting and northing, m."""
        return np.array([window.col + place[1], window.row + window.rows - place[0]]) * self.site.grid.tile_size

    def place(self, point: Floats, window: TileWindow) -> tuple[float, float]:
        """Convert easting and northing [m] to rows from the north edge and columns from the west edge of a window."""
        return place_in_window(point, self.site.grid, window)
