"""The terrain library: the same bits of a seed, finite, on the slopes it says, and of the shapes it names."""

import numpy as np
import pytest

from bumpymap.core.errors import UsageError
from bumpymap.lab.worlds.terrains import KINDS, fractal, make_terrain

pytestmark = pytest.mark.slow


def without_plane(surface):
    """Residual of a square surface, by least squares."""
    row, col = np.indices(surface.shape)
    design = np.stack([np.ones(row.size), row.ravel(), col.ravel()], axis=1)
    fitted = design @ np.linalg.lstsq(design, surface.ravel(), rcond=None)[0]
    return surface - fitted.reshape(surface.shape)


def slope_deg(terrain):
    axis = (np.arange(len(terrain.surface)) + 0.5) * terrain.tile_size / len(terrain.surface)
    x, y = np.meshgrid(axis, axis[::-1])
    design = np.stack([np.ones(x.size), x.ravel(), y.ravel()], axis=1)
    _, east, north = np.linalg.lstsq(design, terrain.surface.ravel(), rcond=None)[0]
    return np.degrees(np.arctan(np.hypot(east, north)))


@pytest.mark.parametrize("kind", KINDS)
def test_same_seed_and_index_give_the_same_bits_and_others_do_not(kind):
    first, again, other, seeded = (make_terrain(kind, *which).surface for which in ((1, 3), (1, 3), (1, 4), (2, 3)))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    assert not np.array_equal(first, seeded)


@pytest.mark.parametrize("kind", KINDS)
def test_every_terrain_is_finite_has_relief_and_no_more_than_the_ground_of_its_size(kind):
    for index in range(24):
        terrain = make_terrain(kind, 7, index, slope_limit_deg=30.0)
        assert np.isfinite(terrain.surface).all()
        relief = np.ptp(without_plane(terrain.surface))
        assert 0.002 < relief < 4.5


@pytest.mark.parametrize("limit", [10.0, 30.0])
def test_slopes_reach_a_little_beyond_the_limit_and_half_of_them_are_gentle(limit):
    slopes = np.array(
        [slope_deg(make_terrain("low_noise", 1, i, height_scale=0.0, slope_limit_deg=limit)) for i in range(300)]
    )
    assert 0.9 * 1.2 * limit < slopes.max() < 1.2 * limit
    # Half are below 8 degrees by design; of the others the share 8 / (1.2 limit).
    expected = 0.5 + 0.5 * min(1.0, 8.0 / (1.2 * limit))
    assert np.mean(slopes <= 8.0) == pytest.approx(expected, abs=0.09)


@pytest.mark.parametrize("hurst", [0.2, 0.5, 0.8])
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
