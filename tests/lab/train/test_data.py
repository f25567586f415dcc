"""Training and validation sets: labels, sizes, and that nothing leaks between them."""

import numpy as np
from numpy.testing import assert_array_equal

from bumpymap.lab.train.texture_data import (
    NONE,
    epoch_samples,
    training_patches,
    unseen_patches,
)


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
