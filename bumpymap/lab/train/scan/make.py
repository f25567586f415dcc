"""The whole job: gather sectors, train, score, write the ONNX file and its model card."""

import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

import bumpymap
from bumpymap.core import OutputError, PolarSettings, atomic, locked
from bumpymap.lab.train.scan.card import model_card
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
from bumpymap.lab.train.scan.evaluate import ScanEvaluation, evaluate, even_accuracy
from bumpymap.lab.train.scan.export import to_onnx
from bumpymap.lab.train.scan.train import ScanTrainSettings, train
from bumpymap.lab.train.train import EpochReport
from bumpymap.scan import SECTOR_VERSION, grid_record

__all__ = ["UNSEEN_SCENES", "MadeScanModel", "make_scan_model"]

UNSEEN_SCENES = 105
"""Made-up scenes that the scores are made of: fifteen of every theme."""


@dataclass(frozen=True, slots=True)
class MadeScanModel:
    """What was written, and how good it is."""

    model: Path
    card: Path
    evaluation: ScanEvaluation
    parameters: int
    """Trained numbers of the network."""


def make_scan_model(
    settings: ScanTrainSettings,
    out: Path,
    scans: Path | None = None,
    progress: Callable[[EpochReport], None] | None = None,
    gathered: Told | None = None,
) -> MadeScanModel:
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
        Hears of every scan that was cut into sectors: how many are done, of how many.

    Raises
    ------
    OutputError
        A file cannot be written.
    BadInputError
        The folder holds no scans with labels.
    UsageError
        A checkpoint of another training is in the way.
    """
    if not (out.parent.is_dir() and os.access(out.parent, os.W_OK)):
        raise OutputError(f"cannot write {out}: {out.parent} is not a writable folder. Choose another --out")
    with locked(out.parent, f".{out.name}.lock"):
        return _make(settings, out, scans, progress, gathered)


def _make(
    settings: ScanTrainSettings,
    out: Path,
    scans: Path | None,
    progress: Callable[[EpochReport], None] | None,
    gathered: Told | None,
) -> MadeScanModel:
    keep = out.with_name(out.name + ".sectors")
    checkpoint = out.with_name(out.name + ".checkpoint")
    learn, unseen, unseen_scans = _gather(settings, scans, keep, gathered)
    net = train(settings, learn, checkpoint, progress)
    evaluation = evaluate(net, unseen, unseen_scans)
    counts = tuple(np.bincount(learn.class_id, minlength=3).tolist())
    command = f"bumpymap train --scans {'simulated' if scans is None else 'RELLIS_FOLDER'} {settings.options}"
    content = to_onnx(net, _metadata(settings, evaluation, net.parameter_count(), command))
    card = out.with_suffix(".md")
    with atomic(out) as beside:
        beside.write_bytes(content)
    with atomic(card) as beside:
        text = model_card(
            settings, evaluation, counts, net.parameter_count(), len(content), command, simulated=scans is None
        )
        beside.write_text(text, encoding="utf-8")
    checkpoint.unlink(missing_ok=True)
    shutil.rmtree(keep, ignore_errors=True)
    return MadeScanModel(out, card, evaluation, net.parameter_count())


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
    return {
        "format": "bumpymap-scan",
        "bumpymap": bumpymap.__version__,
        "torch": torch.__version__,
        "sector_version": SECTOR_VERSION,
        "grid": grid_record(PolarSettings()),
        "parameters": parameters,
        "seed": settings.seed,
        "command": command,
        "accuracy_even": even_accuracy(evaluation.every),
        "accuracy_unseen": evaluation.every.accuracy,
        "confusion_unseen": evaluation.every.confusion,
        "accuracy_gated": evaluation.gated.accuracy,
        "confusion_gated": evaluation.gated.confusion,
    }
