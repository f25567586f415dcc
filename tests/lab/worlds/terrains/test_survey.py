"""What a survey sees of a terrain: density and noise as they were asked for."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from bumpymap.lab.worlds.terrains import ScanEffects, Terrain, survey_terrain

LEVEL = Terrain("plane", np.zeros((60, 60)), 3.0)


def slope():
    axis = (np.arange(60) + 0.5) * 0.05
    return Terrain("plane", np.broadcast_to(0.2 * axis, (60, 60)) - 0.3 * axis[:, None], 3.0)


def survey(terrain, seed=1, **effects):
    return survey_terrain(terrain, ScanEffects(**effects), np.random.default_rng(seed))


@pytest.mark.parametrize("density", [10, 1000])
def test_density_is_that_of_a_poisson_process(density):
    counts = [len(survey(LEVEL, seed, density=density).upward) for seed in range(40)]
    expected = 9 * density
    # Four standard errors of a Poisson mean of 40 draws.
    assert np.mean(counts) == pytest.approx(expected, abs=4 * np.sqrt(expected / 40))
    assert 0.5 < np.var(counts, ddof=1) / expected < 1.9


def test_perfect_points_lie_on_the_surface_north_up():
    points = survey(slope(), density=500)
    inside = (np.abs(points.easting - 1.5) < 1.4) & (np.abs(points.northing - 1.5) < 1.4)
    expected = 0.2 * points.easting - 0.3 * (3.0 - points.northing)
    np.testing.assert_allclose(points.upward[inside], expected[inside], atol=1e-9)


@pytest.mark.parametrize("noise", [0.01, 0.05])
def test_white_noise_has_its_deviation_and_neighbours_do_not_share_it(noise):
    points = survey(LEVEL, density=1000, noise_m=noise)
    assert points.upward.std() == pytest.approx(noise, rel=4 / np.sqrt(2 * 9000))
    tree = cKDTree(np.stack([points.easting, points.northing], axis=1))
    _, nearest = tree.query(tree.data, k=2)
    correlation = np.corrcoef(points.upward, points.upward[nearest[:, 1]])[0, 1]
    assert abs(correlation) < 0.06
