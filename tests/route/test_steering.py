"""Ways past stones, on made-up maps with closed tiles of all kinds, against shapely."""

import numpy as np
import pytest
import shapely
from tile_maps import TileMap

from bumpymap.core import Barred, RouteVehicle
from bumpymap.route.obstacles import touches_along
from bumpymap.route.planner import Planner
from bumpymap.route.settings import CostSettings

ROWS, COLS = 26, 34
CODES = (Barred.SLOPE, Barred.OBSTACLE, Barred.UNKNOWN, Barred.STEP)


def stone_centres(site):
    """Middles of the pixels that hold stones, m."""
    return (np.floor(np.array(site.stones) / site.grid.pixel_size) + 0.5) * site.grid.pixel_size


def squares(site, row, col):
    """Tiles as polygons, m."""
    size = site.grid.tile_size
    west, south = (site.west + col) * size, (site.south + len(site.c_r) - 1 - row) * size
    return shapely.box(west, south, west + size, south + size)


def stony_map(seed):
    """A map with closed tiles and stones, some of them beside the ends; and the ends."""
    rng = np.random.default_rng(seed)
    barred = np.where(rng.random((ROWS, COLS)) < 0.18, rng.choice(CODES, size=(ROWS, COLS)), Barred.NO)
    vehicle = RouteVehicle("cart", float(rng.choice([1.0, 1.18, 1.38, 2.2])), 1.0)
    site = TileMap(rng.uniform(0.05, 0.5, (ROWS, COLS)), barred, vehicle=vehicle)
    free = np.argwhere(barred == Barred.NO)
    ends = [site.at(*place) for place in free[rng.integers(len(free), size=2)] + rng.uniform(0.05, 0.95, (2, 2))]
    stones = [site.at(*place) for place in rng.uniform(0, (ROWS, COLS), (40, 2))]
    site.stones = [tuple(stone) for stone in [*stones, *(end + rng.normal(size=2) * 0.6 for end in ends)]]
    return site, np.array(ends)


@pytest.mark.parametrize("seed", [3, 5, 6, 13, 14, 28, 34, 50, *range(100, 108)])
def test_ways_keep_clear_of_closed_tiles_whatever_stones_lie_on_them(seed):
    site, ends = stony_map(seed)
    plan = Planner(site, CostSettings(), 10**7)
    way = plan.way(ends)
    back = Planner(site, CostSettings(), 10**7).way(ends[::-1])
    if way is None:
        assert back is None
        return
    assert way.measured.figures.cost_m == pytest.approx(back.measured.figures.cost_m, rel=1e-9)
    line = shapely.LineString(way.line)
    row, col = np.nonzero(site.barred != Barred.NO)
    closed = squares(site, row, col)
    site_box = shapely.union_all(squares(site, np.array([0, ROWS - 1]), np.array([0, COLS - 1]))).envelope
    assert shapely.length(shapely.intersection(line, closed)).sum() < 1e-6
    assert shapely.covers(site_box, line)
    # Ends may lie nearer to closed tiles. Of tiles that obstacles close, the vehicle may overlap what is free.
    middle = shapely.difference(line, shapely.union_all(shapely.buffer(shapely.points(ends), 4.3)))
    hard = closed[site.barred[row, col] != Barred.OBSTACLE]
    assert middle.is_empty or shapely.distance(middle, hard).min() >= plan.margin * site.grid.tile_size - 1e-6
    along = shapely.get_coordinates(shapely.line_interpolate_point(line, np.arange(0.0, line.length, 0.01)))
    apart = np.hypot(*(along[:, None] - stone_centres(site)).T).min(axis=0)
    told = way.measured.figures.obstacle_m
    assert told == pytest.approx(0.01 * (apart < plan.reach_m).sum(), abs=0.3)
    assert told > 0.0 or apart.min() > plan.reach_m - 0.01


@pytest.mark.parametrize("reach", [0.3, 0.6, 0.79])
def test_every_point_near_a_stone_is_found(reach):
    rng = np.random.default_rng(8)
    site = TileMap(np.full((20, 20), 0.1))
    site.stones = [tuple(site.at(*place)) for place in rng.uniform(0, 20, (400, 2))]
    points = np.array([site.at(*place) for place in rng.uniform(1, 19, (3000, 2))])
    apart = np.hypot(*(points[:, None] - stone_centres(site)).T).min(axis=0)
    np.testing.assert_array_equal(touches_along(site, points, reach).near, apart < reach)
