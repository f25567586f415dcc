"""The trainer of the scan network: seeded, on the CPU, restartable from its last whole epoch."""

import logging
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from bumpymap.core import UsageError
from bumpymap.lab.train.checkpoint import restore, save
from bumpymap.lab.train.scan.data import Sectors, draw_epoch
from bumpymap.lab.train.scan.model import ScanNet, ScanNetSettings
from bumpymap.lab.train.train import EpochReport
from bumpymap.scan import SECTOR_VERSION

__all__ = ["ScanTrainSettings", "train"]

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class ScanTrainSettings:
    """Everything that a training depends on, beside the scans themselves."""

    seed: int = 1
    epochs: int = 20
    scenes: int = 300
    """Made-up scenes to learn from; a data set on disk brings its own frames."""
    turns: int = 2
    """How often each scan is cut once more after a random turn."""
    sectors_per_class: int = 10_000
    """Sectors of each class in every epoch."""
    batch: int = 128
    learning_rate: float = 4e-3
    """Peak, after the warm-up."""
    weight_decay: float = 2e-2
    smoothing: float = 0.05
    """Share of each answer that is given to the other classes: labels at margins are a matter of taste."""
    threads: int = 1
    network: ScanNetSettings = field(default_factory=ScanNetSettings)

    def __post_init__(self) -> None:
        for name in ("epochs", "scenes", "sectors_per_class", "batch", "threads"):
            if getattr(self, name) < 1:
                raise UsageError(f"{name} is {getattr(self, name)}; it must be at least 1")
        if min(self.seed, self.turns) < 0:
            raise UsageError(f"seed is {self.seed} and turns {self.turns}; they must be 0 or more")

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
        To learn from.
    checkpoint : Path, optional
        Rewritten after every epoch; where it exists already, training goes on from it.
    told : callable, optional
        Gets a report after every epoch.

    Returns
    -------
    ScanNet
        In evaluation mode.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(settings.threads)
    try:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(settings.seed)
            net = ScanNet(settings.network)
        optimizer = torch.optim.AdamW(net.parameters(), settings.learning_rate, weight_decay=settings.weight_decay)
        record = _record(settings, sectors)
        done = restore(checkpoint, record, net, optimizer) if checkpoint and checkpoint.exists() else 0
        for epoch in range(done, settings.epochs):
            report = _run_epoch(net, optimizer, sectors, settings, epoch)
            _log.info("epoch %d of %d: loss %.4f", report.epoch, report.epochs, report.loss)
            if checkpoint:
                save(checkpoint, record, net, optimizer, epoch + 1)
            if progress:
                progress(report)
    finally:
        torch.set_num_threads(threads)
    return net.eval()


def _run_epoch(
    net: ScanNet, optimizer: torch.optim.Optimizer, sectors: Sectors, settings: ScanTrainSettings, epoch: int
) -> EpochReport:
    start = time.perf_counter()
    net.train()
    rng = np.random.default_rng([settings.seed, 4, epoch])
    patches, measures, class_id = (torch.from_numpy(a) for a in draw_epoch(sectors, settings.sectors_per_class, rng))
    batches = math.ceil(len(class_id) / settings.batch)
    loss_sum, hits = 0.0, 0
    for number in range(batches):
        rows = slice(number * settings.batch, (number + 1) * settings.batch)
        rate = _learning_rate((epoch + number / batches) / settings.epochs, settings.learning_rate)
        for group in optimizer.param_groups:
            group["lr"] = rate
        logits = net(patches[rows], measures[rows])
        loss = nn.functional.cross_entropy(logits, class_id[rows], label_smoothing=settings.smoothing)
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        loss_sum += loss.item() * len(logits)
        hits += int((logits.argmax(1) == class_id[rows]).sum())
    seconds = time.perf_counter() - start
    return EpochReport(epoch + 1, settings.epochs, loss_sum / len(class_id), hits / len(class_id), seconds)


def _learning_rate(progress: float, peak: float) -> float:
    """Rise over the first twentieth, then fall along half a cosine to zero; ``progress`` runs from 0 to 1."""
    rise = min(1.0, (progress + 0.005) / 0.055)
    return peak * rise * 0.5 * (1 + math.cos(math.pi * progress))


def _record(settings: ScanTrainSettings, sectors: Sectors) -> dict[str, Any]:
    record = asdict(settings)
    record["network"] = {key: list(v) if isinstance(v, tuple) else v for key, v in record["network"].items()}
    counts = np.bincount(sectors.class_id, minlength=3).tolist()
    return {**record, "sectors": counts, "sector_version": SECTOR_VERSION}
