"""Rate tiles by rolling the vehicle over them (``rating="ride"``), after the scan noise of their heightmaps is removed.

A pixel's height is the mean of its points. Their spread inside the pixel, less what the slope of the ground explains,
tells the noise of a point; a mean of n points errs by its n-th part (as variance), whether the spread is the scanner's
or that of gravel finer than a pixel. So the noise of the heightmap is known, and it is white: alike in all its cosines
(an orthonormal transform whose half-sample mirroring is that of the ride model). Ground is not white: its power falls
with the wave number k as k^-beta, beta from 2 to 4.5 over the Hurst exponents of natural surfaces. Strength and
exponent are fitted to each patch (Whittle's likelihood), and each cosine is shrunk to the power that is the ground's;
one that stands far out of the noise keeps what is above it, so that a kerb or a washboard stays.

What the points cannot tell: errors that neighbours share (photogrammetry, flight lines) look like ground, and stay.

*The ride of a line* is what is felt along it, from the pitch of the rockers at even distances. The correction that the
drives of a calibration taught turns geometric values of a tile into its C_r. It holds for a line as well: the values
are those of a stretch as long as a tile, about each place of the line, and what is felt at the place is its share of
the stretch. A heightmap holds the scan's noise, and a map does not keep how much. But the C_r of a tile was predicted
without it: the relief is denoised (as for that prediction) just so far that the same prediction comes out of it.
"""

from functools import cache
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    FAIL_SHARE,
    NO_CLASS,
    NORMAL_80,
    CostMap,
    Floats,
    PatchStack,
    Reason,
    loops,
    tiles_of,
)
from bumpymap.rating.calibration import Calibration
from bumpymap.rating.ride.correction import Correction, Prediction, class_chance
from bumpymap.rating.ride.operator import MotionOperator, RideOperator, Rides, cosines, move_over, roll_over
from bumpymap.rating.ride.speed import motion_factors, plain_speed_factor, speed_log_sd
from bumpymap.rating.vehicle_profile import with_floor

_STEEPNESS = (2.0, 2.6, 3.2, 3.8, 4.5)
"""Exponents of the ground's spectrum that are tried: Hurst exponents from 0 to beyond 1."""
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

    Raises BadInputError if the ride model of the calibration is damaged.
    """

    def __init__(self, calibration: Calibration) -> None:
        self.calibration = calibration
        self.operator = RideOperator.of(calibration.profile, calibration.tile_size, calibration.pixels)
        self.correction = Correction.from_record(calibration.ride)
        self.moving: MotionOperator | None = None
        """Of a map at another speed than the profile's."""
        if calibration.map_speed != float(calibration.vehicle["speed_mps"]):
            size = calibration.tile_size, calibration.pixels
            self.moving = MotionOperator.of(calibration.profile, *size, (calibration.map_speed,))

    def _predict(self, patches: PatchStack) -> Prediction:
        """Predict C_r and p_fail of n tiles, NaN where a tile cannot be judged."""
        relief_map, (_, noise) = denoise(patches)
        rides = roll_over(relief_map, self.operator)
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
        found = self._predict(patches)
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
        )


def interval(found: Prediction, floor: float) -> tuple[Floats, Floats, Floats]:
    """Return C_r and both ends of the interval in which 80 % of drives lie, of n predictions, rad/m, with the floor."""
    below, above = (NORMAL_80 * np.hypot(side, DRIVE_LOG_SD) for side in (found.below, found.above))
    ends = (found.log_c_r, found.log_c_r - below, found.log_c_r + above)
    c_r, low, high = (with_floor(np.exp(value), floor) for value in ends)
    return c_r, low, high


def judge(found: Prediction, slope: NDArray[np.floating], calibration: Calibration) -> tuple[NDArray[np.int64], Floats]:
    """Return class and its probability of predictions of any shape.

    Where the ground is steeper than the vehicle's limit (``slope``, of that shape, degrees), or at least ``FAIL_SHARE``
    of the drives fail, the class is the roughest. The floor plays no part: predictions and limits are those of drives.
    """
    class_id = np.searchsorted(np.log(calibration.class_limits), found.log_c_r, side="right")
    chance = class_chance(class_id, found.log_c_r, (found.below, found.above), calibration.class_limits)
    failing = np.where(slope > float(calibration.vehicle["slope_limit_deg"]), 1.0, found.p_fail)
    lost = failing >= FAIL_SHARE
    last = len(calibration.class_limits)
    return np.where(lost, last, class_id), np.where(lost, np.maximum(failing, chance), chance)


