"""Augmentation: each against an independent answer, all together as properties."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import ndimage

from bumpymap.core.shared_kernels import fill_holes as fill_holes_of_features
from bumpymap.lab.train.texture_data import (
    blur,
    fill_holes,
    punch_holes,
    rotate,
)
from bumpymap.rating.textures import make_textures


@pytest.fixture
def patches():
    return make_textures("low_noise", 30, np.random.default_rng(0))


def test_rotation_agrees_with_scipy(patches):
    degrees = 33.0
    ours = rotate(patches.astype(float), np.full(30, np.radians(degrees)))
    theirs = ndimage.rotate(patches.astype(float), degrees, axes=(2, 1), reshape=False, order=1, mode="reflect")
    assert_allclose(ours[:, 4:11, 4:11], theirs[:, 4:11, 4:11], atol=1e-5)


def test_blur_agrees_with_scipy_inside(patches):
    ours = blur(patches.astype(float), np.full(30, 0.7))
    theirs = np.stack([ndimage.gaussian_filter(patch, 0.7, truncate=6) for patch in patches.astype(float)])
    assert_allclose(ours[:, 5:10, 5:10], theirs[:, 5:10, 5:10], atol=1e-4)
    assert_allclose(blur(np.ones((1, 15, 15)), np.array([2.0])), 1)


def test_holes_are_filled_as_the_features_fill_them(patches):
    holed = punch_holes(patches.astype(float), np.full(30, 0.6), np.full(30, 2.5), np.random.default_rng(6))
    expected = holed.copy()
    for patch in expected:
        assert fill_holes_of_features(patch, 15, np.empty(patch.size, np.int32), np.empty(patch.size)) == 0
    assert_allclose(fill_holes(holed), expected, rtol=1e-12)
