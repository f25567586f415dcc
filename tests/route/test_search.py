import math

import numpy as np
import pytest
from route_oracles import gap_to_closed, reach_by_graph, smooth_field

from bumpymap.route._search_kernels import FROM_START, NOT_REACHED
from bumpymap.route.search import MOVES, find_way, follow_back, spread
from bumpymap.route.straighten import is_clear, line_cost, pull_tight, wide_margin

EVEN = np.ones((100, 100), np.float32)


def test_even_ground_is_crossed_straight_in_all_directions():
    """By moves alone and pulled tight: the straight line, which find_way tries first, is not asked."""
    rng, ratios = np.random.default_rng(1), []
    for _ in range(10):
        start = tuple(rng.uniform(0, 100, 2))
        _, back = spread(EVEN, start)
        for goal in rng.integers(0, 100, (20, 2)):
            line = np.vstack([start, follow_back(back, *goal)[::-1]])
            straight = math.dist(start, line[-1])
            assert line_cost(EVEN, line) <= 1.0076 * straight + 0.05  # the start is in no middle
            ratios.append(line_cost(EVEN, pull_tight(EVEN, line)) / max(straight, 1e-9))
            assert find_way(EVEN, start, tuple(line[-1])).cost == pytest.approx(straight, abs=1e-8)
    assert np.mean(ratios) <= 1.001
    assert np.max(ratios) <= 1.005


@pytest.mark.parametrize("margin", [0.0, 0.25, 0.4999])
def test_reach_is_that_of_the_same_graph_in_scipy(margin):
    for seed in range(34):
        rng = np.random.default_rng([seed, int(100 * margin)])
        cost = smooth_field(rng, (15, 18), width=seed % 3, closed=rng.uniform(0.0, 0.4))
        start = rng.permutation(np.argwhere(np.isfinite(cost)))[0]
        reach, back = spread(cost, tuple(start + 0.5), margin=margin)
        wanted = reach_by_graph(cost, MOVES, margin, start)
        np.testing.assert_allclose(reach, wanted, rtol=1e-9)
        np.testing.assert_array_equal(back == NOT_REACHED, np.isinf(wanted))
        assert back[tuple(start)] == FROM_START


@pytest.mark.parametrize("seed", range(5))
def test_a_way_by_moves_costs_what_the_graph_says_or_the_straight_line(seed):
    rng = np.random.default_rng(seed)
    cost = smooth_field(rng, (40, 30), closed=0.2)
    start, goal = rng.permutation(np.argwhere(np.isfinite(cost)))[:2]
    wanted = reach_by_graph(cost, MOVES, wide_margin(0.3), start)[tuple(goal)]
    straight = np.array([start, goal]) + 0.5
    if is_clear(cost, straight, wide_margin(0.3)):
        wanted = min(wanted, line_cost(cost, straight))
    way = find_way(cost, tuple(start + 0.5), tuple(goal + 0.5), margin=0.3)
    if way is None:
        assert math.isinf(wanted)
        return
    assert way.graph_cost == pytest.approx(wanted, rel=1e-9)
    assert way.cost <= way.graph_cost
    assert way.cost == pytest.approx(line_cost(cost, way.line), rel=1e-9)
    assert is_clear(cost, way.line, 0.3)
    assert gap_to_closed(cost, way.line) >= 0.3 - 1e-6


@pytest.mark.parametrize("margin", [0.1, 0.3, 0.45])
def test_a_margin_bends_the_way_around_a_corner_in_an_arc(margin):
    cost = EVEN[:40, :40].copy()
    cost[20, :21] = np.inf
    start, goal = (10.0, 10.0), (33.0, 9.0)
    way = find_way(cost, start, goal, margin=margin)
    corners = np.array([[20.0, 21.0], [21.0, 21.0]])
    length, turned = 1.0, 0.0  # the wall's end is one tile wide
    for point, corner, towards in ((start, corners[0], 1), (goal, corners[1], -1)):
        away = np.subtract(corner, point)
        length += math.sqrt(away @ away - margin**2)
        heading = math.atan2(away[1], towards * away[0]) + math.asin(margin / math.hypot(*away))
        turned += heading
    exact = length + margin * turned
    assert exact - 1e-6 <= way.cost <= exact * 1.001
    assert margin - 1e-6 <= gap_to_closed(cost, way.line) <= 1.05 * margin + 1e-4
    assert len(way.line) < 12


@pytest.mark.parametrize("seed", range(4))
def test_there_and_back_turned_and_mirrored_cost_the_same(seed):
    rng = np.random.default_rng(seed)
    cost = smooth_field(rng, (50, 60), closed=0.15)
    start, goal = rng.permutation(np.argwhere(np.isfinite(cost)))[:2] + rng.uniform(0.05, 0.95, (2, 2))
    way, back = (
        find_way(cost, tuple(start), tuple(goal), margin=0.2),
        find_way(cost, tuple(goal), tuple(start), margin=0.2),
    )
    assert (way.cost, way.graph_cost) == (back.cost, back.graph_cost)
    np.testing.assert_array_equal(way.line, back.line[::-1])
    others = {
        "turned": (np.rot90(cost), lambda p: (60 - p[1], p[0])),
        "upside down": (cost[::-1], lambda p: (50 - p[0], p[1])),
        "transposed": (cost.T, lambda p: (p[1], p[0])),
    }
    for name, (turned, place) in others.items():
        other = find_way(turned, place(start), place(goal), margin=0.2)
        assert other.graph_cost == pytest.approx(way.graph_cost, rel=1e-12), name
        assert other.cost == pytest.approx(way.cost, rel=1e-9), name


def test_a_start_beside_closed_tiles_leads_away_from_them():
    cost = EVEN[:12, :12].copy()
    cost[4, 2:9] = np.inf
    cost[2:5, 8] = np.inf
    start, goal = (3.98, 7.99), (8.0, 5.0)
    way = find_way(cost, start, goal, margin=0.4)
    np.testing.assert_allclose(way.line[[0, -1]], [start, goal], rtol=0, atol=1e-9)
    assert gap_to_closed(cost, way.line[1:]) >= 0.4 - 1e-6
    assert gap_to_closed(cost, way.line[:2]) == pytest.approx(0.01, abs=1e-9)


@pytest.mark.parametrize(
    ("least", "margin", "message"),
    [(0.99, 0.0, "at least 1"), (np.nan, 0.0, "at least 1"), (1.0, 0.5, "margin is"), (1.0, np.nan, "margin is")],
)
def test_costs_and_margins_that_make_no_sense_are_refused(least, margin, message):
    cost = EVEN[:5, :5].copy()
    cost[2, 2] = least
    with pytest.raises(ValueError, match=message):
        find_way(cost, (1.0, 1.0), (3.0, 3.0), margin=margin)


@pytest.mark.parametrize("goal", [(4.5, 4.5), (-0.5, 2.0), (12.0, 3.0), (3.0, 1e9)])
def test_ends_in_closed_tiles_or_outside_have_no_way(goal):
    cost = EVEN[:12, :12].copy()
    cost[4, 4] = np.inf
    assert find_way(cost, (1.0, 1.0), goal) is None
    assert find_way(cost, goal, (1.0, 1.0)) is None
