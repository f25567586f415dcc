"""Predict the ride over tiles with few points, from their points and their filled heightmap.

A heightmap with one point in some pixels and none in the others rolls too smoothly where holes were filled, and too
roughly where noise was not averaged. By how much depends on how many points there are, on the noise, and on how the
ground's variance is spread over wavelengths, which the pairs of points tell. So ln C_r is linear in the logarithms of
a few measures and in their products with the logarithm of the number of points; the coefficients are fitted to thin
simulated surveys of the terrain library. p_fail is a logistic regression on those surveys: the expectation of p_fail
given what is measured, so that it rises where a tile is little known.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.rating.ride.correction import Coefficients, Prediction
from bumpymap.rating.ride.motion_operator import roll_over
from bumpymap.rating.ride.operator import RideOperator

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
_TINY = 1e-5
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
    return 0.5 * np.log(2.0 * np.maximum(variance, (_LEAST_SHARE * noise) ** 2 + _TINY**2))


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
    return 0.5 * np.log(np.maximum(ride**2 - of_noise**2, (_LEAST_RIDE * ride) ** 2 + _TINY**2))


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
            np.log(np.maximum(_column(columns, "pitch"), _TINY)),
            np.log(np.maximum(_column(columns, "twist"), _TINY)),
            np.log(np.maximum(_column(columns, "pitch_change_rms"), ride + _TINY) / (ride + _TINY)),
            np.minimum(_column(columns, "belly"), 3.0),
            slope,
            slope**2,
        )
    )
    return np.column_stack((_with_points(terms, _log_points(columns), 1), _excess(columns, noise), _unseen(columns)))


def _unseen(columns: Floats) -> Floats:
    return 1.0 - _column(columns, "seen")
