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
