"""Yards within walls, surveyed and mapped: nothing gets in or out but through a gap that the vehicle fits through."""

import math
import re

import numpy as np
import pytest
from pyproj import Transformer
from ring_maps import SIDE_M, TOOLS, Yard, read_graph
from scipy.sparse.csgraph import dijkstra

import bumpymap
from bumpymap.layers import open_map

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("gap", "thickness", "density", "classified"),
    [
        (0.0, 0.1, 50, True),
        (0.0, 0.3, 20, True),
        (0.0, 0.2, 50, False),
        (1.0, 0.2, 50, True),
        (1.0, 0.3, 50, False),
        (2.3, 0.2, 50, True),
        (2.3, 0.1, 20, False),
        (2.3, 0.3, 50, False),
    ],
)
def test_a_wall_is_a_wall_for_all_that_read_the_map(tmp_path, gap, thickness, density, classified):
    yard = Yard(gap, thickness, density, classified, seed=int(100 * gap + 10 * thickness + density))
    layers = yard.map(tmp_path)
    fits = gap >= 2.0
    way = yard.way_out(layers)
    assert (way is not None) == fits
    if fits:
        line, obstacle_m = way
        assert abs(np.interp(0.5 * SIDE_M, *line.T)) < 0.5 * gap - 0.4
        assert obstacle_m == 0.0
    assert yard.is_reached(layers) == fits
    assert yard.crossed_by_tools(layers) == dict.fromkeys(TOOLS, fits)


def test_a_solver_that_follows_the_graph_goes_where_a_route_goes(tmp_path):
    yard = Yard(2.3, 0.2, 50, classified=True, seed=7)
    layers = yard.map(tmp_path)
    places, costs = read_graph(open_map(layers), tmp_path / "graph")
    start, goal = (int(np.hypot(*(places - end).T).argmin()) for end in yard.ends)
    spent, before = dijkstra(costs, indices=start, return_predecessors=True)
    nodes = [goal]
    while nodes[-1] != start:
        nodes.append(before[nodes[-1]])
    (route,) = bumpymap.find_routes(layers, tuple(places[start]), tuple(places[goal]))
    assert route.figures.cost_m <= spent[goal] < 1.08 * route.figures.cost_m
    for line in (places[nodes[::-1]], route.line):
        x, y = yard.place.in_scene(*line.T)
        assert abs(np.interp(0.5 * SIDE_M, x, y)) < 0.5 * 2.3 - 0.4


def test_without_a_way_the_message_names_the_gap_that_is_too_narrow(tmp_path):
    yard = Yard(2.0, 0.2, 50, classified=True, seed=4)
    layers = yard.map(tmp_path, vehicle="car")
    with pytest.raises(bumpymap.BadInputError) as raised:
        bumpymap.find_routes(layers, *yard.ends, snap=6.0)
    said = re.search(r"widest opening .* (\S+),(\S+) \(longitude, latitude\), about (\S+) m wide", str(raised.value))
    longitude, latitude, width = map(float, said.groups())
    place = Transformer.from_crs(4326, 32632, always_xy=True).transform(longitude, latitude)
    assert math.dist(place, yard.place.of_scene(0.5 * SIDE_M + 0.1, 0.0)) < 0.6
    assert 1.5 < width < 2.0
