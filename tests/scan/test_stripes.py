"""The filter method: the filters against scikit-image, the count against scipy, and what the count means."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from bumpymap.core import NOT_TRAVERSABLE, Scan
from bumpymap.core.errors import UsageError
from bumpymap.scan import classify_filter, load_stripes, polar_sectors
from bumpymap.scan.stripes import StripeFilter, count_stripes, gabor_bank


def relief(rms, smooth, count=40, seed=0):
    rng = np.random.default_rng(seed)
    maps = rng.standard_normal((count, 15, 15))
    maps = np.stack([gaussian_filter(m, smooth) for m in maps]) if smooth else maps
    maps -= maps.mean(axis=(1, 2), keepdims=True)
    return (rms * maps / maps.std(axis=(1, 2), keepdims=True)).astype(np.float32)


def skimage_kernels(settings):
    gabor_kernel = pytest.importorskip("skimage.filters").gabor_kernel
    sigma = 3.0 * math.sqrt(math.log(2.0) / 2.0) / math.pi * settings.wavelength_px
    for number in range(settings.orientations):
        yield gabor_kernel(
            1.0 / settings.wavelength_px,
            theta=math.pi * number / settings.orientations,
            sigma_x=sigma,
            sigma_y=sigma / settings.gamma,
            n_stds=10,
        )


@pytest.mark.parametrize("settings", [StripeFilter(), StripeFilter(wavelength_px=4.0, gamma=0.8, orientations=5)])
def test_the_filters_are_those_of_scikit_image(settings):
    bank = gabor_bank(15, settings)
    for number, kernel in enumerate(skimage_kernels(settings)):
        middle_row, middle_column = (side // 2 for side in kernel.shape)
        for row, column in ((7, 7), (0, 3), (14, 14)):
            near = kernel[
                middle_row - row : middle_row - row + 15, middle_column - column : middle_column - column + 15
            ]
            weight = (near.real**2 / np.abs(near)).sum()  # of unbroken stripes: envelope times squared wave
            mine = bank[row * 15 + column, number, :225].reshape(15, 15)
            np.testing.assert_allclose(mine, near.real / weight, atol=2e-6)
    assert not bank[:, :, 225:].any()


@pytest.mark.parametrize("count", [1, 63, 64, 130])
def test_counts_are_those_of_a_plain_loop(count):
    settings = StripeFilter()
    heights = relief(np.linspace(0.001, 0.2, count)[:, None, None], 1.0, count)
    bank = gabor_bank(15, settings)[:, :, :225].astype(float)
    rows = np.arange(15)[:, None]
    expected = []
    for one in heights:
        moving_bars = np.cos(2 * np.pi * ((rows - 7) / 3.0 + one.astype(float) / 0.25)).ravel()
        answer = (bank @ moving_bars).max(axis=1).reshape(15, 15)
        starts = sum((column[i] >= 0.5) and (i == 0 or column[i - 1] < 0.5) for column in answer.T for i in range(15))
        expected.append(starts / 15)
    # An answer within a rounding of the threshold may fall on either side.
    np.testing.assert_allclose(count_stripes(heights, settings), expected, atol=2 / 15 + 1e-6)
    assert np.mean(np.abs(count_stripes(heights, settings) - expected) > 1e-6) < 0.05


def test_even_ground_has_a_stripe_every_wavelength_and_rough_ground_none():
    assert count_stripes(np.zeros((3, 15, 15), np.float32)).tolist() == [5.0, 5.0, 5.0]
    assert count_stripes(relief(1.0, 0.0)).max() < 1.0


def test_stripes_do_not_depend_on_the_level_or_on_other_sectors():
    heights = relief(np.linspace(0.0, 0.15, 70)[:, None, None], 1.0, 70)
    alone = np.concatenate([count_stripes(one[None]) for one in heights])
    np.testing.assert_array_equal(count_stripes(heights), alone)
    # By a whole stripe: the same picture.
    assert np.abs(count_stripes(heights + np.float32(0.5)) - alone).mean() < 0.01


def scans_of_ground(seed):
    """Even ground to one side, bumps to the other, waves between them."""
    rng = np.random.default_rng(seed)
    r, turn = 4.0 + 30.0 * rng.random(60_000), 2 * np.pi * rng.random(60_000)
    size = np.choose((turn / (2 * np.pi) * 3).astype(int), [0.0, 0.05, 0.4])
    z = -1.5 + size * rng.standard_normal(60_000)
    return polar_sectors(Scan(np.column_stack([r * np.cos(turn), r * np.sin(turn), z]).astype(np.float32)))


def test_sectors_get_the_class_of_the_nearest_centre_raised_by_what_stands_on_them():
    stack, model = scans_of_ground(1), load_stripes()
    classed = classify_filter(stack, model)
    for row, class_id in enumerate(classed.class_id):
        things = stack.count[row] - stack.ground_count[row]
        covered = stack.ground_count[row] < 0.55 * stack.count[row]
        standing = int(covered) + int(covered and stack.obstacle_count[row] >= 0.45 * things)
        if not stack.traversable[row]:
            assert class_id == NOT_TRAVERSABLE
            assert np.isnan(classed.stripes[row])
        else:
            assert class_id == max(standing, min(range(3), key=lambda c: abs(model.centres[c] - classed.stripes[row])))
    means = [stack.residual[classed.class_id == class_id].mean() for class_id in range(3)]
    assert means[0] < means[1] < means[2]


def test_a_model_of_other_pixels_is_refused():
    stack = scans_of_ground(1)
    with pytest.raises(UsageError, match="9 pixels"):
        classify_filter(stack, replace(load_stripes(), pixels=9))
