"""Yards within walls, surveyed and mapped: nothing gets in or out but through a gap that the vehicle fits through."""

import numpy as np
import pytest
from ring_maps import SIDE_M, TOOLS, Yard

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("gap", "thickness", "density", "classified"),
    [(0.0, 0.1, 50, True), (0.0, 0.3, 20, True), (0.0, 0.2, 50, False), (1.0, 0.2, 50, True), (2.3, 0.2, 50, True)],
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
