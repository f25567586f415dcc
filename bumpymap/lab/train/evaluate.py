"""How good a network is: on ground it has never seen, and the way the paper measured it."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from bumpymap.core import TEXTURES
from bumpymap.lab.train.alter import ALL, KINDS, NONE
from bumpymap.lab.train.data import Samples, altered_copies, training_patches, unseen_patches, unseen_short_waves
from bumpymap.lab.train.model import TextureNet

__all__ = ["Evaluation", "Score", "evaluate", "predict", "score"]

_BATCH = 1024


@dataclass(frozen=True, slots=True)
class Score:
    """Right and wrong answers."""

    confusion: tuple[tuple[int, ...], ...]
    """``[what it is][what the network says]``, number of patches, textures in the order of ``TEXTURES``."""

    @property
    def count(self) -> int:
        """Number of patches."""
        return sum(sum(line) for line in self.confusion)

    @property
    def accuracy(self) -> float:
        """Share of right answers, 0..1."""
        return sum(line[i] for i, line in enumerate(self.confusion)) / self.count


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Every score that the model card reports."""

    unseen: Score
    """Patches from other seeds, all alterations."""
    altered_copies: Score
    """Altered copies of the training patches: the paper's validation."""
    single: dict[str, Score]
    """Patches from other seeds, unaltered (``none``) and with one alteration each."""
    short_waves: Score
    """Short regular waves from other seeds, all alterations; ``high_noise`` is the right answer."""


def evaluate(net: TextureNet, seed: int, training_per_texture: int, unseen_per_texture: int) -> Evaluation:
    """Score a trained network.

    Parameters
    ----------
    net : TextureNet
        In evaluation mode.
    seed : int
        The seed of its training. Unseen patches come from other generators of the same seed.
    training_per_texture, unseen_per_texture : int
        Number of training patches (copies of all of them are scored) and of unseen patches.
    """
    pixels = net.settings.pixels
    single = {"none": score(net, unseen_patches(seed, unseen_per_texture, pixels, NONE))}
    for name in KINDS:
        single[name] = score(net, unseen_patches(seed, unseen_per_texture, pixels, ALL.only(name)))
    return Evaluation(
        unseen=score(net, unseen_patches(seed, unseen_per_texture, pixels)),
        altered_copies=score(net, altered_copies(training_patches(seed, training_per_texture, pixels), seed)),
        single=single,
        short_waves=score(net, unseen_short_waves(seed, unseen_per_texture, pixels)),
    )


def predict(net: TextureNet, patches: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return probabilities (n, classes) of patches (n, pixels, pixels) scaled to [0, 1]."""
    with torch.no_grad():
        parts = [net(part[:, None]).softmax(1) for part in torch.from_numpy(patches).split(_BATCH)]  # type: ignore[no-untyped-call]
    probability: NDArray[np.float32] = torch.cat(parts).numpy()
    return probability


def score(net: TextureNet, samples: Samples) -> Score:
    """Count right and wrong answers."""
    answer = predict(net, samples.patches).argmax(axis=1)
    size = len(TEXTURES)
    counts = np.bincount(samples.labels * size + answer, minlength=size * size).reshape(size, size)
    return Score(tuple(tuple(int(n) for n in line) for line in counts))
