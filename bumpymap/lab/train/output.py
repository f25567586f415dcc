"""What a training leaves: the ONNX file and its model card, whole or not at all."""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import bumpymap
from bumpymap.core import OutputError, atomic, locked

__all__ = ["MadeModel", "ModelFiles", "model_files", "model_metadata"]

Scores = TypeVar("Scores")


@dataclass(frozen=True, slots=True)
class MadeModel(Generic[Scores]):
    """What was written, and how good it is."""

    model: Path
    card: Path
    evaluation: Scores
    parameters: int
    """Trained numbers of the network."""


@dataclass(frozen=True, slots=True)
class ModelFiles:
    """The files of one training."""

    model: Path
    """The ONNX file."""

    @property
    def card(self) -> Path:
        """The model card, in Markdown."""
        return self.model.with_suffix(".md")

    @property
    def checkpoint(self) -> Path:
        """Where a training that is broken off goes on from."""
        return self.model.with_name(self.model.name + ".checkpoint")

    def write(self, content: bytes, card: str) -> None:
        """Write network and card; the checkpoint goes away."""
        with atomic(self.model) as beside:
            beside.write_bytes(content)
        with atomic(self.card) as beside:
            beside.write_text(card, encoding="utf-8")
        self.checkpoint.unlink(missing_ok=True)


@contextmanager
def model_files(out: Path) -> Iterator[ModelFiles]:
    """Hold the place of a network against a second training.

    Raises
    ------
    OutputError
        Its folder cannot be written, or is in use.
    """
    if not (out.parent.is_dir() and os.access(out.parent, os.W_OK)):
        raise OutputError(
            f"cannot write {out}: {out.parent} is not a folder that you can write to. Choose another --out"
        )
    with locked(out.parent, f".{out.name}.lock"):
        yield ModelFiles(out)


def model_metadata(
    kind: str, network: Mapping[str, object], training: Mapping[str, object], scores: Mapping[str, Any]
) -> dict[str, object]:
    """Say in the ONNX file what it is.

    Parameters
    ----------
    kind : str
        Its format.
    network, training, scores : mappings
        What the network is for, how it was trained, how good it is.
    """
    import torch

    versions = {"format": kind, "bumpymap": bumpymap.__version__, "torch": torch.__version__}
    return {**versions, **network, **training, **scores}
