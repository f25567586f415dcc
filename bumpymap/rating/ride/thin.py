"""Predict the ride over tiles with few points, from their points and their filled heightmap.

A heightmap with one point in some pixels and none in the others rolls too smoothly where holes were filled, and too
roughly where noise was not averaged. By how much depends on how many points there are, on the noise, and on how the
ground's variance is spread over wavelengths, which the pairs of points tell. So ln C_r is linear in the logarithms of
a few measures and in their products with the logarithm of the number of points; the coefficients are fitted to thin
simulated surveys of the terrain library. p_fail is a logistic regression on those surveys: the expectation of p_fail
given what is measured, so that it rises where a tile is little known.

A block is rated when the columns of its tiles and of their neighbours are known: they share their noise, and each is
pulled towards the others.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import DENSE_COVERAGE, NO_CLASS, SPANNED_POINTS, THIN_POINTS, THIN_SEEN, Reason
from bumpymap.rating.calibration import Calibration, remembered
from bumpymap.rating.ride.correction import NORMAL_TAIL, Coefficients, Prediction
from bumpymap.rating.ride.motion_operator import roll_over
from bumpymap.rating.ride.operator import RideOperator
from bumpymap.rating.ride.rate import interval, judge
from bumpymap.rating.ride.speed import plain_speed_factor, speed_log_sd
from bumpymap.rating.vehicle_body import less_floor

Floats = NDArray[np.float64]
_LAGS = 5
"""Classes of distance of pairs of points, of `bumpymap.patches.measure_thin`."""
THIN_COLUMNS = (
    *("points", "seen", "spread", "size_share", "slope"),
    *("pitch_change", "pitch_change_rms", "pitch", "twist", "belly"),
    *(f"squares_{lag}" for lag in range(1, _LAGS + 1)),
    *(f"pairs_{lag}" for lag in range(1, _LAGS + 1)),
)
"""Columns of `thin_columns`: number of points; share of the tile's nine parts that hold one (0: a hole of a quarter);
standard deviation about the plane, m; mean absolute distance over that; slope of the plane (tangent); the ride over the
filled heightmap as in `Rides`; sums of the squared height differences of pairs of points by distance, m^2; pairs."""
_USUAL_POINTS = 36.0
"""Points of a tile at which their logarithm is 0 in the terms: 4 a square metre of a tile of 3 m."""
_PSEUDO_PAIRS = 3.0
"""Pairs of each distance that are added, with half of the variance at great distances. Chosen."""
_LEAST_SHARE = 0.1
"""Least relief, as a share of the noise, that is distinguished from it."""
_LEAST_RATIO = 0.03
"""Least value of the structure function over that at great distances. Chosen."""
_LEAST_RIDE = 0.15
"""Least pitch change without noise, as a share of that with it."""
_ZERO = 1e-5
"""Heights, angles and rad/m that stand for 0 in a logarithm."""
_MOST_LOGIT = 30.0
"""Of p_fail, absolute: beyond, it is 0 or 1 to every digit that is stored."""


def thin_columns(
    pairs: Floats, relief_map: NDArray[np.float32], count: NDArray[np.int64], operator: RideOperator
) -> NDArray[np.float32]:
    """Return what the rating of thin tiles needs of each tile, (n, 20) in the order of ``THIN_COLUMNS``.

    ``pairs`` (n, 15): measures of pairs of points, of `bumpymap.patches.measure_thin`; ``relief_map`` (n, pixels,
    pixels): filled heightmaps of the same, m; ``count`` (n,): points of each tile.
    """
    rides = roll_over(relief_map, operator)
    points = np.where(np.isfinite(pairs[:, 0]), count, np.nan)
    parts = (rides.pitch_change, rides.pitch_change_rms, rides.pitch, rides.twist, rides.belly_reach)
    return np.column_stack((points, pairs[:, 1:5], *parts, pairs[:, 5:])).astype(np.float32)


@dataclass(frozen=True, slots=True)
class ThinModel(Coefficients):
    """Coefficients of the prediction for thin tiles."""

    model = "the model of thin surveys"

    relief: tuple[float, float]
    """Lowest and highest ln of the relief [m] that was trained; beyond, C_r grows as the relief does."""
    felt: tuple[float, float]
    """ln of the pitch change of noise alone over the noise [rad/m per m]: constant, and per ln of the points."""
    c_r: tuple[float, ...]
    """Coefficients of `ride_terms`."""
    spread: tuple[float, ...]
    """Coefficients of `spread_terms`: ln of the standard deviation of ln C_r, apart from the ride model's own."""
    sides: tuple[float, float]
    """Factors on it below and above the median."""
    own_spread: float
    """Standard deviation of ln C_r of the ride model itself."""
    fail: tuple[float, ...]
    """Coefficients of `fail_terms`, in logits."""
    origin: dict[str, Any]
    """The data of the fit, and its errors."""
    prior: tuple[float, float]
    """Mean and standard deviation of ln C_r of the terrain of the fit, towards whose mean the predictions of tiles with
    few points are shrunk."""

    def require_lengths(self) -> None:
        """Raise ValueError if there are too few or too many coefficients."""
        row = np.ones((1, len(THIN_COLUMNS)))
        noise = np.zeros(1)
        for name, terms in (
            ("c_r", ride_terms(row, noise, self.felt, self.relief)),
            ("spread", spread_terms(row, noise, self.felt, self.relief)),
            ("fail", fail_terms(row, noise, self.felt)),
        ):
            if len(getattr(self, name)) != terms.shape[1]:
                raise ValueError(f"{len(getattr(self, name))} coefficients of {name}, not {terms.shape[1]}")
        if len(self.sides) != 2:
            raise ValueError(f"sides are {self.sides}")

    @property
    def fail_growth(self) -> float:
        """Growth of the logit of p_fail per ln C_r where the ground keeps its form, at a usual number of points."""
        return float(sum(self.fail[1:5]))

    def predict(self, columns: Floats, noise: Floats) -> Prediction:
        """Predict C_r and p_fail of n tiles; NaN where a column is.

        ``columns`` (n, 20): of `thin_columns`; ``noise`` (n,): standard deviation of the height of a point, m.
        """
        inputs = (columns, noise, self.felt, self.relief)
        relief = _log_relief(columns, noise)
        log_c_r = ride_terms(*inputs) @ np.array(self.c_r) + (relief - np.clip(relief, *self.relief))
        sd = np.exp(spread_terms(*inputs) @ np.array(self.spread))
        logit = np.clip(fail_terms(columns, noise, self.felt) @ np.array(self.fail), -_MOST_LOGIT, _MOST_LOGIT)
        below, above = (np.hypot(self.own_spread, side * sd) for side in self.sides)
        return Prediction(log_c_r, below, above, 1.0 / (1.0 + np.exp(-logit)))


