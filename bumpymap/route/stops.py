"""The points that a way must pass: read, placed on the map, moved off closed ground where that is allowed."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError
from bumpymap.layers import read_points
from bumpymap.route.places import parse_point
from bumpymap.route.planner import Planner
from bumpymap.route.settings import RouteConfig
from bumpymap.route.snap import explain_closed, nearest_usable
from bumpytiles import TileWindow

__all__ = ["Stops", "find_stops"]

_LOOK_M = 150.0
"""How far a message looks for ground that can be used, m."""


@dataclass(frozen=True, slots=True)
class Stops:
    """Start, points to pass and goal."""

    points: NDArray[np.float64]
    """(k, 2) easting and northing, m, on ground that can be used."""
    notes: tuple[str, ...]
    """What was moved."""


def find_stops(planner: Planner, config: RouteConfig) -> Stops:
    """Return the points that the settings name.

    Raises
    ------
    BadInputError
        A point does not lie on the map, or on ground that cannot be used.
    """
    named = _named(planner, config)
    points, notes = [], []
    for name, point in named:
        usable, note = _usable(planner, name, point, config.snap)
        points.append(usable)
        notes += [note] if note else []
    return Stops(np.array(points), tuple(notes))


def _named(planner: Planner, config: RouteConfig) -> list[tuple[str, NDArray[np.float64]]]:
    """Return the points by name."""
    if config.points is not None:
        found = [(name, np.array(point)) for name, point in read_points(config.points, planner.site)]
        if len(found) < 2:
            raise BadInputError(f"{config.points} has {len(found)} points; a way needs at least a start and a goal")
        return found
    texts = [("start", config.start), *(("point to pass", via) for via in config.via), ("goal", config.goal)]
    return [(name, np.array(parse_point(text, planner.site))) for name, text in texts if text is not None]


def _usable(planner: Planner, name: str, point: NDArray[np.float64], snap: float) -> tuple[NDArray[np.float64], str]:
    """Return a point, or the nearest one on ground that can be used, and a note if it was moved."""
    size = planner.site.grid.tile_size
    window = _around(planner, point, max(snap, _LOOK_M))
    cost = planner.load(window)
    row, col = (math.floor(value) for value in planner.place(point, window))
    if np.isfinite(cost[row, col]):
        return point, ""
    near, distance = nearest_usable(np.isfinite(cost), planner.place(point, window), size, planner.margin)
    if near is not None and distance <= snap:
        moved = np.array([window.col + near[1], window.row + window.rows - near[0]]) * size
        return moved, f"the {name} was moved by {distance:.1f} m to ground that can be used"
    raise BadInputError(explain_closed(planner, name, point, near, distance, window))


def _around(planner: Planner, point: NDArray[np.float64], reach_m: float) -> TileWindow:
    size = planner.site.grid.tile_size
    reach = math.ceil(reach_m / size) + 1
    col, row = (int(index) for index in planner.site.grid.index(point))
    return TileWindow(col - reach, row - reach, 2 * reach + 1, 2 * reach + 1)
