"""The whole job: train, score, write the ONNX file and its model card."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch

import bumpymap
from bumpymap.core import OutputError, atomic, locked
from bumpymap.lab.train.card import model_card
from bumpymap.lab.train.evaluate import Evaluation, evaluate
from bumpymap.lab.train.export import to_onnx
from bumpymap.lab.train.train import EpochReport, TrainSettings, train
from bumpymap.rating import FEATURE_VERSION

__all__ = ["UNSEEN_PER_TEXTURE", "MadeModel", "make_model"]

UNSEEN_PER_TEXTURE = 2500
"""Patches of each texture that the scores on unseen seeds are made of."""


@dataclass(frozen=True, slots=True)
class MadeModel:
    """What was written, and how good it is."""

    model: Path
    card: Path
    evaluation: Evaluation
    parameters: int
    """Trained numbers of the network."""


def make_model(settings: TrainSettings, out: Path, progress: Callable[[EpochReport], None] | None = None) -> MadeModel:
    """Train a texture network and write it.

    Parameters
    ----------
    settings : TrainSettings
        Decide every byte of the file on one machine.
    out : Path
        The ONNX file. The model card stands beside it (``.md``); while training runs, a checkpoint does
        (``.checkpoint``), from which the same call goes on after a break.
    told : callable, optional
        Gets a report after every epoch.

    Raises
    ------
    OutputError
        A file cannot be written.
    UsageError
        A checkpoint of other settings is in the way.
    """
    if not (out.parent.is_dir() and os.access(out.parent, os.W_OK)):
        raise OutputError(f"cannot write {out}: {out.parent} is not a writable folder. Choose another --out")
    with locked(out.parent, f".{out.name}.lock"):
        return _make(settings, out, progress)


def _make(settings: TrainSettings, out: Path, progress: Callable[[EpochReport], None] | None) -> MadeModel:
    checkpoint = out.with_name(out.name + ".checkpoint")
    net = train(settings, checkpoint, progress)
    evaluation = evaluate(net, settings.seed, settings.patches_per_texture, UNSEEN_PER_TEXTURE)
    content = to_onnx(net, _metadata(settings, evaluation, net.parameter_count()))
    card = out.with_suffix(".md")
    with atomic(out) as beside:
        beside.write_bytes(content)
    with atomic(card) as beside:
        beside.write_text(model_card(settings, evaluation, net.parameter_count(), len(content)), encoding="utf-8")
    checkpoint.unlink(missing_ok=True)
    return MadeModel(out, card, evaluation, net.parameter_count())


def _metadata(settings: TrainSettings, evaluation: Evaluation, parameters: int) -> dict[str, object]:
    return {
        "format": "bumpymap-textures",
        "bumpymap": bumpymap.__version__,
        "torch": torch.__version__,
        "classes": list(settings.network.classes),
        "pixels": settings.network.pixels,
        "tile_size": settings.tile_size,
        "feature_version": FEATURE_VERSION,
        "channels": list(settings.network.channels),
        "hidden": settings.network.hidden,
        "parameters": parameters,
        "seed": settings.seed,
        "command": settings.command,
        "accuracy_unseen": evaluation.unseen.accuracy,
        "confusion_unseen": evaluation.unseen.confusion,
        "accuracy_altered_copies": evaluation.altered_copies.accuracy,
        "confusion_altered_copies": evaluation.altered_copies.confusion,
        "accuracy_short_waves": evaluation.short_waves.accuracy,
    }
