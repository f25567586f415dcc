"""Train the texture network: settings, data, learning rate."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import torch

from bumpymap.core import UsageError
from bumpymap.lab.train.data import epoch_samples, training_patches
from bumpymap.lab.train.model import NetworkSettings, TextureNet
from bumpymap.lab.train.training import EpochData, EpochReport, LoopSettings, Training
from bumpymap.rating import FEATURE_VERSION

__all__ = ["TrainSettings", "train"]


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainSettings(LoopSettings):
    """All settings that affect a training."""

    epochs: int = 30
    patches_per_texture: int = 6534
    """As in the paper: 26,136 patches in total."""
    batch: int = 256
    """Minimum number of patches per optimizer step; batches are as equal in size as possible."""
    learning_rate: float = 5e-3
    weight_decay: float = 1e-2
    tile_size: float = 3.0
    """Side of the tiles the network is for, m. It is metadata only: texture sizes are relative to the side."""
    network: NetworkSettings = field(default_factory=NetworkSettings)

    def __post_init__(self) -> None:
        for name, least in {"epochs": 1, "patches_per_texture": 1, "batch": 2, "threads": 1}.items():
            if getattr(self, name) < least:
                raise UsageError(f"`{name}` is {getattr(self, name)}; it must be at least {least}")
        if self.seed < 0:
            raise UsageError(f"`seed` is {self.seed}; it must be 0 or more")
        if not (math.isfinite(self.tile_size) and self.tile_size > 0):
            raise UsageError(f"`tile_size` is {self.tile_size}; it must be a positive number of metres")
        if self.network.pixels < 9:
            raise UsageError(f"`pixels` is {self.network.pixels}; the network needs at least 9")

    @property
    def command(self) -> str:
        """The command line of this training, without ``--out``."""
        options = {
            "seed": self.seed,
            "epochs": self.epochs,
            "patches-per-texture": self.patches_per_texture,
            "tile-size": f"{self.tile_size:g}",
            "pixels": self.network.pixels,
            "threads": self.threads,
        }
        return "bumpymap train " + " ".join(f"--{name} {value}" for name, value in options.items())


def train(
    settings: TrainSettings, checkpoint: Path | None = None, progress: Callable[[EpochReport], None] | None = None
) -> TextureNet:
    """Train a network.

    Parameters
    ----------
    settings : TrainSettings
        The same settings give the same bits on the same machine and libraries.
    checkpoint : Path, optional
        Rewritten after every epoch; if it exists, training resumes from it.
    progress : callable, optional
        Called with a report after every epoch.

    Returns
    -------
    TextureNet
        In evaluation mode.

    Raises
    ------
    UsageError
        The checkpoint belongs to a training with other settings.
    OutputError
        The checkpoint cannot be written.
    """
    loop = Training(
        settings,
        lambda: _network(settings),
        lambda numbers: _epochs(settings, numbers),
        lambda share: _learning_rate(share, settings.learning_rate),
        record={"feature_version": FEATURE_VERSION},
    )
    return loop.run(checkpoint, progress)


def _network(settings: TrainSettings) -> TextureNet:
    net = TextureNet(settings.network)
    net.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # a quarter faster
    return net


def _epochs(settings: TrainSettings, numbers: range) -> Iterator[EpochData]:
    training = training_patches(settings.seed, settings.patches_per_texture, settings.network.pixels)
    for epoch in numbers:
        samples = epoch_samples(training, settings.seed, epoch)
        patches = torch.from_numpy(samples.patches)[:, None].contiguous(memory_format=torch.channels_last)
        count = len(samples.labels)
        batches = max(1, count // settings.batch)  # of equal size: a batch of one patch has no variance to normalise
        bounds = [number * count // batches for number in range(batches + 1)]
        yield EpochData((patches,), torch.from_numpy(samples.labels), bounds)


def _learning_rate(share: float, peak: float) -> float:
    """Rise linearly over the first tenth, then fall along half a cosine to zero; ``share``: of the training, 0..1."""
    if share < 0.1:
        return peak * (share + 0.01) / 0.11
    return peak * 0.5 * (1 + math.cos(math.pi * (share - 0.1) / 0.9))
