"""Made-up ground: the terrain library and what a survey sees of it, and the site of the sample survey."""

from pathlib import Path

import laspy
import made_quarry
import numpy as np
import pytest
from ply_files import read_vertices
from scipy.spatial import cKDTree

from bumpymap.core.errors import UsageError
from bumpymap.lab.worlds.terrains import KINDS, ScanEffects, Terrain, fractal, make_terrain, survey_terrain

SAMPLES = Path(__file__).resolve().parents[2] / "sample_data"


def plane_of(terrain):
    """Residual of the surface from its plane by least squares [m], and the slope of the plane [deg]."""
    axis = (np.arange(len(terrain.surface)) + 0.5) * terrain.tile_size / len(terrain.surface)
    x, y = np.meshgrid(axis, axis[::-1])
    design = np.stack([np.ones(x.size), x.ravel(), y.ravel()], axis=1)
    found = np.linalg.lstsq(design, terrain.surface.ravel(), rcond=None)[0]
    return terrain.surface.ravel() - design @ found, np.degrees(np.arctan(np.hypot(*found[1:])))


@pytest.mark.parametrize("kind", KINDS)
def test_a_terrain_belongs_to_its_seed_and_index_and_has_relief_of_its_size(kind):
    first, again, other, seeded = (make_terrain(kind, *which).surface for which in ((1, 3), (1, 3), (1, 4), (2, 3)))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    assert not np.array_equal(first, seeded)
    for index in range(8):
        residual, _ = plane_of(make_terrain(kind, 7, index, slope_limit_deg=30.0))
        assert 0.002 < np.ptp(residual) < 4.5  # NaN is not


@pytest.mark.parametrize("limit", [10.0, 30.0])
def test_slopes_reach_a_little_beyond_the_limit_and_half_of_them_are_gentle(limit):
    flat = (make_terrain("low_noise", 1, i, height_scale=0.0, slope_limit_deg=limit) for i in range(300))
    slopes = np.array([plane_of(terrain)[1] for terrain in flat])
    assert 0.9 * 1.2 * limit < slopes.max() < 1.2 * limit
    # Half are below 8 degrees by design; of the others the share 8 / (1.2 limit).
    expected = 0.5 + 0.5 * min(1.0, 8.0 / (1.2 * limit))
    assert np.mean(slopes <= 8.0) == pytest.approx(expected, abs=0.09)


@pytest.mark.parametrize("hurst", [0.2, 0.8])
def test_fractal_ground_has_the_spectrum_of_its_exponent(hurst):
    # Mean squared height difference of a self-affine surface grows as lag^(2 H) well below the longest wave. The flat
    # part of the spectrum and the samples bend it, so the wanted exponent is that of the spectrum itself, summed.
    n, step, lags = 256, 0.05, np.array([4, 8, 16])
    x = np.broadcast_to(np.arange(n) * step, (n, n))
    rng = np.random.default_rng(3)
    found = np.zeros(3)
    for _ in range(6):
        surface = fractal(rng, x, hurst, 0.1)
        found += [np.mean((surface[:, lag:] - surface[:, :-lag]) ** 2) for lag in lags]
    waves = np.fft.fftfreq(4 * n, step)
    k = np.hypot(*np.meshgrid(waves, waves))
    power = np.where(k > 1 / 6, np.maximum(k, 1e-9) ** (-2 * hurst - 2), 0.0)
    wanted = [np.sum(power * (1 - np.cos(2 * np.pi * waves[None, :] * lag * step))) for lag in lags]
    np.testing.assert_allclose(np.diff(np.log(found)), np.diff(np.log(wanted)), atol=0.12)


def test_what_cannot_be_made_is_refused():
    with pytest.raises(UsageError, match=r"kind is 'lawn'; it must be one of flat, .*ditch"):
        make_terrain("lawn", 1, 0)
    with pytest.raises(UsageError, match="3 pixels"):
        make_terrain("flat", 1, 0, pixels=3)


