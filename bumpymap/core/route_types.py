"""The records of routes: a window of a map as the search reads it, and a way with what lies along it.

Arrays of a window are (rows, cols), north row first. Lengths and coordinates are in metres, on the grid of tiles;
``Georeference`` converts to the units of the survey's CRS.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core.config import DirectionSettings
from bumpymap.core.seen_sizes import SeenSizes, chance_text
from bumpymap.core.types import CostRule, Floats, Georeference, obstacle_reach
from bumpytiles import Grid, TileWindow


@dataclass(frozen=True, slots=True)
class RouteVehicle:
    """The vehicle that a map was made for."""

    name: str
    width_m: float
    """Full width, m."""
    speed_mps: float
    """Speed of the profile, m/s."""

    @property
    def reach_m(self) -> float:
        """Distance that the middle of the vehicle keeps from obstacles, m."""
        return obstacle_reach(self.width_m)


@dataclass(frozen=True, slots=True)
class TileField:
    """A window of a map: what a route needs to know of each tile."""

    grid: Grid
    georeference: Georeference
    window: TileWindow
    barred: NDArray[np.uint8]
    """(rows, cols) a `Barred`, 0 where passable; ``NO_TILE`` where the map has no tile."""
    c_r: NDArray[np.float32]
    """(rows, cols) ride cost, rad/m; NaN if unknown (so are the next four)."""
    c_r_low: NDArray[np.float32]
    """(rows, cols) lower end of its 80 % interval, rad/m."""
    c_r_high: NDArray[np.float32]
    """(rows, cols) upper end, rad/m."""
    p_fail: NDArray[np.float32]
    """(rows, cols) share of simulated drives that fail, 0..1."""
    obstacle: NDArray[np.float32]
    """(rows, cols) share of the pixels with an obstacle, 0..1."""
    all_density: NDArray[np.float32]
    """(rows, cols) points of any class per m2; NaN if unknown (so are the next two)."""
    smallest_object: NDArray[np.float32]
    """(rows, cols) side of the narrowest standing object that would have shown, m."""
    smallest_step: NDArray[np.float32]
    """(rows, cols) lowest step that would have been found, m."""
    rule: CostRule
    """How ride and risk become cost."""
    vehicle: RouteVehicle


def slope_cost(
    settings: DirectionSettings, gradient: NDArray[np.floating], down: NDArray[np.floating], right: NDArray[np.floating]
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return what the slope adds to the cost of a metre, (n,), and where its direction is barred, (n,).

    ``gradient`` (n, 2): rise per length southwards and eastwards; ``down``, ``right`` (n,) or numbers: a direction,
    southwards and eastwards, of any length.
    """
    length = np.hypot(down, right)
    down, right = (np.divide(x, length, out=np.zeros(len(gradient)), where=length > 0.0) for x in (down, right))
    south, east = gradient.astype(np.float64).T
    rise, across = south * down + east * right, np.abs(south * right - east * down)
    along = np.where(rise > 0.0, settings.climb * rise, -settings.descent * rise)
    return along + settings.side_slope * across, across > settings.steepest


@dataclass(frozen=True, slots=True)
class TracedLine:
    """The pieces of a line, cut at the borders of tiles, in order; pieces of length 0 are left out."""

    row: NDArray[np.int64]
    """(n,) row of the tile in the window, from the north."""
    col: NDArray[np.int64]
    """(n,) column of the tile in the window, from the west."""
    length: NDArray[np.float64]
    """(n,) length of the piece, in tiles. Along a border of two tiles, the piece belongs to the one that costs more."""
    part: NDArray[np.int64]
    """(n,) which straight part of the line it belongs to, from 0."""


@dataclass(frozen=True, slots=True)
class RouteProfile:
    """Points at even distances along a way, first and last included; (n,) each."""

    distance: NDArray[np.float64]
    """From the start along the way, m."""
    easting: NDArray[np.float64]
    """m, on the grid."""
    northing: NDArray[np.float64]
    """m, on the grid."""
    z: NDArray[np.float64]
    """Height of the ground, m; NaN if unknown."""
    slope: NDArray[np.float64]
    """Along the way, degrees, positive uphill; NaN if unknown."""
    c_r: NDArray[np.float64]
    """Of the tile, rad/m; NaN if unknown (so are the next three)."""
    c_r_low: NDArray[np.float64]
    c_r_high: NDArray[np.float64]
    p_fail: NDArray[np.float64]
    cost: NDArray[np.float64]
    """Cost of the way so far, m."""
    obstacle: NDArray[np.bool_]
    """Where the vehicle touches an obstacle, as it may only if ways through obstacles are allowed."""
    c_r_line: NDArray[np.float64]
    """Of the metre of the way itself (`ride_along`), rad/m; NaN if unknown."""
    speed: NDArray[np.float64]
    """Speed made good on the tile, m/s."""


