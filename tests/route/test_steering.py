"""Ways past stones, on made-up maps with closed tiles of all kinds, against a plain search over pixels."""

import numpy as np
import pytest
import shapely
from route_oracles import cheapest_on_pixels
from tile_maps import TileMap

from bumpymap.core import Barred, RouteVehicle
from bumpymap.route.ground import CostGround
from bumpymap.route.measure import way_cost
from bumpymap.route.planner import Planner
from bumpymap.route.settings import CostSettings

ROWS, COLS = 26, 34
CODES = (Barred.SLOPE, Barred.OBSTACLE, Barred.UNKNOWN, Barred.STEP, Barred.SPLIT)


def stone_centres(site):
    """Middles of the pixels that hold stones, m."""
    return (np.floor(np.array(site.stones) / site.grid.pixel_size) + 0.5) * site.grid.pixel_size


def stony_map(seed):
    """A map with closed tiles and stones, some of them beside the ends; and the ends."""
    rng = np.random.default_rng(seed)
    barred = np.where(rng.random((ROWS, COLS)) < 0.18, rng.choice(CODES, size=(ROWS, COLS)), Barred.NO)
    vehicle = RouteVehicle("cart", float(rng.choice([1.0, 1.18, 1.38, 2.2])), 1.0)
    site = TileMap(rng.uniform(0.05, 0.5, (ROWS, COLS)), barred, vehicle=vehicle)
    site.stones = [tuple(site.at(*place)) for place in rng.uniform(0, (ROWS, COLS), (140, 2))]
    free = np.argwhere(site.passage(site.window))
    ends = [site.at(*(place + 0.5) / site.grid.pixels) for place in free[rng.integers(len(free), size=2)]]
    return site, np.array(ends)


@pytest.mark.parametrize("seed", [3, 5, 6, 13, 14, 28, 34, 50])
def test_a_way_touches_nothing_and_is_there_wherever_a_search_over_pixels_finds_one(seed):
    site, ends = stony_map(seed)
    ground = CostGround(site, CostSettings(), 10**7)
    line, back = Planner(ground).line(*ends), Planner(ground).line(*ends[::-1])
    start, goal = np.floor(ground.in_window(ends, site.window)).astype(int)
    best = cheapest_on_pixels(ground.on_pixels(site.window), start, goal, site.grid.pixel_size)
    if line is None:
        assert not np.isfinite(best)
        assert back is None
        return
    np.testing.assert_array_equal(line, back[::-1])
    assert way_cost(ground, line) <= 1.03 * best
    way = shapely.LineString(line)
    along = shapely.get_coordinates(shapely.line_interpolate_point(way, np.arange(0.0, way.length, 0.01)))
    apart = np.hypot(*(along[:, None] - stone_centres(site)).T).min(axis=0)
    assert apart.min() > 0.5 * site.vehicle.width_m - 0.01
    assert ground.is_clear(line)
