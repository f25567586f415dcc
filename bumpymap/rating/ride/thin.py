"""Predict the ride over tiles with few points, from the strengths of ground and noise and the filled heightmap.

A heightmap with one point in some pixels and none in the others rolls too smoothly where holes were filled, and too
roughly where noise was not averaged. The points tell how strong the ground is beside the noise, and
C_r is proportional to that for ground of one form. Its form shows in the ride over the heightmap as far as that is more
than noise. So ln C_r is linear in the ground's strength and a few measures of form, and in their products with the
logarithm of the number of points; the coefficients are fitted to thin simulated surveys of the terrain library. p_fail
is a logistic regression on those surveys: the expectation of p_fail given what is measured, so that it rises where a
tile is little known.

A block is rated when the columns of its tiles and of their neighbours are known.

*Ground and noise* (``ground_power.cpp``). About its plane the ground is a sum of waves whose power falls with the cube
of the wave number; noise is alike in all. So the points of a tile make each pair of strengths, of its ground and of the
noise of a point, more or less likely: a long wave that is seen by many points is ground, what is left of points close
together is noise. A tile of few points says little of either, and its neighbours say the rest: strengths vary from
place to place, and each tile's prior is how they are spread around it, which follows from the same likelihoods
(empirical Bayes, in a few rounds).
"""

from dataclasses import dataclass, fields, replace
from functools import cache, reduce
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    DENSE_COVERAGE,
    NO_CLASS,
    SPANNED_POINTS,
    THIN_POINTS,
    THIN_SEEN,
    Floats,
    Reason,
    interval_log_sd,
    loops,
)
from bumpymap.rating.calibration import Calibration, remembered
from bumpymap.rating.ride.correction import Coefficients, Prediction
from bumpymap.rating.ride.operator import RideOperator, roll_over
from bumpymap.rating.ride.rate import DRIVE_LOG_SD, interval, judge
from bumpymap.rating.ride.speed import plain_speed_factor, speed_log_sd
from bumpymap.rating.vehicle_profile import less_floor

_STEEPNESS = 3.0
"""Power of the ground's waves over their number: a Hurst exponent of a half. From 2.5 to 3.5 nothing changes much."""
_LONGEST, _SHORTEST = 4, 14
"""Half waves along a tile up to which waves are summed, one by one; and up to which the ground has power."""
WAVE_SUMS = 34
"""Numbers that are left of the points of a tile: degrees of freedom, and a tridiagonal matrix of 17 rows."""
_GROUND_M, _NOISE_M = np.exp(np.arange(-6.9, 0.5, 0.35)), np.exp(np.arange(-6.2, -2.9, 0.35))
"""Standard deviations that are tried: of ground about its plane, 1 mm to 1.2 m; of noise, 2 mm to 0.05 m: few
surveys have more, and rubble of which each stone holds one point must not pass for noise."""
_USUAL = ((-3.0, 1.5), (-4.2, 1.0))
"""Mean and standard deviation of ln of both strengths [m] before any neighbour is known: counts as one neighbour."""
_LEAST_SD = (0.3, 0.15)
"""Least standard deviation of both between neighbours."""
_FREEDOM = 4.0
"""Degrees of freedom of Student's distribution of strengths around a tile: a kerb is unlike its neighbours."""
_MOST_OWN = 0.6
"""Most that ln of a tile's noise differs from that around it: what is beyond, stones and tufts, is ground."""
_CLOSE_SHARE = 0.036
"""Share of the ground's power in the half mean square of height differences at 0.13 m, the mean distance of the pairs:
of that spectrum, in closed form."""
_PAIR_WEIGHT = 0.5
"""Degrees of freedom of a close pair: some of them share a point."""
_NEAR, _ROUNDS = 2, 3
"""Tiles to each side whose strengths are the prior of one, and how often it is improved."""
THIN_RING = _NEAR * _ROUNDS
"""Tiles to each side that have a part in the rating of a thin one."""


class Strength(NamedTuple):
    """How strong ground and noise are in n tiles; NaN where unknown."""

    ground: Floats
    """Mean of ln of the standard deviation of the ground about its plane, m."""
    ground_sd: Floats
    """Standard deviation of that logarithm."""
    noise: Floats
    """Mean of ln of the standard deviation of the height of a point, m."""


