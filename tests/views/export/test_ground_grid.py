"""Grids of classified sectors: each cell against the sector that its centre lies in."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from bumpymap.core import PolarSettings, Scan, UsageError
from bumpymap.scan import polar_sectors
from bumpymap.views import GroundGrid
from bumpymap.views.export.grid_bag import sector_occupancy

GRIDS = [
    PolarSettings(),
    PolarSettings(anchored=False),
    PolarSettings((1.0, 4.0, 12.0), 28.0, (16, 24, 40), (2, 4, 4)),
    PolarSettings((0.0,), 25.0, (7,), (3,)),
]


def centres(grid):
    axis = (np.arange(grid.side) + 0.5) * grid.resolution_m - grid.reach_m
    return np.meshgrid(axis, axis)  # x grows along a row, y from row to row


@settings(max_examples=25)
@given(st.integers(0, 2**31), st.sampled_from(GRIDS), st.floats(0.2, 1.0), st.floats(1.0, 40.0))
def test_points_and_cells_agree(seed, polar, resolution, reach):
    """The kernels that sort points into sectors are the oracle: here the points are the centres of the cells."""
    grid = GroundGrid(resolution, reach)
    x, y = centres(grid)
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]).astype(np.float32)
    points[:, 2] = np.random.default_rng(seed).normal(-1.0, 0.01, len(points))
    stack = polar_sectors(Scan(points), replace(polar, least_points=3))
    same = grid.rows(stack).ravel() == stack.point_sector
    # Points are float32, so those on a border may fall to the other side: at most a diagonal or two of the cells.
    assert (~same).sum() <= 2 * grid.side


def test_occupancy_says_class_and_obstacle(classed):
    classed = replace(classed, sectors=replace(classed.sectors, obstacle=np.arange(len(classed.class_id)) % 5 == 0))
    values = sector_occupancy(classed)
    expected = [
        100 if obstacle else {0: 0, 1: 33, 2: 66, 255: 100}[class_id]
        for class_id, obstacle in zip(classed.class_id.tolist(), classed.sectors.obstacle.tolist(), strict=True)
    ]
    assert values.tolist() == expected
    assert {0, 66, 100} <= set(expected)
    grid = GroundGrid()
    everywhere = replace(classed.sectors, ground_end=np.full(1, np.inf, np.float32))
    cells, rows = grid.occupancy(replace(classed, sectors=everywhere)), grid.rows(classed.sectors)
    np.testing.assert_array_equal(cells[rows >= 0], values[rows[rows >= 0]])
    assert (cells[rows < 0] == -1).all()
    assert (rows < 0).any()


def test_beyond_the_end_of_the_ground_only_what_bars_the_way_is_known(scan, classed):
    grid = GroundGrid()
    ended = replace(classed, sectors=replace(classed.sectors, ground_end=np.full(4, 8.0, np.float32)))
    near, bars = np.hypot(*centres(grid)) < 8.0, grid.occupancy(classed) == 100
    cells = grid.occupancy(ended)
    beyond = ~near & (np.hypot(*centres(grid)) > 8.5)
    np.testing.assert_array_equal(cells[near], grid.occupancy(classed)[near])
    np.testing.assert_array_equal(cells[beyond], np.where(bars, 100, -1)[beyond])
    assert np.isnan(grid.layers(scan, ended)["class"][beyond]).all()


def test_layers_are_those_of_the_sectors_and_the_mean_height_of_ground(scan, classed):
    grid = GroundGrid(0.5, 20.0)
    layers, rows = grid.layers(scan, classed), grid.rows(classed.sectors)
    assert list(layers) == ["class", "elevation", "obstacle_height", "ground"]
    stack, seen = classed.sectors, rows >= 0
    known = seen & (np.hypot(*centres(grid)) < 12.0)  # the ground goes on
    class_id = classed.class_id[rows[known]]
    np.testing.assert_array_equal(np.nan_to_num(layers["class"][known], nan=255), class_id)
    share = (stack.ground_count / stack.count).astype(np.float32)
    np.testing.assert_array_equal(layers["ground"][seen], share[rows[seen]])
    np.testing.assert_array_equal(layers["obstacle_height"][seen], stack.obstacle_height[rows[seen]])
    for name in ("class", "ground", "obstacle_height"):
        assert np.isnan(layers[name][~seen]).all()
    rng = np.random.default_rng(0)
    ground = scan.points[stack.point_ground].astype(float)
    for row, col in rng.integers(0, grid.side, (200, 2)).tolist():
        low = np.array([col, row]) * 0.5 - 20.0
        z = ground[((ground[:, :2] >= low) & (ground[:, :2] < low + 0.5)).all(axis=1), 2]
        found = layers["elevation"][row, col]
        assert np.isnan(found) if not len(z) else found == pytest.approx(z.mean(), abs=1e-5)
    assert np.isfinite(layers["elevation"]).mean() > 0.3


def test_a_message_is_filled_by_its_attributes(classed):
    part = SimpleNamespace
    message = part(info=part(origin=part(position=part(x=0.0, y=0.0, z=0.0), orientation=part(w=0.0))))
    header = part(frame_id="lidar", stamp=part(sec=3, nanosec=4))
    grid = GroundGrid(0.4, 10.0)
    assert grid.fill(message, classed, header) is message
    assert message.header is header
    assert (message.info.width, message.info.height, message.info.resolution) == (50, 50, 0.4)
    assert (message.info.origin.position.x, message.info.origin.position.y) == (-10.0, -10.0)
    assert message.data.typecode == "b"
    np.testing.assert_array_equal(np.array(message.data, np.int8).reshape(50, 50), grid.occupancy(classed))


@pytest.mark.parametrize(
    ("resolution", "reach", "said"),
    [
        (np.nan, 5.0, "resolution_m is nan; it must be a finite number greater than 0 m"),
        (2.0, 1.0, "at most 4,000,000"),
        (0.01, 50.0, "at most 4,000,000"),
    ],
)
def test_grids_without_cells_or_with_too_many(resolution, reach, said):
    with pytest.raises(UsageError, match=said):
        GroundGrid(resolution, reach)
