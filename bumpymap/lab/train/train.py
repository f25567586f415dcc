"""The trainer: seeded, on the CPU, restartable from its last whole epoch."""

import logging
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import nn

from bumpymap.core import UsageError
from bumpymap.lab.train.checkpoint import restore, save
from bumpymap.lab.train.data import Samples, epoch_samples, training_patches
from bumpymap.lab.train.model import NetworkSettings, TextureNet
from bumpymap.rating import FEATURE_VERSION

__all__ = ["EpochReport", "TrainSettings", "train"]

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class TrainSettings:
    """Everything that a training depends on."""

    seed: int = 1
    epochs: int = 30
    patches_per_texture: int = 6534
    """As in the paper: 26,136 patches in all."""
    batch: int = 256
    """Least number of patches between two steps; batches are as even as can be."""
    learning_rate: float = 5e-3
    """Peak, after the warm-up."""
    weight_decay: float = 1e-2
    tile_size: float = 3.0
    """Side of the tiles the network is for, m. Textures are shares of a side, so only the label changes."""
    threads: int = 1
    network: NetworkSettings = field(default_factory=NetworkSettings)

    def __post_init__(self) -> None:
        for name, least in {"epochs": 1, "patches_per_texture": 1, "batch": 2, "threads": 1}.items():
            if getattr(self, name) < least:
                raise UsageError(f"{name} is {getattr(self, name)}; it must be at least {least}")
        if self.seed < 0:
            raise UsageError(f"seed is {self.seed}; it must be 0 or more")
        if not (math.isfinite(self.tile_size) and self.tile_size > 0):
            raise UsageError(f"tile_size is {self.tile_size}; it must be a positive number of metres")
        if self.network.pixels < 9:
            raise UsageError(f"pixels is {self.network.pixels}; the network needs at least 9")

    @property
    def command(self) -> str:
        """The command line of this training, all but where to write."""
        options = {
            "seed": self.seed,
            "epochs": self.epochs,
            "patches-per-texture": self.patches_per_texture,
            "tile-size": f"{self.tile_size:g}",
            "pixels": self.network.pixels,
            "threads": self.threads,
        }
        return "bumpymap train " + " ".join(f"--{name} {value}" for name, value in options.items())


@dataclass(frozen=True, slots=True)
class EpochReport:
    """How one epoch went."""

    epoch: int
    """From 1."""
    epochs: int
    loss: float
    """Mean cross-entropy, nats."""
    accuracy: float
    """On the altered training patches of this epoch, while learning."""
    seconds: float


def train(
    settings: TrainSettings, checkpoint: Path | None = None, progress: Callable[[EpochReport], None] | None = None
) -> TextureNet:
    """Train a network.

    Parameters
    ----------
    settings : TrainSettings
        The same settings give the same bits on the same machine and libraries.
    checkpoint : Path, optional
        Rewritten after every epoch; where it exists already, training goes on from it.
    told : callable, optional
        Gets a report after every epoch.

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
    threads = torch.get_num_threads()
    torch.set_num_threads(settings.threads)
    try:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(settings.seed)
            net = TextureNet(settings.network)
        net.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # a quarter faster
        optimizer = torch.optim.AdamW(net.parameters(), lr=0.0, weight_decay=settings.weight_decay)
        record = _record(settings)
        done = restore(checkpoint, record, net, optimizer) if checkpoint and checkpoint.exists() else 0
        training = training_patches(settings.seed, settings.patches_per_texture, settings.network.pixels)
        for epoch in range(done, settings.epochs):
            report = _run_epoch(net, optimizer, epoch_samples(training, settings.seed, epoch), settings, epoch)
            _log.info("epoch %d of %d: loss %.4f", report.epoch, report.epochs, report.loss)
            if checkpoint:
                save(checkpoint, record, net, optimizer, epoch + 1)
            if progress:
                progress(report)
    finally:
        torch.set_num_threads(threads)
    return net.eval()


def _run_epoch(
    net: TextureNet, optimizer: torch.optim.Optimizer, samples: Samples, settings: TrainSettings, epoch: int
) -> EpochReport:
    start = time.perf_counter()
    net.train()
    patches = torch.from_numpy(samples.patches)[:, None].contiguous(memory_format=torch.channels_last)
    labels = torch.from_numpy(samples.labels)
    batches = max(1, len(labels) // settings.batch)  # of even sizes: one of a single patch has no spread to normalise
    loss_sum, hits = 0.0, 0
    for number in range(batches):
        rows = slice(number * len(labels) // batches, (number + 1) * len(labels) // batches)
        rate = _learning_rate((epoch + number / batches) / settings.epochs, settings.learning_rate)
        for group in optimizer.param_groups:
            group["lr"] = rate
        logits = net(patches[rows])
        loss = nn.functional.cross_entropy(logits, labels[rows])
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        loss_sum += loss.item() * len(logits)
        hits += int((logits.argmax(1) == labels[rows]).sum())
    seconds = time.perf_counter() - start
    return EpochReport(epoch + 1, settings.epochs, loss_sum / len(labels), hits / len(labels), seconds)


def _learning_rate(progress: float, peak: float) -> float:
    """Rise linearly over the first tenth, then fall along half a cosine to zero; ``progress`` runs from 0 to 1."""
    if progress < 0.1:
        return peak * (progress + 0.01) / 0.11
    return peak * 0.5 * (1 + math.cos(math.pi * (progress - 0.1) / 0.9))


def _record(settings: TrainSettings) -> dict[str, Any]:
    record = asdict(settings)
    record["network"] = {key: list(v) if isinstance(v, tuple) else v for key, v in record["network"].items()}
    return {**record, "feature_version": FEATURE_VERSION}