@cache
def _waves(pixels: int) -> tuple[Floats, float]:
    """Return plane and waves at the pixels, (pixels^2, 3 + 16), and the share of power in shorter waves."""
    order = np.arange(_SHORTEST + 1)
    number = np.hypot(order[:, None], order)
    power = np.where(number > 0, np.maximum(number, 1.0) ** -_STEEPNESS, 0.0)
    power /= power.sum()
    long = (number > 0) & (number <= _LONGEST)
    place = (np.arange(pixels) + 0.5) / pixels
    cosines = np.cos(np.pi * np.outer(order, place)) * np.where(order > 0, np.sqrt(2.0), 1.0)[:, None]
    down, across = np.nonzero(long)
    waves = (cosines[down][:, :, None] * cosines[across][:, None, :]).reshape(len(down), -1)
    y, x = (axis.ravel() for axis in np.meshgrid(place - 0.5, place - 0.5, indexing="ij"))
    columns = np.vstack((np.ones_like(x), x, y, waves * np.sqrt(power[long])[:, None]))
    return np.ascontiguousarray(columns.T), float(1.0 - power[long].sum())


def wave_sums(
    relief_map: NDArray[np.float32], count: NDArray[np.int32], variance: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Sum the points of n tiles over the waves, (n, ``WAVE_SUMS``); NaN for tiles with NaN or without a plane.

    All (n, pixels, pixels): mean height of the points of a pixel about the tile's plane, m, anything where there is
    none; their number; and their variance, m^2.
    """
    sums = np.empty((len(count), WAVE_SUMS), np.float32)
    known = np.asarray(np.isfinite(relief_map).all(axis=(1, 2)))
    relief, held, spread = np.ascontiguousarray(relief_map), np.ascontiguousarray(count), np.ascontiguousarray(variance)
    loops.sum_waves(known, relief, held, spread, _waves(count.shape[1])[0], sums)
    return sums


def find_strengths(sums: NDArray[np.float32], pairs: NDArray[np.float32]) -> tuple[Strength, Strength]:
    """Find the strengths of a rectangle of tiles, (rows, cols), from their sums, (rows, cols, ``WAVE_SUMS``).

    ``pairs`` (rows, cols, 2): sum of the squared height differences of close pairs of points, m^2, and their number.
    Twice: with the ground of neighbours, and of each tile alone under the noise that it shares with them.
    """
    known = np.isfinite(sums[..., 0])
    found = np.empty((known.size, len(_NOISE_M), len(_GROUND_M)), np.float32)
    flat = np.ascontiguousarray(sums.reshape(-1, WAVE_SUMS))
    loops.weigh_strengths(flat, _NOISE_M, _GROUND_M, _waves(_SHORTEST + 1)[1], found)
    squares, number = np.where(known.reshape(-1, 1), pairs.reshape(-1, 2), 0.0).T[..., None, None].astype(np.float32)
    near = 2.0 * (_NOISE_M[:, None] ** 2 + _CLOSE_SHARE * _GROUND_M**2).astype(np.float32)
    found -= 0.5 * _PAIR_WEIGHT * (number * np.log(near) + squares / near)
    likelihood = np.exp(found - found.max(axis=(1, 2), keepdims=True))
    (mean_a, sd_a), (mean_s, sd_s) = _USUAL
    usual = np.array([mean_a, sd_a**2, mean_s, sd_s**2])
    prior = np.broadcast_to(usual[:, None], (4, known.size)).copy()
    for _ in range(_ROUNDS):
        prior = _around(_posterior(likelihood, prior), known, usual)
    alone = prior.copy()
    alone[:2] = usual[:2, None]
    ends = (_posterior(likelihood, each, is_last=True) for each in (prior, alone))
    unknown = np.where(known.ravel(), 0.0, np.nan)
    return tuple(
        Strength(*((values + unknown).reshape(known.shape) for values in (a, np.sqrt(var_a), s)))
        for a, var_a, s, _ in ends
    )  # type: ignore[return-value]


def _posterior(likelihood: NDArray[np.float32], prior: Floats, *, is_last: bool = False) -> Floats:
    """Return mean and variance of ln of ground and noise, (4, n), under priors of the same form."""
    grids = np.log(_GROUND_M), np.log(_NOISE_M)
    of_ground, of_noise = (_student(grid, *own) for grid, own in zip(grids, (prior[:2], prior[2:]), strict=True))
    if is_last:
        of_noise = np.maximum(1.0 - ((grids[1] - prior[2][:, None]) / _MOST_OWN) ** 2, 0.0) ** 2
    ground = of_ground * np.matmul(of_noise[:, None].astype(np.float32), likelihood)[:, 0]
    noise = of_noise * np.matmul(likelihood, of_ground[:, :, None].astype(np.float32))[..., 0]
    found = []
    for share, grid in zip((ground, noise), grids, strict=True):
        total = share.sum(axis=1)
        mean = (share * grid).sum(axis=1) / total
        found += [mean, np.maximum((share * grid**2).sum(axis=1) / total - mean**2, 0.0)]
    return np.array(found)


def _student(grid: Floats, mean: Floats, variance: Floats) -> Floats:
    """Return Student's density, but for its scale, of ln of a strength around n tiles, (n, values of the grid)."""
    away = (grid - mean[:, None]) ** 2 / variance[:, None]
    return np.asarray((1.0 + away / _FREEDOM) ** (-0.5 * (_FREEDOM + 1.0)))


def _around(found: Floats, known: NDArray[np.bool_], usual: Floats) -> Floats:
    """Return the spread of the strengths around each tile, the usual one among them, (4, n)."""
    prior = []
    for at, least in zip((0, 2), _LEAST_SD, strict=True):
        mean, variance = found[at : at + 2]
        weight = np.where(known.ravel(), least**2 / (variance + least**2), 0.0)
        if at == 2:  # where the ground is smooth, the noise is known best: as means of squares are weighted
            weight = weight * np.exp(-3.0 * (mean - usual[2]))
        parts = np.stack([weight, weight * mean, weight * (variance + mean**2)]).reshape(3, *known.shape)
        total, first, second = sums_around(parts, _NEAR).reshape(3, -1) + least**2 / (
            usual[at + 1] + least**2
        ) * np.array([[1.0], [usual[at]], [usual[at + 1] + usual[at] ** 2]])
        middle = first / total
        prior += [middle, np.maximum(second / total - middle**2, least**2)]
    return np.array(prior)


def sums_around(values: Floats, reach: int) -> Floats:
    """Sum (..., rows, cols) over squares of ``reach`` tiles to each side; always in the same order."""
    rows, cols = values.shape[-2:]
    wide = np.zeros((*values.shape[:-2], rows + 2 * reach, cols + 2 * reach))
    wide[..., reach : reach + rows, reach : reach + cols] = values
    down = reduce(np.add, [wide[..., first : first + rows, :] for first in range(2 * reach + 1)])
    return np.asarray(reduce(np.add, [down[..., first : first + cols] for first in range(2 * reach + 1)]))


THIN_COLUMNS = (
    *("points", "seen", "slope", "squares", "pairs"),
    *("pitch_change", "pitch_change_rms", "pitch", "twist", "belly"),
    *(f"wave_{number}" for number in range(WAVE_SUMS)),
)
"""Columns of `thin_columns`: number of points; share of the tile's nine parts that hold one (0: a hole of a quarter);
slope of the plane (tangent); sum of the squared height differences of close pairs of points, m^2; their number; the
ride over the filled heightmap as in `Rides`; sums of `wave_sums`. The last two are NaN of dense tiles."""
_MEASURED = len(THIN_COLUMNS) - WAVE_SUMS
_USUAL_POINTS = 36.0
"""Points of a tile at which their logarithm is 0 in the terms: 4 a square metre of a tile of 3 m."""
_LEAST_SHARE = 0.02
"""Least share of the ground in a ride, for a logarithm."""
_ZERO = 1e-5
"""Heights, angles and rad/m that stand for 0 in a logarithm."""
_MOST_LOGIT = 30.0
"""Of p_fail, absolute: beyond, it is 0 or 1 to every digit that is stored."""


def thin_columns(
    pairs: Floats, maps: tuple[NDArray[Any], NDArray[Any], NDArray[Any]], count: NDArray[np.int64],
    operator: RideOperator,
) -> NDArray[np.float32]:  # fmt: skip
    """Return what the rating of thin tiles needs of each tile, (n, 44) in the order of ``THIN_COLUMNS``.

    ``pairs`` (n, 5) and ``maps``, (n, pixels, pixels) each: of `bumpymap.patches.measure_thin`; ``count`` (n,): points
    of each tile.
    """
    rides = roll_over(maps[0], operator)
    points = np.where(np.isfinite(pairs[:, 0]), count, np.nan)
    parts = (rides.pitch_change, rides.pitch_change_rms, rides.pitch, rides.twist, rides.belly_reach)
    return np.column_stack((points, pairs[:, 1:], *parts, wave_sums(*maps))).astype(np.float32)


@dataclass(frozen=True, slots=True)
class ThinModel(Coefficients):
    """Coefficients of the prediction for thin tiles."""

    model = "the model of thin surveys"
    lengths = {"relief": 2, "felt": 3, "c_r": 11, "spread": 8, "sides": 2, "fail": 20}  # noqa: RUF012 (as ClassVar)

    relief: tuple[float, float]
    """ln of the ground's strength [m] below and beyond which C_r grows as that does."""
    felt: tuple[float, float, float]
    """ln of the pitch change over the filled heightmap [rad/m per m]: of noise alone over the noise, constant and per
    ln of the points; of ground over its strength."""
    c_r: tuple[float, ...]
    """Coefficients of the first of `thin_terms`."""
    spread: tuple[float, ...]
    """Of the second: ln of the standard deviation of ln C_r where the ground's strength is known."""
    sides: tuple[float, float]
    """Factors below and above the median on that and the error of the strength."""
    own_spread: float
    """Standard deviation of ln C_r of the ride model itself."""
    fail: tuple[float, ...]
    """Of the third, in logits."""
    origin: dict[str, Any]
    """The data of the fit, and its errors."""

    def predict(self, columns: Floats, strength: Strength) -> Prediction:
        """Predict C_r and p_fail of n tiles; NaN where a column is.

        ``columns`` (n, 44): of `thin_columns`; ``strength``: of `find_strengths`, (n,) each.
        """
        ride, spread, fail = thin_terms(columns, strength, self.felt, self.relief)
        beyond = strength.ground - np.clip(strength.ground, *self.relief)
        log_c_r = ride @ np.array(self.c_r) + beyond
        sd = np.hypot(np.exp(spread @ np.array(self.spread)), strength.ground_sd)
        logit = np.clip(fail @ np.array(self.fail), -_MOST_LOGIT, _MOST_LOGIT)
        below, above = (np.hypot(self.own_spread, side * sd) for side in self.sides)
        return Prediction(log_c_r, below, above, 1.0 / (1.0 + np.exp(-logit)))


def _column(columns: Floats, name: str) -> Floats:
    return columns[:, THIN_COLUMNS.index(name)]


def log_points(points: Floats) -> Floats:
    """Return ln of the number of points over a usual one."""
    return np.log(points / _USUAL_POINTS)


def _log_points(columns: Floats) -> Floats:
    return log_points(_column(columns, "points"))


def _with_points(terms: Floats, columns: Floats) -> Floats:
    """Return terms, their products with ln of the points, and the share of the tile that is not seen."""
    return np.column_stack((terms, terms * _log_points(columns)[:, None], 1.0 - _column(columns, "seen")))


def thin_terms(
    columns: Floats, strength: Strength, felt: tuple[float, ...], relief: tuple[float, float]
) -> tuple[Floats, Floats, Floats]:
    """Return the terms of ln C_r, of ln of its standard deviation, and of the logit of p_fail, (n, terms) each.

    Two of them are ln of the filled heightmap's pitch change over a usual one, for ground of that strength under that
    noise, and the share of the ground in it.
    """
    of_ground = 2.0 * (strength.ground + felt[2])
    both = np.logaddexp(of_ground, 2.0 * (strength.noise + felt[0] + felt[1] * _log_points(columns)))
    ride = _column(columns, "pitch_change")
    log_ride = np.log(np.maximum(ride, _ZERO))
    form, share = log_ride - 0.5 * both, np.exp(of_ground - both)
    one, ground, slope = np.ones(len(columns)), np.clip(strength.ground, *relief), _column(columns, "slope")
    tilt = np.minimum(slope, 5.0)
    of_ride = np.column_stack((one, ground, ground**2, share * form, slope))
    of_spread = np.column_stack((one, ground, share * np.clip(form, -3.0, 3.0)))
    of_fail = np.column_stack(
        (
            one,
            log_ride + 0.5 * np.log(np.maximum(share, _LEAST_SHARE)),
            strength.ground,
            np.log(np.maximum(_column(columns, "pitch"), _ZERO)),
            np.log(np.maximum(_column(columns, "twist"), _ZERO)),
            np.log(np.maximum(_column(columns, "pitch_change_rms"), ride + _ZERO) / (ride + _ZERO)),
            np.minimum(_column(columns, "belly"), 3.0),
            tilt,
            tilt**2,
        )
    )
    return (
        _with_points(of_ride, columns),
        np.column_stack((_with_points(of_spread, columns), ground**2)),
        np.column_stack((_with_points(of_fail, columns), share)),
    )


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

    ``columns`` (rows, cols, 44): of `thin_columns`, the tiles of the block and those around it, NaN where a tile has no
    points; ``first``: results of the first pass for the same tiles; ``coverage``, ``slope`` (rows, cols): of
    `PatchStack`, 0..1 and degrees, NaN where a tile has no points. ``ring``: tiles around the block on each side, which
    the result lacks: neighbours, of which those beyond ``THIN_RING`` have no part in what a tile of the block is.

    Raises BadInputError if the model of thin surveys of the calibration is damaged.
    """
    model = _model(calibration)
    weight = np.where(first.class_id != NO_CLASS, dense_share(coverage), 0.0)  # of the first pass
    reason = np.where(is_rateable(columns, first.reason) & (weight < 1.0), np.uint8(Reason.OK), first.reason)
    asked = reason == Reason.OK
    weight, slope, reason, before = *(_without(values, ring) for values in (weight, slope, reason)), first.inner(ring)
    rated = (reason == Reason.OK) & (weight < 1.0)
    if not rated.any():
        return before
    with np.errstate(all="ignore"):  # of tiles without points
        sums = np.where(asked[..., None], columns[..., _MEASURED:], np.float32(np.nan))
        around, alone = (
            Strength(*(_without(values, ring).ravel() for values in each))
            for each in find_strengths(sums, columns[..., 3:5])
        )
        flat = _without(columns, ring).reshape(-1, len(THIN_COLUMNS)).astype(np.float64)
        thin_tiles = model.predict(flat, around)
        # Rougher neighbours raise p_fail; smoother ones never make a tile safer.
        thin_tiles = replace(thin_tiles, p_fail=np.maximum(thin_tiles.p_fail, model.predict(flat, alone).p_fail))
        if more := speed_log_sd(calibration):
            thin_tiles = thin_tiles.at_speed(plain_speed_factor(calibration, thin_tiles.log_c_r), more)
        found = _mixed(thin_tiles, before, weight, calibration.map_floor)
        # A tile is barred as too steep by ``slope`` alone. Where only the plane of its few points is, drives fail.
        tangent = flat[:, THIN_COLUMNS.index("slope")].reshape(slope.shape)
        limit = float(calibration.vehicle["slope_limit_deg"])
        only_by_points = (np.degrees(np.arctan(tangent)) > limit) & ~(slope > limit)
        found = replace(found, p_fail=np.where(only_by_points, 1.0, found.p_fail))
        thin = _as_rating(found, slope, reason, calibration)
    rated &= np.isfinite(found.log_c_r)
    return BlockRating(
        *(
            np.where(rated, getattr(thin, f.name), getattr(before, f.name)).astype(getattr(before, f.name).dtype)
            for f in fields(BlockRating)
        )
    )


def _without(values: NDArray[Any], ring: int) -> NDArray[Any]:
    """Return an array (rows, cols, ...) without ``ring`` tiles on each side."""
    return values[ring : len(values) - ring, ring : values.shape[1] - ring]


@remembered
def _model(calibration: Calibration) -> ThinModel:
    return ThinModel.from_record(calibration.thin)


def dense_share(coverage: NDArray[np.floating]) -> Floats:
    """Return how far the heightmap of a tile counts: 0 up to a coverage of 0.35, 1 from 0.75, of any shape."""
    return np.clip((np.nan_to_num(coverage.astype(np.float64)) - _ALL_THIN) / (DENSE_COVERAGE - _ALL_THIN), 0.0, 1.0)


def is_rateable(columns: NDArray[np.float32], reason: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return which tiles can be rated from their points: four at least; ``SPANNED_POINTS`` and more span the tile.

    ``columns`` (..., 44): of `thin_columns`; ``reason`` (...): of the first pass.
    """
    points, seen = (columns[..., THIN_COLUMNS.index(name)] for name in ("points", "seen"))
    spanned = (points < SPANNED_POINTS) | (seen >= THIN_SEEN)
    known = np.isfinite(columns).all(axis=-1) & (points >= THIN_POINTS) & spanned
    return np.asarray(np.isin(reason, _RATEABLE) & known)


def _mixed(thin: Prediction, first: BlockRating, weight: Floats, floor: float) -> Prediction:
    """Mix with the first pass less its floor, (rows, cols); the result is continuous in the coverage."""
    ends = (first.c_r, first.c_r_low, first.c_r_high)
    c_r, low, high = (np.maximum(less_floor(values, floor), _LOST_SHARE * floor) for values in ends)
    sides = interval_log_sd(c_r, low, high, DRIVE_LOG_SD)
    ride: tuple[Floats, ...] = (np.log(c_r), *sides, first.p_fail.astype(np.float64))
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
    class_id, chance = judge(found, slope, calibration)
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