def _where(known: NDArray[np.bool_], values: Floats) -> NDArray[np.float32]:
    return np.where(known, values, np.nan).astype(np.float32)


_ROUNDS = 7
"""Halvings of the logarithm of the noise that is tried: 1/128 of its range is left. Chosen."""
_NOISE_M = (1e-4, 0.07)
"""Least and most noise of a pixel that is tried, m."""
_LEAST = 1e-5
"""C_r below is a rounding error, rad/m."""


def remove_plane(patches: NDArray[np.floating]) -> Floats:
    """Subtract the least-squares plane from each patch (n, pixels, pixels) without NaN.

    On a full square of pixels the regressors 1, x, y (centred) are orthogonal, so each coefficient is one dot product.
    """
    pixels = patches.shape[-1]
    axis = np.arange(pixels) - (pixels - 1) / 2
    heights = patches - patches.mean(axis=(1, 2), keepdims=True, dtype=np.float64)
    weight = 1.0 / (pixels * np.sum(axis**2))
    slope_row = np.einsum("nij,i->n", heights, axis) * weight
    slope_col = np.einsum("nij,j->n", heights, axis) * weight
    plane = slope_row[:, None, None] * axis[:, None] + slope_col[:, None, None] * axis[None, :]
    return np.asarray(heights - plane)


def match_noise(
    relief_map: NDArray[np.float32], c_r: Floats, slope_deg: Floats, correction: Correction, operator: RideOperator
) -> Floats:
    """Return how much noise of a pixel, (n,) m, brings the predicted C_r of n tiles down to the one that is stated.

    It is 0 where the prediction is no higher, where a tile has holes, and where one of both is unknown.
    ``relief_map`` (n, pixels, pixels): plane-removed, m; ``c_r`` (n,): at the profile's speed, without the vehicle's
    floor, rad/m; ``slope_deg`` (n,): of their planes.
    """
    wanted = np.log(np.maximum(c_r, _LEAST))
    rough = np.flatnonzero(correction.without_noise(roll_over(relief_map, operator), slope_deg) > wanted)
    relief, wanted, slope_deg = relief_map[rough], wanted[rough], slope_deg[rough]
    low, high = (np.full(len(rough), np.log(end)) for end in _NOISE_M)
    for _ in range(_ROUNDS):
        middle = 0.5 * (low + high)
        ridden = roll_over(_without(relief, np.exp(middle)), operator)
        too_rough = correction.without_noise(ridden, slope_deg) > wanted
        low, high = np.where(too_rough, middle, low), np.where(too_rough, high, middle)
    noise = np.zeros(len(relief_map))
    noise[rough] = np.exp(low)
    return noise


def smooth_over(heights: Floats, noise: Floats, pixels: int) -> Floats:
    """Return what is to be added to heights, (rows * pixels, cols * pixels) m, to take the noise of their tiles off.

    ``noise`` (rows, cols): of a pixel, m, of `match_noise`; NaN where it is not known. Patches of the size of a tile
    are denoised at the places of the tiles and half a tile beside them, and blended, so that nothing jumps at borders.
    """
    added, weight, half = np.zeros(heights.shape), np.zeros(heights.shape), pixels // 2
    fade = np.sin(np.pi * (np.arange(pixels) + 0.5) / pixels) ** 2
    fade = fade[:, None] * fade
    variance = np.repeat(np.repeat(noise**2, pixels, axis=0), pixels, axis=1)
    for first in product((0, half), repeat=2):
        here = tuple(slice(own, (own - pixels) if own else None) for own in first)
        patches, own, taken, shares = (tiles_of(values[here], pixels) for values in (heights, variance, added, weight))
        known, found = np.isfinite(patches).all(axis=(2, 3)), np.isfinite(own)
        mean = np.where(found, own, 0.0).sum(axis=(2, 3)) / np.maximum(found.sum(axis=(2, 3)), 1)
        shares[known] += fade
        at = np.nonzero(known & (mean > 0.0))
        relief = remove_plane(patches[at]).astype(np.float32)
        taken[at] += fade * (_without(relief, np.sqrt(mean[at])) - relief)
    return added / np.maximum(weight, 1e-9)


