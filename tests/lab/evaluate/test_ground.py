"""The ground that is driven for a tile."""

import numpy as np
import pytest

from bumpymap.lab.evaluate.rated_survey import take_tiles
from bumpymap.lab.evaluate.survey_trial import driven_ground


@pytest.fixture(scope="module")
def bumpy():
    """Heights of a bumpy slope 1500 m up, four points a pixel."""

    def surface(x, y):
        return 1500 + 0.3 * x - 0.1 * y + 0.05 * np.sin(4 * x) * np.cos(3 * y)

    axis = (np.arange(30) + 0.5) * 0.1
    x, y = (part.ravel() for part in np.meshgrid(axis, axis))
    return x, y, surface(x, y)


def test_without_holes_it_is_the_heightmap(bumpy, measure_points):
    patches = measure_points(*bumpy)
    ground, heights = driven_ground(patches)[0], patches.heights[0].astype(float)
    np.testing.assert_allclose(ground - ground.mean(), heights - heights.mean(), atol=5e-4)


def test_holes_are_filled_on_the_same_plane(bumpy, measure_points):
    x, y, z = bumpy
    kept = np.hypot(x - 1.2, y - 1.8) > 0.4
    whole, holed = measure_points(x, y, z), measure_points(x[kept], y[kept], z[kept])
    assert np.isnan(holed.heights[0]).any()
    apart = driven_ground(holed)[0] - driven_ground(whole)[0]
    assert np.isfinite(apart).all()
    assert np.ptp(apart) < 0.12


def test_tiles_can_be_chosen_in_any_order(measure_points):
    rng = np.random.default_rng(2)
    patches = measure_points(rng.uniform(0, 6, 2000), rng.uniform(0, 6, 2000), rng.random(2000))
    order = np.array([2, 0, 3])
    chosen = take_tiles(patches, order)
    assert np.array_equal(chosen.heights, patches.heights[order], equal_nan=True)
    assert chosen.col.tolist() == patches.col[order].tolist()
