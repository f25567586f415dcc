"""The points that a way must pass: read, placed on the map, moved off closed ground where that is allowed."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError
from bumpymap.layers import read_points
from bumpymap.route.ground import CostGround
from bumpymap.route.places import GridPoint, parse_point, place_in_window, place_point
from bumpymap.route.planner import Planner
from bumpymap.route.reach import window_within
from bumpymap.route.settings import RouteConfig
from bumpymap.route.snap import nearest_usable, usable_point

__all__ = ["Stops", "find_stops"]

_NEAR_M, _LOOK_M = 30.0, 150.0
"""How far from a point ground that can be used is looked for: first, and for a message, m."""


@dataclass(frozen=True, slots=True)
class Stops:
    """Start, points to pass and goal."""

    points: NDArray[np.float64]
    """(k, 2) easting and northing, m, on ground that can be used."""
    names: tuple[str, ...]
    """(k,) how a message calls each of them."""
    notes: tuple[str, ...]
    """What was moved."""

    def in_order(self, order: Sequence[int]) -> "Stops":
        """Return some of the stops, in another order; a stop may be there twice."""
        return replace(self, points=self.points[list(order)], names=tuple(self.names[at] for at in order))


def find_stops(planner: Planner, config: RouteConfig, compared: Path | None = None) -> Stops:
    """Return the points that the settings name.

    Parameters
    ----------
    planner : Planner
    config : RouteConfig
    compared : Path, optional
        The layers if they are those of another vehicle, which messages then name.

    Raises
    ------
    BadInputError
        A point does not lie on the map, or on ground that cannot be used.
    """
    vehicle = planner.site.vehicle.name
    where, of = ("", "") if compared is None else (f"in {compared} ({vehicle}), ", f"{vehicle}: ")
    named = _named(planner, config)
    points = [_usable(planner, where + name, point, config.snap) for name, point in named]
    names, notes = [], []
    for (name, point), used in zip(named, points, strict=True):
        if used == point:
            names.append(name)
            continue
        moved = f"moved by {math.dist(point, used):.1f} m"
        names.append(f"{name} ({moved})")
        notes.append(f"{of}{name} was {moved} to ground that can be used")
    return Stops(np.array(points), tuple(names), tuple(notes))


def _named(planner: Planner, config: RouteConfig) -> list[tuple[str, GridPoint]]:
    """Return the points by name."""
    site = planner.site
    if config.points is not None:
        found = read_points(config.points)
        if len(found) < 2:
            raise BadInputError(f"{config.points} holds one point; a way needs at least a start and a goal")
        names = [f"point {point.name} of {config.points}" for point in found]
        return [
            (name, place_point(point.x, point.y, site, point.system, name=name, beyond_m=config.snap))
            for name, point in zip(names, found, strict=True)
        ]
    texts = [("start", config.start), *(("point to pass", via) for via in config.via), ("goal", config.goal)]
    return [
        (f"the {name} {text}", parse_point(text, site, beyond_m=config.snap))
        for name, text in texts
        if text is not None
    ]


def _usable(planner: Planner, name: str, point: GridPoint, snap_m: float) -> GridPoint:
    """Return a point, or the nearest pixel on which the vehicle fits. Raises BadInputError if that is too far."""
    site, size = planner.site, planner.site.grid.tile_size
    cells, margin = site.grid.pixels, 0.5
    reach, most = (math.ceil(metres / size) + 1 for metres in (_NEAR_M, max(snap_m, _LOOK_M)))
    while True:
        window = window_within(site.window, np.array(point) / size, reach)
        cost = CostGround(planner).on_pixels(window)
        place = (cells * at for at in place_in_window(point, site.grid, window))
        found = nearest_usable(np.isfinite(cost), *place, margin=margin)
        too_many = 4 * window.cols * window.rows * cells**2 > planner.memory_tiles
        # What lies outside the window is at least ``reach`` away.
        if (
            (found is not None and found.distance <= reach * cells)
            or reach >= most
            or window == site.window
            or too_many
        ):
            break
        reach = min(2 * reach, most)
    field = site.read(window, planner.bands)
    return usable_point(site, field, cost, point, name=name, snap_m=snap_m, margin=margin)
