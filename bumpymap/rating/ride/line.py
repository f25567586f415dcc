"""The ride of a line: what is felt along it, from the pitch of the rockers at even distances.

The correction that the drives of a calibration taught turns geometric values of a tile into its C_r. It holds for a
line as well: the values are those of a stretch as long as a tile, about each place of the line, and what is felt at the
place is its share of the stretch.

A heightmap holds the scan's noise, and a map does not keep how much. But the C_r of a tile was predicted without it:
the relief is denoised (as for that prediction) just so far that the same prediction comes out of it.
"""

from itertools import product

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Floats, loops
from bumpymap.rating.ride.correction import Correction
from bumpymap.rating.ride.motion_operator import Rides, roll_over
from bumpymap.rating.ride.operator import RideOperator
from bumpymap.rating.ride.rate import take_noise_off
from bumpymap.rating.textures import remove_plane

_ROUNDS = 7
"""Halvings of the logarithm of the noise that is tried: 1/128 of its range is left. Chosen."""
_NOISE_M = (1e-4, 0.07)
"""Least and most noise of a pixel that is tried, m."""
_LEAST = 1e-5
"""C_r below is a rounding error, rad/m."""


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
        patches, own, taken, shares = (_cut(values[here], pixels) for values in (heights, variance, added, weight))
        known, found = np.isfinite(patches).all(axis=(2, 3)), np.isfinite(own)
        mean = np.where(found, own, 0.0).sum(axis=(2, 3)) / np.maximum(found.sum(axis=(2, 3)), 1)
        shares[known] += fade
        at = np.nonzero(known & (mean > 0.0))
        relief = remove_plane(patches[at]).astype(np.float32)
        taken[at] += fade * (_without(relief, np.sqrt(mean[at])) - relief)
    return added / np.maximum(weight, 1e-9)


def _cut(mosaic: Floats, pixels: int) -> Floats:
    """Return a view of a mosaic as tiles, (rows, cols, pixels, pixels)."""
    rows, cols = (size // pixels for size in mosaic.shape)
    return mosaic.reshape(rows, pixels, cols, pixels).transpose(0, 2, 1, 3)


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
    felt: Floats = np.exp(correction.without_noise(rides, slopes)).reshape(pitch.shape) * change / size
    return felt
