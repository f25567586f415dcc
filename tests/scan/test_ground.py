"""The ground of scans: made-up ground whose height is known at every point, and real labelled frames."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from bumpymap.core import PolarSettings, Scan
from bumpymap.readers import read_scan
from bumpymap.scan import classify_filter, polar_sectors
from bumpymap.scan.ground import SectorBuffers

GRID = PolarSettings()


def rings(seed=0, far=50.0, lines=60, columns=900):
    """Places of the returns of a spinning sensor on open ground, (n, 2) m."""
    rng = np.random.default_rng(seed)
    r = 1.2 * (far / 1.2) ** np.linspace(0, 1, lines)[:, None] * np.ones(columns)
    turn = rng.uniform(0, 2 * np.pi, (lines, columns))
    return np.column_stack([(r * np.cos(turn)).ravel(), (r * np.sin(turn)).ravel()])


def plane(places, slope_deg=0.0, heading=0.0, height=-1.2):
    slope = math.tan(math.radians(slope_deg))
    return height + slope * (places[:, 0] * math.cos(heading) + places[:, 1] * math.sin(heading))


def stack_of(xy, z, **changes):
    points = np.column_stack([xy, z]).astype(np.float32)
    return polar_sectors(Scan(points), PolarSettings(**changes) if changes else None)


def box(rng, x, y, side, low, high, count=400):
    """Points on the sides and the top of a box."""
    place = rng.uniform(-0.5, 0.5, (count, 2)) * side
    edge = rng.integers(0, 3, count)
    place[edge == 0, 0] = np.sign(place[edge == 0, 0]) * side / 2
    place[edge == 1, 1] = np.sign(place[edge == 1, 1]) * side / 2
    z = np.where(edge == 2, high, rng.uniform(low, high, count))
    return np.column_stack([place + np.array([x, y]), z])


@settings(max_examples=12, deadline=None)
@given(
    slope=st.floats(0, 34),
    heading=st.floats(0, 6.28),
    height=st.floats(-2.0, -0.4),
    noise=st.floats(0, 0.02),
    seed=st.integers(0, 9),
)
def test_a_plane_of_any_slope_that_can_be_driven_is_ground_and_heights_stand_on_it(slope, heading, height, noise, seed):
    xy = rings(seed)
    z = plane(xy, slope, heading, height) + noise * np.random.default_rng(seed).standard_normal(len(xy))
    stack = stack_of(xy, z)
    assert stack.point_ground.mean() > 0.995
    assert (
        np.abs(
            stack.point_height[stack.point_ground] - (z - plane(xy, slope, heading, height))[stack.point_ground]
        ).max()
        < 0.05
    )
    assert stack.traversable.mean() > 0.99
    assert not stack.obstacle.any()


def test_boxes_are_obstacles_on_ground_and_crowns_are_overhead():
    rng = np.random.default_rng(1)
    xy = rings(1)
    ground = np.column_stack([xy, plane(xy, 5.0) + 0.01 * rng.standard_normal(len(xy))])
    cars = [
        box(rng, x, y, 2.0, plane(np.array([[x, y]]), 5.0)[0], plane(np.array([[x, y]]), 5.0)[0] + 1.2)
        for x, y in ((8, 3), (-6, -9), (0, 15))
    ]
    crown_xy = np.column_stack([rng.uniform(10, 20, 3000), rng.uniform(-12, -4, 3000)])
    crown = np.column_stack([crown_xy, plane(crown_xy, 5.0) + rng.uniform(3.0, 5.0, 3000)])
    kinds = np.concatenate([np.zeros(len(ground)), np.ones(sum(map(len, cars))), np.full(len(crown), 2)])
    scan = Scan(np.concatenate([ground, *cars, crown]).astype(np.float32))
    stack = polar_sectors(scan)
    truth = scan.points[:, 2] - plane(scan.points[:, :2].astype(float), 5.0)
    assert stack.point_ground[kinds == 0].mean() > 0.985
    assert stack.point_ground[(kinds == 1) & (truth > 0.2)].mean() < 0.01
    assert not stack.point_ground[kinds == 2].any()
    known = np.isfinite(stack.point_height)
    assert known.mean() > 0.99
    assert np.quantile(np.abs(stack.point_height - truth)[known], 0.99) < 0.05
    row = stack.point_sector
    on_cars = (kinds == 1) & (truth > GRID.belly_m + 0.05) & (row >= 0)
    assert stack.obstacle[row[on_cars]].mean() > 0.99
    held = np.unique(row[on_cars])
    assert np.abs(stack.obstacle_height[held].max() - 1.2) < 0.1
    under = np.unique(row[(kinds == 2) & (row >= 0)])
    without_car = np.setdiff1d(under, held)
    assert stack.traversable[without_car].mean() > 0.9
    assert not stack.obstacle[without_car].any()
    assert np.nanmin(stack.clearance[without_car]) == pytest.approx(3.0, abs=0.1)
    free = stack.traversable & ~stack.obstacle
    assert set(classify_filter(stack).class_id[free & (stack.overhead_count == 0)].tolist()) == {0}


def test_both_sides_of_a_kerb_are_ground():
    rng = np.random.default_rng(2)
    xy = rings(2)
    z = plane(xy) + 0.16 * (xy[:, 1] > 4.0) + 0.005 * rng.standard_normal(len(xy))
    stack = stack_of(xy, z)
    near = np.hypot(*xy.T) < 30
    assert stack.point_ground[near & (xy[:, 1] > 4.0)].mean() > 0.95
    assert stack.point_ground[near & (xy[:, 1] < 4.0)].mean() > 0.95


def test_reflections_below_the_ground_are_left_out_and_move_nothing():
    rng = np.random.default_rng(3)
    xy = rings(3)
    z = plane(xy) + 0.01 * rng.standard_normal(len(xy))
    deep = rng.uniform(size=len(xy)) < 0.004
    below = np.where(deep, z - rng.uniform(1.0, 4.0, len(xy)), z)
    stack = stack_of(xy, below)
    assert not stack.point_ground[deep].any()
    assert stack.point_ground[~deep].mean() > 0.99
    assert np.abs(stack.point_height[~deep]).max() < 0.1


def test_a_crown_without_ground_below_it_is_no_ground():
    rng = np.random.default_rng(4)
    xy = rings(4, far=20.0)
    crown_xy = np.column_stack([rng.uniform(24, 30, 4000), rng.uniform(-3, 3, 4000)])
    z = np.concatenate([plane(xy), -1.2 + rng.uniform(2.5, 5.0, 4000)])
    stack = stack_of(np.concatenate([xy, crown_xy]), z)
    there = stack.point_sector[len(xy) :]
    assert not stack.traversable[there[there >= 0]].any()
    assert not stack.point_ground[len(xy) :].any()


@pytest.mark.parametrize("height", [-2.0, -0.6])
def test_a_scan_with_z_down_has_no_ground(height):
    xy = rings(7)
    z = plane(xy, 3.0, 1.0, height)
    assert stack_of(xy, z).traversable.mean() > 0.99
    upside_down = stack_of(xy * [1, -1], -z)
    assert not upside_down.traversable.any()
    assert not upside_down.point_ground.any()


def test_ground_is_the_same_in_other_buffers_and_with_another_heading():
    rng = np.random.default_rng(5)
    xy = rings(5)
    points = np.column_stack([xy, plane(xy, 8.0) + 0.02 * rng.standard_normal(len(xy))]).astype(np.float32)
    points[rng.integers(0, len(points), 3000), 2] += 0.9
    buffers = SectorBuffers()
    first = polar_sectors(Scan(points), buffers=buffers)
    kept = first.things.copy(), first.point_ground.copy(), first.point_height.copy()
    polar_sectors(Scan(points[::-1].copy()), buffers=buffers)
    again = polar_sectors(Scan(points), buffers=buffers)
    for mine, other, before in zip(
        (first.things, first.point_ground, first.point_height),
        (again.things, again.point_ground, again.point_height),
        kept,
        strict=True,
    ):
        np.testing.assert_array_equal(mine, before)
        np.testing.assert_array_equal(mine, other)
    c, s = math.cos(1.1), math.sin(1.1)
    turned = (points.astype(float) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])).astype(np.float32)
    other = polar_sectors(Scan(turned))
    assert (other.point_ground == first.point_ground).mean() > 0.995


@pytest.mark.realdata
@pytest.mark.parametrize(("name", "least"), [("marv/marv.npz", 35), ("tradr/tradr.npz", 30), ("husky_oru", 60)])
def test_low_robots_find_the_ground_around_them(shared_data, name, least):
    path = shared_data / "scans" / "monoforce" / name
    if path.is_dir():
        scan = read_scan(next(path.glob("*.ply")))
    else:
        cloud = np.load(path)["cloud"].ravel()
        points = np.stack([cloud[axis] for axis in "xyz"], axis=1)
        scan = Scan(np.ascontiguousarray(points[np.hypot(points[:, 0], points[:, 1]) > 0.5]))
    stack = polar_sectors(scan)
    assert stack.traversable.sum() >= least
    # Not stretched to reach the number: what is called ground is thin.
    heights = np.abs(stack.point_height[stack.point_ground])
    assert np.quantile(heights, 0.95) < 0.3


@pytest.mark.realdata
@pytest.mark.parametrize("pattern", ["monoforce/husky/*.ply", "monoforce/husky_oru/*.ply", "patchwork_128ch/*.pcd"])
def test_smooth_sectors_of_a_real_scan_hold_ground_and_nothing_tall(shared_data, pattern):
    stack = polar_sectors(read_scan(next((shared_data / "scans").glob(pattern))))
    smooth = classify_filter(stack).class_id == 0
    assert smooth.sum() >= 8
    assert stack.residual[smooth].mean() < 0.06
    assert np.abs(stack.point_height[stack.point_ground]).max() < 1.2
    assert (np.abs(stack.heights[smooth]) > 0.5).mean() < 0.01  # over the plane of its sector, pixel by pixel
