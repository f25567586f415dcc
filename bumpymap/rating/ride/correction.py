"""Predict the C_r and p_fail that the simulation measures from the geometric C_r, with few coefficients.

- ln C_r is a cubic in ln g, g being the geometric C_r, plus terms of the slope, the unevenness, the distance between
  bumps (pitch over its change per metre, because a suspension hides short bumps) and the reach of the ground towards
  the belly, which shakes a vehicle that it strikes. Below the calibrated range, C_r is proportional to g: small motions
  are linear in the ground.
- The error of this prediction is log-normal, with a standard deviation that depends on g, and a part that another
  simulation of the same vehicle would add.
- Survey noise shifts and widens it: tables hold quantiles of how much rougher or smoother the true ground was than the
  denoised heightmap, over the *excess* (ln of the C_r with the noise over that without it) and the points per pixel.
  A geometric C_r below a tenth of its noise cannot be distinguished from it and is raised to that tenth.
- p_fail is a logistic regression on the logarithms of g, pitch, twist, unevenness, height range and height differences
  over two pixels, the belly reach, and the slope.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from operator import attrgetter
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import NORMAL_80, BadInputError, Floats, loops, plain_json
from bumpymap.rating.ride.operator import Rides

TAIL = 0.1
"""Probability below c_r_low and above c_r_high."""
_MIN_C_R = 1e-5
"""Smallest geometric C_r, rad/m; values below it are rounding errors."""
_MIN_NOISE_SHARE = 0.1
"""Smallest geometric C_r as a share of the C_r that the noise alone would cause."""
_MIN_HEIGHT = 1e-4
"""Smallest height range and height difference, m; less makes no difference."""
_MOST_REACH, _MOST_FELT_REACH = 3.0, 1.5
"""Reach of the ground towards the belly beyond which more makes no difference to p_fail, and to C_r. Vehicles cross
terrains of up to 1.4 to 2.3, and on those beyond 1.5 the fit is as good or better with this limit; without it two seeds
of the Warthog's drives differ 2.6 times on lava blocks, which reach 2 to 3."""


@dataclass(frozen=True, slots=True)
class Prediction:
    """The C_r of n patches, a log-normal distribution with its own width below and above the median, and p_fail."""

    log_c_r: Floats
    """(n,) median of ln C_r (rad/m)."""
    below: Floats
    """(n,) standard deviation of ln C_r below the median."""
    above: Floats
    """(n,) standard deviation of ln C_r above the median."""
    p_fail: Floats
    """(n,) 0..1."""

    def at_speed(self, log_ratio: Floats, log_sd: float) -> "Prediction":
        """Return it at another speed: C_r times exp(``log_ratio``), with an error more of that size in ln C_r."""
        return Prediction(
            self.log_c_r + log_ratio, np.hypot(self.below, log_sd), np.hypot(self.above, log_sd), self.p_fail
        )


def class_chance(
    class_id: NDArray[np.integer], log_c_r: Floats, sides: tuple[Floats, Floats], limits: tuple[float, ...]
) -> Floats:
    """Return the probability that a log-normal C_r lies between the limits of a class [rad/m]; all of one shape.

    ``log_c_r``: median of ln C_r; ``sides``: its standard deviations below and above the median.
    """
    edges = np.concatenate(([-np.inf], np.log(limits), [np.inf]))
    shares = np.empty((2, log_c_r.size))
    for edge, share in zip((edges[class_id], edges[class_id + 1]), shares, strict=True):
        loops.normal_shares(((edge - log_c_r) / np.where(edge < log_c_r, *sides)).ravel(), share)
    return np.asarray((shares[1] - shares[0]).reshape(log_c_r.shape))