@dataclass(frozen=True, slots=True)
class RouteFigures:
    """Cost of a whole way."""

    length_m: float
    straight_m: float
    """Sum of the straight lines between start, stops and goal, m."""
    cost_m: float
    """Length, and the detours that shaking and risk are worth, m."""
    c_r_mean: float
    """Mean along the way where it is known, rad/m, with the means of both ends of the 80 % intervals."""
    c_r_mean_low: float
    c_r_mean_high: float
    c_r_max: float
    """Of the worst tile on the way, rad/m, with its 80 % interval."""
    c_r_max_low: float
    c_r_max_high: float
    hazard: float
    """Sum of the hazard along the way."""
    p_fail_max: float
    unknown_m: float
    """Length on unknown ground, m."""
    obstacle_m: float
    """Length on which an obstacle is nearer than half the vehicle's width and 0.1 m, m: no way around was found."""
    tight_turns_deg: float
    """Sum of the angles by which the way turns where what stops the vehicle is nearly as near as it may be, degrees."""
    climb_m: float
    descent_m: float
    seconds: float
    """Time at the speed made good, s."""
    c_r_line: float = math.nan
    """Mean of the way itself, rolled over the pixels (`ride_along`), rad/m, with its 80 % interval; NaN if unknown."""
    c_r_line_low: float = math.nan
    c_r_line_high: float = math.nan
    seen: SeenSizes = SeenSizes()  # noqa: RUF009 (frozen)
    """Smallest objects that the survey would have shown on all but the worst twentieth of the way."""

    @property
    def p_arrives(self) -> float:
        """Probability of arriving, if failures are independent: ``exp(-hazard - tight_turns_deg / 100) 2^-obstacle_m``.

        It holds if nothing stands in the way that the survey would not have shown: see ``seen``.
        A vehicle that turns swings its corners out: of simulated drives past trees, a share of 1 % was caught for each
        degree of a tight turn (docs/pages/routes.md). Nobody knows what driving through an obstacle does: each metre of
        it is counted as failing every second time.
        """
        return float(np.exp(-self.hazard - self.tight_turns_deg / 100) * 0.5**self.obstacle_m)

    @property
    def detour(self) -> float:
        """Length over the straight line; 1 for a way of length 0."""
        return self.length_m / self.straight_m if self.straight_m > 0 else 1.0


class Turn(NamedTuple):
    """A stretch of the straight line for which a way turns: closed tiles one after another, or one costly tile."""

    easting: float
    """Of the tile in its middle, m, as the northing."""
    northing: float
    closed_m: float
    """Length that is closed, m."""
    length_m: float
    """Its length, m."""
    why: str
    """The reasons."""


@dataclass(frozen=True, slots=True)
class StraightLine:
    """The straight line between the stops of a way, which says why the way turns."""

    cost_m: float
    """Of its open part, m."""
    closed_m: float
    """Length on which the vehicle cannot be, m."""
    turns: tuple[Turn, ...]
    """The stretches of it for which the way turns, at most three, the worst first."""
    words: str
    """All this in sentences; empty if start and goal are one place."""


@dataclass(frozen=True, slots=True)
class Route:
    """A way over a map."""

    name: str
    """Such as ``route``."""
    georeference: Georeference
    grid: Grid
    line: NDArray[np.float64]
    """(m, 2) easting and northing of its corners, m, on the grid."""
    stops: NDArray[np.float64]
    """(k, 2) easting and northing of start, via points in order, and goal, m."""
    profile: RouteProfile
    figures: RouteFigures
    vehicle: RouteVehicle
    risk_m: float
    """Weight of the hazard that it was planned with, m."""
    straight: StraightLine | None = None
    """The line between its stops; None if it was not looked at."""

    def __repr__(self) -> str:
        found = self.figures
        return (
            f"<Route {self.name} for {self.vehicle.name}: {found.length_m:,.1f} m, cost {found.cost_m:,.1f} m, "
            f"c_r {found.c_r_mean:.3f} rad/m, arrives {chance_text(found.p_arrives)} {found.seen.condition}>"
        )
