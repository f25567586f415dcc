"""Move a calibration to measured drives, with the simulation as the prior (``bumpymap check --refit``).

Two numbers move: a shift of ln C_r, and a tilt of it (how much more it moves on rough ground than on smooth); a third,
the floor of the profile, if left-out parts of the drives are predicted better with it. Before any drive, shift and tilt
are 0, give or take what vehicles differ from their profiles (docs/pages/check.md has the table) and more, since no
simulation holds all of a vehicle. A calibration is moved only if it then predicts left-out parts better, and only from
a stated length of drive on.

*Bayes' rule for these numbers*: prior from simulation, likelihood from measured stretches.

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

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import NORMAL_80, BadInputError, DrivenStretches, Floats, plain_json
from bumpymap.rating.calibration import Calibration

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
_INTERVAL_SD = 2 * NORMAL_80
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
    relative = np.full(len(known), np.nan)
    relative[known] = _expected_sd(s.measured[known], s.measured_sd[known], scale[known]) / scale[known]
    low = known & ~fast & (relative > MOST_SENSOR_SHARE)
    lost = {name: float(s.way_m[each].sum()) for name, each in zip(LEFT_OUT, (~known, fast, low), strict=True)}
    rows = known & ~fast & ~low
    s = DrivenStretches(**{each.name: getattr(s, each.name)[rows] for each in fields(s)})
    place = np.column_stack((s.easting, s.northing))
    without_floor = np.sqrt(np.maximum(s.c_r**2 - floor**2, (_LEAST_SHARE * s.c_r) ** 2))
    return DriveEvidence(
        log_c_r=np.log(without_floor),
        log_measured=np.log(np.maximum(s.measured, _LEAST_SHARE * s.measured_sd + _TINY)),
        own_variance=relative[rows] ** 2 + (np.nan_to_num(s.place_sd) / s.c_r) ** 2,
        map_sd=np.maximum(np.log(s.c_r_high / s.c_r_low) / _INTERVAL_SD, _LEAST_MAP_SD),
        square=_numbered(np.floor(place / SQUARE_M).astype(np.int64)),
        fold=_folds(s.drive, s.start_s, s.way_m),
        drive=s.drive,
        way_m=s.way_m,
        new_m=s.way_m / _times_driven(place, s.way_m),
    ), lost


def _expected_sd(measured: Floats, sd: Floats, scale: Floats) -> Floats:
    """Return standard errors as if each stretch had measured what is expected of it, ``scale``; all (n,), rad/m.

    Errors that grow with what was measured would otherwise give low readings more weight than high ones.
    """
    above = np.log(np.maximum(measured, _LEAST_SHARE * sd + _TINY) / scale)
    terms = np.column_stack((np.ones(len(sd)), np.log(scale), above))
    growth = np.linalg.lstsq(terms, np.log(sd + _TINY), rcond=None)[0][2] if len(sd) >= _LEAST_STRETCHES else 0.0
    return np.asarray(sd * np.exp(-np.clip(growth, 0.0, 1.0) * above))


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


def hold_out(
    evidence: DriveEvidence, prior: DrivePrior, line_sd: float, *, moved: bool = True
) -> tuple[Floats, Floats]:
    """Predict each part from the others; not ``moved``: by the calibration as it is.

    ``line_sd``: of `MovePosterior`, what is expected of errors. Returns ln of measured over predicted C_r (n,), and for
    each part the sum of the log probability densities of its stretches, apart from a constant, (parts,).
    """
    predicted = respond(prior.mean, evidence.log_c_r, prior)[0]
    for part in np.unique(evidence.fold) if moved else ():
        out = evidence.fold == part
        numbers = fit_move(evidence.chosen(~out), prior).mean
        predicted[out] = respond(numbers, evidence.log_c_r[out], prior)[0]
    left = evidence.log_measured - predicted
    variance = TAIL_SCALE * (evidence.own_variance + evidence.map_sd**2 + line_sd**2)
    score = -0.5 * (FREEDOM + 1.0) * np.log1p(left**2 / (FREEDOM * variance))
    return left, np.asarray(np.bincount(evidence.fold, score), np.float64)


def _gain(after: Floats, before: Floats) -> tuple[float, float]:
    """Return how much better left-out parts (n,) are predicted, and the standard error of that by their scatter."""
    gain = after - before
    return float(gain.sum()), float(np.sqrt(len(gain)) * gain.std(ddof=1))


_DIGITS = 10
"""Significant digits of moved coefficients."""
_POINTS = 31
"""Places of the range that a straight line of the spread is fitted to. Chosen."""
_NOISE = ("noise_low", "noise_middle", "noise_high")


@dataclass(frozen=True, slots=True)
class LogMove:
    """How ln C_r moves: a straight line, with what is not known of it."""

    middle: float
    shift: float
    tilt: float
    covariance: Floats
    """(2, 2) of shift and tilt."""
    widening: float
    """Factor on standard deviations of ln C_r, at least 1."""

    @property
    def slope(self) -> float:
        """Factor on differences of ln C_r."""
        return 1.0 + self.tilt

    @property
    def intercept(self) -> float:
        """Constant that is added to ``slope`` times ln C_r."""
        return self.shift - self.tilt * self.middle

    def log(self, log_c_r: Floats) -> Floats:
        """Return moved ln C_r."""
        return self.intercept + self.slope * log_c_r

    def terms(self, coefficients: Sequence[float]) -> list[float]:
        """Return moved coefficients of ln C_r, of which the first is the constant."""
        first, *rest = (self.slope * value for value in coefficients)
        return [_short(first + self.intercept), *map(_short, rest)]

    def c_r(self, value: Any) -> Any:
        """Return moved C_r of a number, None, or nested sequences of them, as tuples or lists as they came."""
        return _each(value, lambda c_r: float(np.exp(self.log(np.log(c_r)))) if c_r > 0 else c_r)

    def sd(self, value: Any, c_r: float) -> Any:
        """Return moved standard deviations of ln C_r about a C_r [rad/m], of the same kinds of values."""
        at = np.array([1.0, np.log(c_r) - self.middle])
        unknown = float(np.sqrt(at @ self.covariance @ at))
        return _each(value, lambda sd: float(np.hypot(self.widening * self.slope * sd, unknown)))


def moved_calibration(calibration: Calibration, move: LogMove, record: dict[str, Any]) -> Calibration:
    """Return a calibration whose C_r is moved; ``record``, plain JSON, becomes ``moved_to_drives`` in its settings."""
    ride, thin, tile = calibration.ride, calibration.thin, calibration.steps["tile"]
    wider, middle = move.widening * move.slope, float(np.exp(move.middle))
    more = {name: _each(ride[name], lambda value: value * move.slope) for name in _NOISE}
    more |= {"c_r": move.terms(ride["c_r"]), "spread": _moved_spread(ride, move)}
    more |= {"model_error": _short(wider * ride["model_error"])}
    log_sd = [move.sd(sd, c_r) for sd, c_r in zip(tile["c_r_log_sd"], tile["c_r"], strict=True)]
    first, *rest = thin["spread"]
    spread = {"spread": [_short(first + np.log(wider)), *rest], "own_spread": move.sd(thin["own_spread"], middle)}
    return replace(
        calibration,
        c_r=move.c_r(calibration.c_r),
        c_r_log_sd=move.sd(calibration.c_r_log_sd, middle),
        class_c_r=_class_means(calibration, move),
        ride=ride | more,
        thin=thin | {"c_r": move.terms(thin["c_r"])} | spread,
        steps=calibration.steps | {"tile": tile | {"c_r": move.c_r(tile["c_r"]), "c_r_log_sd": log_sd}},
        settings=calibration.settings | {"moved_to_drives": record},
    )


def _moved_spread(ride: Mapping[str, Any], move: LogMove) -> list[float]:
    """Return ln of the moved spread at both ends: the straight line nearest to it, nowhere below the simulation's.

    Where on the range a C_r lies follows from the geometric C_r, which is near that of the drives.
    """
    low, high = ride["log_range"]
    log_g = np.linspace(low, high, _POINTS)
    own = np.exp(np.interp(log_g, (low, high), ride["spread"]))
    wanted = np.log([move.sd(sd, np.exp(at)) for sd, at in zip(own.tolist(), log_g.tolist(), strict=True)])
    slope, start = np.polyfit(np.linspace(0.0, 1.0, _POINTS), wanted, 1).tolist()
    least = np.log(move.widening * move.slope)
    return [_short(max(new, sd + least)) for new, sd in zip((start, start + slope), ride["spread"], strict=True)]


def _class_means(calibration: Calibration, move: LogMove) -> tuple[float, float, float, float]:
    """Return the mean moved C_r of the library's terrains by class; the limits stay, so terrains change class."""
    edges = np.array([0.0, *calibration.class_limits, np.inf])
    known = [
        c_r
        for columns in calibration.settings.get("library", {}).values()
        for c_r in columns["c_r"]
        if c_r is not None and c_r > 0
    ]
    moved = np.exp(move.log(np.log(np.array(known, np.float64))))
    class_id = np.searchsorted(calibration.class_limits, moved, side="right")
    likely = np.clip(move.c_r(calibration.class_c_r), edges[:-1], edges[1:])
    means = [moved[class_id == k].mean() if (class_id == k).any() else likely[k] for k in range(len(likely))]
    a, b, c, d = map(_short, means)
    return a, b, c, d


