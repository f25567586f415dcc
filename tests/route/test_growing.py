"""Windows that grow until no way outside of them can be cheaper, against the same search over the whole map."""

import numpy as np
import pytest
from route_oracles import smooth_field
from tile_maps import WARTHOG, TileMap

from bumpymap.core import Barred, UsageError
from bumpymap.route import CostSettings
from bumpymap.route.ground import CostGround
from bumpymap.route.places import in_window
from bumpymap.route.planner import tile_line
from bumpymap.route.search import find_way
from bumpymap.route.straighten import line_cost

ROWS, COLS = 120, 140
MARGIN = WARTHOG.reach_m / 3.0


def map_with_walls(seed):
    """Walls through most of the map, in a random direction: ways must go far around."""
    rng = np.random.default_rng(seed)
    cost = smooth_field(rng, (ROWS, COLS), most=3, width=2)
    for _ in range(4):
        row, col, half = rng.integers(5, 115), rng.integers(5, 135), rng.integers(20, 70)
        if rng.random() < 0.5:
            cost[row, max(0, col - half) : col + half] = np.inf
        else:
            cost[max(0, row - half) : row + half, col] = np.inf
    start, goal = rng.permutation(np.argwhere(np.isfinite(cost)))[:2] + rng.random((2, 2))
    return cost, tuple(start), tuple(goal)


def plan(cost, start, goal, memory_tiles=10**6):
    """Plan over tiles of such costs; return the line in field coordinates, and the windows that were read."""
    site = TileMap((np.where(np.isfinite(cost), cost, 1.0) - 1.0) / 5.0, np.where(np.isfinite(cost), 0, Barred.SLOPE))
    ground = CostGround(site, CostSettings(), memory_tiles)
    line = tile_line(ground, site.at(*start), site.at(*goal))
    return None if line is None else in_window(line, site.grid, site.window), site.windows


@pytest.mark.parametrize("seed", range(6))
def test_a_grown_window_gives_the_way_of_the_whole_map(seed):
    cost, start, goal = map_with_walls(seed)
    line, windows = plan(cost, start, goal)
    whole = find_way(cost, start, goal, margin=MARGIN)
    assert windows
    if whole is None:
        assert line is None
        return
    assert line_cost(cost, line) == pytest.approx(whole.cost, rel=1e-6)
    np.testing.assert_allclose(line[[0, -1]], [start, goal], rtol=0, atol=1e-6)


def test_a_start_that_is_walled_in_is_found_without_reading_the_whole_map():
    cost = np.ones((ROWS, COLS), np.float32)
    cost[50:61, 50:61] = np.inf
    cost[51:60, 51:60] = 1.0
    line, windows = plan(cost, (55.0, 55.0), (80.0, 90.0))
    assert line is None
    assert all(each.rows < ROWS for each in windows)


@pytest.mark.parametrize("goal", [(-1.0, 5.0), (121.0, 5.0), (5.0, 141.0)])
def test_ends_outside_the_map_have_no_way(goal):
    assert plan(np.ones((ROWS, COLS), np.float32), (5.0, 5.0), goal) == (None, [])


def test_a_window_that_memory_does_not_hold_is_refused():
    cost = np.ones((ROWS, COLS), np.float32)
    cost[60, :-1] = np.inf  # a way around it leads along the whole map
    with pytest.raises(UsageError, match=r"tiles or more, .* GB of memory; allowed are 5000 tiles.*via points"):
        plan(cost, (50.0, 20.0), (70.0, 20.0), memory_tiles=5000)
    line, windows = plan(cost, (50.0, 20.0), (70.0, 20.0))
    assert line_cost(cost, line) > 200
    assert len(windows) > 1