def _column(columns: Floats, name: str) -> Floats:
    return columns[:, THIN_COLUMNS.index(name)]


def _log_relief(columns: Floats, noise: Floats) -> Floats:
    """Return ln of the standard deviation of the ground about the plane times sqrt 2, without the noise."""
    variance = _column(columns, "spread") ** 2 - noise**2
    return 0.5 * np.log(2.0 * np.maximum(variance, (_LEAST_SHARE * noise) ** 2 + _ZERO**2))


def log_points(points: Floats) -> Floats:
    """Return ln of the number of points over a usual one."""
    return np.log(points / _USUAL_POINTS)


def _log_points(columns: Floats) -> Floats:
    return log_points(_column(columns, "points"))


def _excess(columns: Floats, noise: Floats) -> Floats:
    """Return ln of the relief with noise over that without."""
    return 0.5 * np.log1p(2.0 * noise**2 * np.exp(-2.0 * _log_relief(columns, noise)))


def _log_ride(columns: Floats, noise: Floats, felt: tuple[float, float]) -> Floats:
    """Return ln of the pitch change of the filled heightmap [rad/m], without that of the noise."""
    ride = _column(columns, "pitch_change")
    of_noise = noise * np.exp(felt[0] + felt[1] * _log_points(columns))
    return 0.5 * np.log(np.maximum(ride**2 - of_noise**2, (_LEAST_RIDE * ride) ** 2 + _ZERO**2))