def _without(relief_map: NDArray[np.float32], noise: Floats) -> NDArray[np.float32]:
    """Denoise n patches whose pixels have a noise [m], (n,): as if each held two points that lie so far apart."""
    known = np.asarray(np.isfinite(relief_map).all(axis=(1, 2)))
    # The noise of a point is the median of the variances over that of chi-square numbers with one degree of freedom.
    variance = np.broadcast_to((noise**2 * (7 / 9) ** 3)[:, None, None], relief_map.shape).astype(np.float32)
    return take_noise_off(relief_map, known, np.full(relief_map.shape, 2, np.int32), variance)[0]


def roll_wheels(
    heights: Floats, place: Floats, turn: NDArray[np.int64], before: NDArray[np.int64], operator: RideOperator
) -> tuple[Floats, Floats]:
    """Return the lowest point of k wheels along a line, (k, n) m, and how far it jumps where they take another turn.

    On a slope, wheels of two of the few directions that they have stand at two heights. NaN: a wheel meets ground that
    is not known. ``heights`` (rows, cols): of pixels, m; NaN where unknown. ``place`` (k, n, 2): row and column from
    the north-west corner, pixels: a wheel and two pixels or more from all edges. ``turn`` (k, n): of `wheel_turn`, rows
    southwards; ``before`` (k, n): those of the samples before.
    """
    nodes = tuple(size * operator.fine + 1 for size in heights.shape)
    envelope = np.empty((len(operator.wheel.starts) - 1, *nodes))
    known = np.zeros(envelope.shape, np.bool_)

    def roll(some: Floats, to: NDArray[np.int64]) -> Floats:
        low = np.empty(len(some))
        loops.roll_along(heights, np.ascontiguousarray(some), to, operator.fine, operator.wheel, envelope, known, low)
        return low

    low, jump, turned = (
        roll(place.reshape(-1, 2), turn.ravel()).reshape(turn.shape),
        np.zeros(turn.shape),
        turn != before,
    )
    jump[turned] = np.nan_to_num(low[turned] - roll(place[turned], before[turned]))
    return low, jump


def felt_along(
    pitch: Floats, taps: Floats, way: float, stretch: float, reach: Floats, slope_deg: Floats, correction: Correction
) -> Floats:
    """Return what is felt at each sample of k lines, (k, n) rad/m; its mean over a stretch is the C_r there.

    ``pitch`` (k, n): of the rockers, rad; ``taps``: how the chassis follows them, of `chassis_response`; ``way``:
    between samples, m; ``stretch``: length that geometric values are taken over: the side of the tiles that the
    correction was fitted to, m; ``reach``, ``slope_deg`` (n,): of the tile that each sample lies in.
    """
    from scipy.ndimage import uniform_filter1d

    def mean(values: Floats) -> Floats:
        return np.asarray(uniform_filter1d(values, max(round(stretch / way), 1), mode="nearest"))

    count = pitch.shape[1]
    changes = np.diff(pitch, prepend=pitch[:, :1])
    change = np.abs([np.convolve(each, taps)[:count] for each in changes]) / way
    size = np.maximum(mean(change), _LEAST)
    rms = np.maximum(np.sqrt(np.maximum(mean(change**2), 0.0)), size)
    about = np.sqrt(np.maximum(mean(pitch**2) - mean(pitch) ** 2, 0.0))
    reaches, slopes = (np.tile(values, len(pitch)) for values in (reach, slope_deg))
    none = np.zeros(pitch.size)
    rides = Rides(size.ravel(), rms.ravel(), about.ravel(), none, reaches, none, none)
    return np.exp(correction.without_noise(rides, slopes)).reshape(pitch.shape) * change / size
