"""Signals of the inertial sensor, an even rate, gaps, the band limit; and the attitude that follows from its rates."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, sosfiltfilt
from scipy.spatial.transform import Rotation

from bumpymap.core import BadInputError, ImuTrack

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_GAP_SAMPLES = 5.0
"""A pause of more sampling intervals than this, and of ``_GAP_S``, is a gap."""
_GAP_S = 0.1
_LEAST_PIECE_S = 2.0
"""Shorter pieces between gaps are left out."""
_LEAST_SAMPLES = 200
_RATE_TO_BAND = 2.5
"""Samples per second that the band limit needs, per Hz."""
_MOST_RADPS = 35.0
"""No ground vehicle turns faster (2,000 degrees per second is where sensors end)."""
_ORDER = 4


@dataclass(frozen=True, slots=True)
class EvenImu:
    """The record of an inertial sensor at an even rate, in the sensor's own axes."""

    time: Floats
    """(n,) s."""
    rate: Floats
    """(n, 3) rad/s; 0 where not known."""
    force: Floats
    """(n, 3) specific force, m/s2; 0 where not known, NaN throughout without an accelerometer."""
    known: Mask
    """(n,) False in gaps."""
    hertz: float
    """Samples in a second."""

    @property
    def has_force(self) -> bool:
        """True if there was an accelerometer."""
        return not bool(np.isnan(self.force).any())


def even_imu(imu: ImuTrack, name: str, band_hz: float) -> EvenImu:
    """Bring the record of a sensor to an even rate, its own median one.

    Raises BadInputError: the sensor is too slow for the band, the record too short, or the rates cannot be in rad/s.
    """
    order = in_order(imu.time, np.asarray(np.isfinite(imu.rate).all(axis=1)))
    time, rate, force = imu.time[order], imu.rate[order], imu.acceleration[order]
    if len(time) < _LEAST_SAMPLES:
        raise BadInputError(
            f"{name} has {len(time)} samples of angular rates; a drive needs at least {_LEAST_SAMPLES}. "
            "Give a longer record"
        )
    step = float(np.median(np.diff(time)))
    hertz = 1.0 / step
    _refuse_unfit(rate, name, hertz, band_hz)
    grid = time[0] + step * np.arange(round((time[-1] - time[0]) / step) + 1)
    known = np.zeros(len(grid), np.bool_)
    has_force = bool(np.isfinite(force).all(axis=1).mean() > 0.5)
    values = np.concatenate([rate, np.nan_to_num(force)], axis=1)
    even = np.zeros((len(grid), 6))
    for part in _whole_pieces(time, step):
        inside = slice(*np.searchsorted(grid, (time[part.start], time[part.stop - 1] + 1e-9)))
        even[inside] = make_interp_spline(time[part], values[part], k=3)(grid[inside])
        known[inside] = True
    if not known.any():
        raise BadInputError(
            f"{name}: no {_LEAST_PIECE_S:g} s without a gap in the angular rates. Record the IMU without losses"
        )
    return EvenImu(grid, even[:, :3], even[:, 3:] if has_force else np.full((len(grid), 3), np.nan), known, hertz)


def in_order(time: Floats, known: Mask) -> NDArray[np.int64]:
    """Return the rows that are known and have a time, in its order; of equal times the first."""
    order = np.argsort(time, kind="stable")
    order = order[np.isfinite(time[order]) & known[order]]
    return np.asarray(order[np.diff(time[order], prepend=-np.inf) > 0.0])


def _refuse_unfit(rate: Floats, name: str, hertz: float, band_hz: float) -> None:
    if hertz < _RATE_TO_BAND * band_hz * 0.99:
        raise BadInputError(
            f"{name}: the IMU gives {hertz:.3g} samples per second, and a band of {band_hz:g} Hz needs at least "
            f"{_RATE_TO_BAND * band_hz:g}. Record it faster, or set `band_hz` to {hertz / _RATE_TO_BAND:.2g} or less: "
            "C_r then leaves out faster shaking and reads low"
        )
    most = float(np.quantile(np.abs(rate), 0.999))
    if most > _MOST_RADPS:
        raise BadInputError(
            f"{name}: angular rates reach {most:.3g} rad/s, which no ground vehicle does. If they are in degrees per "
            "second, say so with `columns`"
        )


