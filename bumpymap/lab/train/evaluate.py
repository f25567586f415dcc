"""Score the texture network on patches of unseen seeds, and by the paper's method."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from bumpymap.core import TEXTURES
from bumpymap.lab.train.augment import ALL, KINDS, NONE
from bumpymap.lab.train.data import (
    LabelledPatches,
    augmented_copies,
    training_patches,
    unseen_patches,
    unseen_short_waves,
)
from bumpymap.lab.train.model import TextureNet
from bumpymap.lab.train.score import Score, count_answers

__all__ = ["Evaluation", "evaluate", "predict", "score"]

_BATCH = 1024


@dataclass(frozen=True, slots=True)
class Evaluation:
    """All scores of the model card."""

    unseen: Score
    """Patches from other seeds, fully augmented."""
    augmented_copies: Score
    """Augmented copies of the training patches, the paper's validation."""
    single: dict[str, Score]
    """Patches from other seeds, without augmentation (``none``) and with one effect each."""
    short_waves: Score
    """Short regular waves from other seeds, fully augmented; ``high_noise`` is the right answer."""


def evaluate(net: TextureNet, seed: int, training_per_texture: int, unseen_per_texture: int) -> Evaluation:
    """Score a trained network.

    Parameters
    ----------
    net : TextureNet
        In evaluation mode.
    seed : int
        The seed of its training. Unseen patches come from other random streams of the same seed.
    training_per_texture, unseen_per_texture : int
        Number of training patches (copies of all of them are scored) and of unseen patches.
    """
    pixels = net.settings.pixels
    single = {"none": score(net, unseen_patches(seed, unseen_per_texture, pixels, NONE))}
    for name in KINDS:
        single[name] = score(net, unseen_patches(seed, unseen_per_texture, pixels, ALL.only(name)))
    return Evaluation(
        unseen=score(net, unseen_patches(seed, unseen_per_texture, pixels)),
        augmented_copies=score(net, augmented_copies(training_patches(seed, training_per_texture, pixels), seed)),
        single=single,
        short_waves=score(net, unseen_short_waves(seed, unseen_per_texture, pixels)),
    )


def predict(net: nn.Module, *inputs: torch.Tensor) -> NDArray[np.float32]:
    """Return the probabilities (n, classes) that a network computes for inputs (n, ...)."""
    with torch.no_grad():
        batches = zip(*(torch.split(values, _BATCH) for values in inputs), strict=True)
        parts = [net(*batch).softmax(1) for batch in batches]
    probability: NDArray[np.float32] = torch.cat(parts).numpy()
    return probability


def score(net: TextureNet, samples: LabelledPatches) -> Score:
    """Count right and wrong answers."""
    answer = predict(net, torch.from_numpy(samples.patches)[:, None]).argmax(axis=1)
    return count_answers(samples.labels, answer, len(TEXTURES))