@dataclass(frozen=True, slots=True)
class Coefficients:
    """Coefficients of a fitted model, as a calibration holds them: numbers, tables of numbers, and ``origin``."""

    model: ClassVar[str]
    """The model in error messages."""
    parts: ClassVar[dict[str, Callable[[Any], Any]]] = {}
    """Fields that are no numbers, but records of their own: name -> what reads it."""
    lengths: ClassVar[dict[str, int]] = {}
    """Number of coefficients by field, also by ``part.field``."""

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> Self:
        """Read the mapping that `to_record` returned; raise BadInputError if it is damaged."""
        try:
            values = {f.name: record[f.name] for f in fields(cls)}
            kinds = {"origin": dict, **cls.parts}
            made = cls(**{k: kinds.get(k, _numbers)(v) for k, v in values.items()})
            made.require_lengths()
        except (LookupError, TypeError, ValueError) as error:
            raise BadInputError(
                f"{cls.model} of the calibration is damaged: {error!r}. If an earlier version made it, fit its drives "
                "again with: python -m bumpymap.lab.simulate.refit FILE. Else make it again with: bumpymap calibrate"
            ) from error
        return made

    def to_record(self) -> dict[str, Any]:
        """Return the coefficients as plain numbers for JSON."""
        plain: dict[str, Any] = plain_json(self)
        return plain

    def require_lengths(self) -> None:
        """Raise ValueError if there are too few or too many coefficients."""
        for name, wanted in self.lengths.items():
            if (found := len(attrgetter(name)(self))) != wanted:
                raise ValueError(f"{found} coefficients of {name}, not {wanted}")


def _numbers(value: Any) -> Any:
    """Return a number of JSON as a float, lists of them as tuples; raise ValueError or TypeError at anything else."""
    return tuple(map(_numbers, value)) if isinstance(value, list | tuple) else float(value)


@dataclass(frozen=True, slots=True)
class Correction(Coefficients):
    """Coefficients that turn geometric values into predictions, fitted to the drives of a calibration."""

    model, lengths = "the ride model", {"log_range": 2, "spread": 2, "c_r": 9, "fail": 10}

    log_range: tuple[float, float]
    """Lowest and highest ln g of the driven patches."""
    c_r: tuple[float, ...]
    """Coefficients of `ride_features`."""
    spread: tuple[float, float]
    """ln of the standard deviation of ln C_r at the lowest and the highest ln g; linear in between."""
    fail: tuple[float, ...]
    """Coefficients of `fail_features`, in logits."""
    excess: tuple[float, ...]
    """Columns of the noise tables: noise excess, increasing from 0."""
    pixel_points: tuple[float, ...]
    """Rows of the noise tables: mean points per pixel, increasing."""
    noise_low: tuple[tuple[float, ...], ...]
    """10 % quantile of ln (C_r of the true ground / C_r of the denoised patch), ``[pixel_points][excess]``."""
    noise_middle: tuple[tuple[float, ...], ...]
    """Median of the same."""
    noise_high: tuple[tuple[float, ...], ...]
    """90 % quantile of the same."""
    origin: dict[str, Any]
    """The data of the fit, and its errors."""
    model_error: float
    """Standard deviation of ln C_r between simulations of the same vehicle."""

    def require_lengths(self) -> None:
        """Raise ValueError if tables or coefficients do not fit."""
        Coefficients.require_lengths(self)
        shapes = {np.shape(table) for table in (self.noise_low, self.noise_middle, self.noise_high)}
        if shapes != {(len(self.pixel_points), len(self.excess))}:
            raise ValueError("tables of different sizes")
        if not 0.0 <= self.model_error < math.inf:
            raise ValueError(f"model_error is {self.model_error}")

    def predict(self, rides: Rides, slope_deg: Floats, noise_felt: Floats, pixel_points: Floats) -> Prediction:
        """Predict C_r and p_fail of n denoised patches, by their geometric values and slope [degrees].

        ``noise_felt`` (n,): pitch change that the noise makes on level ground, rad/m; NaN (unknown) counts as the
        largest excess of the tables. ``pixel_points`` (n,): mean points per pixel.
        """
        g, excess = subtract_noise(rides.pitch_change, noise_felt)
        log_g = np.log(g)
        log_c_r = self._log_c_r(log_g, rides, slope_deg)
        sd = np.hypot(np.exp(np.interp(log_g, self.log_range, self.spread)), self.model_error)
        shift, down, up = (
            self._interpolate(table, excess, pixel_points)
            for table in (self.noise_middle, self.noise_low, self.noise_high)
        )
        return Prediction(
            log_c_r=log_c_r + shift,
            below=np.hypot(sd, (shift - down) / NORMAL_80),
            above=np.hypot(sd, (up - shift) / NORMAL_80),
            p_fail=1 / (1 + np.exp(-np.clip(fail_features(rides, slope_deg) @ np.array(self.fail), -40, 40))),
        )

    def without_noise(self, rides: Rides, slope_deg: Floats) -> Floats:
        """Return ln C_r of n patches that have no noise and many points, (n,); else as `predict`."""
        log_g = np.log(np.maximum(rides.pitch_change, _MIN_C_R))
        shift = self._interpolate(self.noise_middle, np.zeros(1), np.full(1, self.pixel_points[-1]))
        return self._log_c_r(log_g, rides, slope_deg) + shift

    def _log_c_r(self, log_g: Floats, rides: Rides, slope_deg: Floats) -> Floats:
        inside = np.clip(log_g, *self.log_range)
        fitted: Floats = ride_features(inside, rides, slope_deg) @ np.array(self.c_r)
        return fitted + (log_g - inside)

    def _interpolate(self, table: tuple[tuple[float, ...], ...], excess: Floats, pixel_points: Floats) -> Floats:
        """Interpolate a noise table linearly; beyond its ends, use the nearest entry."""
        known = np.where(np.isnan(excess), self.excess[-1], excess)
        rows = np.stack([np.interp(known, self.excess, row) for row in table])
        knots = np.log(self.pixel_points)
        place = np.interp(np.log(np.maximum(pixel_points, 1e-9)), knots, np.arange(len(knots)))
        low = np.minimum(place.astype(np.int64), len(knots) - 2)
        part = place - low
        each = np.arange(len(known))
        return np.asarray(rows[low, each] * (1 - part) + rows[low + 1, each] * part)


