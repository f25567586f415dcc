"""The four terrain forms: what holds for every patch, and what sets the forms apart."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bumpymap.core.errors import UsageError
from bumpymap.core.types import TEXTURES
from bumpymap.rating.textures import make_short_waves, make_textures, normalise, remove_plane


@pytest.mark.parametrize("texture", TEXTURES)
@pytest.mark.parametrize("pixels", [4, 15, 30])
def test_every_patch_is_scaled_and_has_no_plane(texture, pixels):
    patches = make_textures(texture, 50, np.random.default_rng(3), pixels)
    assert patches.shape == (50, pixels, pixels)
    assert patches.dtype == np.float32
    assert_array_equal(patches.min(axis=(1, 2)), 0)
    assert_array_equal(patches.max(axis=(1, 2)), 1)
    assert_allclose(normalise(remove_plane(patches)), patches, atol=1e-6)


@pytest.mark.parametrize("texture", TEXTURES)
def test_the_seed_decides_every_bit(texture):
    first, again, other = (make_textures(texture, 20, np.random.default_rng(s)) for s in (1, 1, 2))
    assert_array_equal(first, again)
    assert np.abs(first - other).mean() > 0.1
    assert len(np.unique(first.reshape(20, -1), axis=0)) == 20


def test_a_stream_of_patches_does_not_depend_on_the_chunk():
    whole = make_textures("low_noise", 1100, np.random.default_rng(1))
    assert_array_equal(whole[:1024], make_textures("low_noise", 1024, np.random.default_rng(1)))


def _roughness(texture, order):
    """Mean absolute difference of neighbours (order 1) or curvature (order 2) at equal range."""
    patches = make_textures(texture, 400, np.random.default_rng(11))
    return np.mean([np.abs(np.diff(patches, order, axis=axis)).mean(axis=(1, 2)) for axis in (1, 2)], axis=0)


@pytest.mark.parametrize("order", [1, 2])
def test_forms_get_rougher_at_equal_range(order):
    flat, low, sine, high = (np.median(_roughness(texture, order)) for texture in TEXTURES)
    assert 1.3 * flat < low
    assert 1.3 * low < sine
    assert 1.1 * sine < high


def _power(texture):
    """Mean share of the power at each wave number (0 .. 10 waves a side)."""
    patches = make_textures(texture, 400, np.random.default_rng(5))
    power = np.abs(np.fft.fft2(patches - patches.mean(axis=(1, 2), keepdims=True))) ** 2
    power /= power.sum(axis=(1, 2), keepdims=True)
    wave = np.abs(np.fft.fftfreq(15, 1 / 15))
    number = np.round(np.hypot(wave[:, None], wave[None, :])).astype(int)
    return np.bincount(number.ravel(), power.mean(axis=0).ravel())


def test_spectra_are_where_the_forms_say():
    flat, low, sine, high = (_power(texture) for texture in TEXTURES)
    assert flat[1] > 0.65, "one undulation a patch, and what its borders leak"
    assert low[1] < flat[1] - 0.1
    assert low[2:4].sum() > flat[2:4].sum() + 0.1, "bumps of about a metre"
    assert sine[2:5].sum() > 0.6, "waves of 0.8 to 2.4 m"
    assert high[5:].sum() > 0.35, "rubble"
    assert max(flat[5:].sum(), low[5:].sum(), sine[5:].sum()) < 0.1


def test_remove_plane_is_least_squares():
    ground = np.random.default_rng(1).standard_normal((1, 15, 15))
    row, col = np.mgrid[:15, :15]
    design = np.column_stack([np.ones(225), row.ravel(), col.ravel()])
    fit = np.linalg.lstsq(design, ground.ravel(), rcond=None)[0]
    assert_allclose(remove_plane(ground).ravel(), ground.ravel() - design @ fit, atol=1e-12)


def test_nonsense_is_refused():
    rng = np.random.default_rng(0)
    with pytest.raises(UsageError, match="noise_sin"):
        make_textures("gravel", 1, rng)
    with pytest.raises(UsageError, match="count"):
        make_textures("flat", -1, rng)
    with pytest.raises(UsageError, match="pixels"):
        make_textures("flat", 1, rng, pixels=2)
    assert make_textures("flat", 0, rng).shape == (0, 15, 15)


@pytest.mark.parametrize("pixels", [15, 30])
def test_short_waves_are_short(pixels):
    patches = make_short_waves(400, np.random.default_rng(3), pixels)
    assert patches.shape == (400, pixels, pixels)
    assert (patches.min(), patches.max()) == (0.0, 1.0)
    power = np.abs(np.fft.fft2(patches - patches.mean(axis=(1, 2), keepdims=True))) ** 2
    frequency = np.hypot(*np.meshgrid(*[np.fft.fftfreq(pixels, 1 / pixels)] * 2))  # waves a tile
    # 0.4 to 0.75 m on a tile of 3 m: 4 to 7.5 waves; crossing ones beat up to sqrt(2) faster.
    inside = (frequency >= 3) & (frequency <= 11)
    assert np.mean(power[:, inside].sum(axis=1) / power.sum(axis=(1, 2))) > 0.9
