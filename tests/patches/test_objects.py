"""Obstacles and canopy of single tiles: made-up points whose truth is plain, and what must not be taken for them."""

from dataclasses import replace

import numpy as np
import pytest

from bumpymap.core.config import FeatureSettings
from bumpymap.core.types import CANOPY, FREE, OBSTACLE, UNDECIDED, UNSEEN, VehicleBody
from bumpymap.patches.features import measure
from bumpymap.patches.objects import find_objects, settle_solids
from bumpytiles import Grid, TileBuckets

BODY = VehicleBody(clearance_m=0.25, height_m=1.4, width_m=1.4, brush_stem_m=0.25)
EAST, NORTH = 500_001.0, 4_000_002.0  # south-west corner of a tile


def meadow(rng, density=50, tiles=1, slope=0.1):
    """Easting, northing, upward and ground flag of open ground, metres from the corner of a tile."""
    n = rng.poisson(density * 9 * tiles)
    x, y = rng.uniform(0, 3 * tiles, n), rng.uniform(0, 3, n)
    return np.column_stack([x, y, slope * x + 0.02 * rng.normal(size=n), np.ones(n)])


def things(x, y, height, slope=0.1):
    """Points over the ground, rows like those of ``meadow``."""
    x, y, height = np.broadcast_arrays(*(np.asarray(axis, float) for axis in (x, y, height)))
    return np.column_stack([axis.ravel() for axis in (x, y, slope * x + height, np.zeros(x.shape))])


def found(*points, body=BODY):
    x, y, z, ground = np.concatenate(points).T
    buckets = TileBuckets(Grid())
    buckets.add(EAST + x, NORTH + y, z, ground == 1)
    (block,) = buckets.blocks()
    settings = FeatureSettings()
    stack = find_objects(block, measure(block, settings, ground_only=True), body)
    col, row = block.col - block.col.min() + 1, block.row.max() - block.row + 1
    mosaic = np.full((3, 15, col.max() + 2, 15), UNSEEN, np.uint8)
    mosaic[row, :, col] = stack.objects
    settled = settle_solids(mosaic.reshape(45, -1), Grid(), settings.max_hole)
    states = settled.reshape(mosaic.shape)[row, :, col]
    return replace(stack, objects=states, obstacle=np.mean(states == OBSTACLE, axis=(1, 2)))


def pixel(x, y):
    return 14 - int(y / 0.2), int(x / 0.2)


@pytest.mark.parametrize(
    ("height", "state"),
    [(0.0, FREE), (0.15, FREE), (0.35, OBSTACLE), (1.3, OBSTACLE), (1.5, CANOPY), (9.0, CANOPY)],
)
def test_the_height_above_ground_decides(height, state):
    stack = found(meadow(np.random.default_rng(1)), things([1.5, 1.52, 1.51], [1.1, 1.1, 1.12], height))
    assert stack.objects[0][pixel(1.5, 1.1)] == state
    assert np.count_nonzero(stack.objects[0] != FREE) == (state != FREE)
    assert stack.obstacle[0] == pytest.approx((state == OBSTACLE) / 225)
    assert stack.canopy[0] == pytest.approx((state == CANOPY) / 225)
    assert stack.obstacle_height[0] == pytest.approx(height * (state == OBSTACLE), abs=0.06)
    assert stack.clearance[0] == pytest.approx(height if state == CANOPY else np.nan, abs=0.06, nan_ok=True)


@pytest.mark.parametrize(
    ("density", "height", "returns", "free"),
    [(50, 0.8, 1, True), (50, 5.0, 1, True), (1000, 0.8, 6, True), (100, 0.8, 6, False)],
)
def test_a_bird_is_no_obstacle_and_no_canopy(density, height, returns, free):
    """In a dense survey, it may return more than once."""
    bird = things([1.5, 1.55, 1.6, 1.5, 1.55, 1.6][:returns], 1.1, height)
    stack = found(meadow(np.random.default_rng(2), density), bird)
    assert np.all(stack.objects == FREE) == free


