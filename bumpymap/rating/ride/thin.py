"""Predict the ride over tiles with few points, from the strengths of ground and noise and the filled heightmap.

A heightmap with one point in some pixels and none in the others rolls too smoothly where holes were filled, and too
roughly where noise was not averaged. The points tell how strong the ground is beside the noise, see `ground_power`, and
C_r is proportional to that for ground of one form. Its form shows in the ride over the heightmap as far as that is more
than noise. So ln C_r is linear in the ground's strength and a few measures of form, and in their products with the
logarithm of the number of points; the coefficients are fitted to thin simulated surveys of the terrain library. p_fail
is a logistic regression on those surveys: the expectation of p_fail given what is measured, so that it rises where a
tile is little known.

A block is rated when the columns of its tiles and of their neighbours are known.
"""

from dataclasses import dataclass, fields, replace
from typing import Any

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
)
from bumpymap.rating.calibration import Calibration, remembered
from bumpymap.rating.ride.correction import Coefficients, Prediction
from bumpymap.rating.ride.ground_power import POWER_RING, WAVE_SUMS, Strength, find_strengths, wave_sums
from bumpymap.rating.ride.motion_operator import roll_over
from bumpymap.rating.ride.operator import RideOperator
from bumpymap.rating.ride.rate import DRIVE_LOG_SD, interval, judge
from bumpymap.rating.ride.speed import plain_speed_factor, speed_log_sd
from bumpymap.rating.vehicle_profile import less_floor

THIN_COLUMNS = (
    *("points", "seen", "slope", "squares", "pairs"),
    *("pitch_change", "pitch_change_rms", "pitch", "twist", "belly"),
    *(f"wave_{number}" for number in range(WAVE_SUMS)),
)
"""Columns of `thin_columns`: number of points; share of the tile's nine parts that hold one (0: a hole of a quarter);
slope of the plane (tangent); sum of the squared height differences of close pairs of points, m^2; their number; the
ride over the filled heightmap as in `Rides`; sums of `wave_sums`. The last two are NaN of dense tiles."""
_MEASURED = len(THIN_COLUMNS) - WAVE_SUMS
THIN_RING = POWER_RING
"""Tiles to each side that have a part in the rating of a thin one."""
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
    """Coefficients of `ride_terms`."""
    spread: tuple[float, ...]
    """Coefficients of `spread_terms`: ln of the standard deviation of ln C_r where the ground's strength is known."""
    sides: tuple[float, float]
    """Factors below and above the median on that and the error of the strength."""
    own_spread: float
    """Standard deviation of ln C_r of the ride model itself."""
    fail: tuple[float, ...]
    """Coefficients of `fail_terms`, in logits."""
    origin: dict[str, Any]
    """The data of the fit, and its errors."""

    def predict(self, columns: Floats, strength: Strength) -> Prediction:
        """Predict C_r and p_fail of n tiles; NaN where a column is.

        ``columns`` (n, 44): of `thin_columns`; ``strength``: of `find_strengths`, (n,) each.
        """
        inputs = (columns, strength, self.felt, self.relief)
        beyond = strength.ground - np.clip(strength.ground, *self.relief)
        log_c_r = ride_terms(*inputs) @ np.array(self.c_r) + beyond
        sd = np.hypot(np.exp(spread_terms(*inputs) @ np.array(self.spread)), strength.ground_sd)
        logit = np.clip(fail_terms(columns, strength, self.felt) @ np.array(self.fail), -_MOST_LOGIT, _MOST_LOGIT)
        below, above = (np.hypot(self.own_spread, side * sd) for side in self.sides)
        return Prediction(log_c_r, below, above, 1.0 / (1.0 + np.exp(-logit)))


def _column(columns: Floats, name: str) -> Floats:
    return columns[:, THIN_COLUMNS.index(name)]


def log_points(points: Floats) -> Floats:
    """Return ln of the number of points over a usual one."""
    return np.log(points / _USUAL_POINTS)


def _log_points(columns: Floats) -> Floats:
    return log_points(_column(columns, "points"))


def _form(columns: Floats, strength: Strength, felt: tuple[float, ...]) -> tuple[Floats, Floats]:
    """Return ln of the filled heightmap's pitch change over a usual one, and the share of the ground in it.

    Usual for ground of that strength under that noise.
    """
    of_ground = 2.0 * (strength.ground + felt[2])
    both = np.logaddexp(of_ground, 2.0 * (strength.noise + felt[0] + felt[1] * _log_points(columns)))
    ride = np.log(np.maximum(_column(columns, "pitch_change"), _ZERO))
    return ride - 0.5 * both, np.exp(of_ground - both)


def _with_points(terms: Floats, columns: Floats) -> Floats:
    """Return terms, their products with ln of the points, and the share of the tile that is not seen."""
    return np.column_stack((terms, terms * _log_points(columns)[:, None], 1.0 - _column(columns, "seen")))


def ride_terms(columns: Floats, strength: Strength, felt: tuple[float, ...], relief: tuple[float, float]) -> Floats:
    """Return the terms of ln C_r, (n, terms)."""
    ground, (form, share) = np.clip(strength.ground, *relief), _form(columns, strength, felt)
    terms = np.column_stack(
        (
            np.ones(len(columns)),
            ground,
            ground**2,
            share * form,
            _column(columns, "slope"),
        )
    )
    return _with_points(terms, columns)


def spread_terms(columns: Floats, strength: Strength, felt: tuple[float, ...], relief: tuple[float, float]) -> Floats:
    """Return the terms of ln of the standard deviation, (n, terms)."""
    ground, (form, share) = np.clip(strength.ground, *relief), _form(columns, strength, felt)
    terms = np.column_stack((np.ones(len(columns)), ground, share * np.clip(form, -3.0, 3.0)))
    return np.column_stack((_with_points(terms, columns), ground**2))


def fail_terms(columns: Floats, strength: Strength, felt: tuple[float, ...]) -> Floats:
    """Return the terms of the logit of p_fail, (n, terms)."""
    ride, (_, share) = _column(columns, "pitch_change"), _form(columns, strength, felt)
    slope = np.minimum(_column(columns, "slope"), 5.0)
    terms = np.column_stack(
        (
            np.ones(len(columns)),
            np.log(np.maximum(ride, _ZERO)) + 0.5 * np.log(np.maximum(share, _LEAST_SHARE)),
            strength.ground,
            np.log(np.maximum(_column(columns, "pitch"), _ZERO)),
            np.log(np.maximum(_column(columns, "twist"), _ZERO)),
            np.log(np.maximum(_column(columns, "pitch_change_rms"), ride + _ZERO) / (ride + _ZERO)),
            np.minimum(_column(columns, "belly"), 3.0),
            slope,
            slope**2,
        )
    )
    return np.column_stack((_with_points(terms, columns), share))


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
    weight = ride_weight(first, coverage)
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


def ride_weight(first: BlockRating, coverage: NDArray[np.floating]) -> Floats:
    """Return the weight of the first pass in the rating of each tile: 0 of thin and unknown tiles, 1 of dense ones."""
    return np.where(first.class_id != NO_CLASS, dense_share(coverage), 0.0)


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
