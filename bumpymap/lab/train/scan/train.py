"""Train the scan network: settings, data, learning rate."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch

from bumpymap.core import UsageError
from bumpymap.lab.train.scan.data import Sectors, draw_epoch
from bumpymap.lab.train.scan.model import ScanNet, ScanNetSettings
from bumpymap.lab.train.training import EpochData, EpochReport, LoopSettings, Training
from bumpymap.scan import SECTOR_VERSION

__all__ = ["ScanTrainSettings", "train"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanTrainSettings(LoopSettings):
    """All settings that affect a training; the scans come in addition."""

    epochs: int = 20
    scenes: int = 440
    """Number of synthetic training scenes; not used with a data set on disk."""
    turns: int = 2
    """Number of additional cuts of each scan, each after a random rotation."""
    sectors_per_class: int = 10_000
    """Sectors of each class in every epoch."""
    batch: int = 128
    learning_rate: float = 4e-3
    weight_decay: float = 2e-2
    smoothing: float = 0.05
    """Label smoothing: share of each label that is spread over the other classes; labels at margins are uncertain."""
    network: ScanNetSettings = field(default_factory=ScanNetSettings)

    def __post_init__(self) -> None:
        for name in ("epochs", "scenes", "sectors_per_class", "batch", "threads"):
            if getattr(self, name) < 1:
                raise UsageError(f"`{name}` is {getattr(self, name)}; it must be at least 1")
        if min(self.seed, self.turns) < 0:
            raise UsageError(f"`seed` is {self.seed} and turns {self.turns}; they must be 0 or more")

    @property
    def options(self) -> str:
        """The options of the command that repeats this training."""
        names = ("seed", "epochs", "scenes", "sectors_per_class", "threads")
        return " ".join(f"--{name.replace('_', '-')} {getattr(self, name)}" for name in names)


def train(
    settings: ScanTrainSettings,
    sectors: Sectors,
    checkpoint: Path | None = None,
    progress: Callable[[EpochReport], None] | None = None,
) -> ScanNet:
    """Train a network.

    Parameters
    ----------
    settings : ScanTrainSettings
        The same settings and sectors give the same bits on the same machine and libraries.
    sectors : Sectors
        Training sectors.
    checkpoint : Path, optional
        Rewritten after every epoch; if it exists, training resumes from it.
    progress : callable, optional
        Called with a report after every epoch.

    Returns
    -------
    ScanNet
        In evaluation mode.
    """
    counts = np.bincount(sectors.class_id, minlength=3).tolist()
    loop = Training(
        settings,
        lambda: ScanNet(settings.network),
        lambda numbers: _epochs(settings, sectors, numbers),
        lambda share: _learning_rate(share, settings.learning_rate),
        smoothing=settings.smoothing,
        record={"sectors": counts, "sector_version": SECTOR_VERSION},
    )
    return loop.run(checkpoint, progress)


def _epochs(settings: ScanTrainSettings, sectors: Sectors, numbers: range) -> Iterator[EpochData]:
    for epoch in numbers:
        rng = np.random.default_rng([settings.seed, 4, epoch])
        drawn = draw_epoch(sectors, settings.sectors_per_class, rng)
        patches, measures, class_id = (torch.from_numpy(values) for values in drawn)
        yield EpochData((patches, measures), class_id, [*range(0, len(class_id), settings.batch), len(class_id)])


def _learning_rate(share: float, peak: float) -> float:
    """Rise over the first twentieth, then fall along half a cosine to zero; ``share``: of the training, 0..1."""
    rise = min(1.0, (share + 0.005) / 0.055)
    return peak * rise * 0.5 * (1 + math.cos(math.pi * share))
