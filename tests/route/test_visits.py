"""The best order of points: against every permutation."""

from itertools import pairwise, permutations

import numpy as np
import pytest

from bumpymap.route.pipeline import best_order


def tour_cost(costs, order):
    return sum(costs[a, b] for a, b in pairwise(order))


@pytest.mark.parametrize("fixed_end", [True, False])
@pytest.mark.parametrize("seed", range(8))
def test_no_permutation_is_cheaper(seed, fixed_end):
    n = 2 + seed % 5
    costs = np.random.default_rng(seed).uniform(1, 100, (n, n))
    order = best_order(costs, fixed_end=fixed_end)
    assert sorted(order) == list(range(n))
    assert order[0] == 0
    inner = range(1, n - 1) if fixed_end else range(1, n)
    tail = (n - 1,) if fixed_end else ()
    assert tour_cost(costs, order) == pytest.approx(
        min(tour_cost(costs, (0, *middle, *tail)) for middle in permutations(inner)), rel=1e-12
    )
    if fixed_end:
        assert order[-1] == n - 1


def test_without_any_order_the_given_one_stays():
    costs = np.full((4, 4), np.inf)
    assert best_order(costs, fixed_end=False) == [0, 1, 2, 3]
