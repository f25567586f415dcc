"""Move a calibration to measured drives, with the simulation as the prior (``bumpymap check --refit``).

Two numbers move: a shift of ln C_r, and a tilt of it (how much more it moves on rough ground than on smooth); a third,
the floor of the profile, if left-out parts of the drives are predicted better with it. Before any drive, shift and tilt
are 0, give or take what vehicles differ from their profiles (docs/pages/check.md has the table) and more, since no
simulation holds all of a vehicle. A calibration is moved only if it then predicts left-out parts better, and only from
a stated length of drive on.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, DrivenStretches, plain_json
from bumpymap.rating.calibration import Calibration
from bumpymap.rating.drive_posterior import (
    DriveEvidence,
    DrivePrior,
    HeldOutScore,
    MovePosterior,
    collect_evidence,
    fit_move,
    hold_out,
    respond,
)
from bumpymap.rating.ride.correction import NORMAL_TAIL, Correction
from bumpymap.rating.ride.thin import ThinModel

Floats = NDArray[np.float64]
_DIGITS = 10
"""Significant digits of moved coefficients."""
_POINTS = 31
"""Places of the range that a straight line of the spread is fitted to. Chosen."""


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
    tile = calibration.steps["tile"]
    log_sd = [move.sd(sd, c_r) for sd, c_r in zip(tile["c_r_log_sd"], tile["c_r"], strict=True)]
    return replace(
        calibration,
        c_r=move.c_r(calibration.c_r),
        c_r_log_sd=move.sd(calibration.c_r_log_sd, float(np.exp(move.middle))),
        class_c_r=_class_means(calibration, move),
        ride=_moved_ride(calibration.ride, move),
        thin=_moved_thin(calibration.thin, move),
        steps=calibration.steps | {"tile": tile | {"c_r": move.c_r(tile["c_r"]), "c_r_log_sd": log_sd}},
        settings=calibration.settings | {"moved_to_drives": record},
    )


def _moved_ride(record: dict[str, Any], move: LogMove) -> dict[str, Any]:
    old = Correction.from_record(record)
    new = replace(
        old,
        c_r=_moved_terms(old.c_r, move),
        spread=_moved_spread(old, move),
        noise_low=_each(old.noise_low, lambda value: value * move.slope),
        noise_middle=_each(old.noise_middle, lambda value: value * move.slope),
        noise_high=_each(old.noise_high, lambda value: value * move.slope),
    )
    moved = record | new.to_record()
    return moved | {"model_error": _short(move.widening * move.slope * old.model_error)}


def _moved_spread(old: Correction, move: LogMove) -> tuple[float, float]:
    """Return ln of the moved spread at both ends: the straight line nearest to it, nowhere below the simulation's.

    Where on the range a C_r lies follows from the geometric C_r, which is near that of the drives.
    """
    log_g = np.linspace(*old.log_range, _POINTS)
    own = np.exp(np.interp(log_g, old.log_range, old.spread))
    wanted = np.log([move.sd(sd, np.exp(at)) for sd, at in zip(own.tolist(), log_g.tolist(), strict=True)])
    slope, start = np.polyfit(np.linspace(0.0, 1.0, _POINTS), wanted, 1).tolist()
    least = np.log(move.widening * move.slope)
    low, high = (max(new, sd + least) for new, sd in zip((start, start + slope), old.spread, strict=True))
    return _short(low), _short(high)


def _moved_thin(record: dict[str, Any], move: LogMove) -> dict[str, Any]:
    old = ThinModel.from_record(record)
    new = replace(
        old,
        c_r=_moved_terms(old.c_r, move),
        spread=(_short(old.spread[0] + np.log(move.widening * move.slope)), *old.spread[1:]),
        own_spread=_short(move.sd(old.own_spread, np.exp(move.middle))),
        prior=(_short(float(move.log(np.array(old.prior[0])))), _short(move.slope * old.prior[1])),
    )
    return record | new.to_record()


def _moved_terms(coefficients: tuple[float, ...], move: LogMove) -> tuple[float, ...]:
    """Move the coefficients of ln C_r, of which the first is the constant."""
    first, *rest = (move.slope * value for value in coefficients)
    return (_short(first + move.intercept), *map(_short, rest))


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


@dataclass(frozen=True, slots=True)
class UpdateSettings:
    """Prior of the numbers, and how much must have been driven before a calibration is moved."""

    shift_sd: float = 0.2
    """Standard deviation of the shift of ln C_r before any drive."""
    tilt_sd: float = 0.1
    """The same of its tilt."""
    speed_mps: float | None = None
    """Speed that the map's C_r is for, m/s; None: that of the profile."""
    least_m: float = 200.0
    """Least length of driven ground, m; ground that was driven twice counts once."""
    least_stretches: int = 12
    least_gain: float = 1.28
    """Least gain on parts that were left out, in its standard errors: by chance alone, one in ten has it."""
    least_floor_gain: float = 2.0
    """The same for a floor that moves, over one that does not."""


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
    calibration: Calibration, stretches: DrivenStretches, settings: UpdateSettings | None = None
) -> tuple[Calibration, DriveUpdate]:
    """Move the C_r of a calibration to what drives measured; its vehicle, class limits and p_fail stay.

    ``calibration``: the one that the map of the stretches was made with; ``stretches``: of all drives. Raises
    BadInputError if the calibration was moved before, or the drives are too short, or agree with it.
    """
    settings = settings or UpdateSettings()
    if "moved_to_drives" in calibration.settings:
        before = calibration.settings["moved_to_drives"].get("calibration_id", "before")
        raise BadInputError(
            f"the calibration {calibration.id} was moved to drives already, and would count them twice. Check all "
            f"drives together, those of then and those of now, against a map made with the calibration {before}"
        )
    floor = calibration.floor
    speed = settings.speed_mps or float(calibration.vehicle["speed_mps"])
    evidence, lost = collect_evidence(stretches, speed, floor)
    _require_enough(evidence, lost, speed, settings)
    plain = DrivePrior(
        middle=math.log(calibration.class_limits[_MIDDLE_LIMIT]),
        sd=(settings.shift_sd, settings.tilt_sd),
        log_floor=math.log(floor) if floor else -math.inf,
    )
    line_sd = fit_move(evidence, plain).line_sd
    prior, after = _best_prior(evidence, plain, line_sd, settings)
    before = hold_out(evidence, plain, line_sd, moved=False)
    update = _described(calibration, evidence, lost, prior, (before, after))
    if not update.gain[0] > settings.least_gain * update.gain[1]:
        raise BadInputError(_agree(update))
    found = update.posterior
    shift, tilt = found.mean[:2].tolist()
    move = LogMove(prior.middle, shift, tilt, found.covariance[:2, :2], max(1.0, found.map_scale))
    moved = moved_calibration(calibration, move, update.to_record())
    if update.floor[0] != update.floor[1]:
        moved = replace(moved, vehicle=moved.vehicle | {"floor": {"c_r_radpm": update.floor[1]}})
    return moved, update


