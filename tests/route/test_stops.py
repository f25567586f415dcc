"""Start and goal at the edges of tiles and maps, and how far around them is looked."""

import numpy as np
import pytest
from route_maps import write_folder
from route_sites import COLS, ROWS, SOUTH, WEST, place, site
from tile_maps import TileMap

from bumpymap.core import BadInputError, Barred
from bumpymap.layers import open_map
from bumpymap.route import RouteConfig, plan_routes
from bumpymap.route.ground import CostGround
from bumpymap.route.places import place_in_window
from bumpymap.route.planner import Planner
from bumpymap.route.settings import CostSettings
from bumpymap.route.stops import find_stops

GOAL = place(1.5, 28.5)


@pytest.fixture(scope="module")
def layers(tmp_path_factory):
    return write_folder(tmp_path_factory.mktemp("stops") / "layers", site())


def stops(layers, **settings):
    config = RouteConfig(layers, goal=GOAL, **settings)
    return find_stops(CostGround(open_map(layers), config.cost, 10**7), config)


def test_a_point_beside_the_map_is_moved_onto_it(layers):
    outside = place(10.5, -0.5)
    with pytest.raises(BadInputError, match="outside the map"):
        stops(layers, start=outside, snap=1.4)
    found = stops(layers, start=outside, snap=4.0)
    assert found.points[0] == pytest.approx(np.array([WEST * 3.0 + 0.1, (SOUTH + ROWS - 10.5) * 3.0]))
    assert "moved by 1.9 m" in found.notes[0]


def test_points_on_the_sides_of_the_map_lie_in_their_tiles(layers):
    corner = f"{WEST * 3.0},{SOUTH * 3.0}"
    with pytest.raises(BadInputError, match="unknown ground"):
        stops(layers, start=corner)
    found = plan_routes(RouteConfig(layers, start=place(ROWS, COLS - 0.5), goal=GOAL))
    assert found.routes[0].stops[0].tolist() == [(WEST + COLS - 0.5) * 3.0, SOUTH * 3.0]


@pytest.mark.parametrize("south", [712_000, 1_700_001, -3])
def test_a_point_on_a_border_lies_in_the_tile_north_of_it(south):
    barred = np.zeros((12, 9), np.uint8)
    barred[6] = Barred.SLOPE
    site = TileMap(np.full(barred.shape, 0.1), barred, south=south)
    plan = Planner(CostGround(site, CostSettings(), 10**6))
    assert np.floor(place_in_window(site.at(6.0, 3.0), site.grid, site.window)).tolist() == [5.0, 3.0]
    assert plan.line(site.at(5.5, 3.0), site.at(1.0, 8.0)) is not None
    assert plan.line(site.at(5.5, 3.0), site.at(11.0, 8.0)) is None
