"""Collect sectors, train and score a scan network; write the ONNX file and its model card."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np

from bumpymap.core import PolarSettings
from bumpymap.lab.train.output import TrainedModel, model_files, model_metadata
from bumpymap.lab.train.scan.card import CardFacts, model_card
from bumpymap.lab.train.scan.data import (
    UNSEEN,
    ScanProgress,
    Sectors,
    folder_frames,
    folder_sectors,
    join,
    overhead_sectors,
    simulated_sectors,
)
from bumpymap.lab.train.scan.evaluate import ScanEvaluation, evaluate
from bumpymap.lab.train.scan.export import to_onnx
from bumpymap.lab.train.scan.train import ScanTrainSettings, train
from bumpymap.lab.train.training import EpochReport
from bumpymap.scan import SECTOR_VERSION

__all__ = ["UNSEEN_SCENES", "make_scan_model"]

UNSEEN_SCENES = 110
"""Number of synthetic scenes in the scores: ten of every theme."""


def make_scan_model(
    settings: ScanTrainSettings,
    out: Path,
    scans: Path | None = None,
    progress: Callable[[EpochReport], None] | None = None,
    scan_progress: ScanProgress | None = None,
) -> TrainedModel[ScanEvaluation]:
    """Train a network for the sectors of scans and write it.

    Parameters
    ----------
    settings : ScanTrainSettings
        Together with the scans they determine every byte of the file on one machine.
    out : Path
        The ONNX file. The model card is written next to it (``.md``), and while the job runs a folder of sectors
        (``.sectors``) and a checkpoint (``.checkpoint``), from which the same call resumes after an interruption.
    scans : Path, optional
        A folder in the layout of RELLIS-3D. If None, scenes are simulated, which needs open3d.
    progress : callable, optional
        Called with a report after every epoch.
    scan_progress : callable, optional
        Called with (finished scans, all scans) after every scan that was cut into sectors.

    Raises
    ------
    OutputError
        A file cannot be written.
    BadInputError
        The folder contains no scans with labels.
    UsageError
        A checkpoint of another training exists.
    """
    keep = out.with_name(out.name + ".sectors")
    command = f"bumpymap train --scans {'simulated' if scans is None else 'RELLIS_FOLDER'} {settings.options}"
    with model_files(out) as files:
        learn, unseen, unseen_scans = _collect_sectors(settings, scans, keep, scan_progress)
        net = train(settings, learn, files.checkpoint, progress)
        evaluation = evaluate(net, unseen, unseen_scans)
        content = to_onnx(net, _metadata(settings, evaluation, net.parameter_count(), command))
        made = CardFacts(
            learned=tuple(np.bincount(learn.class_id, minlength=3).tolist()),
            parameters=net.parameter_count(),
            size=len(content),
            command=command,
            simulated=scans is None,
        )
        files.write(content, model_card(settings, evaluation, made))
        shutil.rmtree(keep, ignore_errors=True)
    return TrainedModel(files.model, files.card, evaluation, net.parameter_count())


def _collect_sectors(
    settings: ScanTrainSettings, scans: Path | None, keep: Path, scan_progress: ScanProgress | None
) -> tuple[Sectors, Sectors, int]:
    """Return training sectors, test sectors and the number of scans of the test sectors."""
    if scans is not None:
        learn, unseen = folder_frames(scans)
        return (
            folder_sectors(learn, settings.turns, settings.seed, scan_progress),
            folder_sectors(unseen, progress=scan_progress),
            len(unseen),
        )
    unseen_scenes = range(UNSEEN, UNSEEN + UNSEEN_SCENES)
    learned = [simulated_sectors(settings.seed, range(settings.scenes), settings.turns, keep, scan_progress)]
    overhead = range(0, settings.scenes - 9, 10)  # every tenth, in every theme
    if overhead:
        learned.append(overhead_sectors(settings.seed, overhead))
    return (
        join(learned),
        simulated_sectors(settings.seed, unseen_scenes, 0, keep, scan_progress),
        UNSEEN_SCENES,
    )


def _metadata(
    settings: ScanTrainSettings, evaluation: ScanEvaluation, parameters: int, command: str
) -> dict[str, object]:
    network = {"sector_version": SECTOR_VERSION, "pixels": PolarSettings().pixels}
    training = {"parameters": parameters, "seed": settings.seed, "command": command}
    scores = {
        "accuracy_even": evaluation.every.balanced_accuracy,
        "accuracy_unseen": evaluation.every.accuracy,
        "confusion_unseen": evaluation.every.confusion,
    }
    return model_metadata("bumpymap-scan", network, training, scores)
