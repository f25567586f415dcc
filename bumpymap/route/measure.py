"""The cost of a way: the exact integral over its tiles, a profile of points at even distances, and why it turns.

A way may be long and its window large, so it is measured in stretches, each with a small window of its own.
"""

import math
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    BARRED_TEXT,
    CROSSING_UNKNOWN,
    NO_TILE,
    SEEN_COLUMNS,
    Barred,
    Floats,
    RouteFigures,
    RouteProfile,
    SeenSizes,
    StraightLine,
    TracedLine,
    Turn,
    slope_cost,
)
from bumpymap.layers import MapReader
from bumpymap.route.ground import TOUCHING, CostGround, points_along, sample_line, stretches, window_around
from bumpymap.route.places import in_window
from bumpymap.route.search import as_costs, trace
from bumpymap.route.stops import place_text

_STRETCH_TILES = 128
"""Longest stretch of a way whose window is read at once, tiles (chosen)."""
_SAMPLES_A_TILE = 3
"""Points of a profile along a tile: 1 m apart at the usual size (chosen)."""
_RIDE = ("c_r", "c_r_low", "c_r_high")
_WORST = 0.05
"""Share of a way on which less may be seen than its figures say (chosen)."""


@dataclass(frozen=True, slots=True)
class MeasuredWay:
    """A way through all stops, and what it costs."""

    line: Floats
    """(m, 2) easting and northing of its corners, m."""
    figures: RouteFigures
    profile: RouteProfile


_Pieces: TypeAlias = dict[str, NDArray[Any]]
"""The pieces of a way inside single tiles, (n,) each: ``col`` and ``row`` on the grid, ``length`` m, ``cost`` and
``hazard`` per metre (0 if unknown), ``slow`` s/m, ``barred``, ``unknown``, ``c_r``, ``c_r_low``, ``c_r_high``,
``p_fail`` and what would have shown (NaN if unknown). And of the cost what slopes add, ``slope``, and ``across``:
whether it lies across a slope that is steeper than the limit."""


def measure_way(ground: CostGround, line: Floats, stops: Floats) -> MeasuredWay:
    """Measure a way over a map.

    ``line`` (m, 2), ``stops`` (k, 2): easting and northing of its corners, and of start, stops and goal, m on the grid.
    """
    pieces = cut_into_tiles(ground, line)
    profile, obstacle_m = _profile(ground.site, line, pieces), 0.0
    if ground.settings.through_obstacles:
        points, step = sample_line(line, ground.site.grid)
        obstacle_m = float((~ground.clear_at(points)).sum()) * step
        if obstacle_m > 0.0:
            clear = ground.clear_at(np.column_stack([profile.easting, profile.northing]))
            profile = replace(profile, obstacle=~clear)
    length, climb = float(pieces["length"].sum()), _climb(profile, ground.site.grid.tile_size)
    shares = (_WORST, 1.0 - _WORST, 1.0 - _WORST)
    seen = (_quantile(pieces[name], pieces["length"], part) for name, part in zip(SEEN_COLUMNS, shares, strict=True))
    figures = RouteFigures(
        length_m=length,
        straight_m=float(np.hypot(*np.diff(stops, axis=0).T).sum()),
        cost_m=float((pieces["length"] * pieces["cost"]).sum()),
        **_ride(pieces),
        hazard=float((pieces["length"] * pieces["hazard"]).sum()),
        p_fail_max=float(np.nanmax(pieces["p_fail"])) if np.isfinite(pieces["p_fail"]).any() else math.nan,
        unknown_m=float(pieces["length"][pieces["unknown"]].sum()),
        obstacle_m=obstacle_m,
        tight_turns_deg=ground.tight_turns_deg(line),
        climb_m=climb[0],
        descent_m=climb[1],
        seconds=float((pieces["length"] * pieces["slow"]).sum()),
        seen=SeenSizes(*seen),
    )
    return MeasuredWay(line, figures, profile)


def way_cost(ground: CostGround, line: Floats) -> float:
    """Return the cost of a way alone, m: ``figures.cost_m`` of `measure_way`."""
    pieces = cut_into_tiles(ground, line)
    return float((pieces["length"] * pieces["cost"]).sum())