def _log_structure(columns: Floats, noise: Floats) -> Floats:
    """Return half the ln of the structure function over its value at great distances, (n, lags).

    Pairs are few: a few more that know nothing are added.
    """
    whole = np.exp(2.0 * _log_relief(columns, noise))[:, None]
    first = THIN_COLUMNS.index("squares_1")
    squares, pairs = columns[:, first : first + _LAGS], columns[:, first + _LAGS : first + 2 * _LAGS]
    ground = squares - 2.0 * pairs * noise[:, None] ** 2 + 0.5 * _PSEUDO_PAIRS * whole
    ratio: Floats = 0.5 * np.log(np.maximum(ground / ((pairs + _PSEUDO_PAIRS) * whole), _LEAST_RATIO))
    return ratio


def _with_points(terms: Floats, log_n: Floats, powers: int) -> Floats:
    """Return terms and their products with powers of ln of the points."""
    return np.concatenate([terms * log_n[:, None] ** power for power in range(powers + 1)], axis=1)


def ride_terms(columns: Floats, noise: Floats, felt: tuple[float, float], relief: tuple[float, float]) -> Floats:
    """Return the terms of ln C_r, (n, terms)."""
    height = np.clip(_log_relief(columns, noise), *relief)
    terms = np.column_stack(
        (
            np.ones(len(columns)),
            height,
            height**2,
            _log_ride(columns, noise, felt) - _log_relief(columns, noise),
            _log_structure(columns, noise),
            _column(columns, "size_share"),
            _excess(columns, noise),
            _column(columns, "slope"),
        )
    )
    return np.column_stack((_with_points(terms, _log_points(columns), 2), _unseen(columns)))


def spread_terms(columns: Floats, noise: Floats, felt: tuple[float, float], relief: tuple[float, float]) -> Floats:
    """Return the terms of ln of the standard deviation, (n, terms)."""
    log_n, excess = _log_points(columns), _excess(columns, noise)
    height = np.clip(_log_relief(columns, noise), *relief)
    ratio = np.clip(_log_ride(columns, noise, felt) - _log_relief(columns, noise), -3.0, 3.0)
    terms = np.column_stack((np.ones(len(columns)), excess, height, ratio))
    return np.column_stack(
        (
            _with_points(terms, log_n, 1),
            log_n**2,
            excess**2,
            height**2,
            excess * height,
            _log_structure(columns, noise)[:, :2],
            _unseen(columns),
        )
    )


def fail_terms(columns: Floats, noise: Floats, felt: tuple[float, float]) -> Floats:
    """Return the terms of the logit of p_fail, (n, terms)."""
    ride = _column(columns, "pitch_change")
    slope = np.minimum(_column(columns, "slope"), 5.0)
    terms = np.column_stack(
        (
            np.ones(len(columns)),
            _log_ride(columns, noise, felt),
            _log_relief(columns, noise),
            np.log(np.maximum(_column(columns, "pitch"), _ZERO)),
            np.log(np.maximum(_column(columns, "twist"), _ZERO)),
            np.log(np.maximum(_column(columns, "pitch_change_rms"), ride + _ZERO) / (ride + _ZERO)),
            np.minimum(_column(columns, "belly"), 3.0),
            slope,
            slope**2,
        )
    )
    return np.column_stack((_with_points(terms, _log_points(columns), 1), _excess(columns, noise), _unseen(columns)))


def _unseen(columns: Floats) -> Floats:
    return 1.0 - _column(columns, "seen")


