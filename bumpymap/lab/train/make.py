"""Train and score a texture network; write the ONNX file and its model card."""

from collections.abc import Callable
from pathlib import Path

from bumpymap.lab.train.card import model_card
from bumpymap.lab.train.evaluate import Evaluation, evaluate
from bumpymap.lab.train.export import to_onnx
from bumpymap.lab.train.output import TrainedModel, model_files, model_metadata
from bumpymap.lab.train.train import TrainSettings, train
from bumpymap.lab.train.training import EpochReport
from bumpymap.rating import FEATURE_VERSION

__all__ = ["UNSEEN_PER_TEXTURE", "make_model"]

UNSEEN_PER_TEXTURE = 2500
"""Number of patches per texture in the scores on unseen seeds."""


def make_model(
    settings: TrainSettings, out: Path, progress: Callable[[EpochReport], None] | None = None
) -> TrainedModel[Evaluation]:
    """Train a texture network and write it.

    Parameters
    ----------
    settings : TrainSettings
        They determine every byte of the file on one machine.
    out : Path
        The ONNX file. The model card is written next to it (``.md``), and during training a checkpoint
        (``.checkpoint``), from which the same call resumes after an interruption.
    progress : callable, optional
        Called with a report after every epoch.

    Raises
    ------
    OutputError
        A file cannot be written.
    UsageError
        A checkpoint with other settings exists.
    """
    with model_files(out) as files:
        net = train(settings, files.checkpoint, progress)
        evaluation = evaluate(net, settings.seed, settings.patches_per_texture, UNSEEN_PER_TEXTURE)
        content = to_onnx(net, _metadata(settings, evaluation, net.parameter_count()))
        files.write(content, model_card(settings, evaluation, net.parameter_count(), len(content)))
    return TrainedModel(files.model, files.card, evaluation, net.parameter_count())


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
        "accuracy_altered_copies": evaluation.augmented_copies.accuracy,
        "confusion_altered_copies": evaluation.augmented_copies.confusion,
        "accuracy_short_waves": evaluation.short_waves.accuracy,
    }
    return model_metadata("bumpymap-textures", network, training, scores)
