"""What can be reached, against ways to single tiles and closed forms."""

import math
import tracemalloc
from itertools import pairwise

import numpy as np
import pytest
from tile_maps import TileMap

from bumpymap.core import Barred, UsageError
from bumpymap.route.ground import CostGround
from bumpymap.route.planner import Planner
from bumpymap.route.reach import find_reach
from bumpymap.route.search import BYTES_PER_TILE, NOT_REACHED, follow_back, spread
from bumpymap.route.settings import CostSettings


def test_on_even_ground_cost_and_minutes_follow_the_distance():
    site = TileMap(np.full((41, 41), 0.2))
    reach = find_reach(CostGround(site, CostSettings(), 10**6), site.at(20.5, 20.5))
    row, col = np.mgrid[0:41, 0:41]
    distance = np.hypot(row - 20, col - 20) * 3.0
    away = distance > 0
    assert (reach.cost[away] / (2.0 * distance[away])).max() < 1.0076
    assert (reach.cost[away] / (2.0 * distance[away])).min() > 1.0 - 1e-6
    np.testing.assert_allclose(reach.minutes, reach.cost / 2.0 / 2.0 / 60.0, rtol=1e-5, atol=1e-6)
    assert reach.share == 1.0
    assert reach.area_ha == pytest.approx(41 * 41 * 9 / 1e4)


def test_minutes_are_those_of_the_way_by_moves():
    rng = np.random.default_rng(3)
    barred = np.where(rng.random((40, 50)) < 0.3, Barred.STEP, Barred.NO)
    barred[20, 25] = Barred.NO
    site = TileMap(rng.gamma(2.0, 0.2, (40, 50)), barred)
    start = site.at(20.3, 25.8)
    ground = CostGround(site, CostSettings(), 10**6)
    reach = find_reach(ground, start)
    _, back = spread(ground.on_tiles(reach.window, through=False), (20.3, 25.8), margin=ground.margin)
    assert (back == NOT_REACHED).sum() > 100
    assert np.isnan(reach.cost[back == NOT_REACHED]).all()
    assert np.isnan(reach.minutes[back == NOT_REACHED]).all()
    for row, col in rng.permutation(np.argwhere(back != NOT_REACHED))[:40]:
        line = np.concatenate([follow_back(back, int(row), int(col)), [[20.3, 25.8]]])
        length = np.hypot(*np.diff(line, axis=0).T).sum() * 3.0
        assert reach.minutes[row, col] == pytest.approx(length / 2.0 / 60.0, rel=1e-5)


def test_a_limit_reads_a_window_and_keeps_what_lies_within():
    rng = np.random.default_rng(5)
    site = TileMap(rng.gamma(2.0, 0.1, (120, 150)))
    start = site.at(60.5, 70.5)
    whole = find_reach(CostGround(site, CostSettings(), 10**6), start)
    part = find_reach(CostGround(site, CostSettings(), 10**6), start, most_m=60.0)
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
        find_reach(CostGround(site, CostSettings(), 500), site.at(3.5, 3.5), math.inf)


def test_the_field_takes_no_more_memory_than_the_search():
    """A map may fill the limit."""
    rng = np.random.default_rng(6)
    site = TileMap(rng.uniform(0.05, 0.5, (300, 300)), np.where(rng.random((300, 300)) < 0.1, Barred.SLOPE, Barred.NO))
    ground = CostGround(site, CostSettings(), 10**6)
    cost = ground.on_tiles(site.window, through=False)
    start = site.at(*(np.argwhere(site.barred == Barred.NO)[0] + 0.5))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(CostGround, "on_tiles", lambda *_, **__: cost.copy())
        find_reach(ground, start)  # compiles
        tracemalloc.start()
        find_reach(ground, start)
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert most < 1.3 * BYTES_PER_TILE * cost.size


def walled(gap):
    """30 x 40 tiles with a wall from north to south; ``gap`` [m] in it, in the middle of a tile; and a start."""
    barred = np.zeros((30, 40), np.uint8)
    barred[:, 20] = Barred.SPLIT
    site = TileMap(np.full((30, 40), 0.2), barred)
    (east, south), (_, middle), (_, north) = (site.at(row, 20.5) for row in (30, 10.5, 0))
    wall = np.arange(south + 0.1, north, 0.2)
    site.stones = [(east + 0.1, float(y)) for y in wall if abs(y - middle) >= 0.5 * gap]
    return site, site.at(15.5, 8.5)


def test_what_lies_behind_a_gap_is_reached_at_the_cost_of_a_way_there():
    site, start = walled(2.6)
    ground = CostGround(site, CostSettings(), 10**6)
    planner, reach = Planner(ground), find_reach(ground, start)
    assert np.isfinite(reach.cost).all()
    assert reach.share == 1.0
    for row, col in ((10, 21), (2, 30), (28, 39), (15, 24)):
        cost = planner.leg_cost(start, site.at(row + 0.5, col + 0.5))
        # A way keeps room at the corners of the gap, for which it is up to a few percent longer.
        assert reach.cost[row, col] == pytest.approx(cost, rel=0.06), (row, col)
        assert reach.minutes[row, col] == pytest.approx(reach.cost[row, col] / 2.0 / 2.0 / 60.0, rel=1e-4)


def corridor(apart):
    """10 x 10 tiles, split by a wall with a diagonal corridor, ``apart`` pixels wide along rows; start and goal."""
    barred = np.zeros((10, 10), np.uint8)
    barred[:, 4:7] = Barred.SPLIT
    site, half = TileMap(np.full((10, 10), 0.2), barred), apart // 2
    along = np.arange(13)
    north, south = np.stack([60 + along, 75 + half + along], 1), np.stack([60 + half + along, 75 + along], 1)
    to_north = np.stack(np.broadcast_arrays(np.arange(60), north[0, 1]), 1)
    to_south = np.stack(np.broadcast_arrays(np.arange(south[-1, 0], 150), south[-1, 1]), 1)
    pixels = np.concatenate([north, to_north, south, to_south])
    site.stones = [tuple(map(float, site.at(*((pixel + 0.5) / 15)))) for pixel in pixels]
    return site, site.at(5.5, 1.5), site.at(5.5, 8.5)


def test_a_way_leads_over_corners_of_pixels_where_half_the_width_is_free():
    """Of the pixels of a corridor in which the middle fits, each touches the next at a corner alone."""
    site, start, goal = corridor(12)
    ground = CostGround(site, CostSettings(), 10**6)
    line = Planner(ground).line(start, goal)
    steps = [np.linspace(a, b, 200) for a, b in pairwise(line)]
    gap = np.hypot(*(np.concatenate(steps)[:, None] - np.array(site.stones)).transpose(2, 0, 1)).min()
    assert 0.5 * site.vehicle.width_m < gap < 0.5 * site.vehicle.width_m + 0.2
    reach = find_reach(ground, start)
    assert np.isfinite(reach.cost).all()
    assert reach.cost[5, 8] == pytest.approx(Planner(ground).leg_cost(start, goal), rel=0.15)  # by areas, straight


def test_without_the_memory_for_it_only_whole_tiles_are_searched_and_that_is_said():
    site, start = walled(2.6)
    reach = find_reach(CostGround(site, CostSettings(), 2000), start)
    assert np.isnan(reach.cost[:, 21:]).all()
    (note,) = reach.notes
    assert "between obstacles were not looked for" in note