LEVEL = Terrain("plane", np.zeros((60, 60)), 3.0)


def survey(terrain, seed=1, **effects):
    return survey_terrain(terrain, ScanEffects(**effects), np.random.default_rng(seed))


@pytest.mark.parametrize("density", [10, 1000])
def test_density_is_that_of_a_poisson_process(density):
    counts = [len(survey(LEVEL, seed, density=density)[2]) for seed in range(40)]
    expected = 9 * density
    # Four standard errors of a Poisson mean of 40 draws.
    assert np.mean(counts) == pytest.approx(expected, abs=4 * np.sqrt(expected / 40))
    assert 0.5 < np.var(counts, ddof=1) / expected < 1.9


def test_perfect_points_lie_on_the_surface_north_up():
    axis = (np.arange(60) + 0.5) * 0.05
    slope = Terrain("plane", np.broadcast_to(0.2 * axis, (60, 60)) - 0.3 * axis[:, None], 3.0)
    x, y, z = survey(slope, density=500)
    inside = (np.abs(x - 1.5) < 1.4) & (np.abs(y - 1.5) < 1.4)
    np.testing.assert_allclose(z[inside], (0.2 * x - 0.3 * (3.0 - y))[inside], atol=1e-9)


@pytest.mark.parametrize("noise", [0.01, 0.05])
def test_white_noise_has_its_deviation_and_neighbours_do_not_share_it(noise):
    x, y, z = survey(LEVEL, density=1000, noise_m=noise)
    assert z.std() == pytest.approx(noise, rel=4 / np.sqrt(2 * 9000))
    tree = cKDTree(np.stack([x, y], axis=1))
    _, nearest = tree.query(tree.data, k=2)
    correlation = np.corrcoef(z, z[nearest[:, 1]])[0, 1]
    assert abs(correlation) < 0.06


def residual_deviation(col, row):
    inner = (np.arange(40) + 0.5) * 3.0 / 40
    east, north = (axis.ravel() for axis in np.meshgrid(col * 3.0 + inner, row * 3.0 + inner))
    z = made_quarry.height(east, north)
    design = np.column_stack((east - col * 3.0, north - row * 3.0, np.ones(z.size)))
    return np.std(z - design @ np.linalg.lstsq(design, z, rcond=None)[0])


def test_zones_of_the_page_are_as_rough_as_their_names():
    """The symbols on the map of the page: pad, ramp, road, floor, washboard, ruts, step, rubble, bank."""
    pad, ramp, road, floor, washboard, ruts, step, rubble, bank = (
        np.median([residual_deviation(*place) for place in np.transpose(made_quarry.tiles_of(symbol))[::4]])
        for symbol in "P/RfWUSXB"
    )
    assert max(pad, ramp) < 1e-9
    assert 0.0 < road < floor < washboard < ruts < step < rubble < bank


@pytest.mark.parametrize(("read", "name"), [(laspy.read, "quarry.laz"), (read_vertices, "quarry_part.ply")])
def test_heights_of_the_sample_files_are_the_reliefs_within_the_noise(read, name):
    points = read(SAMPLES / name)
    if name == "quarry.laz":
        points = points[np.asarray(points["withheld"]) == 0][::4]
    ground = np.asarray(points["classification"]) == 2
    x, y, z = (np.asarray(points[axis], float)[ground] for axis in "xyz")
    error = z - made_quarry.height(x, y)
    stray = np.abs(error) > 10.0
    assert stray.sum() <= 4
    error = error[~stray]
    assert abs(error.mean()) < 5.0 * 0.008 / np.sqrt(error.size)
    assert error.std() == pytest.approx(0.008, rel=0.01)
    assert np.abs(error).max() < 6.0 * 0.008
    assert not made_quarry.is_water(x, y).any()


def test_the_page_of_the_samples_names_them_all():
    text = (SAMPLES / "README.md").read_text(encoding="utf-8")
    assert all(f"`{path.name}`" in text for path in SAMPLES.iterdir() if path.name != "README.md")
