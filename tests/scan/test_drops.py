"""Where the ground drops or ends: nothing that a scan does not know may look as if it could be driven on."""

import math

import numpy as np
import pytest

from bumpymap.core import Scan
from bumpymap.scan import classify_filter, polar_sectors
from bumpymap.views import GroundGrid

GRID = GroundGrid(0.25, 20.0)


def seen(height_at, sensor_m=1.2, lines=64, seed=0):
    """Points of a sensor of 64 lines over ground of that height; where it is NaN, there is none."""
    rng = np.random.default_rng(seed)
    down = np.radians(np.linspace(-25.0, -1.0, lines))[:, None]
    turn = np.linspace(-math.pi, math.pi, 720, endpoint=False)[None, :]
    away = np.full((lines, 720), np.nan)
    for r in np.arange(0.6, 45.0, 0.02):  # the first place where a beam is below the ground
        x, y = np.broadcast_arrays(r * np.cos(turn), r * np.sin(turn))
        below = sensor_m + r * np.tan(down) <= height_at(x, y)
        away = np.where(np.isnan(away) & below, r, away)
    away += 0.01 * rng.standard_normal(away.shape)
    points = np.stack([away * np.cos(turn), away * np.sin(turn), away * np.tan(down)], axis=-1)
    return points.reshape(-1, 3)[np.isfinite(away).ravel()].astype(np.float32)


def occupancy_of(points):
    return GRID.occupancy(classify_filter(polar_sectors(Scan(points))))


def centres():
    axis = (np.arange(GRID.side) + 0.5) * GRID.resolution_m - GRID.reach_m
    return np.meshgrid(axis, axis)


def is_free(cells):
    return (cells >= 0) & (cells <= 33)


@pytest.mark.parametrize(("edge", "drop"), [(3.2, 0.4), (9.0, 0.6)])
def test_a_step_down_bars_the_way(edge, drop):
    cells = occupancy_of(seen(lambda x, _: np.where(x > edge, -drop, 0.0)))
    x, y = centres()
    at_edge = (np.abs(x - edge - 0.1) < 0.3) & (np.abs(y) < 5.0)
    assert is_free(cells)[at_edge].mean() < 0.05
    level = occupancy_of(seen(lambda x, _: 0.0 * x))
    assert (is_free(cells) == is_free(level))[(x < 0.0) | (np.hypot(x, y) < edge - 2.0)].mean() > 0.97


@pytest.mark.parametrize(("at", "width", "depth"), [(4.0, 1.2, 0.6), (7.0, 2.5, 5.0)])
def test_a_ditch_bars_the_way(at, width, depth):
    cells = occupancy_of(seen(lambda x, _: np.where((x > at) & (x < at + width), -depth, 0.0)))
    x, y = centres()
    inside = (x > at) & (x < at + width) & (np.abs(y) < 4.0)
    barred = ~is_free(cells) & inside
    assert barred.any(axis=1)[inside.any(axis=1)].all()  # every straight way across


def test_nothing_is_free_beyond_the_end_of_the_ground():
    cells = occupancy_of(seen(lambda x, _: np.where(x > 6.4, np.nan, 0.0)))
    x, y = centres()
    assert is_free(cells)[x > 6.9].mean() < 0.001
    assert is_free(cells)[(x < 5.5) & (np.hypot(x, y) > 4.0) & (np.hypot(x, y) < 9.0)].mean() > 0.95


@pytest.mark.parametrize(
    "height_at",
    [
        lambda x, _: -0.25 * x,
        lambda x, _: np.where(x > 6.0, -0.2 * (x - 6.0), 0.0),
        lambda x, y: 0.4 * np.sin(x / 9.0) * np.sin(y / 11.0 + 1.0),
        lambda x, y: np.where(np.abs(y) > 4.0, 0.16, 0.0 * x),
    ],
    ids=["down", "ramp", "hills", "kerbs"],
)
def test_slopes_hills_and_kerbs_are_no_drops(height_at):
    stack = polar_sectors(Scan(seen(height_at)))
    assert stack.traversable.mean() > 0.9
    assert stack.obstacle.mean() < 0.03


def test_heights_of_obstacles_are_not_known_at_a_drop():
    stack = polar_sectors(Scan(seen(lambda x, _: np.where(x > 5.0, -1.0, 0.0))))
    assert stack.obstacle.any()
    assert np.isnan(stack.obstacle_height).all()


def test_reflections_in_wet_ground_are_no_drops():
    points = seen(lambda x, _: 0.0 * x)
    rng = np.random.default_rng(3)
    far = (np.hypot(points[:, 0], points[:, 1]) > 4.0) & (rng.uniform(size=len(points)) < 0.02)
    points[far] *= rng.uniform(1.3, 2.0, (far.sum(), 1)).astype(np.float32)
    stack = polar_sectors(Scan(points))
    drops = stack.obstacle & np.isnan(stack.obstacle_height)
    assert drops.mean() < 0.03


def test_drops_are_found_if_the_origin_is_on_the_ground():
    points = seen(lambda x, _: np.where(x > 5.0, -0.6, 0.0)) + np.float32([0.0, 0.0, 1.2])
    x, y = centres()
    assert is_free(occupancy_of(points))[(np.abs(x - 5.1) < 0.3) & (np.abs(y) < 5.0)].mean() < 0.05
