"""How good a scan network is on ground that it has never seen."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from bumpymap.core import CLASSES
from bumpymap.lab.train.evaluate import Score
from bumpymap.lab.train.scan.data import Sectors
from bumpymap.lab.train.scan.model import ScanNet

__all__ = ["ScanEvaluation", "confusion", "evaluate", "even_accuracy", "predict"]

_BATCH = 1024


@dataclass(frozen=True, slots=True)
class ScanEvaluation:
    """Every score that the model card reports, on unseen scans."""

    every: Score
    """All sectors with a class."""
    gated: Score
    """Those that the gate lets through: what the network is asked in use."""
    labels: dict[int, tuple[int, ...]]
    """RELLIS-3D id -> sectors said to be of class 0, 1, 2."""
    scans: int
    """Number of scans."""


def even_accuracy(score: Score) -> float:
    """Share of right answers if every class that is there were as frequent, 0..1: patches are balanced so."""
    shares = [line[i] / sum(line) for i, line in enumerate(score.confusion) if sum(line)]
    return sum(shares) / len(shares)


def predict(net: ScanNet, sectors: Sectors) -> NDArray[np.float32]:
    """Return probabilities (n, CLASSES)."""
    patches, measures = torch.from_numpy(sectors.patches), torch.from_numpy(sectors.measures)
    with torch.no_grad():
        chunks = zip(torch.split(patches, _BATCH), torch.split(measures, _BATCH), strict=True)
        parts = [net(patch, measure).softmax(1) for patch, measure in chunks]
    probability: NDArray[np.float32] = torch.cat(parts).numpy()
    return probability


def confusion(class_id: NDArray[np.integer], said: NDArray[np.integer]) -> Score:
    """Count right and wrong answers."""
    counts = np.bincount(class_id * CLASSES + said, minlength=CLASSES * CLASSES).reshape(CLASSES, CLASSES)
    return Score(tuple(tuple(int(n) for n in line) for line in counts))


def evaluate(net: ScanNet, unseen: Sectors, scans: int) -> ScanEvaluation:
    """Score a trained network on the sectors of so many unseen scans."""
    said = predict(net, unseen).argmax(axis=1)
    gate = unseen.traversable
    labels = {
        int(label): tuple(np.bincount(said[unseen.label == label], minlength=CLASSES).tolist())
        for label in np.unique(unseen.label)
    }
    return ScanEvaluation(confusion(unseen.class_id, said), confusion(unseen.class_id[gate], said[gate]), labels, scans)
