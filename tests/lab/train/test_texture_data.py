"""Patches to learn from: alterations against independent answers, and that nothing leaks between training and test."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import ndimage

from bumpymap.core.shared_kernels import fill_holes as fill_holes_of_features
from bumpymap.lab.train.texture_data import (
    NONE,
    blur,
    epoch_samples,
    fill_holes,
    punch_holes,
    rotate,
    training_patches,
    unseen_patches,
)
from bumpymap.rating import make_textures


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


def test_epochs_shuffle_and_alter_anew_but_repeatably():
    training = training_patches(1, 40, 15)
    first, again, second = epoch_samples(training, 1, 0), epoch_samples(training, 1, 0), epoch_samples(training, 1, 1)
    assert_array_equal(first.patches, again.patches)
    assert_array_equal(first.labels, again.labels)
    assert (np.diff(first.labels) < 0).any()
    assert_array_equal(np.sort(first.labels), np.concatenate([training.labels, [3] * 8]))
    assert np.abs(first.patches - second.patches).mean() > 0.05


def test_unseen_patches_share_none_with_training():
    training, unseen = training_patches(1, 60, 15), unseen_patches(1, 60, 15, NONE)
    flat = np.concatenate([training.patches, unseen.patches]).reshape(480, -1)
    assert len(np.unique(flat, axis=0)) == 480
    assert np.abs(training.patches - unseen.patches).max(axis=(1, 2)).min() > 0.05
