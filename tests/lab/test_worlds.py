"""Made-up ground: the paper's forms, the terrain library and a survey of it, and the site of the sample survey."""

from pathlib import Path

import laspy
import numpy as np
import pytest
from made_quarry import tiles_of

from bumpymap.core import TEXTURES
from bumpymap.lab.terrains import KINDS, Terrain, fractal, make_terrain, make_textures, survey_terrain

SAMPLES = Path(__file__).resolve().parents[2] / "sample_data"


def plane(points):
    """Steepness [deg] of the plane through points (n, 3) by least squares, and what it leaves of their heights [m]."""
    east, north, z = (points - points.mean(axis=0)).T
    design = np.column_stack([east, north, np.ones(len(z))])
    found = np.linalg.lstsq(design, z, rcond=None)[0]
    return np.degrees(np.arctan(np.hypot(*found[:2]))), z - design @ found


def plane_of(terrain):
    axis = (np.arange(len(terrain.surface)) + 0.5) * terrain.tile_size / len(terrain.surface)
    x, y = np.meshgrid(axis, axis[::-1])
    return plane(np.stack([x, y, terrain.surface], axis=-1).reshape(-1, 3))


@pytest.mark.parametrize("kind", KINDS)
def test_a_terrain_belongs_to_its_seed_and_index_and_has_relief_of_its_size(kind):
    first, again, other, seeded = (make_terrain(kind, *which).surface for which in ((1, 3), (1, 3), (1, 4), (2, 3)))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    assert not np.array_equal(first, seeded)
    for index in range(8):
        _, residual = plane_of(make_terrain(kind, 7, index, slope_limit_deg=30.0))
        assert 0.002 < np.ptp(residual) < 4.5  # NaN is not


@pytest.mark.parametrize("limit", [10.0, 30.0])
def test_slopes_reach_a_little_beyond_the_limit_and_half_of_them_are_gentle(limit):
    flat = (make_terrain("low_noise", 1, i, height_scale=0.0, slope_limit_deg=limit) for i in range(300))
    slopes = np.array([plane_of(terrain)[0] for terrain in flat])
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


@pytest.mark.parametrize("texture", TEXTURES)
@pytest.mark.parametrize("pixels", [4, 15, 30])
def test_every_patch_is_scaled_has_no_plane_and_belongs_to_its_seed(texture, pixels):
    patches, again, other = (make_textures(texture, 50, np.random.default_rng(seed), pixels) for seed in (3, 3, 4))
    assert (patches.shape, patches.dtype) == ((50, pixels, pixels), np.float32)
    np.testing.assert_array_equal(patches.min(axis=(1, 2)), 0)
    np.testing.assert_array_equal(patches.max(axis=(1, 2)), 1)
    design = np.column_stack([np.ones(pixels**2), *(axis.ravel() for axis in np.mgrid[:pixels, :pixels])])
    plane = np.linalg.lstsq(design, patches.reshape(50, -1).T.astype(float), rcond=None)[0]
    np.testing.assert_allclose(plane[1:], 0, atol=1e-6)
    np.testing.assert_array_equal(again, patches)
    assert np.abs(patches - other).mean() > 0.1
    assert len(np.unique(patches.reshape(50, -1), axis=0)) == 50


def test_perfect_points_lie_on_the_surface_north_up():
    axis = (np.arange(60) + 0.5) * 0.05
    slope = Terrain("plane", np.broadcast_to(0.2 * axis, (60, 60)) - 0.3 * axis[:, None], 3.0)
    x, y, z = survey_terrain(slope, 500, 0.0, np.random.default_rng(1))
    inside = (np.abs(x - 1.5) < 1.4) & (np.abs(y - 1.5) < 1.4)
    np.testing.assert_allclose(z[inside], (0.2 * x - 0.3 * (3.0 - y))[inside], atol=1e-9)


@pytest.fixture(scope="module")
def quarry():
    return laspy.read(SAMPLES / "quarry.laz")


@pytest.fixture(scope="module")
def patches_in(quarry):
    """Function of a zone's symbol: x, y, z of the ground points (n, 3) of each of its tiles with points, m."""
    ground = (np.asarray(quarry.classification) == 2) & (np.asarray(quarry.withheld) == 0)
    points = quarry.xyz[ground]
    key = (points[:, 0] // 3) * 1e7 + points[:, 1] // 3
    order = np.argsort(key, kind="stable")
    points, key = points[order], key[order]

    def patches(symbol):
        keys = [col * 1e7 + row for col, row in zip(*tiles_of(symbol), strict=True)]
        ends = np.searchsorted(key, np.add.outer(keys, [0, 1]))
        return [points[first:last] for first, last in ends if last > first]

    return patches


def test_the_sample_survey_holds_what_its_page_says(quarry, patches_in):
    """Counts of points; noise of 8 mm on the pad and on the ramp, a plane at 15 degrees; a pond."""
    marked = np.asarray(quarry.withheld) == 1
    counts = np.bincount(np.asarray(quarry.classification)[~marked], minlength=8)
    assert (len(quarry), marked.sum(), *counts[[1, 2, 5, 7]]) == (1_250_248, 40, 4, 1_228_505, 21_639, 60)
    for symbol in "P/":
        assert np.median([plane(points)[1].std() for points in patches_in(symbol)]) == pytest.approx(0.008, rel=0.01)
    assert np.median([plane(points)[0] for points in patches_in("/")]) == pytest.approx(15.0, abs=0.02)
    away = np.hypot((quarry.x - 512_340 - 37) / 5, (quarry.y - 5_403_210 - 61.5) / 4)
    assert away.min() > 1.0  # the pond


def test_zones_of_the_page_are_as_rough_as_their_names(patches_in):
    """The symbols on the map of the page: ramp, road, floor, washboard, ruts, step, rubble, bank."""
    rough = [np.median([plane(points)[1].std() for points in patches_in(symbol)]) for symbol in "/RfWUSXB"]
    assert (np.diff(rough) > 0).all()
    # The washboard is a sine of 2 cm on the grain of the road.
    assert rough[3] ** 2 - rough[1] ** 2 == pytest.approx(0.02**2 / 2, rel=0.05)


def test_the_page_of_the_samples_names_them_all():
    text = (SAMPLES / "README.md").read_text(encoding="utf-8")
    assert all(f"`{path.name}`" in text for path in SAMPLES.iterdir() if path.name != "README.md")
