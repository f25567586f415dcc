"""The calibration that follows from moved numbers: every C_r in it is moved, limits and p_fail stay.

Inside the calibrated range the moved calibration predicts exactly the moved C_r: the coefficients of ln C_r are
multiplied and shifted, and what noise does to ln C_r is multiplied. Beyond the range, C_r stays proportional to the
ground, as before. Intervals widen by what is not known of the moved numbers, and by what the drives scatter more than
the intervals said. They never become narrower than the simulation's own.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.rating.calibration import Calibration
from bumpymap.rating.ride.correction import Correction
from bumpymap.rating.ride.thin import ThinModel
from bumpymap.rating.update.posterior import DrivePrior, MovePosterior

__all__ = ["LogMove", "moved_calibration"]

Floats = NDArray[np.float64]
_DIGITS = 10
_POINTS = 31


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

    @classmethod
    def of(cls, prior: DrivePrior, posterior: MovePosterior) -> "LogMove":
        """Take shift and tilt of a posterior; a floor is none of this."""
        shift, tilt = posterior.mean[:2].tolist()
        return cls(prior.middle, shift, tilt, posterior.covariance[:2, :2], max(1.0, posterior.map_scale))

    @property
    def slope(self) -> float:
        """Factor on differences of ln C_r."""
        return 1.0 + self.tilt

    @property
    def intercept(self) -> float:
        """What is added to ``slope`` times ln C_r."""
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
    """Return a calibration whose C_r is moved.

    Parameters
    ----------
    calibration : Calibration
    move : LogMove
    record : dict
        What is written to its settings as ``moved_to_drives``; plain JSON.
    """
    return replace(
        calibration,
        c_r=move.c_r(calibration.c_r),
        c_r_log_sd=move.sd(calibration.c_r_log_sd, float(np.exp(move.middle))),
        class_c_r=_class_means(calibration, move),
        ride=None if calibration.ride is None else _moved_ride(calibration.ride, move),
        thin=None if calibration.thin is None else _moved_thin(calibration.thin, move),
        steps=None if calibration.steps is None else _moved_steps(calibration.steps, move),
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
    if moved.get("model_error"):
        moved["model_error"] = _short(move.widening * move.slope * moved["model_error"])
    return moved


def _moved_spread(old: Correction, move: LogMove) -> tuple[float, float]:
    """Return ln of the moved spread at both ends: the straight line nearest to it, nowhere below the simulation's.

    Where on the range a C_r lies is told by the geometric C_r, which is near that of the drives.
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
    )
    return record | new.to_record()


def _moved_steps(record: dict[str, Any], move: LogMove) -> dict[str, Any]:
    tile = record["tile"]
    moved = {"c_r": move.c_r(tile["c_r"])}
    moved["c_r_log_sd"] = [move.sd(sd, c_r) for sd, c_r in zip(tile["c_r_log_sd"], tile["c_r"], strict=True)]
    return record | {"tile": tile | moved}


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
