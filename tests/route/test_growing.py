import numpy as np
import pytest
from route_oracles import smooth_field

from bumpymap.core import UsageError
from bumpymap.route.planner import plan_way
from bumpymap.route.search import find_way
from bumpytiles import TileWindow

EXTENT = TileWindow(-40, 1000, 140, 120)


class Map:
    """A map that is read by windows, and the windows."""

    def __init__(self, cost):
        self.cost, self.windows = cost, []

    def __call__(self, window):
        self.windows.append(window)
        top = EXTENT.row + EXTENT.rows - window.row - window.rows
        left = window.col - EXTENT.col
        assert top >= 0
        assert left >= 0
        read = self.cost[top : top + window.rows, left : left + window.cols]
        assert read.shape == (window.rows, window.cols)
        return read


def map_with_walls(seed):
    """Walls through most of the map, in a random direction: ways must go far around."""
    rng = np.random.default_rng(seed)
    cost = smooth_field(rng, (EXTENT.rows, EXTENT.cols), most=3, width=2)
    for _ in range(4):
        row, col, half = rng.integers(5, 115), rng.integers(5, 135), rng.integers(20, 70)
        if rng.random() < 0.5:
            cost[row, max(0, col - half) : col + half] = np.inf
        else:
            cost[max(0, row - half) : row + half, col] = np.inf
    start, goal = rng.permutation(np.argwhere(np.isfinite(cost)))[:2] + rng.random((2, 2))
    return cost, tuple(start), tuple(goal)


def plan(reading, start, goal, **settings):
    return plan_way(reading, EXTENT, start, goal, **{"margin": 0.2, "memory_tiles": 10**6} | settings)


@pytest.mark.parametrize("seed", range(12))
def test_a_grown_window_gives_the_way_of_the_whole_map(seed):
    cost, start, goal = map_with_walls(seed)
    reading = Map(cost)
    way, whole = plan(reading, start, goal), find_way(cost, start, goal, margin=0.2)
    if whole is None:
        assert way is None
        return
    assert way.graph_cost == pytest.approx(whole.graph_cost, rel=1e-12)
    assert way.cost == pytest.approx(whole.cost, rel=1e-9)
    np.testing.assert_allclose(way.line[[0, -1]], [start, goal], rtol=0, atol=1e-9)
    back = plan(Map(cost), goal, start)
    assert (back.cost, back.graph_cost) == (way.cost, way.graph_cost)
    np.testing.assert_array_equal(back.line[::-1], way.line)


def test_a_start_that_is_walled_in_is_found_without_reading_the_whole_map():
    cost = np.ones((EXTENT.rows, EXTENT.cols), np.float32)
    cost[50:61, 50:61] = np.inf
    cost[51:60, 51:60] = 1.0
    reading = Map(cost)
    assert plan(reading, (55.0, 55.0), (80.0, 90.0)) is None
    assert all(each.rows < EXTENT.rows for each in reading.windows)


@pytest.mark.parametrize("goal", [(-1.0, 5.0), (120.0, 5.0), (5.0, 140.0)])
def test_ends_outside_the_map_have_no_way(goal):
    reading = Map(np.ones((EXTENT.rows, EXTENT.cols), np.float32))
    assert plan(reading, (5.0, 5.0), goal) is None
    assert not reading.windows


def test_a_window_that_memory_does_not_hold_is_refused_before_it_is_read():
    cost = np.ones((EXTENT.rows, EXTENT.cols), np.float32)
    cost[60, :-1] = np.inf  # a way around it leads along the whole map
    reading = Map(cost)
    with pytest.raises(UsageError, match=r"tiles or more, .* GB of memory; allowed are 5000 tiles.*via points"):
        plan(reading, (50.0, 20.0), (70.0, 20.0), memory_tiles=5000)
    assert reading.windows
    assert max(each.rows * each.cols for each in reading.windows) <= 5000
    assert plan(Map(cost), (50.0, 20.0), (70.0, 20.0)).cost > 200
    reading = Map(cost)
    with pytest.raises(UsageError, match="allowed are 100 tiles"):
        plan(reading, (50.0, 20.0), (70.0, 20.0), memory_tiles=100)
    assert not reading.windows
