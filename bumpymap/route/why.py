"""Why a way is not straight: what closes the straight line between its stops, and where a metre of it costs most."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BARRED_TEXT, NO_TILE, Barred, RouteFigures, StraightLine, Turn
from bumpymap.route.ground import TOUCHING, CostGround, sample_line
from bumpymap.route.measure import cut_into_tiles
from bumpymap.route.stops import place_text

_NAMED, _LEAST_M = 3, 1.0
"""Most stretches that are named, and least cost of one of them beyond its length, m (chosen)."""


def measure_straight_line(ground: CostGround, stops: NDArray[np.float64], best: RouteFigures) -> StraightLine:
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


def _turn(
    ground: CostGround, pieces: dict[str, NDArray[Any]], closed: NDArray[np.float64], tiles: NDArray[np.int64]
) -> Turn:
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


def _why(pieces: dict[str, NDArray[Any]], at: int, *, is_closed: bool) -> str:
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
