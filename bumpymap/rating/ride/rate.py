"""Rate tiles by rolling the vehicle over them (``rating="ride"``), after the scan noise of their heightmaps is removed.

A pixel's height is the mean of its points. Their spread inside the pixel, less what the slope of the ground explains,
tells the noise of a point; a mean of n points errs by its n-th part (as variance), whether the spread is the scanner's
or that of gravel finer than a pixel. So the noise of the heightmap is known, and it is white: alike in all its cosines
(an orthonormal transform whose half-sample mirroring is that of the ride model). Ground is not white: its power falls
with the wave number k as k^-beta, beta from 2 to 4.5 over the Hurst exponents of natural surfaces. Strength and
exponent are fitted to each patch (Whittle's likelihood), and each cosine is shrunk to the power that is the ground's;
one that stands far out of the noise keeps what is above it, so that a kerb or a washboard stays.

What the points cannot tell: errors that neighbours share (photogrammetry, flight lines) look like ground, and stay.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    AXES_DEG,
    FAIL_SHARE,
    NO_CLASS,
    NORMAL_80,
    CostMap,
    Floats,
    PatchStack,
    Reason,
    loops,
)
from bumpymap.rating.calibration import Calibration
from bumpymap.rating.ride.correction import Correction, Prediction, class_chance
from bumpymap.rating.ride.motion_operator import MotionOperator, move_over, roll_over
from bumpymap.rating.ride.operator import RideOperator, cosines
from bumpymap.rating.ride.speed import LEVEL, motion_factors, plain_speed_factor, speed_log_sd
from bumpymap.rating.vehicle_profile import with_floor

_STEEPNESS = (2.0, 2.6, 3.2, 3.8, 4.5)
"""Exponents of the ground's spectrum that are tried: Hurst exponents from 0 to beyond 1."""
_SHARPENED = 1.2
"""Power of C_r along an axis over the mean. An axis takes samples of 22.5 degrees, and ground that is mirrored at the
edges of the tile has its mirrored headings there: both even out what a line feels. From 1.15 to 1.3 the errors against
drives and rides of lines are least, on made-up and on natural ground."""
DRIVE_LOG_SD = 0.22
"""Standard deviation of ln C_r of one calibration drive (10 s, at any place and heading) about the mean of many over
the tile: the median over the terrains of the Warthog's calibration."""


class Spectrum(NamedTuple):
    """Cosines of a patch, and the ground spectra that are tried."""

    basis: Floats
    """(pixels, pixels) orthonormal cosines."""
    turned: Floats
    """The same, rows and columns exchanged."""
    band: NDArray[np.int32]
    """(pixels, pixels) band of each coefficient; -1 for the mean."""
    shapes: Floats
    """(spectra, bands) power of each band for unit strength."""


def denoise(patches: PatchStack) -> tuple[NDArray[np.float32], Floats]:
    """Estimate the noise of every patch that can be judged, and take it off its relief, see `take_noise_off`."""
    known = patches.reason == Reason.OK
    return take_noise_off(patches.relief_map, known, patches.spread_count, patches.spread_variance)


def take_noise_off(
    relief_map: NDArray[np.float32], known: NDArray[np.bool_], count: NDArray[np.int32], variance: NDArray[np.float32]
) -> tuple[NDArray[np.float32], Floats]:
    """Return denoised relief maps (n, pixels, pixels), m, and the noise of a point and of a pixel, (2, n) m.

    ``known`` (n,): patches to denoise; ``count``, ``variance`` (n, pixels, pixels): points of each pixel and the
    variance of their heights above the tile's plane, m^2. Noise is NaN where pixels hold too few points to tell.
    """
    clean, noise = relief_map.copy(), np.full((2, len(relief_map)), np.nan)
    held, spread = np.ascontiguousarray(count), np.ascontiguousarray(variance)
    spectrum = _spectrum_of(relief_map.shape[1])
    loops.denoise_patches(known, np.ascontiguousarray(relief_map), held, spread, spectrum, clean, noise)
    return clean, noise


@cache
def _spectrum_of(pixels: int) -> Spectrum:
    """Cosines, the band of each coefficient (by its wave number, -1 for the mean), spectra that are tried by band."""
    order = np.arange(pixels)
    wave = np.hypot(order[:, None], order[None, :])
    band = np.rint(wave).astype(np.int32) - 1
    members = [wave[band == b] for b in range(int(band.max()) + 1)]
    shapes = np.array([[float(np.mean(wave_numbers**-beta)) for wave_numbers in members] for beta in _STEEPNESS])
    basis = np.ascontiguousarray(cosines(pixels))
    return Spectrum(basis, np.ascontiguousarray(basis.T), band, shapes)


