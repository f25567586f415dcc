"""The whole job: train, score, write the ONNX file and its model card."""

from collections.abc import Callable
from pathlib import Path

from bumpymap.lab.train.card import model_card
from bumpymap.lab.train.evaluate import Evaluation, evaluate
from bumpymap.lab.train.export import to_onnx
from bumpymap.lab.train.output import MadeModel, model_files, model_metadata
from bumpymap.lab.train.train import TrainSettings, train
from bumpymap.lab.train.training import EpochReport
from bumpymap.rating import FEATURE_VERSION

__all__ = ["UNSEEN_PER_TEXTURE", "make_model"]

UNSEEN_PER_TEXTURE = 2500
"""Patches of each texture that the scores on unseen seeds are made of."""


def make_model(
    settings: TrainSettings, out: Path, progress: Callable[[EpochReport], None] | None = None
) -> MadeModel[Evaluation]:
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
    with model_files(out) as files:
        net = train(settings, files.checkpoint, progress)
        evaluation = evaluate(net, settings.seed, settings.patches_per_texture, UNSEEN_PER_TEXTURE)
        content = to_onnx(net, _metadata(settings, evaluation, net.parameter_count()))
        files.write(content, model_card(settings, evaluation, net.parameter_count(), len(content)))
    return MadeModel(files.model, files.card, evaluation, net.parameter_count())


def _metadata(settings: TrainSettings, evaluation: Evaluation, parameters: int) -> dict[str, object]:
    network = {
        "classes": list(settings.network.classes),
        "pixels": settings.network.pixels,
        "tile_size": settings.tile_size,
        "feature_version": FEATURE_VERSION,
        "channels": list(settings.network.channels),
        "hidden": settings.network.hidden,
    }
    training = {"parameters": parameters, "seed": settings.seed, "command": settings.command}
    scores = {
        "accuracy_unseen": evaluation.unseen.accuracy,
        "confusion_unseen": evaluation.unseen.confusion,
        "accuracy_altered_copies": evaluation.altered_copies.accuracy,
        "confusion_altered_copies": evaluation.altered_copies.confusion,
        "accuracy_short_waves": evaluation.short_waves.accuracy,
    }
    return model_metadata("bumpymap-textures", network, training, scores)