def _best_prior(
    evidence: DriveEvidence, plain: DrivePrior, line_sd: float, settings: UpdateSettings
) -> tuple[DrivePrior, HeldOutScore]:
    """Return the prior with a floor that moves if left-out parts are predicted better with it, else the plain one."""
    own = math.isfinite(plain.log_floor)
    centre, sd = (plain.log_floor, _FLOOR_LOG_SD[0]) if own else (math.log(_USUAL_FLOOR), _FLOOR_LOG_SD[1])
    floored = DrivePrior(plain.middle, (*plain.sd, sd), centre)
    fixed, free = hold_out(evidence, plain, line_sd), hold_out(evidence, floored, line_sd)
    gain, error = free.gain_over(fixed)
    return (floored, free) if gain > settings.least_floor_gain * error else (plain, fixed)


def _require_enough(evidence: DriveEvidence, lost: dict[str, float], speed: float, settings: UpdateSettings) -> None:
    number, new_m = len(evidence.way_m), float(evidence.new_m.sum())
    if number >= settings.least_stretches and new_m >= settings.least_m:
        return
    reasons = ("off the map", f"not near the {speed:g} m/s of the map", "with less motion than the sensor tells")
    parts = zip(reasons, lost.values(), strict=True)
    named = ", ".join(f"{length:.0f} m {reason}" for reason, length in parts if length >= 0.5)
    raise BadInputError(
        f"the drives are too short to move a calibration: {new_m:.0f} m of different ground on {number} stretches count"
        f"{f' (left out: {named})' if named else ''}. It takes at least {settings.least_m:.0f} m on "
        f"{settings.least_stretches} stretches; drive more, over smooth ground and rough, and give all drives together"
    )


def _described(
    calibration: Calibration,
    evidence: DriveEvidence,
    lost: dict[str, float],
    prior: DrivePrior,
    held_out: tuple[HeldOutScore, HeldOutScore],
) -> DriveUpdate:
    found = fit_move(evidence, prior)
    posterior = MovePosterior(
        np.round(found.mean, _DECIMALS),
        np.round(found.covariance, 2 * _DECIMALS),
        round(found.map_scale, _DECIMALS),
        round(found.line_sd, _DECIMALS),
    )
    before, after = held_out
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
        factor=(math.exp(by - NORMAL_TAIL * sd), math.exp(by), math.exp(by + NORMAL_TAIL * sd)),
        ratio=(before.median_ratio, float(np.exp(np.median(fitted - evidence.log_measured)))),
        held_out_error=(before.error, after.error),
        gain=after.gain_over(before),
        parts=after.parts,
    )


def _agree(update: DriveUpdate) -> str:
    low, _, high = update.factor
    return (
        f"the drives agree with the calibration {update.calibration_id}, so it is not moved: over {update.way_m:.0f} m "
        f"({update.stretches} stretches) the map's C_r is {update.ratio[0]:.2f} times the measured in the median; "
        "moved, it would not predict left-out parts of the drives better than by chance (median error "
        f"{100 * update.held_out_error[1]:.1f} %, as it is {100 * update.held_out_error[0]:.1f} %). The drives leave "
        f"room for a factor of {low:.2f} to {high:.2f} on C_r; longer ones would tell"
    )
