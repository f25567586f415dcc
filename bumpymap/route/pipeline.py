"""Job 3: from the layers of a map to ways over it.

Open the map, find the points on it, plan the ways, measure them, write them.
"""

import logging
import math
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, Progress, SilentProgress, UsageError, memory_limit
from bumpymap.layers import (
    PlannedRoute,
    ReachField,
    ReachLevels,
    RouteMap,
    check_reach_out,
    check_route_out,
    open_map,
    read_areas,
    write_reach_files,
    write_routes,
)
from bumpymap.route._moves import MOVES
from bumpymap.route._window import BYTES_PER_TILE, MOST_TILES
from bumpymap.route.alternatives import find_alternatives
from bumpymap.route.ground import WornTiles
from bumpymap.route.no_way import explain_no_way
from bumpymap.route.planner import PlannedWay, Planner
from bumpymap.route.reach import Reach, find_reach
from bumpymap.route.settings import RouteConfig
from bumpymap.route.stops import Stops, find_stops
from bumpymap.route.visits import MOST_VISITS, best_order

__all__ = ["RouteResult", "plan_routes", "reach_from"]

_log = logging.getLogger(__name__)

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class RouteResult:
    """What a route run found."""

    routes: tuple[PlannedRoute, ...]
    """The best way first."""
    reach: Reach | None
    """What can be reached, if there was no goal."""
    files: tuple[Path, ...]
    """What was written."""
    notes: tuple[str, ...]
    """Remarks, such as points that were moved."""


def plan_routes(config: RouteConfig, progress: Progress | None = None) -> RouteResult:
    """Plan the ways that the settings ask for, and write them.

    Raises
    ------
    BadInputError
        The layers cannot be read, a point does not lie on ground that can be used, or there is no way.
    UsageError
        The settings contradict each other or the map, or the search does not fit in the memory limit.
    OutputError
        A file cannot be written.
    """
    progress = progress or SilentProgress()
    if config.out is not None:
        check = check_reach_out if config.is_reach else check_route_out
        check(config.out, overwrite=config.overwrite)
    planner = _planner(open_map(config.layers), config)
    stops = find_stops(planner, config)
    if config.is_reach:
        if config.out is None:
            raise UsageError("the map of what can be reached is written to a folder: add `out='DIR'`")
        return _write_reach(planner, stops, config, config.out)
    progress.start("routes", None)
    routes, order = _routes(planner, stops, config)
    notes = [*stops.notes, *order]
    for folder in config.compare:
        other = _planner(open_map([folder]), config)
        vehicle = other.site.vehicle.name
        others = find_stops(other, config, folder)
        (route, *_), order = _routes(other, others, replace(config, alternatives=1))
        routes.append(replace(route, name=f"{route.name}, {vehicle}"))
        notes += [*others.notes, *(f"{vehicle}: {note}" for note in order)]
    files: list[Path] = []
    if config.out is not None:
        manifest = {"settings": asdict(config), "remarks": notes}
        files = write_routes(routes, planner.site, config.out, manifest=manifest, overwrite=config.overwrite)
    return RouteResult(tuple(routes), None, tuple(files), tuple(notes))


def _planner(site: RouteMap, config: RouteConfig) -> Planner:
    avoid, only = (
        None if path is None else read_areas(path, site, allow_outside=config.cost.allow_outside)
        for path in (config.cost.avoid, config.cost.only)
    )
    tiles = min(memory_limit(config.memory) // BYTES_PER_TILE, MOST_TILES)
    return Planner(site, config.cost, tiles, avoid, only)


def _routes(planner: Planner, stops: Stops, config: RouteConfig) -> tuple[list[PlannedRoute], list[str]]:
    """Plan the best way through the stops, and alternatives; return them and a remark on the order that was found."""
    if config.visit:
        stops = _in_best_order(planner, stops, config)
    if config.round_trip:
        stops = stops.in_order([*range(len(stops.names)), 0])
    points = stops.points

    def plan(risk: float, worn: WornTiles | None) -> PlannedWay | None:
        return planner.way(points, risk, worn)

    ways = find_alternatives(plan, config.alternatives, planner.risk)
    if not ways:
        raise BadInputError(explain_no_way(planner, points, stops.names))
    names = ["route", *(f"alternative {number}" for number in range(1, len(ways)))]
    order = [f"order of the points: {'; '.join(stops.names)}"] if config.visit else []
    routes = [_route(planner, name, way, points, risk) for name, (way, risk) in zip(names, ways, strict=True)]
    return routes, order


def _route(planner: Planner, name: str, way: PlannedWay, stops: Floats, risk: float) -> PlannedRoute:
    site = planner.site
    return PlannedRoute(
        name=name,
        georeference=site.georeference,
        grid=site.grid,
        line=way.line,
        stops=stops,
        profile=way.measured.profile,
        figures=way.measured.figures,
        vehicle=site.vehicle,
        risk_m=risk,
    )


def _in_best_order(planner: Planner, stops: Stops, config: RouteConfig) -> Stops:
    """Return the stops in the cheapest order; the first stays the first, and the goal the last."""
    points = stops.points
    if len(points) > MOST_VISITS:
        raise UsageError(f"the order of {len(points)} points is not searched: give at most {MOST_VISITS}")
    ring = np.concatenate([points, points[:1]]) if config.round_trip else points
    costs = np.zeros((len(ring), len(ring)))
    for a, b in combinations(range(len(ring)), 2):
        costs[a, b] = costs[b, a] = planner.leg_cost(ring[a], ring[b])
    order = best_order(costs, fixed_end=config.round_trip or config.goal is not None or config.points is not None)
    return stops.in_order(order[: len(points)])


def reach_from(config: RouteConfig) -> ReachField:
    """Map what can be reached from the start, and write nothing. For errors see `plan_routes`."""
    planner = _planner(open_map(config.layers), config)
    found = _find_reach(planner, find_stops(planner, config), config)
    for note in found.notes:
        _log.warning(note)
    return _reach_field(planner, found)


def _find_reach(planner: Planner, stops: Stops, config: RouteConfig) -> Reach:
    limits = [*(minutes * 60.0 * planner.site.vehicle.speed_mps for minutes in config.isochrones), *config.isocosts]
    return find_reach(planner, stops.points[0], max(limits, default=math.inf))


def _reach_field(planner: Planner, found: Reach) -> ReachField:
    site = planner.site
    return ReachField(site.georeference, site.grid, found.window, found.cost, found.minutes, found.back, -MOVES)


def _write_reach(planner: Planner, stops: Stops, config: RouteConfig, out: Path) -> RouteResult:
    found = _find_reach(planner, stops, config)
    notes = (*stops.notes, *found.notes)
    levels = None
    if config.isochrones:
        levels = ReachLevels(config.isochrones, "minutes")
    elif config.isocosts:
        levels = ReachLevels(config.isocosts, "cost")
    files = write_reach_files(
        _reach_field(planner, found),
        planner.site,
        out,
        levels=levels,
        manifest={"settings": asdict(config), "start": stops.points[0], "remarks": notes},
        overwrite=config.overwrite,
    )
    return RouteResult((), found, tuple(files), notes)
