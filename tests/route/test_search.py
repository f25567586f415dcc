"""Ways over fields of costs, against graphs of scipy, closed forms, and distances by shapely."""

import math

import numpy as np
import pytest
from route_oracles import gap_to_closed, reach_by_graph, smooth_field, taut_length

from bumpymap.route._search_kernels import FROM_START, NOT_REACHED
from bumpymap.route.search import MOVES, find_way, spread
from bumpymap.route.straighten import is_clear, line_cost, trace, wide_margin


@pytest.mark.parametrize("seed", range(5))
def test_pieces_are_in_order_add_up_and_lie_in_their_tiles(seed):
    rng = np.random.default_rng(seed)
    cost = smooth_field(rng, (20, 30), width=0)
    line = rng.uniform(0, 1, (4, 2)) * cost.shape
    pieces = trace(cost, line)
    lengths = np.linalg.norm(np.diff(line, axis=0), axis=1)
    assert pieces.length.sum() == pytest.approx(lengths.sum(), rel=1e-12)
    assert (pieces.length * cost[pieces.row, pieces.col]).sum() == pytest.approx(line_cost(cost, line), rel=1e-12)
    middle = np.cumsum(pieces.length) - pieces.length / 2
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    r, c = (np.interp(middle, ends, line[:, axis]) for axis in (0, 1))
    np.testing.assert_array_equal(pieces.row, np.floor(r))
    np.testing.assert_array_equal(pieces.col, np.floor(c))
    step = np.abs(np.diff(pieces.row)) + np.abs(np.diff(pieces.col))
    assert step.max() <= 1  # from tile to neighbour; random lines go through no corner


@pytest.mark.parametrize("turned", [False, True])
def test_along_a_border_the_dearer_tile_counts(turned):
    cost = np.array([[1, 5, 1, 2], [3, 1, 1, 2]], np.float32)
    line = np.array([[1.0, 0.5], [1.0, 3.5]])
    cost, line = (cost.T.copy(), line[:, ::-1]) if turned else (cost, line)
    for way in (line, line[::-1]):
        assert line_cost(cost, way) == pytest.approx(0.5 * 3 + 5 + 1 + 0.5 * 2)
        pieces = trace(cost, way)
        assert (pieces.length * cost[pieces.row, pieces.col]).sum() == pytest.approx(line_cost(cost, way))
    cost = np.where(cost == 5, np.inf, cost)
    assert np.isinf(line_cost(cost, line))


@pytest.mark.parametrize("seed", range(3))
def test_through_corners_and_along_borders_turned_lines_cost_the_same(seed):
    """Corners at whole and half tiles: every special case of borders, in all turns of the map."""
    rng = np.random.default_rng(seed)
    cost = smooth_field(rng, (9, 9), width=0, closed=0.1)
    for _ in range(100):
        line = rng.integers(0, 19, (3, 2)) / 2
        total, clear = line_cost(cost, line), is_clear(cost, line, 0.2)
        for _ in range(4):
            cost, line = np.rot90(cost), np.column_stack([9 - line[:, 1], line[:, 0]])
            for turned, way in ((cost, line[::-1]), (cost[::-1], line * [-1, 1] + [9, 0])):
                assert line_cost(turned, way) == pytest.approx(total, rel=1e-12)
                assert is_clear(turned, way, 0.2) == clear
        if np.isfinite(total):
            pieces = trace(cost, line)
            assert (pieces.length * cost[pieces.row, pieces.col]).sum() == pytest.approx(total, rel=1e-12)


def test_on_the_edge_of_the_window_the_tile_inside_is_traced():
    cost = np.ones((3, 4), np.float32)
    edge = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 4.0], [0.0, 4.0], [0.0, 0.0]])
    pieces = trace(cost, edge)
    assert pieces.length.sum() == pytest.approx(14)
    assert (pieces.row.min(), pieces.row.max(), pieces.col.min(), pieces.col.max()) == (0, 2, 0, 3)
    with pytest.raises(ValueError, match="leaves the window"):
        trace(cost, np.array([[1.0, 1.0], [1.0, 4.01]]))


@pytest.mark.parametrize("margin", [0.0, 0.2, 0.45])
def test_clear_is_what_shapely_measures(margin):
    """Lines whose ends keep the margin, on random maps."""
    rng, clear = np.random.default_rng(int(100 * margin)), []
    for _ in range(150):
        cost = np.pad(smooth_field(rng, (8, 9), width=1, closed=0.25), 1, constant_values=np.inf)
        line = rng.permutation(np.argwhere(np.isfinite(cost)))[:3] + 0.5 + rng.uniform(-0.04, 0.04, (3, 2))
        gap = gap_to_closed(cost, line)
        assert is_clear(cost, line, margin) == (gap > 0 and gap >= margin)
        clear.append(gap >= margin and gap > 0)
    assert 0.05 < np.mean(clear) < 0.95


def test_ends_may_be_near_closed_tiles_but_the_way_may_come_no_nearer():
    cost = np.ones((8, 8), np.float32)
    cost[4:] = np.inf
    assert is_clear(cost, np.array([[3.9, 4.2], [3.5, 4.5], [2.0, 7.0]]), 0.4)  # straight away from it
    assert not is_clear(cost, np.array([[3.9, 2.0], [3.9, 6.0]]), 0.4)  # along it
    assert not is_clear(cost, np.array([[2.0, 2.0], [3.9, 4.0], [2.0, 6.0]]), 0.4)  # in the middle of a line
    assert is_clear(cost, np.array([[3.999, 4.2], [3.5, 4.5]]), 0.4)
    assert not is_clear(cost, np.array([[3.9, 4.2], [4.1, 4.5], [3.5, 4.5]]), 0.0)


EVEN = np.ones((100, 100), np.float32)


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


@pytest.mark.parametrize("goal", [(4.5, 4.5), (-0.5, 2.0), (12.0, 3.0), (3.0, 1e9)])
def test_ends_in_closed_tiles_or_outside_have_no_way(goal):
    cost = EVEN[:12, :12].copy()
    cost[4, 4] = np.inf
    assert find_way(cost, (1.0, 1.0), goal) is None
    assert find_way(cost, goal, (1.0, 1.0)) is None


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
