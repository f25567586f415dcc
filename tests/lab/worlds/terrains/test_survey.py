"""What a survey sees of a terrain: density, noise, holes and smoothing as they were asked for."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from bumpymap.core.errors import UsageError
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


@pytest.mark.parametrize("length", [0.1, 0.4])
def test_shared_errors_have_their_deviation_and_fall_off_with_distance(length):
    # White noise blurred by a Gaussian of standard deviation s: covariance exp(-d^2 / (4 s^2)).
    draws = [survey(LEVEL, seed, density=300, noise_m=0.03, noise_length_m=length) for seed in range(30)]
    variance = np.mean([np.mean(p.upward**2) for p in draws])
    assert np.sqrt(variance) == pytest.approx(0.03, rel=0.12)
    for lag in (0.5 * length, 2 * length):
        products = []
        for p in draws:
            place = np.stack([p.easting, p.northing], axis=1)
            pairs = cKDTree(place).query_pairs(lag * 1.05, output_type="ndarray")
            far = np.linalg.norm(place[pairs[:, 0]] - place[pairs[:, 1]], axis=1) > lag * 0.95
            products.append(np.mean(p.upward[pairs[far, 0]] * p.upward[pairs[far, 1]]))
        assert np.mean(products) / 0.03**2 == pytest.approx(np.exp(-(lag**2) / (4 * length**2)), abs=0.16)


@pytest.mark.parametrize("share", [0.1, 0.4])
def test_holes_take_about_their_share_and_leave_empty_discs(share):
    full = survey(LEVEL, density=300)
    kept = [len(survey(LEVEL, seed, density=300, hole_share=share).upward) / 2700 for seed in range(20)]
    # Discs of up to 0.5 m radius (9 % of the tile) are added until the share is reached.
    assert share - 0.02 < 1 - np.mean(kept) < share + 0.09
    points = survey(LEVEL, 3, density=300, hole_share=share)
    grid = np.stack(np.meshgrid(np.linspace(0.3, 2.7, 60), np.linspace(0.3, 2.7, 60)), axis=-1).reshape(-1, 2)
    empty = [cKDTree(np.stack([p.easting, p.northing], axis=1)).query(grid)[0].max() for p in (full, points)]
    assert empty[0] < 0.18 < empty[1]


@pytest.mark.parametrize("smoothing", [0.1, 0.3])
def test_smoothing_damps_a_wave_as_a_gaussian_does(smoothing):
    axis = (np.arange(60) + 0.5) * 0.05
    length = 1.0
    wave = Terrain("wave", np.broadcast_to(np.sin(2 * np.pi * axis / length), (60, 60)).copy(), 3.0)
    points = survey(wave, density=1000, smoothing_m=smoothing)
    middle = np.abs(points.easting - 1.5) < 0.5
    basis = np.sin(2 * np.pi * points.easting[middle] / length)
    amplitude = float(basis @ points.upward[middle] / (basis @ basis))
    assert amplitude == pytest.approx(np.exp(-2 * (np.pi * smoothing / length) ** 2), abs=0.02)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"density": 0.0}, "density is 0.0"),
        ({"noise_m": -0.1}, "noise_m is -0.1"),
        ({"noise_length_m": float("nan")}, "noise_length_m is nan"),
        ({"smoothing_m": -1}, "smoothing_m is -1"),
        ({"hole_share": 1.0}, "hole_share is 1.0"),
    ],
)
def test_effects_that_cannot_be_are_refused(change, words):
    with pytest.raises(UsageError, match=words):
        replace(ScanEffects(), **change)