def cut_into_tiles(ground: CostGround, line: Floats) -> _Pieces:
    """Cut a way into pieces inside single tiles, stretch by stretch."""
    parts = [_pieces(ground, part) for part in stretches(line, ground.site.grid.tile_size * _STRETCH_TILES)]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _pieces(ground: CostGround, line: Floats) -> _Pieces:
    window = window_around(ground.site, line, 1)
    tiles = ground.site.read(window)
    cost = as_costs(ground.with_slope(ground.of_field(tiles), window, barred=False))
    place = in_window(line, tiles.grid, window)
    found, step = trace(cost, place), np.diff(place, axis=0)
    if not len(found.length):  # a way of no length lies in one tile
        row, col = np.floor(place[:1]).astype(np.int64).T
        found, step = TracedLine(row, col, np.zeros(1), np.zeros(1, np.int64)), np.zeros((1, 2))
    at, way = (found.row, found.col), step[found.part].T
    unknown = np.isin(tiles.barred[at], CROSSING_UNKNOWN)
    gradient = cost.gradient[at] if cost.gradient.size else np.zeros((len(found.row), 2))
    slope, across = slope_cost(ground.settings, gradient, *way)
    hazard, slow = tiles.rule.hazard(tiles.p_fail[at]), ground.slowness(tiles)[at]
    return {
        "col": window.col + found.col,
        "row": window.row + window.rows - 1 - found.row,
        "length": found.length * tiles.grid.tile_size,
        "cost": cost.tiles[at] + slope,
        "slope": slope,
        "across": across,
        "barred": tiles.barred[at],
        "hazard": np.where(unknown | np.isnan(hazard), 0.0, hazard),
        "unknown": unknown,
        "slow": slow,
        **{name: getattr(tiles, name)[at] for name in SEEN_COLUMNS},
        **{name: np.where(unknown, np.nan, getattr(tiles, name)[at]) for name in (*_RIDE, "p_fail")},
    }


def _ride(pieces: _Pieces) -> dict[str, Any]:
    """Return mean and worst ride cost, with their intervals; NaN where none is known."""
    known = np.isfinite(pieces["c_r"])
    weight = pieces["length"] * known
    total, worst = float(weight.sum()), int(np.argmax(np.where(known, pieces["c_r"], -1.0)))
    found = {}
    for name in _RIDE:
        kind, end = name[:3], name[3:]
        mean = (weight * np.nan_to_num(pieces[name])).sum() / total if total > 0 else math.nan
        found[f"{kind}_mean{end}"] = float(mean)
        found[f"{kind}_max{end}"] = float(pieces[name][worst]) if known.any() else math.nan
    return found


def _quantile(values: NDArray[np.floating], weights: Floats, share: float) -> float:
    """Return the value that a share of the weight does not exceed; NaN if none is known."""
    known = np.isfinite(values)
    if not known.any():
        return math.nan
    order = np.argsort(values[known], kind="stable")
    total = np.cumsum(weights[known][order])
    return float(values[known][order[np.searchsorted(total, share * total[-1])]])


def _climb(profile: RouteProfile, tile_size: float) -> tuple[float, float]:
    """Return metres up and metres down between points a tile apart; heights of gaps are interpolated."""
    known = np.isfinite(profile.z)
    if known.sum() < 2:
        return 0.0, 0.0
    length = float(profile.distance[-1])
    apart = np.linspace(0.0, length, max(2, round(length / tile_size) + 1))
    rise = np.diff(np.interp(apart, profile.distance[known], profile.z[known]))
    return float(rise[rise > 0].sum()), float(np.abs(rise[rise < 0]).sum())


def _profile(site: MapReader, line: Floats, pieces: _Pieces) -> RouteProfile:
    length, size = np.cumsum(np.hypot(*np.diff(line, axis=0).T))[-1], site.grid.tile_size
    count = max(2, math.ceil(length / size * _SAMPLES_A_TILE) + 1)
    distance = np.linspace(0.0, length, count)
    points = points_along(line, distance)
    ends = np.cumsum(pieces["length"])
    piece = np.minimum(np.searchsorted(ends, distance, side="left"), len(ends) - 1)
    spent = np.concatenate([[0.0], np.cumsum(pieces["length"] * pieces["cost"])])
    z = _heights(site, points)
    return RouteProfile(
        distance=distance,
        easting=points[:, 0],
        northing=points[:, 1],
        z=z,
        slope=_slope(distance, z, size),
        **{name: pieces[name][piece] for name in (*_RIDE, "p_fail")},
        cost=np.interp(distance, np.concatenate([[0.0], ends]), spent),
        obstacle=np.zeros(count, np.bool_),
        c_r_line=np.full(count, np.nan),
        speed=1.0 / pieces["slow"][piece],
    )


