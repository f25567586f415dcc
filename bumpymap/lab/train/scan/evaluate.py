"""Score a scan network on unseen scans."""

from dataclasses import dataclass

import numpy as np
import torch

from bumpymap.core import CLASSES
from bumpymap.lab.train.evaluate import predict
from bumpymap.lab.train.scan.data import Sectors
from bumpymap.lab.train.scan.model import ScanNet
from bumpymap.lab.train.score import Score, count_answers

__all__ = ["ScanEvaluation", "evaluate"]


@dataclass(frozen=True, slots=True)
class ScanEvaluation:
    """All scores of the model card, on unseen scans."""

    every: Score
    """All sectors with a class and ground, which are the ones classified in use."""
    labels: dict[int, tuple[int, ...]]
    """RELLIS-3D id -> number of sectors classified as 0, 1, 2."""
    scans: int
    """Number of scans."""


def evaluate(net: ScanNet, unseen: Sectors, scans: int) -> ScanEvaluation:
    """Score a trained network on the sectors of ``scans`` unseen scans."""
    probability = predict(net, torch.from_numpy(unseen.patches), torch.from_numpy(unseen.measures))
    predicted = probability.argmax(axis=1)
    labels = {
        int(label): tuple(np.bincount(predicted[unseen.label == label], minlength=CLASSES).tolist())
        for label in np.unique(unseen.label)
    }
    return ScanEvaluation(count_answers(unseen.class_id, predicted, CLASSES), labels, scans)
