"""What steps do to a vehicle: tiles are rated as those with the same step in their middle, borders as usable or not.

The calibration holds what steps do (its ``steps``, see ``bumpymap.lab.simulate.steps``): its ride model's rating of
tiles with a step well inside, and drives over single walls, up and down, at several angles. From these come curves over
the height of a step that never fall, with straight lines between the known heights:

- C_r and p_fail of a tile: the mean, and the 80 % quantile, over steps at several places and directions in the tile;
  C_r is proportional to the height below the lowest. Above the highest known step, the curves stay.
- p_fail of a crossing, up and down: the mean over the angles.

Calibrations without ``steps`` follow the geometry: a step is safe up to half of the wheel radius and stops the
vehicle from a whole one, with a straight line in between; C_r is ``4 / pi atan(height / wheelbase) / tile_size`` (the
vehicle pitches up and back once a tile; 2 / pi is the mean over the headings).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import FAIL_SHARE, NO_CLASS, BadInputError
from bumpymap.rating.calibration import Calibration, remembered
from bumpymap.rating.ride._ride_kernels import normal_shares
from bumpymap.rating.ride.correction import NORMAL_TAIL
from bumpymap.rating.ride.speed import plain_speed_factor
from bumpymap.rating.vehicle_body import less_floor, with_floor

__all__ = ["STEP_COLUMNS", "StepEffect", "apply_steps", "crossing_fails", "edge_usable"]

Floats = NDArray[np.float64]

STEP_COLUMNS = ("class_id", "c_r", "c_r_low", "c_r_high", "p_fail", "confidence")
"""The columns that `apply_steps` changes."""
_LEAST_LOG_SD = 0.1
_GEOMETRIC_LOG_SD = 0.5
_TINY = 1e-9
_SAFE_SHARE = 0.5
"""Without such a record: steps up to this share of the wheel radius are safe."""


@dataclass(frozen=True, slots=True)
class StepEffect:
    """Curves over the height of a step; all arrays are (k,), from a height of 0 on."""

    height: Floats
    """m, increasing."""
    c_r: Floats
    """C_r of a tile with such a step, rad/m."""
    c_r_log_sd: Floats
    """Standard deviation of ln C_r between places and directions of the step."""
    p_fail: Floats
    """p_fail of a tile with such a step."""
    p_up: Floats
    """p_fail of a crossing upwards."""
    p_down: Floats
    """p_fail of a crossing downwards."""

    @classmethod
    def of(cls, calibration: Calibration) -> "StepEffect":
        """Read the ``steps`` of a calibration; without them, follow the geometry.

        Raises
        ------
        BadInputError
            The record is damaged.
        """
        if calibration.steps is None:
            return _geometric(calibration)
        try:
            return _recorded(calibration.steps)
        except (LookupError, TypeError, ValueError) as error:
            raise BadInputError(
                f"the record of steps in the calibration {calibration.id} is damaged: {error!r}. Make it again "
                "with: bumpymap calibrate --vehicle FILE --out CALIBRATION.json"
            ) from error

    def read(self, curve: Floats, step: NDArray[np.floating]) -> Floats:
        """Read a curve at steps [m] of any shape; NaN counts as no step; above the highest step the curve stays."""
        return np.asarray(np.interp(np.fmax(step.astype(np.float64), 0.0), self.height, curve))


def apply_steps(
    columns: Mapping[str, NDArray[Any]], step: NDArray[np.floating], calibration: Calibration
) -> dict[str, NDArray[Any]]:
    """Rate tiles with steps as tiles with the same step in their middle; no tile gets better.

    ``c_r``, its interval and ``p_fail`` are the larger ones of the tile's own and of those of the step. The class
    follows from them as in the rating: that of the C_r, and the roughest if p_fail is at least one half. Tiles without
    class, and those with a step of 0 or NaN, keep their bits.

    Parameters
    ----------
    columns : mapping
        ``STEP_COLUMNS`` and ``coverage``, arrays of one shape, as in `CostMap`.
    step : array
        Of the same shape: `TileSteps.unseen`, m.
    calibration : Calibration
        Of the vehicle.

    Returns
    -------
    dict
        ``STEP_COLUMNS``, in the types they came in.

    Raises
    ------
    BadInputError
        The calibration's record of steps is damaged.
    """
    effect = _effect(calibration)
    own = {name: np.asarray(columns[name]) for name in STEP_COLUMNS}
    known = own["class_id"] != NO_CLASS
    driven, fails, sd = (effect.read(curve, step) for curve in (effect.c_r, effect.p_fail, effect.c_r_log_sd))
    # Without a step there is nothing that a floor could be added to.
    c_r, low, high = (
        np.where(driven > 0.0, with_floor(driven * np.exp(tail * sd), calibration.map_floor), 0.0)
        for tail in (0.0, -NORMAL_TAIL, NORMAL_TAIL)
    )
    raised = known & (c_r > own["c_r"])
    felt = {
        "c_r": np.maximum(own["c_r"], c_r),
        "c_r_low": np.maximum(own["c_r_low"], low),
        "c_r_high": np.maximum(own["c_r_high"], high),
        "p_fail": np.maximum(own["p_fail"], fails),
    }
    lost = fails >= FAIL_SHARE
    class_id = np.maximum(own["class_id"], np.searchsorted(np.array(calibration.class_limits), driven, side="right"))
    class_id = np.where(lost, len(calibration.class_limits), class_id)
    changed = known & (raised | (lost & ~(own["p_fail"] >= FAIL_SHARE)))
    without = less_floor(felt["c_r"], calibration.map_floor)
    sure = np.where(lost, fails, _sureness(class_id, without, sd, calibration.class_limits))
    felt["confidence"] = np.where(changed, sure * np.sqrt(columns["coverage"]), own["confidence"])
    felt["class_id"] = class_id
    return {name: np.where(known, felt[name], own[name]).astype(own[name].dtype) for name in STEP_COLUMNS}


def crossing_fails(step: NDArray[np.floating], calibration: Calibration) -> NDArray[np.float32]:
    """Return p_fail of a crossing of steps [m] in the worse of both directions, of their shape; NaN where unknown."""
    effect = _effect(calibration)
    worse = np.maximum(effect.read(effect.p_up, step), effect.read(effect.p_down, step))
    return np.where(np.isnan(step), np.nan, worse).astype(np.float32)


def edge_usable(border: NDArray[np.floating], calibration: Calibration) -> NDArray[np.bool_]:
    """Return which borders a vehicle can cross both ways: p_fail of a crossing is below one half.

    Parameters
    ----------
    border : array
        Steps of any shape, m, such as `TileSteps.border`. An unknown one (NaN) is not usable; ``numpy.isnan(border)``
        tells it from a wall.
    calibration : Calibration
        Of the vehicle.

    Raises
    ------
    BadInputError
        The calibration's record of steps is damaged.
    """
    return np.asarray(crossing_fails(border, calibration) < FAIL_SHARE)


@remembered
def _effect(calibration: Calibration) -> StepEffect:
    """Return the effect of steps at the speed of the map."""
    effect = StepEffect.of(calibration)
    log_c_r = np.log(np.maximum(effect.c_r, _TINY))
    return replace(effect, c_r=effect.c_r * np.exp(plain_speed_factor(calibration, log_c_r)))


def _recorded(record: Mapping[str, Any]) -> StepEffect:
    tile, crossing = record["tile"], record["crossing"]
    height, c_r, sd, fails = (np.array(tile[name], np.float64) for name in ("height", "c_r", "c_r_log_sd", "p_fail"))
    walls = np.array(crossing["height"], np.float64)
    ways = [np.array(crossing[name], np.float64).reshape(len(walls), -1) for name in ("fail_up", "fail_down")]
    for rising in (height, walls):
        if len(rising) < 1 or rising[0] <= 0 or (np.diff(rising) <= 0).any():
            raise ValueError("heights must be positive and increasing")
    if not all(np.isfinite(values).all() for values in (c_r, sd, fails, *ways)):
        raise ValueError("a number is missing")
    up, down = (np.interp(height, walls, np.maximum.accumulate(way.mean(axis=1))) for way in ways)
    curves = [np.maximum.accumulate(curve) for curve in (c_r, fails)]
    c_r, fails, up, down = (np.concatenate(([0.0], curve)) for curve in (*curves, up, down))
    sd = np.maximum(np.concatenate((sd[:1], sd)), _LEAST_LOG_SD)
    return StepEffect(np.concatenate(([0.0], height)), c_r, sd, fails, up, down)


def _geometric(calibration: Calibration) -> StepEffect:
    radius = float(calibration.vehicle["wheel"]["radius_m"])
    base = float(calibration.vehicle["wheelbase_m"])
    height = np.concatenate(([0.0], radius * np.linspace(0.1, 1.0, 10)))
    fails = np.clip((height / radius - _SAFE_SHARE) / (1 - _SAFE_SHARE), 0.0, 1.0)
    c_r = 4 / np.pi * np.arctan(height / base) / calibration.tile_size
    return StepEffect(height, c_r, np.full(len(height), _GEOMETRIC_LOG_SD), fails, fails, fails)


def _sureness(class_id: NDArray[np.integer], c_r: Floats, sd: Floats, limits: tuple[float, ...]) -> Floats:
    """Return the probability that a log-normal C_r lies between the limits of a class."""
    edges = np.concatenate(([-np.inf], np.log(limits), [np.inf]))
    rank = np.minimum(class_id, len(limits)).astype(np.int64)
    middle = np.log(np.maximum(np.nan_to_num(c_r), 1e-9))
    shares = []
    for edge in (edges[rank], edges[rank + 1]):
        share = np.empty(middle.size)
        normal_shares(((edge - middle) / sd).ravel(), share)
        shares.append(share.reshape(middle.shape))
    return np.asarray(shares[1] - shares[0])
