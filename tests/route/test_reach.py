"""What can be reached, against ways to single tiles and closed forms."""

import math
import tracemalloc

import numpy as np
import pytest
from tile_maps import TileMap

from bumpymap.core import Barred, UsageError
from bumpymap.route import follow_back
from bumpymap.route._window import BYTES_PER_TILE
from bumpymap.route.planner import Planner
from bumpymap.route.reach import find_reach
from bumpymap.route.search import NOT_REACHED
from bumpymap.route.settings import CostSettings


def test_on_even_ground_cost_and_minutes_follow_the_distance():
    site = TileMap(np.full((41, 41), 0.2))
    reach = find_reach(Planner(site, CostSettings(), 10**6), site.at(20.5, 20.5))
    row, col = np.mgrid[0:41, 0:41]
    distance = np.hypot(row - 20, col - 20) * 3.0
    away = distance > 0
    assert (reach.cost[away] / (2.0 * distance[away])).max() < 1.0076
    assert (reach.cost[away] / (2.0 * distance[away])).min() > 1.0 - 1e-6
    np.testing.assert_allclose(reach.minutes, reach.cost / 2.0 / 2.0 / 60.0, rtol=1e-5, atol=1e-6)
    assert reach.share == 1.0
    assert reach.area_ha == pytest.approx(41 * 41 * 9 / 1e4)


def test_minutes_are_those_of_the_way_that_the_back_links_give():
    rng = np.random.default_rng(3)
    barred = np.where(rng.random((40, 50)) < 0.3, Barred.STEP, Barred.NO)
    barred[20, 25] = Barred.NO
    site = TileMap(rng.gamma(2.0, 0.2, (40, 50)), barred)
    start = site.at(20.3, 25.8)
    reach = find_reach(Planner(site, CostSettings(), 10**6), start)
    assert (reach.back == NOT_REACHED).sum() > 100
    assert np.isnan(reach.cost[reach.back == NOT_REACHED]).all()
    assert np.isnan(reach.minutes[reach.back == NOT_REACHED]).all()
    for row, col in rng.permutation(np.argwhere(reach.back != NOT_REACHED))[:40]:
        line = np.concatenate([follow_back(reach.back, int(row), int(col)), [[20.3, 25.8]]])
        length = np.hypot(*np.diff(line, axis=0).T).sum() * 3.0
        assert reach.minutes[row, col] == pytest.approx(length / 2.0 / 60.0, rel=1e-5)


def test_a_limit_reads_a_window_and_keeps_what_lies_within():
    rng = np.random.default_rng(5)
    site = TileMap(rng.gamma(2.0, 0.1, (120, 150)))
    start = site.at(60.5, 70.5)
    whole = find_reach(Planner(site, CostSettings(), 10**6), start)
    part = find_reach(Planner(site, CostSettings(), 10**6), start, most_m=60.0)
    assert part.cost.size < whole.cost.size / 4
    top = site.south + 120 - part.window.row - part.window.rows
    left = part.window.col - site.west
    same = whole.cost[top : top + part.window.rows, left : left + part.window.cols]
    near = same <= 60.0
    assert near.sum() > 100
    np.testing.assert_array_equal(part.cost[near], same[near])


def test_what_does_not_fit_in_memory_is_refused():
    site = TileMap(np.full((30, 30), 0.1))
    with pytest.raises(UsageError, match="900 tiles; 500 fit"):
        find_reach(Planner(site, CostSettings(), 500), site.at(3.5, 3.5), math.inf)


def test_the_field_takes_no_more_memory_than_the_search():
    """A map may fill the limit."""
    rng = np.random.default_rng(6)
    site = TileMap(rng.uniform(0.05, 0.5, (300, 300)), np.where(rng.random((300, 300)) < 0.1, Barred.SLOPE, Barred.NO))
    plan = Planner(site, CostSettings(), 10**6)
    cost = plan.load(site.window)
    start = site.at(*(np.argwhere(site.barred == Barred.NO)[0] + 0.5))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Planner, "load", lambda *_: cost.copy())
        find_reach(plan, start)  # compiles
        tracemalloc.start()
        find_reach(plan, start)
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert most < 1.3 * BYTES_PER_TILE * cost.size