def test_a_crown_is_canopy_and_under_it_one_return_is_an_obstacle():
    rng = np.random.default_rng(4)
    crown = things(*rng.uniform(0, 3, (2, 600)), rng.uniform(3, 8, 600))
    stack = found(meadow(rng), crown, things(1.5, 1.5, 0.9))
    assert np.argwhere(stack.objects[0] == OBSTACLE).tolist() == [list(pixel(1.5, 1.5))]
    assert stack.canopy[0] > 0.8
    assert stack.clearance[0] > 2.9


def test_plants_that_are_brushed_aside_are_no_obstacle():
    rng = np.random.default_rng(6)
    grass = things(*rng.uniform(0, 3, (2, 300)), rng.uniform(0, 0.4, 300))
    ground = meadow(rng)
    assert found(ground, grass).obstacle[0] > 0.2
    assert found(ground, grass, body=VehicleBody(0.25, 1.4, 1.4, brush_stem_m=0.5)).obstacle[0] == 0


def test_a_post_of_30_cm_is_found():
    rng = np.random.default_rng(7)
    hits = 0
    for _ in range(100):
        x, y = rng.uniform(0.4, 2.6, 2)
        ground = meadow(rng, density=50)
        post = np.hypot(ground[:, 0] - x, ground[:, 1] - y) < 0.15
        ground[post, 2] += 1.0
        ground[post, 3] = 0
        lean = rng.uniform(0, 0.3)  # pulses that lean see the side of the post as well
        sides = rng.poisson(50 * 0.3 * 1.0 * lean)
        side = things(x + 0.15 * np.ones(sides), y, rng.uniform(0, 1, sides))
        hits += found(ground, side).obstacle[0] > 0
    assert hits >= 95


def test_a_wire_is_found():
    rng = np.random.default_rng(8)
    wire = things(np.arange(0.1, 3, 0.2), 1.5, 0.8)
    assert found(meadow(rng), wire).obstacle[0] >= 13 / 225


def test_ground_is_continued_under_a_boulder_and_down_a_slope():
    rng = np.random.default_rng(9)
    ground = meadow(rng, slope=0.5)
    under = np.hypot(ground[:, 0] - 1.5, ground[:, 1] - 1.5) < 0.7
    ground[under, 2] += 0.6
    ground[under, 3] = 0
    stack = found(ground)
    assert stack.obstacle[0] == pytest.approx(np.pi * 0.7**2 / 9, rel=0.2)
    assert stack.obstacle_height[0] == pytest.approx(0.6, abs=0.12)


def test_without_ground_what_is_seen_is_an_obstacle_and_the_rest_is_unseen():
    rng = np.random.default_rng(11)
    stack = found(things(rng.uniform(0, 1.5, 300), rng.uniform(0, 3, 300), 7.0))
    assert np.all(stack.objects[0][:, 8:] == UNSEEN)
    assert np.mean(stack.objects[0][:, :7] == OBSTACLE) > 0.8
    assert np.isnan(stack.canopy[0])


def test_a_pixel_far_from_all_points_is_unseen_and_thin_surveys_have_gaps():
    rng = np.random.default_rng(12)
    ground = meadow(rng)
    half = found(ground[ground[:, 0] < 1.0]).objects[0]
    assert np.all(half[:, 11:] == UNSEEN)
    assert np.all(half[:, :9] == FREE)
    assert np.all(found(meadow(rng, density=4)).objects == FREE)


def test_too_few_points_at_a_border_are_left_to_the_neighbour():
    ground = meadow(np.random.default_rng(13), tiles=2)
    stack = found(ground, things([2.95, 3.05], 1.5, 0.8))
    assert [np.argwhere(tile == UNDECIDED).tolist() for tile in stack.objects] == [[[7, 14]], [[7, 0]]]
    assert np.all(stack.obstacle == 0)


def test_any_order_of_points_gives_the_same_bits():
    rng = np.random.default_rng(14)
    points = np.concatenate([meadow(rng), things(*rng.uniform(0, 3, (2, 200)), rng.uniform(0, 5, 200))])
    one, other = found(points), found(rng.permutation(points))
    for name, column in one.columns().items():
        np.testing.assert_array_equal(column, getattr(other, name))