def _heights(site: MapReader, points: Floats) -> Floats:
    """Return the mean height of the pixels within half a metre of each point, or of its pixel alone; NaN if unknown."""
    out = np.full(len(points), np.nan)
    pixels = site.grid.pixels
    reach = pixels // (2 * _SAMPLES_A_TILE)
    around = np.arange(-reach, reach + 1)
    for some in np.array_split(np.arange(len(points)), max(1, len(points) // (_STRETCH_TILES * _SAMPLES_A_TILE))):
        window = window_around(site, points[some], 1)
        heights = site.heights(window)
        place = np.floor(in_window(points[some], site.grid, window) * pixels).astype(np.int64)
        rows = place[:, 0, None, None] + around[:, None]
        cols = place[:, 1, None, None] + around
        z = heights[rows, cols].reshape(len(some), -1).astype(np.float64)
        known = np.isfinite(z)
        count = known.sum(axis=1)
        out[some] = np.where(count > 0, np.nansum(z, axis=1) / np.maximum(count, 1), np.nan)
    return out


def _slope(distance: Floats, z: Floats, span: float) -> Floats:
    """Return the slope along the way over ``span`` metres, degrees, positive uphill; NaN next to unknown heights."""
    if distance[-1] <= 0:
        return np.full(len(z), np.nan)
    low = np.maximum(distance - span / 2, 0.0)
    high = np.minimum(distance + span / 2, distance[-1])
    rise = np.interp(high, distance, z) - np.interp(low, distance, z)
    return np.asarray(np.degrees(np.arctan2(rise, high - low)))


_NAMED, _LEAST_M = 3, 1.0
"""Most stretches that are named, and least cost of one of them beyond its length, m (chosen)."""


def measure_straight_line(ground: CostGround, stops: Floats, best: RouteFigures) -> StraightLine:
    """Measure the straight line through the stops of a way.

    Where it is closed, a metre counts as many times as one on which the vehicle touches an obstacle: by this the
    stretches are ordered that make a way turn. ``stops`` (k, 2): easting and northing of start, stops and goal, m;
    ``best``: figures of the best way.
    """
    moves = np.append(True, (np.diff(stops, axis=0) != 0.0).any(axis=1))
    if moves.sum() < 2:
        return StraightLine(0.0, 0.0, (), "")
    line = stops[moves]
    pieces = cut_into_tiles(ground, line)
    length, cost = pieces["length"], pieces["cost"]
    points, step = sample_line(line, ground.site.grid)
    ends = np.cumsum(length)
    piece = np.minimum(np.searchsorted(ends, (np.arange(len(points)) + 0.5) * step), len(ends) - 1)
    closed = np.minimum(np.bincount(piece, ~ground.clear_at(points), len(ends)) * step, length)
    shut = np.isinf(cost) | pieces["across"]
    closed[shut] = length[shut]
    is_closed, per_metre = closed > 0.0, np.where(np.isinf(cost), 1.0, cost)
    extra = (length - closed) * (per_metre - 1.0) + closed * TOUCHING
    # Closed tiles one after another are one stretch; any other tile is one of its own.
    stretch = np.cumsum(~(is_closed & np.append(False, is_closed[:-1]))) - 1
    of_stretch = np.bincount(stretch, extra)
    order = [at for at in np.argsort(-of_stretch, kind="stable")[:_NAMED].tolist() if of_stretch[at] >= _LEAST_M]
    turns = tuple(_turn(ground, pieces, closed, np.flatnonzero(stretch == at)) for at in order)
    open_cost, closed_m = float(((length - closed) * per_metre).sum()), float(closed.sum())
    return StraightLine(open_cost, closed_m, turns, _words(ground, turns, best, open_cost, closed_m))


def _turn(ground: CostGround, pieces: _Pieces, closed: Floats, tiles: NDArray[np.int64]) -> Turn:
    """Describe a stretch of the line: some of its ``tiles``, one after another."""
    length = pieces["length"][tiles]
    metres: dict[str, float] = {}
    for at in tiles.tolist():
        why = _why(pieces, at, is_closed=closed[at] > 0.0)
        metres[why] = metres.get(why, 0.0) + float(closed[at] or pieces["length"][at])
    most = sorted(metres, key=lambda why: -metres[why])[:2]
    middle = tiles[np.searchsorted(np.cumsum(length), length.sum() / 2.0)]
    size = ground.site.grid.tile_size
    easting, northing = (float(pieces[name][middle] + 0.5) * size for name in ("col", "row"))
    return Turn(easting, northing, float(closed[tiles].sum()), float(length.sum()), ", ".join(most))


def _why(pieces: _Pieces, at: int, *, is_closed: bool) -> str:
    cost, barred = float(pieces["cost"][at]), int(pieces["barred"][at])
    if barred == NO_TILE:
        return "no points"
    if math.isinf(cost):
        return BARRED_TEXT[Barred(barred)] if barred != Barred.NO else "outside the ground that may be used"
    if is_closed:
        return "across a slope steeper than the limit" if pieces["across"][at] else "no room beside an obstacle"
    if pieces["unknown"][at]:
        return BARRED_TEXT[Barred(barred)]
    is_slope = 2.0 * float(pieces["slope"][at]) > cost - 1.0
    kind = "slope" if is_slope else f"rough ground, C_r {float(pieces['c_r'][at]):.3f} rad/m"
    return f"{kind}, {cost:.1f} m for each metre"


def _words(ground: CostGround, turns: tuple[Turn, ...], best: RouteFigures, open_cost: float, closed_m: float) -> str:
    straight = f"The straight line, {best.straight_m:,.0f} m,"
    if not turns:
        return f"{straight} is open and costs {open_cost:,.0f} m; the way costs {best.cost_m:,.0f} m."
    said = f"is closed on {closed_m:,.1f} m and" if closed_m > 0.0 else "is open and"
    rest = " on the rest" if closed_m > 0.0 else ""
    named = []
    for turn in turns:
        place, _, kind = place_text(ground.site, np.array([turn.easting, turn.northing])).partition(" (")
        named.append(f"{turn.closed_m or turn.length_m:.1f} m at {place} ({turn.why})")
    degrees = f" Places are {kind.removesuffix(')')}." if kind else ""
    costs = f"{said} costs {open_cost:,.0f} m{rest}; the way costs {best.cost_m:,.0f} m"
    return f"{straight} {costs}. It turns for {'; '.join(named)}.{degrees}"
