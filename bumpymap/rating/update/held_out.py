"""Whether the update predicts drives that it has not seen: each part is left out in turn."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.rating.update.evidence import DriveEvidence
from bumpymap.rating.update.posterior import FREEDOM, TAIL_SCALE, DrivePrior, fit_move, respond

__all__ = ["HeldOutScore", "hold_out"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class HeldOutScore:
    """How well left-out stretches are predicted."""

    parts: int
    """Number of parts that were left out in turn."""
    error: float
    """Median of abs(predicted / measured - 1)."""
    median_ratio: float
    """Median of predicted / measured."""
    log_score: Floats
    """(parts,) sum of the log probability densities of the stretches of each part, apart from a constant."""

    def gain_over(self, other: "HeldOutScore") -> tuple[float, float]:
        """Return how much better this one predicts, and the standard error of that by the scatter of the parts."""
        gain = self.log_score - other.log_score
        return float(gain.sum()), float(np.sqrt(len(gain)) * gain.std(ddof=1))


def hold_out(evidence: DriveEvidence, prior: DrivePrior, line_sd: float, *, moved: bool = True) -> HeldOutScore:
    """Predict each part from the others.

    Parameters
    ----------
    evidence : DriveEvidence
    prior : DrivePrior
    line_sd : float
        Of `MovePosterior`: what is expected of errors.
    moved : bool
        False: by the calibration as it is.
    """
    predicted = respond(prior.mean, evidence.log_c_r, prior)[0]
    for part in np.unique(evidence.fold) if moved else ():
        out = evidence.fold == part
        numbers = fit_move(evidence.chosen(~out), prior).mean
        predicted[out] = respond(numbers, evidence.log_c_r[out], prior)[0]
    left = evidence.log_measured - predicted
    variance = TAIL_SCALE * (evidence.own_variance + evidence.map_sd**2 + line_sd**2)
    score = -0.5 * (FREEDOM + 1.0) * np.log1p(left**2 / (FREEDOM * variance))
    parts = int(evidence.fold.max()) + 1
    by_part = np.asarray(np.bincount(evidence.fold, score, parts), np.float64)
    return HeldOutScore(parts, float(np.median(np.abs(np.expm1(-left)))), float(np.exp(-np.median(left))), by_part)
