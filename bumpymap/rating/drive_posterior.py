"""Bayes' rule for a few numbers of a calibration: prior from simulation, likelihood from measured stretches.

ln C_r of the vehicle = middle + shift + (1 + tilt) (ln C_r of the calibration - middle), and a floor in power. What a
stretch is off by is its own (measurement, place, and that a drive follows one line where the map tells the mean over
many) or common to its square of ground (the map's error). Own errors have the long tails of Student's distribution.
How much lines differ, and how large the map's error is beside its interval, is not known: the answer is the mean over a
grid of both, each weighted by how well it explains the drives (Laplace's approximation). All sums run over stretches
and squares: no matrix is larger than the few numbers.

scikit-learn's BayesianRidge, rows over their errors, breaks the promises of the tests: its 80 % intervals hold 58 to
65 %, one wild stretch in 15 moves C_r by 12 % (here 0.1 %), and driving ground again five times more than halves the
standard error (here 13 % less). Its errors are normal and independent, and it cannot take a prior that is known.
"""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import DrivenStretches
from bumpymap.rating.ride.correction import NORMAL_TAIL

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
SQUARE_M = 30.0
"""Side of a square of ground whose stretches share a part of the map's error."""
SPEED_FACTOR = 1.3
"""Stretches that were driven faster or slower than the calibration by more than this factor do not count."""
MOST_SENSOR_SHARE = 0.5
"""Stretches whose measurement has a larger standard error than this share of what the map says do not count."""
LEFT_OUT = ("off_map", "other_speed", "below_sensor")
"""Why a stretch does not count: the map does not know the ground, or nothing was measured; it was driven at another
speed; the sensor cannot tell so little motion."""
_FOLD_M, _FOLDS, _LEAST_DRIVES = 50.0, 10, 3
"""Left out together are whole drives, if there are at least three, else pieces of the way of at least 50 m; in ten
parts at most. Chosen."""
_INTERVAL_SD = 2 * NORMAL_TAIL
"""Width of an 80 % interval in standard deviations."""
_LEAST_MAP_SD = 0.03
"""Least standard deviation of ln C_r by the map's interval that is believed."""
_LEAST_STRETCHES = 8
"""With fewer, how errors grow with what was measured is not fitted."""
_TINY = 1e-9
"""C_r that stands for 0 in a logarithm, rad/m."""
_LEAST_SHARE = 0.1
"""Least part of the map's C_r that is not its floor, and of a standard error that a measurement may be."""


@dataclass(frozen=True, slots=True)
class DriveEvidence:
    """Stretches that count, one row each."""

    log_c_r: Floats
    """(n,) ln of the map's C_r [rad/m], without the floor of the profile."""
    log_measured: Floats
    """(n,) ln of the measured C_r [rad/m]."""
    own_variance: Floats
    """(n,) of ln C_r: errors of the measurement and of the place."""
    map_sd: Floats
    """(n,) of ln C_r, by the map's interval."""
    square: Integers
    """(n,) number of the square of ground, from 0."""
    fold: Integers
    """(n,) number of the part of the drives that is left out together, from 0."""
    drive: Integers
    """(n,) number of the drive."""
    way_m: Floats
    """(n,)"""
    new_m: Floats
    """(n,) length of the stretch, divided by how often its ground was driven."""

    def chosen(self, rows: NDArray[np.bool_]) -> "DriveEvidence":
        """Return some of the rows; squares are numbered again."""
        parts = {each.name: getattr(self, each.name)[rows] for each in fields(self)}
        return DriveEvidence(**parts | {"square": _numbered(parts["square"])})


def collect_evidence(
    stretches: DrivenStretches, speed_mps: float, floor: float
) -> tuple[DriveEvidence, dict[str, float]]:
    """Return what stretches say, and the lengths of those that do not count by `LEFT_OUT`, m.

    ``speed_mps``: that of the map's C_r; ``floor``: C_r of level ground in the profile, which the map's C_r holds in
    power, rad/m.
    """
    s = stretches
    known = np.isfinite(s.measured) & np.isfinite(s.measured_sd) & np.isfinite(s.easting + s.northing)
    known &= (np.nan_to_num(s.c_r) > 0) & (np.nan_to_num(s.c_r_low) > 0) & np.isfinite(s.c_r_high)
    with np.errstate(all="ignore"):
        fast = known & (np.abs(np.log(s.speed_mps / speed_mps)) > np.log(SPEED_FACTOR))
        factor = np.median(s.measured[known & ~fast] / s.c_r[known & ~fast]) if (known & ~fast).any() else 1.0
    scale = s.c_r * max(float(factor), 1e-3)
    sd = np.where(known, s.measured_sd, np.nan)
    sd[known] = _expected_sd(s.measured[known], sd[known], scale[known])
    low = known & ~fast & (sd > MOST_SENSOR_SHARE * scale)
    rows = known & ~fast & ~low
    way = s.way_m
    lost = {name: float(way[each].sum()) for name, each in zip(LEFT_OUT, (~known, fast, low), strict=True)}
    return _evidence(s, rows, sd[rows] / scale[rows], floor), lost


