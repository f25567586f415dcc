"""The made-up wood: its pulses obey geometry, and its obstacles are found in a survey of it."""

import numpy as np
import pytest
from made_woods import GROUND, plant_wood, survey_wood, swept_tiles, true_pixels
from scipy.ndimage import binary_dilation

from bumpymap.core.config import FeatureSettings
from bumpymap.core.types import OBSTACLE, Barred, VehicleBody
from bumpymap.patches.features import measure
from bumpymap.patches.objects import find_objects, settle_solids
from bumpymap.rating.passable import find_passable, settle_objects
from bumpytiles import Grid, TileBuckets

BODY = VehicleBody(clearance_m=0.25, height_m=1.38, width_m=1.37, brush_stem_m=0.25)
LOW, HIGH = BODY.lowest_obstacle_m, BODY.height_m
TILES = 16  # 48 m


def test_the_same_seed_gives_the_same_survey():
    wood = plant_wood(3, side=12.0)
    one, other = survey_wood(wood, 20, 0), survey_wood(plant_wood(3, side=12.0), 20, 0)
    np.testing.assert_array_equal(one.upward, other.upward)
    assert not np.array_equal(survey_wood(wood, 20, 1).upward, one.upward)


def test_ground_points_lie_on_the_ground_and_the_others_above_it():
    wood = plant_wood(1)
    points = survey_wood(wood, 20, 1)
    height = points.upward - wood.ground(points.easting, points.northing)
    ground = points.classification == GROUND
    assert np.abs(height[ground]).max() < 0.15
    assert height[~ground].min() > -0.1
    assert 0.4 < ground.mean() < 0.95


def test_what_is_in_the_way_depends_on_the_heights():
    wood = plant_wood(2)
    assert true_pixels(wood, 0.1, 1.4, 0.2).sum() > true_pixels(wood, 0.5, 1.4, 0.2).sum() > 0
    narrow, wide = (swept_tiles(wood, LOW, HIGH, width, 3.0) for width in (0.5, 2.5))
    assert np.all(narrow[wide])
    assert narrow.sum() > wide.sum()


@pytest.fixture(scope="module")
def surveyed():
    """A wood, and the pixels of its survey at 50 points/m2 with a ring of missing tiles."""
    wood = plant_wood(5, things=0.15)
    points = survey_wood(wood, 50, 5)
    buckets = TileBuckets(Grid())
    buckets.add(points.easting, points.northing, points.upward, points.classification == GROUND)
    (block,) = buckets.blocks()
    settings = FeatureSettings()
    stack = find_objects(block, measure(block, settings, ground_only=True), BODY)
    mosaic = np.full(((TILES + 2) * 15, (TILES + 2) * 15), 255, np.uint8)
    for col, row, pixels in zip(block.col, block.row, stack.objects, strict=True):
        top, left = (TILES - row) * 15, (col + 1) * 15
        mosaic[top : top + 15, left : left + 15] = pixels
    return wood, settle_objects(settle_solids(mosaic, Grid(), settings.max_hole), 15)


def test_obstacles_are_found_within_a_pixel(surveyed):
    wood, mosaic = surveyed
    truth, found = true_pixels(wood, LOW, HIGH, 0.2), mosaic[15:-15, 15:-15] == OBSTACLE
    near = np.ones((3, 3), bool)
    assert np.mean(binary_dilation(found, near)[truth]) > 0.95
    assert np.mean(binary_dilation(truth, near)[found]) > 0.99


def test_the_vehicle_passes_where_it_can_be_swept_through_the_true_wood(surveyed):
    wood, mosaic = surveyed
    alone = np.full((TILES, TILES), Barred.NO, np.uint8)
    found = find_passable(mosaic, alone, np.ones((TILES, TILES, 4), bool), BODY, 3.0) == Barred.NO
    truth = swept_tiles(wood, LOW, HIGH, BODY.width_m, 3.0)
    inner = np.s_[1:-1, 1:-1]  # the truth knows nothing of the missing tiles around
    assert np.mean((found == truth)[inner]) > 0.96
    assert np.mean((found & ~truth)[inner]) < 0.01
