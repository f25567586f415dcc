import numpy as np
import pytest
from hypothesis import given, strategies as st

from bumpytiles import Bounds, Grid, TileWindow

coordinates = st.floats(-2e7, 2e7, allow_nan=False)
sizes = st.one_of(st.sampled_from([0.1, 0.3, 0.9, 1.5, 3.0, 1 / 3]), st.floats(0.05, 1000.0))


@given(coordinates, sizes)
def test_every_coordinate_lies_in_the_half_open_bounds_of_its_tile(coordinate, size):
    grid = Grid(tile_size=size)
    i = int(grid.index(np.array([coordinate]))[0])
    bounds = grid.bounds(i, i)
    assert bounds.west <= coordinate < bounds.east
    assert bounds.south <= coordinate < bounds.north


@given(st.integers(-10_000_000, 10_000_000), sizes)
def test_an_edge_belongs_to_the_tile_that_begins_there(i, size):
    grid = Grid(tile_size=size)
    edge = np.array([grid.bounds(i, 0).west])
    assert grid.index(edge)[0] == i
    assert grid.index(np.nextafter(edge, -np.inf))[0] == i - 1


def test_bounds_of_a_tile_and_of_a_window():
    grid = Grid(tile_size=3.0, pixels=15)
    assert grid.bounds(2, -1) == Bounds(6.0, -3.0, 9.0, 0.0)
    window = TileWindow.around(np.array([2, 4]), np.array([-1, 0]))
    assert window == TileWindow(2, -1, 3, 2)
    assert grid.window_bounds(window) == Bounds(6.0, -3.0, 15.0, 3.0)
    assert grid.pixel_size == pytest.approx(0.2)


@pytest.mark.parametrize(("size", "pixels"), [(0.0, 15), (-3.0, 15), (np.nan, 15), (np.inf, 15), (3.0, 0)])
def test_an_impossible_grid_is_refused(size, pixels):
    with pytest.raises(ValueError, match="must be"):
        Grid(tile_size=size, pixels=pixels)
