import math

import numpy as np
import pytest
from route_oracles import gap_to_closed, smooth_field, taut_length

from bumpymap.route.search import find_way, follow_back, spread
from bumpymap.route.straighten import is_clear, line_cost, pull_tight


def way_by_moves(cost, start, goal, margin):
    _, back = spread(cost, start, margin=margin)
    return np.vstack([start, follow_back(back, *goal)[::-1]])


@pytest.mark.parametrize("margin", [0.0, 0.35])
@pytest.mark.parametrize("seed", range(4))
def test_never_dearer_and_never_too_near(seed, margin):
    rng = np.random.default_rng(seed)
    cost = smooth_field(rng, (60, 60), most=20, width=seed, closed=0.15)
    reach, _ = spread(cost, (30.2, 30.9), margin=margin)
    goals = rng.permutation(np.argwhere(np.isfinite(reach)))[:6]
    for goal in goals:
        line = way_by_moves(cost, (30.2, 30.9), goal, margin)
        pulled = pull_tight(cost, line, margin)
        assert line_cost(cost, pulled) <= line_cost(cost, line)
        assert is_clear(cost, pulled, margin)
        assert gap_to_closed(cost, pulled) >= min(margin, gap_to_closed(cost, line[[0, 0]])) - 1e-6
        np.testing.assert_array_equal(pulled[[0, -1]], line[[0, -1]])


def test_around_blocks_the_line_is_taut():
    """Moves decide on which side of a block the way passes; where both cost nearly the same, that may be the longer."""
    shares = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        cost = np.ones((40, 40), np.float32)
        for _ in range(16):
            r, c = rng.integers(0, 36, 2)
            cost[r : r + rng.integers(1, 8), c : c + rng.integers(1, 4)] = np.inf
        start, goal = rng.permutation(np.argwhere(np.isfinite(cost)))[:2] + 0.5
        way, exact = find_way(cost, tuple(start), tuple(goal)), taut_length(cost, start, goal)
        assert (way is None) == math.isinf(exact)
        shares.append(1.0 if way is None else way.cost / exact)
    assert min(shares) > 1 - 1e-6
    assert np.mean(np.array(shares) < 1.0003) > 0.8
    assert max(shares) < 1.03


def test_a_lane_is_joined_and_left_where_it_pays():
    """Closed form: to and from a straight cheap lane at the angle whose cosine is the ratio of the costs."""
    cost = np.full((60, 100), 4.0, np.float32)
    cost[40] = 1.0
    start, goal = (30.0, 10.0), (30.0, 90.0)
    # Down to the lane's edge at cos = 1 / 4 along it, and through it to its middle or beyond for nothing.
    down = 40.0 - start[0]
    exact = 2 * 4.0 * down / math.sqrt(1 - 1 / 16) + (80.0 - 2 * down * (1 / 4) / math.sqrt(1 - 1 / 16)) * 1.0
    assert exact - 1e-6 <= find_way(cost, start, goal).cost <= 1.001 * exact
