"""Speeds that a map is asked for: the calibration at another speed, and factors on its C_r at several.

A calibration remembers the speed of a map in its ``motion``, so that everything that is made from it (tiles, thin
tiles, steps) and its ``id`` follow that speed. What the drives of the calibration measured stays theirs: p_fail.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import SPEED_BANDS, UsageError
from bumpymap.rating.calibration import MAP_SPEED, Calibration, remembered
from bumpymap.rating.ride.geometry import move_over
from bumpymap.rating.ride.motion import MotionModel
from bumpymap.rating.ride.motion_operator import MotionOperator
from bumpymap.rating.vehicle_body import less_floor, with_floor

__all__ = [
    "SpeedRating",
    "at_speed",
    "motion_felt",
    "plain_factors",
    "plain_speed_factor",
    "require_speeds",
    "speed_log_sd",
]

Floats = NDArray[np.float64]
_LEVEL = 5e-4
"""Geometric C_r of ground that is as good as level, rad/m."""


def at_speed(calibration: Calibration, speed: float | None) -> Calibration:
    """Return a calibration whose C_r is that at a speed [m/s]; itself at None and at the profile's own speed.

    Raises
    ------
    UsageError
        It was made without other speeds, or the speed is out of their range.
    """
    if speed is None:
        return calibration
    require_speeds(calibration, (speed,), "speed")
    if speed == float(calibration.vehicle["speed_mps"]):
        return calibration
    return replace(calibration, motion={**(calibration.motion or {}), MAP_SPEED: float(speed)})


def require_speeds(calibration: Calibration, speeds: Sequence[float], setting: str) -> None:
    """Raise UsageError if a calibration cannot tell the ride at speeds [m/s]; ``setting`` is named in the message."""
    own, name = float(calibration.vehicle["speed_mps"]), calibration.vehicle["name"]
    if calibration.motion is None:
        raise UsageError(
            f"`{setting}`: the calibration {calibration.id} of {name} was made without other speeds than {own:g} m/s. "
            "Make one that has them with: bumpymap calibrate"
        )
    low, high = (share * own for share in _model(calibration).range)
    for speed in speeds:
        if not low <= speed <= high:
            raise UsageError(
                f"`{setting}` is {speed:g} m/s; the calibration of {name} ({own:g} m/s) holds from {low:.3g} to "
                f"{high:.3g} m/s. Give a speed in this range, or calibrate a profile with another speed_mps: "
                "bumpymap calibrate"
            )


def plain_speed_factor(calibration: Calibration, log_c_r: Floats) -> Floats:
    """Return ln of C_r at the speed of the map over that at the profile's speed, from ln of the latter, any shape."""
    if calibration.map_speed == float(calibration.vehicle["speed_mps"]):
        return np.zeros_like(log_c_r)
    return _model(calibration).plain_log_factors(np.exp(log_c_r), (calibration.map_speed,))[..., 0, 0]


def speed_log_sd(calibration: Calibration) -> float:
    """Return the standard deviation of ln C_r that the speed of the map adds."""
    speed = calibration.map_speed
    return 0.0 if speed == float(calibration.vehicle["speed_mps"]) else _model(calibration).log_sd(speed)


@dataclass(frozen=True, slots=True)
class SpeedRating:
    """Rates tiles at several speeds, as factors on the C_r of the map."""

    calibration: Calibration
    speeds: tuple[float, ...]
    """m/s."""
    operator: MotionOperator
    """For these speeds and, if it is none of them, the speed of the map."""

    @classmethod
    def of(cls, calibration: Calibration, speeds: tuple[float, ...]) -> "SpeedRating":
        """Make the rating of a calibration with ``motion``."""
        every = tuple(dict.fromkeys((*speeds, calibration.map_speed)))
        operator = MotionOperator.of(calibration.vehicle, calibration.tile_size, calibration.pixels, every)
        return cls(calibration, speeds, operator)

    def factors(self, relief_map: NDArray[np.float32], pitch_change: Floats) -> tuple[Floats, NDArray[np.float32]]:
        """Return ln of C_r at the map's speed over that at the profile's, (n,), and factors on the former, (n, 3 k).

        Parameters
        ----------
        relief_map : array (n, pixels, pixels) float32
            Plane-removed relief without holes, m; patches with NaN are left out.
        pitch_change : array (n,)
            Geometric C_r at the profile's speed, rad/m.

        Returns
        -------
        array (n,)
        array (n, 3 k) float32
            For each of k speeds: c_r over that of the map; c_roll, and a_w [m/s2 per rad/m], over it.

        Both are NaN where the heightmap, without its noise, is as good as level: its form tells nothing then.
        """
        motions = move_over(relief_map, self.operator)
        logs = _model(self.calibration).log_factors(motions, pitch_change, self.operator.speeds)
        logs[~(pitch_change > _LEVEL)] = np.nan
        own = logs[:, self.operator.speeds.index(self.calibration.map_speed), 0]
        told = np.exp(logs[:, : len(self.speeds)] - own[:, None, None])
        return own, told.reshape(len(logs), -1).astype(np.float32)


def motion_felt(
    calibration: Calibration, speeds: Sequence[float], factors: NDArray[np.float32], c_r: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return what is felt at k speeds, (..., 3 k): c_r, c_roll [rad/m] and a_w [m/s2] for each; NaN in unknown tiles.

    The factors are those of the driven C_r: the vehicle's floor is taken off before, and comes back to ``c_r`` alone.

    Parameters
    ----------
    calibration : Calibration
        At the speed of the map.
    speeds : sequence of float
        m/s.
    factors : array (..., 3 k) float32
        Of `SpeedRating.factors`; NaN where the heightmap does not tell.
    c_r : array (...) float32
        Of the map, with the vehicle's floor, rad/m.
    """
    driven = less_floor(c_r, calibration.map_floor)
    known = np.isfinite(factors)
    if not known.all():
        factors = np.where(known, factors, plain_factors(calibration, speeds, driven))
    felt = factors * driven.astype(np.float32)[..., None]
    for number, speed in enumerate(speeds):
        own = number * len(SPEED_BANDS)
        felt[..., own] = with_floor(felt[..., own], calibration.floor_at(speed))
    return felt


def plain_factors(calibration: Calibration, speeds: Sequence[float], c_r: Floats) -> NDArray[np.float32]:
    """Return the factors of tiles without a heightmap, (..., 3 k), from the driven C_r [rad/m] at k speeds."""
    model, speed = _model(calibration), calibration.map_speed
    # The C_r at the profile's speed is not kept: what the map's speed made of it is taken off in one step.
    at_own = c_r * np.exp(-model.plain_log_factors(c_r, (speed,))[..., 0, 0])
    logs = model.plain_log_factors(at_own, (*speeds, speed))
    found = np.exp(logs[..., :-1, :] - logs[..., -1:, :1])
    return found.reshape(*c_r.shape, -1).astype(np.float32)


@remembered
def _model(calibration: Calibration) -> MotionModel:
    if calibration.motion is None:
        raise UsageError(f"the calibration {calibration.id} was made without other speeds")
    return MotionModel.from_record(calibration.motion, float(calibration.vehicle["speed_mps"]))
