"""Rate tiles by rolling the vehicle over them (``--rating ride``)."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import FAIL_SHARE, NO_CLASS, CostMap, Georeference, PatchStack, Reason, TextureMap, UsageError
from bumpymap.rating.calibration import Calibration
from bumpymap.rating.ride._ride_kernels import normal_shares
from bumpymap.rating.ride.correction import NORMAL_TAIL, Correction, Prediction
from bumpymap.rating.ride.geometry import roll_over
from bumpymap.rating.ride.noise import denoise
from bumpymap.rating.ride.operator import RideOperator
from bumpymap.rating.ride.speed import SpeedRating, plain_speed_factor, require_speeds, speed_log_sd
from bumpymap.rating.vehicle_body import with_floor

__all__ = ["RideModel", "interval", "judge"]

Floats = NDArray[np.float64]


class RideModel:
    """Predicts the ride of one vehicle on tiles of one size.

    Parameters
    ----------
    calibration : Calibration
        Of the vehicle; it holds the profile and what its drives taught.
    speeds : tuple of float
        Speeds [m/s] to rate the ride at besides; see `CostMap.motion`.

    Raises
    ------
    UsageError
        The calibration was made without a ride model, or cannot tell the ride at these speeds.
    BadInputError
        Its ride model is damaged.
    """

    def __init__(self, calibration: Calibration, speeds: tuple[float, ...] = ()) -> None:
        if calibration.ride is None:
            raise UsageError(
                f"the calibration {calibration.id} holds no ride model. Make one with: bumpymap calibrate, or rate by "
                "texture and relief: `rating='table'`"
            )
        self.calibration = calibration
        self.operator = RideOperator.of(calibration.vehicle, calibration.tile_size, calibration.pixels)
        self.correction = Correction.from_record(calibration.ride)
        self.speeds: SpeedRating | None = None
        if speeds or calibration.map_speed != float(calibration.vehicle["speed_mps"]):
            require_speeds(calibration, speeds, "speeds")
            self.speeds = SpeedRating.of(calibration, speeds)

    def ground(self, patches: PatchStack) -> tuple[NDArray[np.float32], Floats]:
        """Return the relief that the vehicle rolls over, (n, pixels, pixels), m, and `CleanPatches.noise_felt`."""
        clean = denoise(patches, self.operator)
        return clean.relief_map, clean.noise_felt

    def predict(self, patches: PatchStack) -> Prediction:
        """Predict C_r and p_fail of n tiles; NaN where a tile cannot be judged."""
        return self._predict(patches)[0]

    def _predict(self, patches: PatchStack) -> tuple[Prediction, NDArray[np.float32] | None]:
        """Return also the factors of `CostMap.motion`; None without other speeds."""
        relief, noise_felt = self.ground(patches)
        rides = roll_over(relief, self.operator)
        pixel_points = patches.count / patches.grid.pixels**2
        found = self.correction.predict(rides, patches.slope.astype(np.float64), noise_felt, pixel_points)
        if self.speeds is None:
            return found, None
        log_ratio, factors = self.speeds.factors(relief, rides.pitch_change)
        level = plain_speed_factor(self.calibration, found.log_c_r)
        log_ratio = np.where(np.isnan(log_ratio), level, log_ratio)
        more = speed_log_sd(self.calibration)
        below, above = np.hypot(found.below, more), np.hypot(found.above, more)
        return replace(found, log_c_r=found.log_c_r + log_ratio, below=below, above=above), factors

    def rate(self, patches: PatchStack, textures: TextureMap, georeference: Georeference) -> CostMap:
        """Rate tiles.

        Parameters
        ----------
        patches : PatchStack
            n tiles.
        textures : TextureMap
            Travels with the result; the ride model does not look at it.
        georeference : Georeference
            Travels with the result.

        Raises
        ------
        UsageError
            The calibration was made for tiles of another size or another number of pixels.
        """
        calibration = self.calibration
        calibration.require_grid(patches.grid.tile_size, patches.grid.pixels)
        found, factors = self._predict(patches)
        known = (patches.reason == Reason.OK) & np.isfinite(found.log_c_r)
        class_id, chance, p_fail = judge(found, patches.slope, calibration)
        c_r, low, high = interval(found, calibration.map_floor)
        return CostMap(
            georeference=georeference,
            patches=patches,
            textures=textures,
            class_id=np.where(known, class_id, NO_CLASS).astype(np.uint8),
            c_r=_where(known, c_r),
            c_r_low=_where(known, low),
            c_r_high=_where(known, high),
            p_fail=_where(known, p_fail),
            # Filled pixels are a guess; a tile full of them is believed less.
            confidence=_where(known, chance * np.sqrt(patches.coverage)),
            rule=calibration.cost_rule,
            motion=factors if factors is not None and factors.shape[1] else None,
        )


def interval(found: Prediction, floor: float) -> tuple[Floats, Floats, Floats]:
    """Return C_r and both ends of its 80 % interval of n predictions, rad/m, with the vehicle's floor."""
    ends = (found.log_c_r, found.log_c_r - NORMAL_TAIL * found.below, found.log_c_r + NORMAL_TAIL * found.above)
    c_r, low, high = (with_floor(np.exp(value), floor) for value in ends)
    return c_r, low, high


def judge(
    found: Prediction, slope: NDArray[np.floating], calibration: Calibration
) -> tuple[NDArray[np.int64], Floats, Floats]:
    """Return class, its probability, and p_fail of n predictions.

    Ground steeper than the vehicle's limit (``slope``, (n,) degrees) fails for certain; where at least ``FAIL_SHARE``
    of the drives fail, the class is the roughest. The floor plays no part: predictions and limits are those of drives.
    """
    p_fail = np.where(slope > float(calibration.vehicle["slope_limit_deg"]), 1.0, found.p_fail)
    class_id, chance = _class_chance(found, calibration.class_limits)
    lost = p_fail >= FAIL_SHARE
    last = len(calibration.class_limits)
    return np.where(lost, last, class_id), np.where(lost, np.maximum(p_fail, chance), chance), p_fail


def _class_chance(found: Prediction, limits: tuple[float, ...]) -> tuple[NDArray[np.int64], Floats]:
    """Class of the median of each tile, and its probability under the two-sided distribution."""
    log_limits = np.log(np.array(limits))
    class_id = np.searchsorted(log_limits, found.log_c_r, side="right")
    edges = np.concatenate(([-np.inf], log_limits, [np.inf]))
    shares = np.empty((2, len(class_id)))
    for edge, share in zip((edges[class_id], edges[class_id + 1]), shares, strict=True):
        normal_shares((edge - found.log_c_r) / np.where(edge < found.log_c_r, found.below, found.above), share)
    return class_id, shares[1] - shares[0]


def _where(known: NDArray[np.bool_], values: Floats) -> NDArray[np.float32]:
    return np.where(known, values, np.nan).astype(np.float32)
