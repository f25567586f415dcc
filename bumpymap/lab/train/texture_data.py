"""Training and test patches of the texture network, all from one seed, with the effects of a survey.

Each effect takes patches scaled to [0, 1] and one strength per patch, and works on all patches at once. ``augment``
applies them in the order in which a survey does: rotate the ground, change brightness, blur, add noise, empty pixels
and fill them, remove the plane and scale.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import TEXTURES
from bumpymap.rating import make_short_waves, make_textures, normalise, remove_plane

_Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Augmentation:
    """Maximum strengths; each patch draws its own strengths between 0 and these. Zero switches an effect off."""

    brightness: float = 0.3
    """Heights h become ``gain * h**exp(b) + offset``, with abs(b) up to this. The final scaling removes gain and
    offset, so only b affects the network."""
    rotation: float = 1.0
    """Rotation as a share of a full turn; corners are filled by mirroring. Half of the patches are also flipped."""
    blur: float = 0.7
    """Standard deviation of a Gaussian, px."""
    noise: float = 0.05
    """Standard deviation of white noise, share of the z range."""
    holes: float = 0.4
    """Share of the pixels that are emptied independently; a round hole of up to 2.5 px radius is added."""
    chance: float = 1.0
    """Probability of each effect on a patch, drawn independently."""

    def only(self, name: str) -> "Augmentation":
        """Return a copy with all effects but one switched off."""
        return replace(NONE, **{name: getattr(self, name)})


KINDS = ("brightness", "rotation", "blur", "noise", "holes")
ALL = Augmentation()
"""All effects on every patch, as in the evaluation of networks."""
LIGHT = Augmentation(chance=0.5)
"""Each effect on half of the patches; training uses a few such patches."""
NONE = Augmentation(0.0, 0.0, 0.0, 0.0, 0.0)


def augment(patches: NDArray[np.float32], settings: Augmentation, rng: np.random.Generator) -> NDArray[np.float32]:
    """Augment each patch with its own strengths, then prepare it like a patch of a survey.

    Parameters
    ----------
    patches : array (n, pixels, pixels) float32
        Scaled to [0, 1].
    settings : Augmentation
        Maximum strengths.
    rng : numpy Generator
        The same state gives the same bits. Every effect draws its random numbers even if it is off, so switching one
        off does not change the others.

    Returns
    -------
    array (n, pixels, pixels) float32
        Plane-removed, scaled to [0, 1].
    """
    count = len(patches)
    drawn, happens = rng.uniform(size=(2, len(KINDS), count))
    strength = {
        kind: getattr(settings, kind) * drawn[k] * (happens[k] < settings.chance) for k, kind in enumerate(KINDS)
    }
    heights = patches.astype(np.float64)
    flip = (rng.uniform(size=count) < 0.5) & (settings.rotation > 0)
    heights = rotate(np.where(flip[:, None, None], heights[:, :, ::-1], heights), 2 * np.pi * strength["rotation"])
    heights = brighten(heights, strength["brightness"], rng)
    heights = blur(heights, strength["blur"])
    heights = add_noise(heights, strength["noise"], rng)
    heights = fill_holes(punch_holes(heights, strength["holes"], 2.5 * (strength["holes"] > 0), rng))
    return normalise(remove_plane(heights))


def rotate(patches: _Floats, angle: _Floats) -> _Floats:
    """Rotate each patch about its centre by ``angle`` (n,) rad: bilinear, half-sample mirroring beyond the border."""
    count, pixels, _ = patches.shape
    axis = np.arange(pixels) - (pixels - 1) / 2
    cos, sin = np.cos(angle)[:, None, None], np.sin(angle)[:, None, None]
    row = _mirror(cos * axis[:, None] + sin * axis[None, :] + (pixels - 1) / 2, pixels)
    col = _mirror(cos * axis[None, :] - sin * axis[:, None] + (pixels - 1) / 2, pixels)
    r, c = np.minimum(row.astype(np.int64), pixels - 2), np.minimum(col.astype(np.int64), pixels - 2)
    down, right = row - r, col - c
    which = np.arange(count)[:, None, None]
    upper = patches[which, r, c] * (1 - right) + patches[which, r, c + 1] * right
    lower = patches[which, r + 1, c] * (1 - right) + patches[which, r + 1, c + 1] * right
    turned: _Floats = upper * (1 - down) + lower * down
    return turned


def _mirror(position: _Floats, pixels: int) -> _Floats:
    """Mirror positions [px] into 0 .. pixels - 1 at the outer edges of the first and the last pixel."""
    folded = np.mod(position + 0.5, 2 * pixels)
    return np.clip(np.minimum(folded, 2 * pixels - folded) - 0.5, 0, pixels - 1)


def brighten(patches: _Floats, strength: _Floats, rng: np.random.Generator) -> _Floats:
    """Change gain and offset, and raise heights to a power between ``exp(-strength)`` and ``exp(strength)``."""
    sign = rng.choice([-1.0, 1.0], len(patches))
    gain, offset = rng.uniform(0.5, 2.0, (2, len(patches), 1, 1))
    power = np.exp(sign * strength)[:, None, None]
    changed: _Floats = gain * np.clip(patches, 0.0, 1.0) ** power + offset
    return normalise(changed).astype(np.float64)


def blur(patches: _Floats, sigma: _Floats) -> _Floats:
    """Blur each patch by its own Gaussian of ``sigma`` (n,) px; the weights are renormalised at the border."""
    axis = np.arange(patches.shape[-1])
    distance = axis[None, :] - axis[:, None]
    kernel = np.exp(-0.5 * (distance / np.maximum(sigma, 1e-3)[:, None, None]) ** 2)
    kernel /= kernel.sum(axis=2, keepdims=True)
    blurred: _Floats = kernel @ patches @ kernel.transpose(0, 2, 1)
    return blurred


def add_noise(patches: _Floats, deviation: _Floats, rng: np.random.Generator) -> _Floats:
    """Add white noise; ``deviation`` (n,) is a share of the patch's own range."""
    noisy: _Floats = patches + (deviation * np.ptp(patches, axis=(1, 2)))[:, None, None] * rng.standard_normal(
        patches.shape
    )
    return noisy