def _expected_sd(measured: Floats, sd: Floats, scale: Floats) -> Floats:
    """Return standard errors as if each stretch had measured what is expected of it, ``scale``; all (n,), rad/m.

    Errors that grow with what was measured would otherwise give low readings more weight than high ones.
    """
    above = np.log(np.maximum(measured, _LEAST_SHARE * sd + _TINY) / scale)
    terms = np.column_stack((np.ones(len(sd)), np.log(scale), above))
    growth = np.linalg.lstsq(terms, np.log(sd + _TINY), rcond=None)[0][2] if len(sd) >= _LEAST_STRETCHES else 0.0
    return np.asarray(sd * np.exp(-np.clip(growth, 0.0, 1.0) * above))


def _evidence(s: DrivenStretches, rows: NDArray[np.bool_], relative: Floats, floor: float) -> DriveEvidence:
    c_r, place, sd, way = s.c_r[rows], np.nan_to_num(s.place_sd[rows]), s.measured_sd[rows], s.way_m[rows]
    without_floor = np.sqrt(np.maximum(c_r**2 - floor**2, (_LEAST_SHARE * c_r) ** 2))
    place_of = np.column_stack((s.easting[rows], s.northing[rows]))
    drive = s.drive[rows]
    return DriveEvidence(
        log_c_r=np.log(without_floor),
        log_measured=np.log(np.maximum(s.measured[rows], _LEAST_SHARE * sd + _TINY)),
        own_variance=relative**2 + (place / c_r) ** 2,
        map_sd=np.maximum(np.log(s.c_r_high[rows] / s.c_r_low[rows]) / _INTERVAL_SD, _LEAST_MAP_SD),
        square=_numbered(np.floor(place_of / SQUARE_M).astype(np.int64)),
        fold=_folds(drive, s.start_s[rows], way),
        drive=drive,
        way_m=way,
        new_m=way / _times_driven(place_of, way),
    )


def _numbered(values: Integers) -> Integers:
    """Return numbers of the rows from 0, alike for equal ones."""
    return np.unique(values, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)


def _times_driven(place: Floats, way: Floats) -> Floats:
    """Return how often the ground of each stretch was driven, (n,): 1 for a way that does not cross itself.

    Stretches count by how far they overlap: those whose middles are a stretch apart do not.
    """
    times = np.ones(len(way))
    for first in range(0, len(way), 256):
        part = slice(first, first + 256)
        away = np.hypot(*(place[part, None, :] - place[None, :, :]).transpose(2, 0, 1))
        times[part] = np.maximum(1.0 - away / way[part, None], 0.0).sum(axis=1)
    return times


def _folds(drive: Integers, start_s: Floats, way: Floats) -> Integers:
    """Return which stretches are left out together: whole drives, or pieces of the way of at least 50 m."""
    number = _numbered(drive)
    if len(np.unique(drive)) >= _LEAST_DRIVES:
        return number % _FOLDS
    order = np.lexsort((start_s, number))
    before = np.zeros(len(way))
    before[order] = np.cumsum(way[order]) - way[order]
    total = float(way.sum())
    pieces = min(_FOLDS, max(int(total // _FOLD_M), 2))
    return np.minimum((before / max(total, 1e-9) * pieces).astype(np.int64), pieces - 1)


FREEDOM = 6.0
"""Of Student's distribution."""
TAIL_SCALE = 0.766
"""Its squared scale for errors of variance 1: where they are normal, the size that is found is theirs."""
_SURENESS = 0.717
"""Fisher information of normal errors under these weights, over the sum of the weights."""
_SCALES = np.array([0.25, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8])
"""Grid of the map's error over what its interval says."""
_SCALE_LOG_SD = 0.5
"""Standard deviation of the logarithm of that before any drive. Chosen."""
_LINES = np.array([0.0, 0.06, 0.1, 0.15, 0.22, 0.33, 0.5])
"""Grid of the standard deviation of ln C_r between lines over the ground of a stretch."""
_STEPS = 12
"""Newton's steps at each place of the grid. Chosen."""


@dataclass(frozen=True, slots=True)
class DrivePrior:
    """Distribution of the numbers before any drive."""

    middle: float
    """ln C_r [rad/m] at which the shift is given."""
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
    """Distribution of the numbers after the drives."""

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

    ``numbers`` (p,): shift, tilt and, if it may move, ln of the floor; ``log_c_r`` (n,): of the calibration without its
    floor.
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
    """Predict each part from the others; not ``moved``: by the calibration as it is.

    ``line_sd``: of `MovePosterior`, what is expected of errors.
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
