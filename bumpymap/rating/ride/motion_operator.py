"""Pitch, roll and lift of a chassis at several speeds, by geometry alone: more rows over the same rolled wheels.

Strategy. As in ``bumpymap.rating.ride.operator``, a sample is a row of a sparse matrix over the nodes of the envelope:

- pitch at a speed: the same rows as for C_r, with the response of the suspension at that speed;
- roll: half-tracks have no suspension between wheels and chassis, so its roll follows the mean heights of the wheels
  on both sides at any speed;
- heave at a speed: the mean height of the wheels, filtered along the way. What is felt depends on the frequency, and
  frequency is speed times waves per metre, so weighting and second derivative in time are one filter over distance. Its
  phase does not matter to a root mean square: the filter is symmetric, and short.

The filter reaches as far as the vehicle drives in 2 s, to either side. Its samples are at most half a node apart and
close enough for 10 Hz; where the vehicle passes more than 25 half nodes a second, higher frequencies than those of a
half node are lost.

Vertical motion is weighted by Wk of ISO 2631-1: how much acceleration of a frequency is felt by a seated person. It is
cut at 10 Hz: what shakes a vehicle faster comes from tyres, drive train and ground finer than a heightmap, and in the
simulation from the facets of its ground.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import AXES_DEG, Floats, loops
from bumpymap.rating.ride.operator import (
    NodeLattice,
    PitchSamples,
    RideOperator,
    WheelShape,
    chassis_response,
    joined,
    pitch_change,
    spread_places,
    wheel_rows,
)
from bumpymap.rating.vehicle_profile import Vehicle

_APART = 2
"""Pixels between heights that are compared: 0.4 m in a tile of 3 m."""


@dataclass(frozen=True, slots=True)
class Rides:
    """Motion of a vehicle on each of n patches; NaN where a patch has NaN."""

    pitch_change: NDArray[np.float64]
    """(n,) mean absolute change of the chassis' pitch per metre, rad/m: the geometric C_r."""
    pitch_change_rms: NDArray[np.float64]
    """(n,) its root mean square, rad/m."""
    pitch: NDArray[np.float64]
    """(n,) root mean square of the pitch about the patch's plane, rad."""
    twist: NDArray[np.float64]
    """(n,) the same of the difference of the two sides' pitch, rad."""
    belly_reach: NDArray[np.float64]
    """(n,) highest ground under the belly over its clearance; 1: it touches."""
    height_range: NDArray[np.float64]
    """(n,) highest above lowest pixel of the relief, m."""
    height_change: NDArray[np.float64]
    """(n,) mean absolute height difference of pixels two apart, m."""


def roll_over(relief_map: NDArray[np.float32], operator: RideOperator, by_axis: Floats | None = None) -> Rides:
    """Roll a vehicle over patches.

    ``relief_map`` (n, pixels, pixels): plane-removed relief without holes, m; patches with NaN are left out.
    ``by_axis`` (n, 8) is filled with the geometric C_r along each of ``AXES_DEG``, rad/m; the north row of a patch
    comes first.
    """
    patches = np.ascontiguousarray(relief_map, np.float32)
    known = _without_holes(patches)
    motions = np.full((len(relief_map), 1 if by_axis is None else 1 + len(AXES_DEG), 2), np.nan)
    stands = np.full((len(relief_map), 3), np.nan)
    loops.ride_patches(known, patches, operator, operator, motions, stands)
    if by_axis is not None:
        by_axis[:] = motions[:, 1:, 0]
    heights = _heights(np.where(known[:, None, None], patches, np.float32(np.nan)))
    return Rides(*(*motions[:, 0].T.copy(), *stands.T.copy(), *heights))


@dataclass(frozen=True, slots=True)
class Motions:
    """How a vehicle moves on each of n patches at each of k speeds; NaN where a patch has NaN."""

    roll_change: NDArray[np.float64]
    """(n,) mean absolute change of the chassis' roll per metre, rad/m, at any speed."""
    pitch_change: NDArray[np.float64]
    """(n, k) the same of its pitch, rad/m."""
    heave: NDArray[np.float64]
    """(n, k) root mean square of the weighted vertical acceleration, m/s2."""


@dataclass(frozen=True, slots=True)
class MotionOperator:
    """All that the motion of one vehicle over patches of one size takes."""

    speeds: tuple[float, ...]
    """m/s."""
    fine: int
    """Nodes along the side of a pixel."""
    wheel: WheelShape
    samples: PitchSamples
    """Groups: roll; then pitch and heave at each speed."""

    @classmethod
    def of(cls, vehicle: Vehicle, tile_size: float, pixels: int, speeds: Sequence[float]) -> "MotionOperator":
        """Make the operator of a vehicle for speeds [m/s]."""
        lattice, places = NodeLattice.of(vehicle, tile_size, pixels), spread_places(_SAMPLES, tile_size)
        way = lattice.step / 2
        shares, back = np.array([1.0, -1.0]) / way / (2 * lattice.track), way * np.array([-0.5, 0.5])
        groups = [wheel_rows(lattice, places, (1, -1, 1, -1), shares, back)]
        for speed in speeds:
            groups.append(pitch_change(lattice, places, chassis_response(replace(vehicle, speed_mps=speed), way)))
            felt, back = heave_filter(speed, min(way, speed / (_PER_WAVE * WEIGHTED_BAND_HZ[1])))
            groups.append(wheel_rows(lattice, places, (1, 1, 1, 1), felt / 4, back))
        return cls(tuple(speeds), lattice.fine, lattice.wheel, joined(groups))