def _whole_pieces(time: Floats, step: float) -> Iterator[slice]:
    """Yield the pieces of a record between gaps, without short ones."""
    pause = max(_GAP_SAMPLES * step, _GAP_S)
    ends = [0, *(np.flatnonzero(np.diff(time) > pause) + 1).tolist(), len(time)]
    for start, stop in pairwise(ends):
        if time[stop - 1] - time[start] >= _LEAST_PIECE_S:
            yield slice(start, stop)


def pieces(known: Mask) -> list[slice]:
    """Return the runs of True in a mask, in order."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]]).astype(np.int8)))
    return [slice(start, stop) for start, stop in edges.reshape(-1, 2).tolist()]


def low_pass(values: Floats, known: Mask, hertz: float, cutoff_hz: float) -> Floats:
    """Low-pass piece by piece without delay: a Butterworth filter of order 4, run forwards and backwards.

    Returns 0 where not known. At the cutoff the amplitude is one half.
    """
    out = np.zeros_like(values)
    sos = butter(_ORDER, min(cutoff_hz / (0.5 * hertz), 0.99), output="sos")
    pad = round(2.0 * hertz / cutoff_hz)
    for part in pieces(known):
        out[part] = sosfiltfilt(sos, values[part], axis=0, padtype="even", padlen=min(pad, part.stop - part.start - 1))
    return out


def rolling_mean(values: Floats, samples: int) -> Floats:
    """Return the mean over ``samples`` samples around each, fewer at the ends."""
    half = max(samples // 2, 0)
    total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
    index = np.arange(len(values))
    low, high = np.maximum(index - half, 0), np.minimum(index + half + 1, len(values))
    count = (high - low).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray((total[high] - total[low]) / count)


_UP_HZ = 0.02
"""Attitude by rates drifts more slowly than this; accelerations of a vehicle change faster."""


def turned(rate: Floats, hertz: float) -> Rotation:
    """Return the attitude of the sensor at each sample, relative to the first, from its rates.

    ``rate`` (n, 3): in the sensor's own axes, rad/s, without bias. The result turns vectors of the sensor's axes into
    those that it had at the first sample.
    """
    step = 0.5 * (rate[1:] + rate[:-1]) / hertz
    total = Rotation.from_rotvec(np.concatenate([np.zeros((1, 3)), step]))
    reach = 1
    while reach < len(rate):  # prefix products by doubling
        quaternions = total.as_quat()
        quaternions[reach:] = (total[:-reach] * total[reach:]).as_quat()
        total = Rotation.from_quat(quaternions)
        reach *= 2
    return total


def upward_in_sensor(imu: EvenImu, attitude: Rotation, motion: Floats) -> Floats:
    """Return the upward direction in the sensor's axes: by rates in the short run, by gravity in the long run.

    ``attitude``: from `turned`; ``motion`` (n, 3): acceleration of the vehicle in the sensor's axes as far as known,
    taken off, m/s2. Returns (n, 3): unit vectors.
    """
    fixed = attitude.apply(imu.force - motion)
    everywhere = np.ones_like(imu.known)
    fixed[~imu.known] = np.median(fixed[imu.known], axis=0)
    slow = low_pass(fixed, everywhere, imu.hertz, _UP_HZ)
    slow /= np.maximum(np.linalg.norm(slow, axis=1, keepdims=True), 1e-9)
    return np.asarray(attitude.inv().apply(slow))


def levelling(upward: Floats) -> Rotation:
    """Return the smallest rotation that turns a direction of the sensor's axes into z."""
    unit = upward / np.linalg.norm(upward)
    axis = np.cross(unit, [0.0, 0.0, 1.0])
    sine, cosine = float(np.linalg.norm(axis)), float(unit[2])
    if sine < 1e-9:
        return Rotation.identity() if cosine > 0 else Rotation.from_rotvec([np.pi, 0.0, 0.0])
    return Rotation.from_rotvec(axis / sine * np.arctan2(sine, cosine))


def heading_of(attitude: Rotation, upward: Floats) -> Floats:
    """Return the heading of the sensor's levelled x axis, rad, positive to the left; any zero.

    It is the direction of that axis seen from above, not the sum of rates about the vertical: a vehicle that rolls
    while it is pitched sums to a turn that it does not make.

    ``attitude``: from `turned`; ``upward`` (n, 3): unit vectors in the sensor's axes.
    """
    ahead = levelling(upward.mean(axis=0)).inv().apply([1.0, 0.0, 0.0])
    fixed = levelling(attitude.apply(upward).mean(axis=0)).apply(attitude.apply(ahead))
    return np.asarray(np.unwrap(np.arctan2(fixed[:, 1], fixed[:, 0])))
