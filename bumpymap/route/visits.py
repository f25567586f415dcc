"""The best order of points to pass: exact, by dynamic programming over subsets (Held and Karp 1962)."""

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

__all__ = ["MOST_VISITS", "best_order"]

MOST_VISITS = 12
"""Most points whose order is chosen: the work doubles with each."""


def best_order(costs: NDArray[np.float64], *, fixed_end: bool) -> list[int]:
    """Return the order in which a tour visits points.

    Parameters
    ----------
    costs : array (n, n)
        Cost of the way from point i to point j; inf if there is none.
    fixed_end : bool
        The last point is the end of the tour; otherwise it ends where that is cheapest.

    Returns
    -------
    list of int
        All n points, 0 first. Of equally good orders, the first in the order of numbers.

    Notes
    -----
    If no order is possible, the result is the given one.
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
