"""Training and test patches, all from one seed."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import TEXTURES
from bumpymap.lab.train.augment import ALL, LIGHT, NONE, Augmentation, augment
from bumpymap.rating import make_short_waves, make_textures

__all__ = [
    "LIGHT_EVERY",
    "SHORT_WAVES",
    "LabelledPatches",
    "augmented_copies",
    "epoch_samples",
    "training_patches",
    "unseen_patches",
    "unseen_short_waves",
]

# Second word of every generator's seed, so that no two uses share random numbers.
_TRAINING, _EPOCH, _UNSEEN, _UNSEEN_ALTERED, _COPIES, _ORDER, _WAVES, _UNSEEN_WAVES = range(8)

SHORT_WAVES = 0.2
"""Short regular waves that each epoch adds to the ``high_noise`` patches, as a share of these. They are added rather
than substituted, because otherwise rubble would be rarer than the forms it is confused with."""
LIGHT_EVERY = 7
"""One in this many patches of an epoch is augmented lightly: a network trained only on fully augmented patches mistakes
the grain of an unaltered one for rubble. The others are augmented as in the evaluation: with less strong blur in
training, the network would see too few examples of smooth rubble."""
_HIGH_NOISE = TEXTURES.index("high_noise")


@dataclass(frozen=True, slots=True)
class LabelledPatches:
    """Patches and their labels."""

    patches: NDArray[np.float32]
    """(n, pixels, pixels) plane-removed, scaled to [0, 1]."""
    labels: NDArray[np.int64]
    """(n,) index into ``TEXTURES``."""


def training_patches(seed: int, patches_per_texture: int, pixels: int) -> LabelledPatches:
    """Make the training patches, texture by texture."""
    return _textures(seed, _TRAINING, patches_per_texture, pixels)


def epoch_samples(training: LabelledPatches, seed: int, epoch: int) -> LabelledPatches:
    """Augment and shuffle the training patches for one epoch; a resumed training gets the same patches.

    Short regular waves, which no texture contains, are added as ``high_noise``.
    """
    added = math.ceil(SHORT_WAVES * np.count_nonzero(training.labels == _HIGH_NOISE))
    waves = make_short_waves(added, np.random.default_rng([seed, _WAVES, epoch]), training.patches.shape[-1])
    patches = np.concatenate((training.patches, waves))
    labels = np.concatenate((training.labels, np.full(added, _HIGH_NOISE)))
    order = np.random.default_rng([seed, _ORDER, epoch]).permutation(len(labels))
    patches, labels = patches[order], labels[order]
    lightly = np.arange(len(labels)) % LIGHT_EVERY == 0  # evenly spread, so that every batch holds some
    rng = np.random.default_rng([seed, _EPOCH, epoch])
    patches[lightly] = augment(patches[lightly], LIGHT, rng)
    patches[~lightly] = augment(patches[~lightly], ALL, rng)
    return LabelledPatches(patches, labels)


def unseen_short_waves(seed: int, count: int, pixels: int) -> LabelledPatches:
    """Make short regular waves from seeds that training never uses, fully augmented."""
    rng = np.random.default_rng([seed, _UNSEEN_WAVES])
    return LabelledPatches(augment(make_short_waves(count, rng, pixels), ALL, rng), np.full(count, _HIGH_NOISE))


def unseen_patches(
    seed: int, patches_per_texture: int, pixels: int, alterations: Augmentation = ALL
) -> LabelledPatches:
    """Make patches from seeds that training never uses, then augment them."""
    fresh = _textures(seed, _UNSEEN, patches_per_texture, pixels)
    if alterations == NONE:
        return fresh
    rng = np.random.default_rng([seed, _UNSEEN_ALTERED])
    return LabelledPatches(augment(fresh.patches, alterations, rng), fresh.labels)


def augmented_copies(training: LabelledPatches, seed: int) -> LabelledPatches:
    """Augment the training patches with other random numbers than in training, as in the paper's validation."""
    return LabelledPatches(augment(training.patches, ALL, np.random.default_rng([seed, _COPIES])), training.labels)


def _textures(seed: int, purpose: int, patches_per_texture: int, pixels: int) -> LabelledPatches:
    made = [
        make_textures(texture, patches_per_texture, np.random.default_rng([seed, purpose, index]), pixels)
        for index, texture in enumerate(TEXTURES)
    ]
    return LabelledPatches(np.concatenate(made), np.repeat(np.arange(len(TEXTURES)), patches_per_texture))