def subtract_noise(pitch_change: Floats, noise_felt: Floats) -> tuple[Floats, Floats]:
    """Return the geometric C_r, at least ``_MIN_NOISE_SHARE`` of that of the noise [rad/m], and the noise excess.

    Both are (n,). The excess is ln (C_r with the noise / C_r without it), NaN where the noise is unknown.
    """
    g = np.maximum(pitch_change, np.maximum(_MIN_NOISE_SHARE * np.nan_to_num(noise_felt), _MIN_C_R))
    return g, 0.5 * np.log1p((noise_felt / g) ** 2)


def ride_features(log_g: Floats, rides: Rides, slope_deg: Floats) -> Floats:
    """Return the terms of ln C_r, (n, 9).

    1, ln g, (ln g)^2, tan slope, unevenness, ln of the bump distance, (ln g)^3, the belly reach and its square.
    """
    reach = np.minimum(rides.belly_reach, _MOST_FELT_REACH)
    return np.stack(
        [
            np.ones(len(log_g)),
            log_g,
            log_g**2,
            np.tan(np.radians(slope_deg)),
            _unevenness(rides),
            np.log(np.maximum(rides.pitch, _MIN_C_R) / np.maximum(rides.pitch_change, _MIN_C_R)),
            log_g**3,
            reach,
            reach**2,
        ],
        axis=1,
    )


def fail_features(rides: Rides, slope_deg: Floats) -> Floats:
    """Return the terms of the logit of p_fail, (n, 10)."""
    tangent = np.tan(np.radians(np.minimum(slope_deg, 80.0)))
    return np.stack(
        [
            np.ones(len(tangent)),
            np.log(np.maximum(rides.pitch_change, _MIN_C_R)),
            np.log(np.maximum(rides.pitch, _MIN_C_R)),
            np.log(np.maximum(rides.twist, _MIN_C_R)),
            _unevenness(rides),
            np.minimum(rides.belly_reach, _MOST_REACH),
            tangent,
            tangent**2,
            np.log(np.maximum(rides.height_range, _MIN_HEIGHT)),
            np.log(np.maximum(rides.height_change, _MIN_HEIGHT)),
        ],
        axis=1,
    )


def _unevenness(rides: Rides) -> Floats:
    """Return ln (RMS of the pitch change / its mean): 0.23 for a normal distribution, more for single bumps."""
    size = np.maximum(rides.pitch_change, _MIN_C_R)
    return np.log(np.maximum(rides.pitch_change_rms, size) / size)
