"""The training loop of all networks: seeded, on the CPU, resumable from the last complete epoch."""

import logging
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

import torch
from torch import nn

from bumpymap.core import UsageError, atomic

__all__ = ["EpochData", "EpochReport", "LoopSettings", "Training"]

_log = logging.getLogger(__name__)


def save(
    checkpoint: Path, record: dict[str, Any], net: nn.Module, optimizer: torch.optim.Optimizer, epochs_done: int
) -> None:
    """Write the state of a training.

    Parameters
    ----------
    checkpoint : Path
        Written atomically.
    record : dict
        Plain values: everything that determines the training. A training with another record cannot resume from it.
    net : Module
    optimizer : Optimizer
    epochs_done : int

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    state = {"record": record, "epochs_done": epochs_done}
    with atomic(checkpoint, (RuntimeError,)) as part:
        torch.save({**state, "network": net.state_dict(), "optimizer": optimizer.state_dict()}, part)


def restore(checkpoint: Path, record: dict[str, Any], net: nn.Module, optimizer: torch.optim.Optimizer) -> int:
    """Load a checkpoint into a network and its optimizer; return the number of completed epochs.

    Raises
    ------
    UsageError
        The file is not a checkpoint, or belongs to another training.
    """
    remedy = "Delete it, or choose another --out"
    try:
        state = torch.load(checkpoint, map_location="cpu", weights_only=True)
        found, done = state["record"], int(state["epochs_done"])
    except Exception as error:  # torch raises many kinds of errors for other files
        raise UsageError(f"{checkpoint} cannot be read as a checkpoint: {error}. {remedy}") from error
    if found != record:
        different = ", ".join(f"{k} {found.get(k)} (now {v})" for k, v in record.items() if found.get(k) != v)
        raise UsageError(f"{checkpoint} belongs to a training with other settings: {different}. {remedy}")
    net.load_state_dict(state["network"])
    optimizer.load_state_dict(state["optimizer"])
    _log.info("continuing after epoch %d of %s", done, checkpoint)
    return done


Net = TypeVar("Net", bound=nn.Module)


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopSettings:
    """Settings of the training loop."""

    seed: int = 1
    epochs: int
    learning_rate: float
    """Peak, after the warm-up."""
    weight_decay: float
    threads: int = 1
    """CPU threads; their number affects the last bits of the result."""


@dataclass(frozen=True, slots=True)
class EpochReport:
    """Result of one epoch."""

    epoch: int
    """From 1."""
    epochs: int
    loss: float
    """Mean cross-entropy, nats."""
    accuracy: float
    """Accuracy on the training data of this epoch, during training."""
    seconds: float


@dataclass(frozen=True, slots=True)
class EpochData:
    """Training data of one epoch."""

    inputs: tuple[torch.Tensor, ...]
    """Arguments of the network, (n, ...) each."""
    labels: torch.Tensor
    """(n,) true classes."""
    bounds: list[int]
    """Start rows of the batches, and n."""


@dataclass(frozen=True, slots=True)
class Training(Generic[Net]):
    """A training; the same one gives the same bits on the same machine and libraries."""

    settings: LoopSettings
    make: Callable[[], Net]
    """Make the network with random weights."""
    epochs: Callable[[range], Iterator[EpochData]]
    """Yield the data of epochs by number; a resumed training gets the same data for the remaining epochs."""
    rate: Callable[[float], float]
    """Completed share of the training, 0..1 -> learning rate."""
    smoothing: float = 0.0
    """Label smoothing: share of each label that is spread over the other classes."""
    record: dict[str, Any] = field(default_factory=dict)
    """Plain values that affect the training in addition to its settings."""

    def run(self, checkpoint: Path | None = None, progress: Callable[[EpochReport], None] | None = None) -> Net:
        """Train the network.

        Parameters
        ----------
        checkpoint : Path, optional
            Rewritten after every epoch; if it exists, training resumes from it.
        progress : callable, optional
            Called with a report after every epoch.

        Returns
        -------
        Module
            In evaluation mode.

        Raises
        ------
        UsageError
            The checkpoint belongs to a training with other settings.
        OutputError
            The checkpoint cannot be written.
        """
        threads = torch.get_num_threads()
        torch.set_num_threads(self.settings.threads)
        try:
            with torch.random.fork_rng(devices=[]):
                torch.manual_seed(self.settings.seed)
                net = self.make()
            optimizer = torch.optim.AdamW(net.parameters(), lr=0.0, weight_decay=self.settings.weight_decay)
            record = _plain(asdict(self.settings) | self.record)
            done = restore(checkpoint, record, net, optimizer) if checkpoint and checkpoint.exists() else 0
            for epoch, data in enumerate(self.epochs(range(done, self.settings.epochs)), done):
                report = self._run_epoch(net, optimizer, data, epoch)
                _log.info("epoch %d of %d: loss %.4f", report.epoch, report.epochs, report.loss)
                if checkpoint:
                    save(checkpoint, record, net, optimizer, epoch + 1)
                if progress:
                    progress(report)
        finally:
            torch.set_num_threads(threads)
        return net.eval()

    def _run_epoch(self, net: Net, optimizer: torch.optim.Optimizer, data: EpochData, epoch: int) -> EpochReport:
        start = time.perf_counter()
        net.train()
        loss_sum, hits, count = 0.0, 0, len(data.labels)
        batches = len(data.bounds) - 1
        for number in range(batches):
            rows = slice(data.bounds[number], data.bounds[number + 1])
            rate = self.rate((epoch + number / batches) / self.settings.epochs)
            for group in optimizer.param_groups:
                group["lr"] = rate
            labels = data.labels[rows]
            logits = net(*(values[rows] for values in data.inputs))
            loss = nn.functional.cross_entropy(logits, labels, label_smoothing=self.smoothing)
            optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            optimizer.step()
            loss_sum += loss.item() * len(logits)
            hits += int((logits.argmax(1) == labels).sum())
        seconds = time.perf_counter() - start
        return EpochReport(epoch + 1, self.settings.epochs, loss_sum / count, hits / count, seconds)


def _plain(value: Any) -> Any:
    """Turn tuples into lists, as a checkpoint returns them."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return list(value) if isinstance(value, tuple) else value
