"""Bayes' rule for a few numbers of a calibration: prior from simulation, likelihood from measured stretches.

ln C_r of the vehicle = middle + shift + (1 + tilt) (ln C_r of the calibration - middle), and a floor in power. What a
stretch is off by is its own (measurement, place, and that a drive follows one line where the map tells the mean over
many) or common to its square of ground (the map's error). Own errors have the long tails of Student's distribution.
How much lines differ, and how large the map's error is beside its interval, is not known: the answer is the mean over a
grid of both, each weighted by how well it explains the drives (Laplace's approximation). All sums run over stretches
and squares: no matrix is larger than the few numbers.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.rating.update.evidence import DriveEvidence

__all__ = ["DrivePrior", "MovePosterior", "fit_move", "respond"]

Floats = NDArray[np.float64]
FREEDOM = 6.0
"""Of Student's distribution."""
TAIL_SCALE = 0.766
"""Its squared scale for errors of variance 1: where they are normal, the size that is found is theirs."""
_SURENESS = 0.717
"""Fisher information of normal errors under these weights, over the sum of the weights."""
_SCALES = np.array([0.25, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8])
"""Grid of the map's error over what its interval says."""
_SCALE_LOG_SD = 0.5
_LINES = np.array([0.0, 0.06, 0.1, 0.15, 0.22, 0.33, 0.5])
"""Grid of the standard deviation of ln C_r between lines over the ground of a stretch."""
_STEPS = 12


@dataclass(frozen=True, slots=True)
class DrivePrior:
    """What is known of the numbers before any drive."""

    middle: float
    """ln C_r [rad/m] at which the shift is told."""
    sd: tuple[float, ...]
    """Standard deviations of shift and tilt, and of ln floor if it may move."""
    log_floor: float
    """ln of the floor [rad/m], -inf without one; its centre if it may move."""

    @property
    def mean(self) -> Floats:
        """Return the most likely numbers: nothing moves."""
        return np.array([0.0, 0.0, self.log_floor][: len(self.sd)])


@dataclass(frozen=True, slots=True)
class MovePosterior:
    """What is known of the numbers after the drives."""

    mean: Floats
    """(p,)"""
    covariance: Floats
    """(p, p)"""
    map_scale: float
    """The map's error over what its interval says."""
    line_sd: float
    """Standard deviation of ln C_r between lines over the ground of a stretch."""


def respond(numbers: Floats, log_c_r: Floats, prior: DrivePrior) -> tuple[Floats, Floats]:
    """Return ln C_r of the vehicle (n,), and its derivatives by the numbers (n, p).

    Parameters
    ----------
    numbers : array (p,)
        Shift, tilt and, if it may move, ln of the floor.
    log_c_r : array (n,)
        ln C_r of the calibration without its floor.
    prior : DrivePrior
    """
    x = log_c_r - prior.middle
    log_floor = numbers[2] if len(numbers) > 2 else prior.log_floor
    driven = prior.middle + numbers[0] + (1.0 + numbers[1]) * x
    value = 0.5 * np.logaddexp(2.0 * driven, 2.0 * log_floor)
    share = np.exp(2.0 * (driven - value))
    return value, np.column_stack((share, share * x, 1.0 - share))[:, : len(numbers)]


def fit_move(evidence: DriveEvidence, prior: DrivePrior) -> MovePosterior:
    """Return what prior and drives say together."""
    grid = [(scale, line_sd) for scale in _SCALES.tolist() for line_sd in _LINES.tolist()]
    found = [_fit_at(evidence, prior, scale, line_sd) for scale, line_sd in grid]
    log_weight = np.array([weight for _, _, weight in found])
    log_weight -= 0.5 * (np.log([scale for scale, _ in grid]) / _SCALE_LOG_SD) ** 2
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    means = np.array([mean for mean, _, _ in found])
    mean = weight @ means
    away = means - mean
    covariance = np.einsum("g,gij->ij", weight, np.array([each for _, each, _ in found]))
    covariance += np.einsum("g,gi,gj->ij", weight, away, away)
    scale, line_sd = weight @ np.array(grid)
    return MovePosterior(mean, covariance, float(scale), float(line_sd))


def _fit_at(evidence: DriveEvidence, prior: DrivePrior, scale: float, line_sd: float) -> tuple[Floats, Floats, float]:
    """Return mean, covariance and log evidence at one size of the map's error and of what lines differ."""
    own, common = TAIL_SCALE * (evidence.own_variance + line_sd**2), scale * evidence.map_sd
    square = evidence.square
    sure = np.diag(1.0 / np.square(prior.sd))
    numbers, offset = prior.mean, np.zeros(int(square.max()) + 1)
    for _ in range(_STEPS):
        value, slope = respond(numbers, evidence.log_c_r, prior)
        left = evidence.log_measured - value
        weight = (FREEDOM + 1.0) / (FREEDOM + (left - offset[square] * common) ** 2 / own) / own
        fixed, mixed, whole = _sums(np.column_stack((slope, left)), weight, common, square)
        step = np.linalg.solve(fixed[:-1, :-1] + sure, fixed[:-1, -1] - sure @ (numbers - prior.mean))
        numbers = numbers + step
        offset = (mixed[-1] - step @ mixed[:-1]) / whole
    left = evidence.log_measured - respond(numbers, evidence.log_c_r, prior)[0] - offset[square] * common
    away = numbers - prior.mean
    fixed, _, whole = _sums(slope, _SURENESS * weight, common, square)
    fits = -0.5 * np.log(own).sum() - 0.5 * (FREEDOM + 1.0) * np.log1p(left**2 / (FREEDOM * own)).sum()
    fits -= 0.5 * (offset @ offset + away @ sure @ away + np.log(whole).sum() + np.linalg.slogdet(fixed + sure)[1])
    covariance = np.asarray(np.linalg.inv(fixed + sure), np.float64)
    return numbers, covariance, float(fits)


def _sums(columns: Floats, weight: Floats, common: Floats, square: NDArray[np.int64]) -> tuple[Floats, Floats, Floats]:
    """Return the normal equations of k columns (k, k), and by square the mixed sums (k, squares) and the whole ones.

    What is common to a square is eliminated (Woodbury's identity).
    """
    squares = int(square.max()) + 1
    sums = [np.bincount(square, values, squares) for values in weight * common * np.column_stack((columns, common)).T]
    mixed, whole = np.array(sums[:-1], np.float64), 1.0 + np.array(sums[-1], np.float64)
    return (columns.T * weight) @ columns - (mixed / whole) @ mixed.T, mixed, whole
