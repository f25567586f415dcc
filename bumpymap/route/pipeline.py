"""Job 3: from the layers of a map to ways over it; from the command line and from Python.

Open the map, find the points on it, choose the order in which they are passed (exact, by dynamic programming over
subsets: Held and Karp 1962), plan the ways, measure them, write them.
"""

import logging
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from itertools import combinations, pairwise
from pathlib import Path
from typing import TypeAlias, TypedDict, Unpack

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    BadInputError,
    Progress,
    Route,
    SilentProgress,
    UsageError,
    memory_limit,
    path_of_call,
    refuse_unknown,
    settings_of_call,
    short_repr,
)
from bumpymap.layers import open_map, read_areas
from bumpymap.route.ground import CostGround
from bumpymap.route.line_ride import with_line_ride
from bumpymap.route.measure import measure_straight_line
from bumpymap.route.planner import Planner, name_zones, what_closes
from bumpymap.route.search import MOST_TILES
from bumpymap.route.settings import CostSettings, RouteBy, RouteConfig
from bumpymap.route.stops import Stops, find_stops

MOST_VISITS = 12
"""Most points whose order is chosen: the work doubles with each."""


def best_order(costs: NDArray[np.float64], *, fixed_end: bool) -> list[int]:
    """Return the order in which a tour visits points.

    ``costs`` (n, n): cost of the way from point i to point j; inf if there is none; ``fixed_end``: the last point is
    the end of the tour; otherwise it ends where that is cheapest. Returns all n points, 0 first. Of equally good
    orders, the first in the order of numbers. If no order is possible, the result is the given one.
    """
    n = len(costs)
    between = range(1, n - 1) if fixed_end else range(1, n)
    if len(between) < 1:
        return list(range(n))
    best: dict[tuple[frozenset[int], int], tuple[float, int]] = {
        (frozenset((at,)), at): (float(costs[0, at]), 0) for at in between
    }
    for size in range(2, len(between) + 1):
        for seen in map(frozenset, combinations(between, size)):
            for at in sorted(seen):
                rest = seen - {at}
                best[seen, at] = min((best[rest, last][0] + float(costs[last, at]), last) for last in sorted(rest))
    everything = frozenset(between)
    after = {at: float(costs[at, n - 1]) if fixed_end else 0.0 for at in between}
    total, at = min((best[everything, at][0] + after[at], at) for at in between)
    if not np.isfinite(total):
        return list(range(n))
    order, seen = [at], everything
    while len(seen) > 1:
        _, before = best[seen, at]
        seen, at = seen - {at}, before
        order.append(at)
    return [0, *reversed(order), *([n - 1] if fixed_end else [])]


PathLike: TypeAlias = str | os.PathLike[str]
Point: TypeAlias = str | tuple[float, float]
"""``"lon,lat"`` or ``"x,y"`` in the survey's CRS, or a pair of such numbers."""


class RouteSettings(TypedDict, total=False):
    """Settings of `find_routes`: fields of ``RouteConfig`` and ``CostSettings``; paths may be strings."""

    by: RouteBy
    risk: float | None
    robust: bool
    climb: float
    descent: float
    side_slope: float
    side_limit: float | None
    unknown: float | None
    seen_width: float | None
    snap: float
    avoid: PathLike | None
    only: PathLike | None
    allow_outside: bool
    memory: str
    calibration: PathLike | None
    through_obstacles: bool
    visit: bool
    round_trip: bool
    overwrite: bool


def find_routes(
    layers: PathLike,
    start: Point,
    goal: Point,
    *,
    via: Iterable[Point] = (),
    out: PathLike | None = None,
    **settings: Unpack[RouteSettings],
) -> list[Route]:
    """Find the cheapest way over mapped ground.

    Parameters
    ----------
    layers : path or Layers
        What `map_survey` or ``bumpymap map`` wrote.
    start, goal : str or (float, float)
        Longitude and latitude, or coordinates in the survey's CRS: what lies on the map decides.
    via : points, optional
        Points to pass on the way.
    out : path, optional
        Folder, or file that ends in .geojson, .gpx or .csv.
    **settings
        Those of ``bumpymap route``, with underscores: ``by`` (``cost`` or ``time``), ``risk`` [m],
        ``robust``, ``climb``, ``descent``, ``side_slope`` [m], ``side_limit`` [deg], ``unknown`` [cost
        per metre], ``seen_width`` [m], ``snap`` [m], ``visit``, ``round_trip``, ``avoid``, ``only``,
        ``allow_outside``, ``calibration``, ``through_obstacles``, ``memory``, ``overwrite``.

    Returns
    -------
    list of Route
        The way.

    Raises
    ------
    BadInputError
        The layers cannot be read, a point does not lie on ground that can be used, or there is no way.
    UsageError
        A setting is unknown or wrong.
    OutputError
        A file cannot be written.

    Examples
    --------
    >>> import bumpymap
    >>> [best] = bumpymap.find_routes("site_layers", (512350.5, 5403300.5), (512450.5, 5403300.5))
    >>> round(best.figures.length_m / best.figures.straight_m, 1) >= 1.0
    True
    """
    if isinstance(via, str) or not isinstance(via, Iterable):
        raise UsageError(f"via is {short_repr(via)}; give a list of points, such as [(512350.5, 5403300.5)]")
    refuse_unknown(settings, RouteSettings.__annotations__, "find_routes")
    of_cost = {name: value for name, value in settings.items() if name in CostSettings.__dataclass_fields__}
    others = {name: value for name, value in settings.items() if name not in of_cost}
    checked = settings_of_call(others, RouteConfig, "find_routes")
    checked |= {"cost": CostSettings(**settings_of_call(of_cost, CostSettings, "find_routes"))}
    checked |= {"start": _text("start", start), "goal": _text("goal", goal), "via": tuple(_text("via", p) for p in via)}
    target = None if out is None else Path(path_of_call("out", out))
    config = RouteConfig(layers=Path(path_of_call("layers", layers)), out=target, **checked)
    return [plan_routes(config).route]