class RideModel:
    """Predicts the ride of one vehicle on tiles of one size, by its calibration.

    With ``headings``, the ride by heading is rated too, see `CostMap.headings`. Raises BadInputError if the ride model
    of the calibration is damaged.
    """

    def __init__(self, calibration: Calibration, *, headings: bool = False) -> None:
        self.calibration = calibration
        self.operator = RideOperator.of(calibration.profile, calibration.tile_size, calibration.pixels)
        self.correction = Correction.from_record(calibration.ride)
        self.headings = headings
        self.moving: MotionOperator | None = None
        """Of a map at another speed than the profile's."""
        if calibration.map_speed != float(calibration.vehicle["speed_mps"]):
            size = calibration.tile_size, calibration.pixels
            self.moving = MotionOperator.of(calibration.profile, *size, (calibration.map_speed,))

    def _predict(self, patches: PatchStack, by_axis: Floats | None) -> Prediction:
        """Predict C_r and p_fail of n tiles, NaN where a tile cannot be judged.

        ``by_axis`` (n, 8) is filled with the factors of `CostMap.headings`.
        """
        relief_map, (_, noise) = denoise(patches)
        rides = roll_over(relief_map, self.operator, by_axis)
        if by_axis is not None:
            own = np.where(rides.pitch_change > LEVEL, rides.pitch_change, np.nan)
            by_axis[:] = (by_axis / own[:, None]) ** _SHARPENED
            by_axis /= np.average(by_axis, axis=1, weights=np.diff(self.operator.samples.bounds[1:]))[:, None]
        pixel_points = patches.count / patches.grid.pixels**2
        noise_felt = noise * self.operator.noise_gain
        found = self.correction.predict(rides, patches.slope.astype(np.float64), noise_felt, pixel_points)
        if self.moving is None:
            return found
        motions = move_over(relief_map, self.moving)
        log_ratio, _ = motion_factors(self.calibration, self.moving.speeds, motions, rides.pitch_change)
        level = plain_speed_factor(self.calibration, found.log_c_r)
        log_ratio = np.where(np.isnan(log_ratio), level, log_ratio)
        return found.at_speed(log_ratio, speed_log_sd(self.calibration))

    def rate(self, patches: PatchStack, probability: NDArray[np.float32] | None = None) -> CostMap:
        """Rate n tiles; the probability of textures travels with the result, and the ride model does not look at it.

        Raises UsageError if the calibration was made for tiles of another size or another number of pixels.
        """
        calibration = self.calibration
        calibration.require_grid(patches.grid.tile_size, patches.grid.pixels)
        by_axis = np.full((len(patches.reason), len(AXES_DEG)), np.nan) if self.headings else None
        found = self._predict(patches, by_axis)
        known = (patches.reason == Reason.OK) & np.isfinite(found.log_c_r)
        class_id, chance = judge(found, patches.slope, calibration)
        c_r, low, high = interval(found, calibration.map_floor)
        return CostMap(
            patches=patches,
            class_id=np.where(known, class_id, NO_CLASS).astype(np.uint8),
            c_r=_where(known, c_r),
            c_r_low=_where(known, low),
            c_r_high=_where(known, high),
            p_fail=_where(known, found.p_fail),
            # Filled pixels are a guess; a tile full of them is believed less.
            confidence=_where(known, chance * np.sqrt(patches.coverage)),
            probability=probability,
            headings=None if by_axis is None else _where(known[:, None], by_axis),
        )


def interval(found: Prediction, floor: float) -> tuple[Floats, Floats, Floats]:
    """Return C_r and both ends of the interval in which 80 % of drives lie, of n predictions, rad/m, with the floor."""
    below, above = (NORMAL_80 * np.hypot(side, DRIVE_LOG_SD) for side in (found.below, found.above))
    ends = (found.log_c_r, found.log_c_r - below, found.log_c_r + above)
    c_r, low, high = (with_floor(np.exp(value), floor) for value in ends)
    return c_r, low, high


def judge(found: Prediction, slope: NDArray[np.floating], calibration: Calibration) -> tuple[NDArray[np.int64], Floats]:
    """Return class and its probability of n predictions.

    Where the ground is steeper than the vehicle's limit (``slope``, (n,) degrees), or at least ``FAIL_SHARE`` of the
    drives fail, the class is the roughest. The floor plays no part: predictions and limits are those of drives.
    """
    class_id = np.searchsorted(np.log(calibration.class_limits), found.log_c_r, side="right")
    chance = class_chance(class_id, found.log_c_r, (found.below, found.above), calibration.class_limits)
    failing = np.where(slope > float(calibration.vehicle["slope_limit_deg"]), 1.0, found.p_fail)
    lost = failing >= FAIL_SHARE
    last = len(calibration.class_limits)
    return np.where(lost, last, class_id), np.where(lost, np.maximum(failing, chance), chance)


def _where(known: NDArray[np.bool_], values: Floats) -> NDArray[np.float32]:
    return np.where(known, values, np.nan).astype(np.float32)