def punch_holes(patches: _Floats, share: _Floats, radius: _Floats, rng: np.random.Generator) -> _Floats:
    """Set to NaN a random ``share`` (n,) of the pixels, and a round hole of up to ``radius`` (n,) px."""
    count, pixels, _ = patches.shape
    empty = rng.uniform(size=patches.shape) < share[:, None, None]
    centre = rng.uniform(0, pixels - 1, (2, count, 1, 1))
    size = rng.uniform(0, 1, (count, 1, 1)) * radius[:, None, None]
    axis = np.arange(pixels)
    empty |= (axis[:, None] - centre[0]) ** 2 + (axis[None, :] - centre[1]) ** 2 < size**2
    holed: _Floats = np.where(empty, np.nan, patches)
    return holed


def fill_holes(patches: _Floats) -> _Floats:
    """Fill NaN with the mean of the known pixels among 8 neighbours, ring by ring, as for patches of a survey.

    A patch must contain at least one known pixel.
    """
    filled: _Floats = patches.copy()
    pixels = patches.shape[-1]
    for _ in range(pixels):
        empty = np.isnan(filled)
        if not empty.any():
            break
        rows = np.flatnonzero(empty.any(axis=(1, 2)))
        part, hole = filled[rows], empty[rows]
        known = np.pad(~hole, ((0, 0), (1, 1), (1, 1))).astype(np.float64)
        value = np.pad(np.where(hole, 0.0, part), ((0, 0), (1, 1), (1, 1)))
        total, number = np.zeros_like(part), np.zeros_like(part)
        for down in range(3):
            for right in range(3):
                window = (slice(None), slice(down, down + pixels), slice(right, right + pixels))
                total += value[window]
                number += known[window]
        reach = hole & (number > 0)
        part[reach] = total[reach] / number[reach]
        filled[rows] = part
    return filled


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
