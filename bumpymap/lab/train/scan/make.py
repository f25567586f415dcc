"""The whole job: gather sectors, train, score, write the ONNX file and its model card."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np

from bumpymap.core import PolarSettings
from bumpymap.lab.train.output import MadeModel, model_files, model_metadata
from bumpymap.lab.train.scan.card import CardFacts, model_card
from bumpymap.lab.train.scan.data import (
    UNSEEN,
    Sectors,
    Told,
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
from bumpymap.scan import SECTOR_VERSION, grid_record

__all__ = ["UNSEEN_SCENES", "make_scan_model"]

UNSEEN_SCENES = 105
"""Made-up scenes that the scores are made of: fifteen of every theme."""


def make_scan_model(
    settings: ScanTrainSettings,
    out: Path,
    scans: Path | None = None,
    progress: Callable[[EpochReport], None] | None = None,
    gathered: Told | None = None,
) -> MadeModel[ScanEvaluation]:
    """Train a network for the sectors of scans and write it.

    Parameters
    ----------
    settings : ScanTrainSettings
        With the scans they decide every byte of the file on one machine.
    out : Path
        The ONNX file. The model card stands beside it (``.md``); while the job runs, so do a folder of sectors
        (``.sectors``) and a checkpoint (``.checkpoint``), from which the same call goes on after a break.
    scans : Path, optional
        A folder in the layout of RELLIS-3D; None: scenes are simulated, which needs open3d.
    told : callable, optional
        Gets a report after every epoch.
    gathered : callable, optional
        Called after every scan that was cut into sectors: how many are done, of how many.

    Raises
    ------
    OutputError
        A file cannot be written.
    BadInputError
        The folder holds no scans with labels.
    UsageError
        A checkpoint of another training is in the way.
    """
    keep = out.with_name(out.name + ".sectors")
    command = f"bumpymap train --scans {'simulated' if scans is None else 'RELLIS_FOLDER'} {settings.options}"
    with model_files(out) as files:
        learn, unseen, unseen_scans = _gather(settings, scans, keep, gathered)
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
    return MadeModel(files.model, files.card, evaluation, net.parameter_count())


def _gather(
    settings: ScanTrainSettings, scans: Path | None, keep: Path, gathered: Told | None
) -> tuple[Sectors, Sectors, int]:
    """Sectors to learn from, sectors to be judged by, and how many scans those are of."""
    if scans is not None:
        learn, unseen = folder_frames(scans)
        return (
            folder_sectors(learn, settings.turns, settings.seed, gathered),
            folder_sectors(unseen, progress=gathered),
            len(unseen),
        )
    unseen_scenes = range(UNSEEN, UNSEEN + UNSEEN_SCENES)
    learned = [simulated_sectors(settings.seed, range(settings.scenes), settings.turns, keep, gathered)]
    overhead = range(0, settings.scenes - 9, 10)  # every tenth, in every theme
    if overhead:
        learned.append(overhead_sectors(settings.seed, overhead))
    return (
        join(learned),
        simulated_sectors(settings.seed, unseen_scenes, 0, keep, gathered),
        UNSEEN_SCENES,
    )


def _metadata(
    settings: ScanTrainSettings, evaluation: ScanEvaluation, parameters: int, command: str
) -> dict[str, object]:
    network = {"sector_version": SECTOR_VERSION, "grid": grid_record(PolarSettings())}
    training = {"parameters": parameters, "seed": settings.seed, "command": command}
    scores = {
        "accuracy_even": evaluation.every.even_accuracy,
        "accuracy_unseen": evaluation.every.accuracy,
        "confusion_unseen": evaluation.every.confusion,
        "accuracy_gated": evaluation.gated.accuracy,
        "confusion_gated": evaluation.gated.confusion,
    }
    return model_metadata("bumpymap-scan", network, training, scores)