_FREEDOM = 4.0
"""Degrees of freedom of Student's distribution for how unlike its neighbours a tile is. Chosen."""
_MOST_SHRUNK = 0.8
"""Most of the variance of the ground of the fit that the error of a tile counts for."""
_LEAST_ERROR = 0.02
"""Least standard deviation of ln C_r that a prediction is believed to have."""
_LEAST_VARIANCE = 0.02
"""Of ln C_r between neighbours: even ground differs by 14 % from tile to tile."""
_UNKNOWN_VARIANCE, _LEAST_NEIGHBOURS = 1.0, 12
"""The same where fewer pairs of neighbours than that are known."""
_ROUNDS = 2
"""Fits of the noise: the first weighs tiles as if it were ``_UNKNOWN_M`` everywhere, the second by what that found."""
_POOLED, _COMPARED = 5, 4
"""Tiles to each side that share their noise with one, and among which the terrain varies as it does around one."""
_PREDICTED = 2 + _COMPARED
"""Tiles to each side whose prediction has a part: a neighbour, those around it, and the ones beside these."""
THIN_RING = _PREDICTED + _ROUNDS * _POOLED
"""Tiles to each side that have a part in the rating of a thin one, by their noise."""
_MOST_RISE = 3.0
"""Most rise of ln C_r by its neighbours that p_fail follows. Chosen: C_r twenty times as high."""
_LEAST_WEIGHT = 1e-12
"""Stands for 0 in a division."""
_SIDES = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1))
"""Steps to the eight neighbours of a tile, up and right."""


def pull_to_neighbours(found: Prediction, shared: Floats, own_weight: Floats, model: ThinModel) -> Prediction:
    """Combine the prediction of each tile with those of its eight neighbours; return those without the ring.

    A regression shrinks the prediction of a tile with few points towards the mean of the terrain that it was fitted to,
    and an average of nine such tiles stays as biased as each of them. So the shrinkage is undone first, as for a normal
    error with a normal prior; the neighbours are the prior instead. A tile without known neighbours keeps its
    prediction.

    ``found``: (rows, cols) with a ring of one tile, NaN where a tile is unknown, made by ``model``. ``shared`` (2,
    rows, cols): standard deviation of ln C_r below and above the median that all tiles have in common, and that no
    neighbour makes smaller: that of the noise of the survey; not in ``found``. ``own_weight`` (rows, cols): 0: as the
    errors tell; 1: a tile that does not move.
    """
    mean, prior_sd = model.prior
    model_error = model.own_spread**2
    variance = np.maximum((0.5 * (found.below + found.above)) ** 2 - model_error, _LEAST_ERROR**2)
    most = _MOST_SHRUNK * prior_sd**2
    unsure = np.minimum(variance + np.mean(shared, axis=0) ** 2, most)
    shrinkage = (1.0 - own_weight) * unsure / (prior_sd**2 - unsure)
    log_c_r = found.log_c_r + shrinkage * (found.log_c_r - mean)
    variance = np.minimum(variance, most) * (1.0 + shrinkage)
    between = _variance_between(log_c_r, variance)
    middle, sure, unlike = _mean_of_neighbours(log_c_r, 1.0 / (variance + between))
    inner = np.s_[1:-1, 1:-1]
    between = between[inner]
    own, free = found.each(lambda values: values[inner]), 1.0 - own_weight[inner]
    error, unshrunk, shrinkage = variance[inner], log_c_r[inner], shrinkage[inner]
    prior = between * np.maximum(unlike, 1.0) + 1.0 / np.maximum(sure, 1e-9)
    away = (unshrunk - middle) ** 2 / (prior + error)
    prior = prior * (_FREEDOM + away) / (_FREEDOM + 1.0)
    beside = sure > 0
    moved = np.where(beside, free * error / (prior + error), 0.0)
    by = np.where(beside, unshrunk - own.log_c_r + moved * (middle - unshrunk), 0.0)
    before = np.where(beside, error / (1.0 + shrinkage), error)
    narrower = np.sqrt((error * (1.0 - moved) + model_error) / (before + model_error))
    below, above = shared[:, 1:-1, 1:-1] * free * np.where(beside, 1.0 + shrinkage, 1.0)
    odds = own.p_fail / np.maximum(1.0 - own.p_fail, _LEAST_WEIGHT)
    odds = odds * np.exp(model.fail_growth * np.clip(by, 0.0, _MOST_RISE))
    return replace(
        own,
        log_c_r=own.log_c_r + by,
        p_fail=np.where(by > 0, odds / (1.0 + odds), own.p_fail),
        below=np.hypot(own.below * narrower, below),
        above=np.hypot(own.above * narrower, above),
    )