def move_over(relief_map: NDArray[np.float32], operator: MotionOperator) -> Motions:
    """Roll a vehicle over patches, as `roll_over`, at several speeds."""
    patches = np.ascontiguousarray(relief_map, np.float32)
    motions = np.full((len(relief_map), len(operator.samples.bounds) - 1, 2), np.nan)
    loops.move_over_patches(_without_holes(patches), patches, operator, motions)
    return Motions(motions[:, 0, 0], motions[:, 1::2, 0], motions[:, 2::2, 1])


def _without_holes(patches: NDArray[np.float32]) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(patches).all(axis=(1, 2)))


def _heights(patches: NDArray[np.float32]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return range and mean difference of the heights of patches, (n,) each, m; NaN where a patch has NaN.

    A patch has the same bits wherever it stands among others: its sums run over a row of its own.
    """
    count, pixels = patches.shape[:2]
    flat = patches.reshape(count, pixels * pixels)
    span = flat.max(axis=1).astype(np.float64) - flat.min(axis=1)
    apart = (patches[:, _APART:] - patches[:, :-_APART], patches[:, :, _APART:] - patches[:, :, :-_APART])
    sizes = [np.abs(part).reshape(count, (pixels - _APART) * pixels) for part in apart]
    return span, np.concatenate(sizes, axis=1).mean(axis=1, dtype=np.float64)


WEIGHTED_BAND_HZ = (0.4, 10.0)
"""Vertical motion of these frequencies counts, Hz."""
_LIMITS_HZ = (0.4, 100.0)
"""Corners of the high pass and of the low pass of Wk; these and the next of ISO 2631-1."""
_VELOCITY_HZ, _VELOCITY_Q = 12.5, 0.63
"""Above this frequency the weight falls: velocity is felt rather than acceleration."""
_STEP_HZ, _STEP_Q = (2.37, 3.35), 0.91
"""Between these frequencies the weight rises."""
_CUT_Q = (0.5411961, 1.3065630)
"""Of the two parts of a Butterworth low pass of fourth order."""


def weighting_wk(frequency: NDArray[np.floating]) -> NDArray[np.complex128]:
    """Return the response of Wk at frequencies [Hz] of any shape, with its phase; 0 at 0 Hz.

    The product of a high pass, a low pass, the acceleration to velocity transition and the upward step, with the
    constants of ISO 2631-1:1997, annex A.
    """
    p: NDArray[Any] = 2j * np.pi * frequency
    low, high = (2 * np.pi * corner for corner in _LIMITS_HZ)
    velocity, (first, second) = 2 * np.pi * _VELOCITY_HZ, (2 * np.pi * corner for corner in _STEP_HZ)
    high_pass = p**2 / (p**2 + np.sqrt(2) * low * p + low**2)
    low_pass = 1 / _second_order(p / high, np.sqrt(0.5))
    transition = (1 + p / velocity) / _second_order(p / velocity, _VELOCITY_Q)
    step = _second_order(p / first, _STEP_Q) / _second_order(p / second, _STEP_Q) * (first / second) ** 2
    response: NDArray[np.complex128] = high_pass * low_pass * transition * step
    return response


def felt_response(frequency: NDArray[np.floating]) -> NDArray[np.complex128]:
    """Return the weighted acceleration [m/s2] for a vertical motion of 1 m at frequencies [Hz], up to 10 Hz."""
    p: NDArray[Any] = 1j * frequency / WEIGHTED_BAND_HZ[1]
    cut = _second_order(p, _CUT_Q[0]) * _second_order(p, _CUT_Q[1])
    response: NDArray[np.complex128] = (2j * np.pi * frequency) ** 2 * weighting_wk(frequency) / cut
    return response


def _second_order(p: NDArray[Any], quality: float) -> NDArray[Any]:
    section: NDArray[Any] = 1 + p / quality + p**2
    return section


_SAMPLES = 128
"""Samples before the eight symmetries."""
_PER_WAVE = 2.5
"""Samples in the shortest wave that is felt, at least."""
_FILTER_S = 2.0
"""Half the length of a filter, s: from 0.4 to 8 Hz, what a sine feels is within 3 % of Wk."""
_LONG = 1 << 15
"""Samples of the Fourier transform that the taps come from: many times the longest filter."""


def heave_filter(speed: float, way: float) -> tuple[Floats, Floats]:
    """Return the filter from heights along a way to weighted acceleration at a speed [m/s].

    ``way``: between heights, m. Returns the taps (k,), m/s2 per metre of height, whose sum is 0, and where along the
    way they are, (k,) m, symmetric about 0.
    """
    wave_number = np.fft.rfftfreq(_LONG, way)
    taps = np.fft.irfft(np.abs(felt_response(speed * wave_number)))
    reach = math.ceil(_FILTER_S * speed / way)
    kept = np.concatenate((taps[reach:0:-1], taps[: reach + 1]))
    window = np.hanning(len(kept) + 2)[1:-1]
    kept = kept - window * (kept.sum() / window.sum())
    return np.asarray(kept), np.asarray(way * np.arange(-reach, reach + 1), np.float64)
