"""Several ways between the same points: the lower hull of ride cost against risk, then ways over other ground.

1. *Hull.* A way is the cheapest for some weight of the hazard if it lies on the lower convex hull of ride cost against
   hazard. Two neighbours on the hull give the weight at which both cost the same; a search with this weight finds a way
   between them, or shows that there is none.
2. *Other ground.* The tiles of the ways found, and those beside them, are made dearer, step by step, until the cheapest
   way has enough tiles of its own.
"""

from collections.abc import Callable
from itertools import pairwise
from operator import itemgetter

import numpy as np

from bumpymap.route.ground import WornTiles
from bumpymap.route.measure import MeasuredWay

Plan = Callable[[float, WornTiles | None], MeasuredWay | None]
"""Plans a way with a weight of the hazard [m]; tiles of earlier ways may be dearer."""

_SAFEST_RISK = 1e6
"""m: the weight of the hazard for the safest way."""
_SAME_SHARE = 0.9
"""Of two ways that share more of their tiles, or pass beside them, only one is proposed."""
_OTHER_SHARE = 0.7
"""A way over other ground shares at most this much of its tiles with each way before it."""
_FACTORS = (1.3, 1.6, 2.0, 3.0, 5.0)
_DEAREST = 3.0
"""Ways that cost more than this many times the best are not proposed."""


def find_alternatives(plan: Plan, count: int, risk: float) -> list[tuple[MeasuredWay, float]]:
    """Find up to ``count`` ways, the best first, the others by cost.

    ``plan``: plans a way; ``count``: number of ways wanted; ``risk``: weight of the hazard [m] by which the best one is
    the cheapest. Returns (MeasuredWay, float): ways, and the weight of the hazard that each was planned with; fewer
    than ``count`` if there are no more; none if there is no way.
    """
    best = plan(risk, None)
    if best is None:
        return []
    found = [(best, risk)]
    if count > 1:
        hull = _spread_out(_hull(plan, best, risk), count)
        for way, weight in hull:
            if len(found) < count and _differs(way, found, _SAME_SHARE):
                found.append((way, weight))
    while len(found) < count:
        other = _elsewhere(plan, found, risk)
        if other is None:
            break
        found.append((other, risk))
    return [found[0], *sorted(found[1:], key=lambda each: _cost(each[0]))]


def _hull(plan: Plan, best: MeasuredWay, risk: float) -> list[tuple[MeasuredWay, float]]:
    """Return the ways on the hull, the least ride cost first."""
    ends = [(plan(0.0, None), 0.0), (best, risk), (plan(_SAFEST_RISK, None), _SAFEST_RISK)]
    known = sorted(((way, at) for way, at in ends if way is not None), key=itemgetter(1))
    searching = True
    while searching and len(known) < _MOST_ON_HULL:
        searching = False
        for (left, _), (right, _) in pairwise(tuple(known)):
            between = _between(plan, left, right, risk)
            if between is not None:
                known.append(between)
                known.sort(key=itemgetter(1))
                searching = True
    return known


_MOST_ON_HULL = 12


def _between(plan: Plan, left: MeasuredWay, right: MeasuredWay, risk: float) -> tuple[MeasuredWay, float] | None:
    """Return a way of the hull between two of its ways; None if they are neighbours, or nearly the same way."""
    if left.shared(right) > _SAME_SHARE:
        return None
    more_ride = _ride(right, risk) - _ride(left, risk)
    less_hazard = left.figures.hazard - right.figures.hazard
    if more_ride <= 0 or less_hazard <= 0:
        return None
    weight = more_ride / less_hazard
    way = plan(weight, None)
    if way is None:
        return None
    line = _ride(left, risk) + weight * left.figures.hazard
    if _ride(way, risk) + weight * way.figures.hazard > line * (1 - 1e-4):
        return None
    return way, weight


def _spread_out(ways: list[tuple[MeasuredWay, float]], count: int) -> list[tuple[MeasuredWay, float]]:
    """Order ways of the hull: the safest, the one that costs least without risk, then those between them."""
    if len(ways) <= 2:
        return ways[::-1]
    inner = ways[1:-1]
    step = max(1, len(inner) // count)
    return [ways[-1], ways[0], *inner[::step], *(way for at, way in enumerate(inner) if at % step)]


def _elsewhere(plan: Plan, found: list[tuple[MeasuredWay, float]], risk: float) -> MeasuredWay | None:
    """Return a way that shares little with the ways before it; None if there is none that is not much dearer."""
    tiles = np.unique(np.concatenate([way.tiles for way, _ in found]), axis=0)
    for factor in _FACTORS:
        way = plan(risk, WornTiles(tiles, factor))
        if way is None or _cost(way) > _DEAREST * _cost(found[0][0]):
            return None
        if _differs(way, found, _OTHER_SHARE):
            return way
    return None


def _differs(way: MeasuredWay, found: list[tuple[MeasuredWay, float]], share: float) -> bool:
    return all(way.shared(other) <= share for other, _ in found)


def _cost(way: MeasuredWay) -> float:
    return way.figures.cost_m


def _ride(way: MeasuredWay, risk: float) -> float:
    """Return the cost of a way without its risk, m."""
    figures = way.figures
    return figures.cost_m - risk * figures.hazard