def _variance_between(log_c_r: Floats, variance: Floats) -> Floats:
    """Return the variance of ln C_r between the tiles around each, without the errors of the predictions."""
    sums = np.zeros((*log_c_r.shape, 2))  # of both tiles of each pair
    for near, far in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
        excess = (log_c_r[near] - log_c_r[far]) ** 2 - variance[near] - variance[far]
        pair = np.stack([np.nan_to_num(excess), np.isfinite(excess)], axis=-1)
        sums[near] += pair
        sums[far] += pair
    total, pairs = _sums_around(np.moveaxis(sums, -1, 0), _COMPARED)
    found = np.maximum(0.5 * total / np.maximum(pairs, 1.0), _LEAST_VARIANCE)
    return np.where(pairs < 2 * _LEAST_NEIGHBOURS, _UNKNOWN_VARIANCE, found)


def _sums_around(values: Floats, reach: int) -> Floats:
    """Sum (..., rows, cols) over squares of ``reach`` tiles to each side; always in the same order."""
    rows, cols = values.shape[-2:]
    wide = np.zeros((*values.shape[:-2], rows + 2 * reach, cols + 2 * reach))
    wide[..., reach : reach + rows, reach : reach + cols] = values
    down = reduce(np.add, [wide[..., first : first + rows, :] for first in range(2 * reach + 1)])
    return np.asarray(reduce(np.add, [down[..., first : first + cols] for first in range(2 * reach + 1)]))


