"""Correct the geometric C_r to what the simulation measures: a few numbers, their spread, and p_fail.

- ln C_r = quadratic in ln g + terms of slope, unevenness and the way between bumps (pitch over its change per metre: a
  suspension hides short bumps), g the geometric C_r. Below the calibrated range C_r is
  proportional to g: a small motion is linear in the ground.
- Its spread is log-normal, with a standard deviation that changes with g: what geometry leaves out.
- Noise adds to it: by how much the ground under a noisy heightmap was rougher or smoother than the cleaned one, as
  quantiles over the *excess* (ln of what wheels would have felt with the noise over without it) and the points a pixel.
  Ground that seems smoother than a tenth of its noise counts as a tenth of it: nobody can tell.
- p_fail is logistic in the ln of g, of pitch, twist and unevenness, the belly's reach, and the slope.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError
from bumpymap.rating.ride.geometry import Rides

__all__ = ["NORMAL_TAIL", "TAIL", "Correction", "Prediction", "fail_features", "ride_features", "subtract_noise"]

Floats = NDArray[np.float64]
TAIL = 0.1
"""Probability below c_r_low and above c_r_high."""
NORMAL_TAIL = 1.2815515655446004
"""That quantile of the standard normal, without its sign."""
_LEAST = 1e-5
"""Geometric C_r below this is rounding, rad/m."""
_LEAST_OF_NOISE = 0.1
"""Geometric C_r below this share of what the noise would make cannot be told from it."""


_C_R_TERMS, _FAIL_TERMS = 6, 8


@dataclass(frozen=True, slots=True)
class Prediction:
    """The C_r of n patches as a log-normal distribution with a side each, and p_fail."""

    log_c_r: Floats
    """(n,) median of ln C_r (rad/m)."""
    below: Floats
    """(n,) standard deviation of ln C_r on the lower side."""
    above: Floats
    """(n,) the same on the upper side."""
    p_fail: Floats
    """(n,) 0..1."""


@dataclass(frozen=True, slots=True)
class Correction:
    """The correction of the ride model, fitted to the drives of a calibration."""

    log_range: tuple[float, float]
    """ln g of the ground that was driven: lowest and highest."""
    c_r: tuple[float, ...]
    """Coefficients of `ride_features`."""
    spread: tuple[float, float]
    """ln of the standard deviation of ln C_r: at the lowest and the highest ln g, straight between."""
    fail: tuple[float, ...]
    """Coefficients of `fail_features`, in logits."""
    excess: tuple[float, ...]
    """Noise excess at which the three quantiles that follow are known, rising from 0."""
    pixel_points: tuple[float, ...]
    """Mean points a pixel at which they are known, rising."""
    noise_low: tuple[tuple[float, ...], ...]
    """10 % quantile of ln (C_r of the ground / C_r of the cleaned patch): ``[pixel_points][excess]``."""
    noise_middle: tuple[tuple[float, ...], ...]
    """Median."""
    noise_high: tuple[tuple[float, ...], ...]
    """90 % quantile."""
    origin: dict[str, Any]
    """What it was fitted to, and how well."""

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> "Correction":
        """Read what `to_record` gave.

        Raises
        ------
        BadInputError
            Something is missing or of another length.
        """
        try:
            values = {f.name: record[f.name] for f in fields(cls)}
            numbers: dict[str, Any] = {k: dict(v) if k == "origin" else _numbers(v) for k, v in values.items()}
            made = cls(**numbers)
            made._check()
        except (LookupError, TypeError, ValueError) as error:
            raise BadInputError(f"the ride model of the calibration is damaged: {error!r}") from error
        return made

    def _check(self) -> None:
        shapes = {np.shape(table) for table in (self.noise_low, self.noise_middle, self.noise_high)}
        if shapes != {(len(self.pixel_points), len(self.excess))} or (len(self.log_range), len(self.spread)) != (2, 2):
            raise ValueError("tables of different sizes")
        if (len(self.c_r), len(self.fail)) != (_C_R_TERMS, _FAIL_TERMS):
            raise ValueError(f"{len(self.c_r)} and {len(self.fail)} coefficients, not {_C_R_TERMS} and {_FAIL_TERMS}")

    def to_record(self) -> dict[str, Any]:
        """Return plain numbers for JSON."""
        return {key: _lists(value) for key, value in asdict(self).items()}

    def predict(self, rides: Rides, slope_deg: Floats, noise_felt: Floats, pixel_points: Floats) -> Prediction:
        """Predict C_r and p_fail.

        Parameters
        ----------
        rides : Rides
            Of n patches without noise.
        slope_deg : array (n,)
            Slope of the patch's plane, degrees.
        noise_felt : array (n,)
            Of `CleanPatches`, rad/m; NaN, noise unknown, counts as the largest excess that was seen.
        pixel_points : array (n,)
            Mean points a pixel.
        """
        g, excess = subtract_noise(rides.pitch_change, noise_felt)
        log_g = np.log(g)
        low, high = self.log_range
        inside = np.clip(log_g, low, high)
        features = ride_features(inside, rides, slope_deg)
        log_c_r = features @ np.array(self.c_r) + (log_g - inside)
        sd = np.exp(np.interp(log_g, (low, high), self.spread))
        shift, down, up = (
            self._read(table, excess, pixel_points) for table in (self.noise_middle, self.noise_low, self.noise_high)
        )
        return Prediction(
            log_c_r=log_c_r + shift,
            below=np.hypot(sd, (shift - down) / NORMAL_TAIL),
            above=np.hypot(sd, (up - shift) / NORMAL_TAIL),
            p_fail=1 / (1 + np.exp(-np.clip(fail_features(rides, slope_deg) @ np.array(self.fail), -40, 40))),
        )

    def _read(self, table: tuple[tuple[float, ...], ...], excess: Floats, pixel_points: Floats) -> Floats:
        """Read a noise table: straight between its knots, the nearest knot beyond them."""
        seen = np.where(np.isnan(excess), self.excess[-1], excess)
        rows = np.stack([np.interp(seen, self.excess, row) for row in table])
        knots = np.log(self.pixel_points)
        place = np.interp(np.log(np.maximum(pixel_points, 1e-9)), knots, np.arange(len(knots)))
        low = np.minimum(place.astype(np.int64), len(knots) - 2)
        part = place - low
        each = np.arange(len(seen))
        value: Floats = rows[low, each] * (1 - part) + rows[low + 1, each] * part
        return value


def subtract_noise(pitch_change: Floats, noise_felt: Floats) -> tuple[Floats, Floats]:
    """Return the geometric C_r that exceeds the noise [rad/m], and the excess: ln of C_r with the noise over without.

    Both (n,); where the noise is unknown (NaN), the excess is too.
    """
    g = np.maximum(pitch_change, np.maximum(_LEAST_OF_NOISE * np.nan_to_num(noise_felt), _LEAST))
    return g, 0.5 * np.log1p((noise_felt / g) ** 2)


def _numbers(value: Any) -> Any:
    return tuple(_numbers(item) for item in value) if isinstance(value, list | tuple) else float(value)


def _lists(value: Any) -> Any:
    return [_lists(item) for item in value] if isinstance(value, tuple) else value


def ride_features(log_g: Floats, rides: Rides, slope_deg: Floats) -> Floats:
    """Terms of ln C_r, (n, 6): 1, ln g, its square, tangent of the slope, unevenness, ln of the way between bumps."""
    return np.stack(
        [
            np.ones(len(log_g)),
            log_g,
            log_g**2,
            np.tan(np.radians(slope_deg)),
            _unevenness(rides),
            np.log(np.maximum(rides.pitch, _LEAST) / np.maximum(rides.pitch_change, _LEAST)),
        ],
        axis=1,
    )


def fail_features(rides: Rides, slope_deg: Floats) -> Floats:
    """Terms of the logit of p_fail, (n, 8)."""
    tangent = np.tan(np.radians(np.minimum(slope_deg, 80.0)))
    return np.stack(
        [
            np.ones(len(tangent)),
            np.log(np.maximum(rides.pitch_change, _LEAST)),
            np.log(np.maximum(rides.pitch, _LEAST)),
            np.log(np.maximum(rides.twist, _LEAST)),
            _unevenness(rides),
            np.minimum(rides.belly_reach, 3.0),
            tangent,
            tangent**2,
        ],
        axis=1,
    )


def _unevenness(rides: Rides) -> Floats:
    """Ln of the root mean square of the pitch change over its mean: 0.23 where it is normal, more for single bumps."""
    size = np.maximum(rides.pitch_change, _LEAST)
    uneven: Floats = np.log(np.maximum(rides.pitch_change_rms, size) / size)
    return uneven