def _each(value: Any, change: Any) -> Any:
    """Change every number of nested lists and tuples; None stays."""
    if isinstance(value, list | tuple):
        return type(value)(_each(item, change) for item in value)
    return None if value is None else _short(change(value))


def _short(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")


_MIDDLE_LIMIT = 1
"""The class limit at which the shift is given."""
_DECIMALS = 4
"""Of the moved numbers: what is below differs between machines."""
_USUAL_FLOOR = 0.03
"""Centre of the floor [rad/m] before any drive, where the profile has none: wheeled vehicles on paved ground."""
_FLOOR_LOG_SD = 0.5, 1.0
"""Standard deviation of its logarithm where the profile has one, and where it has none."""


_SHIFT_SD, _TILT_SD = 0.2, 0.1
"""Standard deviations of shift and tilt of ln C_r before any drive."""
_LEAST_M, _LEAST_COUNT = 200.0, 12
"""Least length of driven ground, m (ground that was driven twice counts once), and number of stretches."""
_LEAST_GAIN, _LEAST_FLOOR_GAIN = 1.28, 2.0
"""Least gain on parts that were left out, in its standard errors: by chance alone, one in ten has the first. The second
is that of a floor that moves, over one that does not."""


@dataclass(frozen=True, slots=True)
class DriveUpdate:
    """How a calibration was moved, and what that rests on."""

    calibration_id: str
    """Of the calibration before."""
    drives: int
    stretches: int
    """Number of stretches that count."""
    way_m: float
    """Their length, m."""
    new_m: float
    """The same, with ground that was driven more than once counted once, m."""
    left_out: dict[str, float]
    """Lengths of stretches that do not count by `LEFT_OUT`, m."""
    c_r_range: tuple[float, float]
    """10 and 90 % quantile of the calibration's C_r over them, rad/m."""
    prior: DrivePrior
    posterior: MovePosterior
    floor: tuple[float, float]
    """C_r of even ground before and after, rad/m."""
    factor: tuple[float, float, float]
    """Factor on the calibration's C_r in the middle of that range: low, median and high of 80 %."""
    ratio: tuple[float, float]
    """Median of C_r / measured before and after."""
    held_out_error: tuple[float, float]
    """Median of abs(C_r / measured - 1) on parts that were left out, before and after."""
    gain: tuple[float, float]
    """Gain in ln probability on parts that were left out, and its standard error."""
    parts: int
    """Number of parts that were left out in turn."""

    def to_record(self) -> dict[str, Any]:
        """Return all findings as plain JSON."""
        plain: dict[str, Any] = plain_json(self, 6)
        if not math.isfinite(self.prior.log_floor):
            del plain["prior"]["log_floor"]
        return plain


def update_from_drives(
    calibration: Calibration, stretches: DrivenStretches, speed_mps: float | None = None
) -> tuple[Calibration, DriveUpdate]:
    """Move the C_r of a calibration to what drives measured; its vehicle, class limits and p_fail stay.

    ``calibration``: the one that the map of the stretches was made with; ``stretches``: of all drives;
    ``speed_mps``: that the map's C_r is for, None: that of the profile. Raises BadInputError if the calibration was
    moved before, or the drives are too short, or agree with it.
    """
    if "moved_to_drives" in calibration.settings:
        before = calibration.settings["moved_to_drives"].get("calibration_id", "before")
        raise BadInputError(
            f"the calibration {calibration.id} was moved to drives already, and would count them twice. Check all "
            f"drives together, those of then and those of now, against a map made with the calibration {before}"
        )
    floor = calibration.floor
    speed = speed_mps or calibration.profile.speed_mps
    evidence, lost = collect_evidence(stretches, speed, floor)
    _require_enough(evidence, lost, speed)
    plain = DrivePrior(
        middle=math.log(calibration.class_limits[_MIDDLE_LIMIT]),
        sd=(_SHIFT_SD, _TILT_SD),
        log_floor=math.log(floor) if floor else -math.inf,
    )
    update = _update(calibration, evidence, lost, plain)
    if not update.gain[0] > _LEAST_GAIN * update.gain[1]:
        raise BadInputError(_agree(update))
    found = update.posterior
    shift, tilt = found.mean[:2].tolist()
    move = LogMove(update.prior.middle, shift, tilt, found.covariance[:2, :2], max(1.0, found.map_scale))
    moved = moved_calibration(calibration, move, update.to_record())
    if update.floor[0] != update.floor[1]:
        moved = replace(moved, vehicle=moved.vehicle | {"floor": {"c_r_radpm": update.floor[1]}})
    return moved, update


def _best_prior(evidence: DriveEvidence, plain: DrivePrior, line_sd: float) -> tuple[DrivePrior, Floats, Floats]:
    """Return the prior with a floor that moves if left-out parts are predicted better with it, else the plain one.

    Also return what `hold_out` does with it.
    """
    own = math.isfinite(plain.log_floor)
    centre, sd = (plain.log_floor, _FLOOR_LOG_SD[0]) if own else (math.log(_USUAL_FLOOR), _FLOOR_LOG_SD[1])
    floored = DrivePrior(plain.middle, (*plain.sd, sd), centre)
    fixed, free = hold_out(evidence, plain, line_sd), hold_out(evidence, floored, line_sd)
    gain, error = _gain(free[1], fixed[1])
    return (floored, *free) if gain > _LEAST_FLOOR_GAIN * error else (plain, *fixed)


def _require_enough(evidence: DriveEvidence, lost: dict[str, float], speed: float) -> None:
    number, new_m = len(evidence.way_m), float(evidence.new_m.sum())
    if number >= _LEAST_COUNT and new_m >= _LEAST_M:
        return
    reasons = ("off the map", f"not near the {speed:g} m/s of the map", "with less motion than the sensor tells")
    parts = zip(reasons, lost.values(), strict=True)
    named = ", ".join(f"{length:.0f} m {reason}" for reason, length in parts if length >= 0.5)
    raise BadInputError(
        f"the drives are too short to move a calibration: {new_m:.0f} m of different ground on {number} stretches count"
        f"{f' (left out: {named})' if named else ''}. It takes at least {_LEAST_M:.0f} m on "
        f"{_LEAST_COUNT} stretches; drive more, over smooth ground and rough, and give all drives together"
    )


def _update(
    calibration: Calibration, evidence: DriveEvidence, lost: dict[str, float], plain: DrivePrior
) -> DriveUpdate:
    line_sd = fit_move(evidence, plain).line_sd
    prior, left, score = _best_prior(evidence, plain, line_sd)
    left_before, score_before = hold_out(evidence, plain, line_sd, moved=False)
    found = fit_move(evidence, prior)
    posterior = MovePosterior(
        np.round(found.mean, _DECIMALS),
        np.round(found.covariance, 2 * _DECIMALS),
        round(found.map_scale, _DECIMALS),
        round(found.line_sd, _DECIMALS),
    )
    fitted = respond(posterior.mean, evidence.log_c_r, prior)[0]
    middle = np.array([np.median(evidence.log_c_r)])
    value, slope = respond(posterior.mean, middle, prior)
    floor = calibration.floor
    by = float(value[0]) - 0.5 * float(np.logaddexp(2 * middle[0], 2 * math.log(floor) if floor else -math.inf))
    sd = math.sqrt(float(slope[0] @ posterior.covariance @ slope[0]))
    low, high = np.exp(np.quantile(evidence.log_c_r, (0.1, 0.9))).tolist()
    return DriveUpdate(
        calibration_id=calibration.id,
        drives=len(np.unique(evidence.drive)),
        stretches=len(evidence.way_m),
        way_m=float(evidence.way_m.sum()),
        new_m=float(evidence.new_m.sum()),
        left_out=lost,
        c_r_range=(low, high),
        prior=prior,
        posterior=posterior,
        floor=(floor, round(math.exp(posterior.mean[2]), _DECIMALS) if len(posterior.mean) > 2 else floor),
        factor=(math.exp(by - NORMAL_80 * sd), math.exp(by), math.exp(by + NORMAL_80 * sd)),
        ratio=(float(np.exp(-np.median(left_before))), float(np.exp(np.median(fitted - evidence.log_measured)))),
        held_out_error=(_median_error(left_before), _median_error(left)),
        gain=_gain(score, score_before),
        parts=len(score),
    )


def _median_error(left: Floats) -> float:
    """Return the median of abs(predicted / measured - 1), from ln of measured over predicted C_r (n,)."""
    return float(np.median(np.abs(np.expm1(-left))))


def _agree(update: DriveUpdate) -> str:
    low, _, high = update.factor
    return (
        f"the drives agree with the calibration {update.calibration_id}, so it is not moved: over {update.way_m:.0f} m "
        f"({update.stretches} stretches) the map's C_r is {update.ratio[0]:.2f} times the measured in the median; "
        "moved, it would not predict left-out parts of the drives better than by chance (median error "
        f"{100 * update.held_out_error[1]:.1f} %, as it is {100 * update.held_out_error[0]:.1f} %). The drives leave "
        f"room for a factor of {low:.2f} to {high:.2f} on C_r; longer ones would tell"
    )
