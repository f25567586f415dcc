"""Checkpoints: an interrupted training continues from its last complete epoch."""

import logging
from pathlib import Path
from typing import Any

import torch
from torch import nn

from bumpymap.core import UsageError, atomic

__all__ = ["restore", "save"]

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
