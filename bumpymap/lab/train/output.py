"""The output of a training: the ONNX file and its model card, written atomically."""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import bumpymap
from bumpymap.core import OutputError, atomic, locked

__all__ = ["ModelFiles", "TrainedModel", "model_files", "model_metadata"]

Scores = TypeVar("Scores")


@dataclass(frozen=True, slots=True)
class TrainedModel(Generic[Scores]):
    """The files of a trained model and its scores."""

    model: Path
    card: Path
    evaluation: Scores
    parameters: int
    """Number of trained parameters."""


@dataclass(frozen=True, slots=True)
class ModelFiles:
    """Paths of the files of one training."""

    model: Path
    """The ONNX file."""

    @property
    def card(self) -> Path:
        """The model card, in Markdown."""
        return self.model.with_suffix(".md")

    @property
    def checkpoint(self) -> Path:
        """The file from which an interrupted training resumes."""
        return self.model.with_name(self.model.name + ".checkpoint")

    def write(self, content: bytes, card: str) -> None:
        """Write network and card; delete the checkpoint."""
        with atomic(self.model) as beside:
            beside.write_bytes(content)
        with atomic(self.card) as beside:
            beside.write_text(card, encoding="utf-8")
        self.checkpoint.unlink(missing_ok=True)


@contextmanager
def model_files(out: Path) -> Iterator[ModelFiles]:
    """Lock the output folder against a second training of the same network.

    Raises
    ------
    OutputError
        The folder cannot be written, or another training holds the lock.
    """
    if not (out.parent.is_dir() and os.access(out.parent, os.W_OK)):
        raise OutputError(f"cannot write {out}: {out.parent} is not a writable folder. Choose another --out")
    with locked(out.parent, f".{out.name}.lock"):
        yield ModelFiles(out)


def model_metadata(
    kind: str, network: Mapping[str, object], training: Mapping[str, object], scores: Mapping[str, Any]
) -> dict[str, object]:
    """Return the metadata of the ONNX file.

    Parameters
    ----------
    kind : str
        Format name of the file.
    network, training, scores : mappings
        Description of the network, of its training and its scores.
    """
    import torch

    versions = {"format": kind, "bumpymap": bumpymap.__version__, "torch": torch.__version__}
    return {**versions, **network, **training, **scores}