def _text(name: str, point: Point) -> str:
    if isinstance(point, str):
        return point
    try:
        x, y = (float(value) for value in point)
    except (TypeError, ValueError) as error:
        raise UsageError(
            f"{name} is {short_repr(point)}; give a pair of numbers, such as (512350.5, 5403300.5), or 'LON,LAT'"
        ) from error
    return f"{x!r},{y!r}"


_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class RouteResult:
    """Result of a route run."""

    route: Route
    files: tuple[Path, ...]
    """The files that were written."""
    notes: tuple[str, ...]
    """Remarks, such as points that were moved."""


def plan_routes(config: RouteConfig, progress: Progress | None = None) -> RouteResult:
    """Plan the ways that the settings ask for, and write them.

    Raises BadInputError: the layers cannot be read, a point does not lie on ground that can be used, or there is no
    way; UsageError: the settings contradict each other or the map, or the search does not fit in the memory limit;
    OutputError: a file cannot be written.
    """
    progress = progress or SilentProgress()
    with _opened(config) as ground:
        stops = find_stops(ground, config)
        if config.out is not None:
            from bumpymap.route.output import check_out, write_route  # slow to load

            check_out(config.out, overwrite=config.overwrite)
        progress.start("route", None)
        route, remarks = _route(ground, stops, config)
        notes = [*stops.notes, *remarks]
        files: list[Path] = []
        if config.out is not None:
            manifest = {"settings": asdict(config), "remarks": notes}
            files = write_route(route, ground.site, config.out, manifest, overwrite=config.overwrite)
    return RouteResult(route, tuple(files), tuple(notes))


@contextmanager
def _opened(config: RouteConfig) -> Iterator[CostGround]:
    """Open a map, and keep its files open while it is planned on."""
    site = open_map(config.layers)
    with site.kept_open():
        avoid, only = (
            None if path is None else read_areas(path, site, allow_outside=config.cost.allow_outside)
            for path in (config.cost.avoid, config.cost.only)
        )
        ground = CostGround(site, config.cost, 0, avoid, only)
        yield replace(ground, memory_tiles=min(memory_limit(config.memory) // ground.bytes_per_tile, MOST_TILES))


def _route(ground: CostGround, stops: Stops, config: RouteConfig) -> tuple[Route, list[str]]:
    """Plan the cheapest way through the stops; return it and remarks."""
    planner = Planner(ground)
    if config.visit:
        stops = _in_best_order(planner, stops, config)
    if config.round_trip:
        stops = stops.in_order([*range(len(stops.names)), 0])
    points = stops.points
    way = planner.way(points)
    if way is None:
        legs = zip(pairwise(points), pairwise(stops.names), strict=True)
        ends, (first, second) = next((ends, names) for ends, names in legs if planner.line(*ends) is None)
        unknown = "cross unknown ground with `unknown=COST`, " if config.cost.unknown is None else ""
        raise BadInputError(
            f"there is no way from {first} to {second} on which the vehicle fits. {name_zones(ground, *ends)}"
            f"{what_closes(ground, *ends)}Choose other points, {unknown}map the "
            "survey for another vehicle, or drive through what the map takes for an obstacle with `through_obstacles`"
        )
    way, remarks = with_line_ride(ground, way, config.calibration)
    if config.visit:
        remarks = [f"order of the points: {'; '.join(stops.names)}", *remarks]
    site = ground.site
    route = Route(
        name="route",
        georeference=site.georeference,
        grid=site.grid,
        line=way.line,
        stops=points,
        profile=way.profile,
        figures=way.figures,
        vehicle=site.vehicle,
        risk_m=ground.risk_m,
        straight=measure_straight_line(ground, points, way.figures),
    )
    return route, remarks


def _in_best_order(planner: Planner, stops: Stops, config: RouteConfig) -> Stops:
    """Return the stops in the cheapest order; the first stays the first, and the goal the last."""
    points = stops.points
    if len(points) > MOST_VISITS:
        raise UsageError(f"the order of {len(points)} points is not searched: give at most {MOST_VISITS}")
    ring = np.concatenate([points, points[:1]]) if config.round_trip else points
    costs = np.zeros((len(ring), len(ring)))
    for a, b in combinations(range(len(ring)), 2):
        costs[a, b] = costs[b, a] = planner.leg_cost(ring[a], ring[b])
        if not config.cost.same_back:
            costs[b, a] = planner.leg_cost(ring[b], ring[a])
    order = best_order(costs, fixed_end=config.round_trip or config.goal is not None or config.points is not None)
    return stops.in_order(order[: len(points)])