def _mean_of_neighbours(log_c_r: Floats, weight: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the weighted mean over the eight neighbours, the sum of their weights, and how unlike they are.

    The sum is 0 where none is known. Unlike is their variance over what is expected of it.
    """
    known = np.where(np.isfinite(log_c_r), weight, 0.0)
    value = np.nan_to_num(log_c_r)
    rows, cols = log_c_r.shape
    total, squares, weights, number = np.zeros((4, rows - 2, cols - 2))
    for up, right in _SIDES:
        window = np.s_[1 + up : rows - 1 + up, 1 + right : cols - 1 + right]
        total += known[window] * value[window]
        squares += known[window] * value[window] ** 2
        weights += known[window]
        number += known[window] > 0
    mean = total / np.maximum(weights, 1e-9)
    unlike = (squares - weights * mean**2) / np.maximum(number - 1.0, 1.0)
    return mean, weights, unlike


_LEAST_PAIRS = 10.0
"""With fewer close pairs the noise is unknown. Chosen."""
_UNKNOWN_M = 0.02
"""Noise that is assumed, with an error as large, where too few pairs are close."""
_LEAST_NOISE_M = 0.002
"""For the weights of the second fit: no instrument measures heights better."""
_MOST_NOISE_M = 0.1
"""As in the noise of a heightmap: what is beyond is leaves or blocks, and stays in the ground."""
_SHARE, _MOST_SHARE = 0.3, 0.9
"""Share of the ground's variance that close pairs have: as the first fit assumes, and the most."""
_TINY = 1e-10
"""Variance [m^2] and sums that stand for 0."""


def pool_noise(
    close_sum: Floats, close_pairs: Floats, variance: Floats, total: Callable[[Floats], Floats]
) -> Floats:  # fmt: skip
    """Estimate the noise that tiles share: the standard deviation of the height of a point.

    The mean square of the height differences of close pairs is twice the noise variance and a share of the variance of
    the ground: a weighted straight line through the tiles, whose standard error is that of means of squared normal
    numbers.

    ``close_sum`` (...): sum of the squared height differences of the close pairs of each tile, m^2, NaN for tiles
    without; ``close_pairs`` (...): their number; ``variance`` (...): of the points about the tile's plane, m^2;
    ``total``: sums arrays (k, ...) over the tiles that share their noise with each. Returns (3, ...): one standard
    error lower, the estimate, and one higher, m.
    """
    known = (close_pairs > 0) & np.isfinite(close_sum) & (variance > _TINY)
    pairs, twice = (np.where(known, values, 0.0) for values in (close_pairs, 2.0 * variance))
    squares = np.where(known, close_sum, 0.0) / np.maximum(pairs, 1.0)
    base, across, error = np.full(known.shape, 2.0 * _UNKNOWN_M**2), np.full(known.shape, _SHARE), squares
    for _ in range(_ROUNDS):
        weight = pairs / np.maximum(base + across * twice, 2.0 * _LEAST_NOISE_M**2) ** 2
        base, across, error = _weighted_lines(weight, twice, squares, total)
    grown = 2.0 * (1.0 - np.minimum(across, _MOST_SHARE))
    found = np.stack([base - error, base, base + error]) / grown
    enough = total(pairs[None])[0] >= _LEAST_PAIRS
    unknown = np.array([0.0, _UNKNOWN_M, 2.0 * _UNKNOWN_M]).reshape(3, *(1 for _ in known.shape))
    return np.where(enough, np.minimum(np.sqrt(np.maximum(found, 0.0)), _MOST_NOISE_M), unknown)


def _weighted_lines(
    weight: Floats, x: Floats, y: Floats, total: Callable[[Floats], Floats]
) -> tuple[Floats, Floats, Floats]:
    """Return intercept and slope of lines through (x, y), both at least 0, and the intercept's standard error.

    The error is that of means of squared normal numbers, of which each has the variance 2 / weight.
    """
    wx = weight * x
    n, sx, sxx, sy, sxy = total(np.stack((weight, wx, wx * x, weight * y, wx * y)))
    det = n * sxx - sx * sx
    is_line = det > 1e-9 * n * sxx
    mean, error = sy / np.maximum(n, _TINY), np.sqrt(2.0 / np.maximum(n, _TINY))
    base, across = ((a / np.where(is_line, det, 1.0)) for a in (sy * sxx - sxy * sx, sxy * n - sx * sy))
    falls, is_flat = is_line & (base < 0), ~is_line | (across < 0)
    through_origin = sxy / np.maximum(sxx, _TINY**2)
    base = np.where(falls, 0.0, np.where(is_flat, mean, base))
    across = np.where(falls, through_origin, np.where(is_flat, 0.0, across))
    return base, across, np.where(is_line, np.sqrt(2.0 * sxx / np.where(is_line, det, 1.0)), error)


_ALL_THIN = 0.35
"""Coverage up to which a tile is rated from its points; up to ``DENSE_COVERAGE`` both are mixed."""
_LOST_SHARE = 1e-3
"""C_r below this share of a floor is lost beside it: results are stored as float32."""
_RATEABLE = (Reason.OK, Reason.TOO_FEW_POINTS, Reason.TOO_MANY_HOLES)


@dataclass(frozen=True, slots=True)
class BlockRating:
    """Ratings of a rectangle of tiles, (rows, cols) each, as in `CostMap` and `PatchStack`."""

    class_id: NDArray[np.uint8]
    c_r: NDArray[np.float32]
    c_r_low: NDArray[np.float32]
    c_r_high: NDArray[np.float32]
    p_fail: NDArray[np.float32]
    confidence: NDArray[np.float32]
    reason: NDArray[np.uint8]

    def inner(self, ring: int = 1) -> "BlockRating":
        """Return the tiles without ``ring`` tiles on each side."""
        return BlockRating(*(_without(getattr(self, f.name), ring) for f in fields(self)))


def rate_thin(
    columns: NDArray[np.float32],
    first: BlockRating,
    coverage: NDArray[np.floating],
    slope: NDArray[np.floating],
    calibration: Calibration,
    ring: int = 1,
) -> BlockRating:
    """Rate the thin tiles of a block; all others keep what the first pass found, to the bit.

    ``columns`` (rows, cols, 20): of `thin_columns`, the tiles of the block and those around it, NaN where a tile has no
    points; ``first``: results of the first pass for the same tiles; ``coverage``, ``slope`` (rows, cols): of
    `PatchStack`, 0..1 and degrees, NaN where a tile has no points. ``ring``: tiles around the block on each side, at
    least one, which the result lacks. They are neighbours, and help to tell the noise; beyond ``THIN_RING`` none has a
    part in what a tile of the block is.

    Raises BadInputError if the model of thin surveys of the calibration is damaged.
    """
    model = _model(calibration)
    weight = ride_weight(first, coverage)
    reason = np.where(is_rateable(columns, first.reason) & (weight < 1.0), np.uint8(Reason.OK), first.reason)
    asked = _without((reason == Reason.OK) & (weight < 1.0), ring)
    if not asked.any():
        return first.inner(ring)
    before, beyond = first.inner(ring), max(ring - _PREDICTED, 0)
    with np.errstate(all="ignore"):  # of tiles without points
        noise = _without(_noise_around(columns, reason == Reason.OK), beyond).reshape(-1, 3)
        columns, weight, reason, slope = (_without(values, beyond) for values in (columns, weight, reason, slope))
        flat = columns.reshape(-1, len(THIN_COLUMNS)).astype(np.float64)
        thin_tiles, shared = _predicted(model, flat, reason == Reason.OK, noise)
        if more := speed_log_sd(calibration):
            thin_tiles = thin_tiles.at_speed(plain_speed_factor(calibration, thin_tiles.log_c_r), more)
            mean, prior_sd = model.prior
            mean += float(plain_speed_factor(calibration, np.array([mean]))[0])
            model = replace(model, prior=(mean, prior_sd))
        mixed = _mixed(thin_tiles, first.inner(beyond), weight, calibration.map_floor)
        known = np.where(reason == Reason.OK, mixed.log_c_r, np.nan)
        found = pull_to_neighbours(replace(mixed, log_c_r=known), shared.reshape(2, *weight.shape), weight, model)
        rest = ring - beyond
        found = found.each(lambda values: _without(values, rest - 1))
        tangent, slope, reason = (
            _without(values, rest) for values in (columns[..., THIN_COLUMNS.index("slope")], slope, reason)
        )
        # A tile is barred as too steep by ``slope`` alone. Where only the plane of its few points is, drives fail.
        limit = float(calibration.vehicle["slope_limit_deg"])
        only_by_points = (np.degrees(np.arctan(tangent.astype(np.float64))) > limit) & ~(slope > limit)
        found = replace(found, p_fail=np.where(only_by_points, 1.0, found.p_fail))
        thin = _as_rating(found, slope, reason, calibration)
    rated = np.isfinite(found.log_c_r) & (_without(weight, rest) < 1.0)
    return BlockRating(
        *(
            np.where(rated, getattr(thin, f.name), getattr(before, f.name)).astype(getattr(before, f.name).dtype)
            for f in fields(BlockRating)
        )
    )


def _without(values: NDArray[Any], ring: int) -> NDArray[Any]:
    """Return an array (rows, cols, ...) without ``ring`` tiles on each side."""
    return values[ring : len(values) - ring, ring : values.shape[1] - ring]


def _noise_around(columns: NDArray[np.float32], wanted: NDArray[np.bool_]) -> Floats:
    """Return the noise that each tile shares with those around it, (rows, cols, 3), as of `pool_noise`."""
    names = ("squares_1", "pairs_1", "spread")
    usable = wanted & np.isfinite(columns).all(axis=-1)
    squares, pairs, spread = (columns[..., THIN_COLUMNS.index(name)].astype(np.float64) for name in names)
    found = pool_noise(squares, np.where(usable, pairs, 0.0), spread**2, lambda sums: _sums_around(sums, _POOLED))
    return np.moveaxis(found, 0, -1)


@remembered
def _model(calibration: Calibration) -> ThinModel:
    return ThinModel.from_record(calibration.thin)


def ride_weight(first: BlockRating, coverage: NDArray[np.floating]) -> Floats:
    """Return the weight of the first pass in the rating of each tile: 0 of thin and unknown tiles, 1 of dense ones."""
    return np.where(first.class_id != NO_CLASS, dense_share(coverage), 0.0)


def dense_share(coverage: NDArray[np.floating]) -> Floats:
    """Return how far the heightmap of a tile counts: 0 up to a coverage of 0.35, 1 from 0.75, of any shape."""
    return np.clip((np.nan_to_num(coverage.astype(np.float64)) - _ALL_THIN) / (DENSE_COVERAGE - _ALL_THIN), 0.0, 1.0)


def is_rateable(columns: NDArray[np.float32], reason: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return which tiles can be rated from their points: four at least; ``SPANNED_POINTS`` and more span the tile.

    ``columns`` (..., 20): of `thin_columns`; ``reason`` (...): of the first pass.
    """
    points, seen = (columns[..., THIN_COLUMNS.index(name)] for name in ("points", "seen"))
    spanned = (points < SPANNED_POINTS) | (seen >= THIN_SEEN)
    known = np.isfinite(columns).all(axis=-1) & (points >= THIN_POINTS) & spanned
    return np.asarray(np.isin(reason, _RATEABLE) & known)


def _predicted(
    model: ThinModel, columns: Floats, wanted: NDArray[np.bool_], noise: Floats
) -> tuple[Prediction, Floats]:  # fmt: skip
    """Predict the wanted tiles, NaN for others; ``noise`` (n, 3) of `pool_noise`.

    Also return what the error of the noise changes, as standard deviations of ln C_r below and above, (2, n).
    """
    usable = wanted.ravel() & np.isfinite(columns).all(axis=1)
    number = int(usable.sum())
    at_noise = model.predict(np.tile(columns[usable], (3, 1)), noise[usable].T.reshape(-1))
    low, middle, high = at_noise.log_c_r.reshape(3, number)
    own = np.s_[number : 2 * number]
    found, shared = np.full((4, len(columns)), np.nan), np.zeros((2, len(columns)))
    p_fail = np.array([0.25, 0.5, 0.25]) @ at_noise.p_fail.reshape(3, number)
    found[:, usable] = middle, at_noise.below[own], at_noise.above[own], p_fail
    shared[:, usable] = np.maximum(middle - high, 0.0), np.maximum(low - middle, 0.0)
    return Prediction(*found), shared


def _mixed(thin: Prediction, first: BlockRating, weight: Floats, floor: float) -> Prediction:
    """Mix with the first pass less its floor, (rows, cols); the result is continuous in the coverage."""
    ends = (first.c_r, first.c_r_low, first.c_r_high)
    log_c_r, low, high = (np.log(np.maximum(less_floor(values, floor), _LOST_SHARE * floor)) for values in ends)
    ride: tuple[Floats, ...] = (
        log_c_r,
        (log_c_r - low) / NORMAL_TAIL,
        (high - log_c_r) / NORMAL_TAIL,
        first.p_fail.astype(np.float64),
    )
    ours = (values.reshape(weight.shape) for values in (thin.log_c_r, thin.below, thin.above, thin.p_fail))
    mixed = (
        np.where(weight > 0, weight * theirs + (1.0 - weight) * own, own)
        for theirs, own in zip(ride, ours, strict=True)
    )
    return Prediction(*mixed)


def _as_rating(
    found: Prediction, slope: NDArray[np.floating], reason: NDArray[np.uint8], calibration: Calibration
) -> BlockRating:
    """Turn predictions into what is stored, by the rules of the ride rating."""
    line = judge(found.each(np.ravel), slope.ravel(), calibration)
    class_id, chance = (values.reshape(slope.shape) for values in line)
    c_r, low, high = interval(found, calibration.map_floor)
    return BlockRating(
        class_id=class_id.astype(np.uint8),
        c_r=c_r.astype(np.float32),
        c_r_low=low.astype(np.float32),
        c_r_high=high.astype(np.float32),
        p_fail=found.p_fail.astype(np.float32),
        confidence=chance.astype(np.float32),
        reason=reason,
    )
