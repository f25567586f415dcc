"""The inertial sensor: its signals at an even rate, the attitude by its rates, and how it sits in the vehicle.

Gravity gives roll and pitch, along the whole way, not at one stop, because a vehicle stands on a slope as readily as on
level ground: the mean slope of the way is known from a map, and small without one. Yaw: the acceleration along the
vehicle is that of its speed, and across it speed times yaw rate; which way they point in the sensor's axes tells how
it is turned.

For the offset of the positions' clock, their velocity is compared with unit steps along the heading by the gyroscope:
at the right offset they differ by speed and by one constant turn. `track` refines the offset together with the way.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.ndimage import find_objects, gaussian_filter1d, label
from scipy.signal import butter, sosfiltfilt
from scipy.spatial.transform import Rotation

from bumpymap.check.places import MetrePlaces, in_order, smooth_velocity
from bumpymap.core import BadInputError, Floats, ImuTrack, Mask

_GAP_SAMPLES, _GAP_S = 5.0, 0.1
"""A longer pause, in sampling intervals and in seconds, is a gap (chosen)."""
_LEAST_PIECE_S = 2.0
"""Shorter pieces between gaps are left out, s (chosen)."""
_LEAST_SAMPLES = 200
"""Fewest samples of a drive: 2 s at 100 Hz, as long as the shortest piece."""
_RATE_TO_BAND = 2.5
"""Samples per second that a band limit needs, per Hz: Nyquist's 2, and room for the slope of the filter."""
_MOST_RADPS = 35.0
"""Highest angular rate of a ground vehicle, rad/s: sensors end at 2,000 degrees per second."""
_ORDER = 4
"""Order of the Butterworth filter of `low_pass` (chosen)."""


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
    grid = time[0] + step * np.arange(round((time[-1] - time[0]) / step) + 1)
    known = np.zeros(len(grid), np.bool_)
    has_force = bool(np.isfinite(force).all(axis=1).mean() > 0.5)
    values = np.concatenate([rate, np.nan_to_num(force)], axis=1)
    even = np.zeros((len(grid), 6))
    gaps = np.flatnonzero(np.diff(time) > max(_GAP_SAMPLES * step, _GAP_S)) + 1
    for start, stop in pairwise([0, *gaps.tolist(), len(time)]):
        if time[stop - 1] - time[start] >= _LEAST_PIECE_S:
            inside = slice(*np.searchsorted(grid, (time[start], time[stop - 1] + 1e-9)))
            even[inside] = make_interp_spline(time[start:stop], values[start:stop], k=3)(grid[inside])
            known[inside] = True
    if not known.any():
        raise BadInputError(
            f"{name}: no {_LEAST_PIECE_S:g} s without a gap in the angular rates. Record the IMU without losses"
        )
    return EvenImu(grid, even[:, :3], even[:, 3:] if has_force else np.full((len(grid), 3), np.nan), known, hertz)


def pieces(known: Mask) -> list[slice]:
    """Return the runs of True in a mask, in order."""
    return [part for (part,) in find_objects(label(known)[0])]


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
"""Frequency between the drift of an attitude by rates, which is slower, and accelerations of a vehicle, Hz (chosen)."""


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


def upward_in_sensor(imu: EvenImu, attitude: Rotation, motion: Floats | float = 0.0) -> Floats:
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


Complexes = NDArray[np.complex128]

_STEP_S, _REACH_S = 0.1, 3.0
"""Step and limit of the offsets that are tried, s (chosen: clocks that are set by hand are off by a second or two)."""
_WINDOW_S = 60.0
"""Time over which the heading by the gyroscope does not drift, s (chosen)."""
_SMOOTH_S = 0.6
"""Standard deviation of the Gaussian that velocities are smoothed by, s (chosen)."""
_SLOW_MPS = 0.15
"""Speed below which positions give no course, m/s (chosen)."""
_LEAST_SECONDS = 5.0
"""Shortest time in common, and of driving, from which an offset is found, s (chosen)."""
_WRONG_UNIT = 15.0
"""Ratio of turning that only another unit explains: a quarter of 57.3, the degrees of a radian."""
_LEAST_TURN = 0.5
"""Turning below which the unit is not judged, rad (chosen)."""


def fit_clock(places: MetrePlaces, time: Floats, heading: Floats, name: str) -> tuple[float, bool, float]:
    """Estimate the offset of the clocks by the heading.

    ``time``, ``heading`` (n,): of the gyroscope, s and rad; ``name``: of the drive, for messages. Returns the time to
    add to the times of the positions, s, 0 if it cannot be determined; whether it could; and the angle to add to the
    heading of the gyroscope for that of the positions (east is 0), rad. Raises BadInputError: positions and sensor have
    no time in common.
    """
    first, last = max(time[0], places.time[0]), min(time[-1], places.time[-1])
    if last - first < _LEAST_SECONDS:
        raise BadInputError(
            f"{name}: positions run from {places.time[0]:.10g} to {places.time[-1]:.10g} s and the IMU from "
            f"{time[0]:.10g} to {time[-1]:.10g} s: less than {_LEAST_SECONDS:g} s in common. Give both on one clock"
        )
    even = np.arange(first, last, _STEP_S)
    velocity, known = smooth_velocity(places, even, _SMOOTH_S)
    speed = gaussian_filter1d(np.abs(velocity), 1.0 / _STEP_S)
    use = known & (speed > _SLOW_MPS)
    if use.sum() * _STEP_S < _LEAST_SECONDS:
        return 0.0, False, 0.0
    group = ((even - first) // _WINDOW_S).astype(np.int64)
    offsets = np.arange(-_REACH_S, _REACH_S + 1e-9, _STEP_S)
    explained = np.array(
        [_explained(velocity * use, _steps(even, offset, time, heading, speed), group) for offset in offsets]
    )
    best = int(np.argmax(explained))
    power = float((np.abs(velocity[use]) ** 2).sum())
    left = power - explained
    # Sure if it explains more than chance: what is left must grow clearly to both sides.
    clearly = min(left[0], left[-1]) - left[best] > 0.05 * max(left[best], 1e-3 * power)
    sure = bool(0 < best < len(offsets) - 1 and clearly)
    offset = 0.0
    if sure:  # the top of the parabola through the best offset and its neighbours
        below, top, above = explained[best - 1 : best + 2]
        bend = below - 2.0 * top + above
        offset = float(offsets[best] + (0.5 * (below - above) / bend if bend < 0 else 0.0) * _STEP_S)
    unit = _steps(even, offset, time, heading, speed)
    turn = float(np.angle((velocity * use * unit.conj())[group == group[use][0]].sum()))
    return offset, sure, turn


def _steps(even: Floats, offset: float, time: Floats, heading: Floats, speed: Floats) -> Complexes:
    """Return the velocity that heading and rough speed give, smoothed as that of the positions is."""
    raw = speed * np.exp(1j * np.interp(even + offset, time, heading))
    return np.asarray(gaussian_filter1d(raw, _SMOOTH_S / _STEP_S))


def _explained(velocity: Complexes, steps: Complexes, group: NDArray[np.int64]) -> float:
    """Return the power of the velocity that the steps explain with one factor and turn in each window."""
    product = velocity * steps.conj()
    both = np.bincount(group, product.real) + 1j * np.bincount(group, product.imag)
    power = np.bincount(group, np.abs(steps) ** 2)
    return float((np.abs(both) ** 2 / np.maximum(power, 1e-12)).sum())


def refuse_wrong_unit(places: MetrePlaces, offset_s: float, time: Floats, heading: Floats, name: str) -> None:
    """Refuse a drive whose gyroscope turns in another unit than its course does.

    Raises BadInputError: the turning of both differs by a factor that only a wrong unit explains.
    """
    even = np.arange(max(time[0], places.time[0]), min(time[-1], places.time[-1]), _STEP_S)
    velocity, known = smooth_velocity(places, even, 2.0)
    use = known & (np.abs(velocity) > 3.0 * _SLOW_MPS)
    lag = round(3.0 / _STEP_S)
    both = use[lag:] & use[:-lag]
    course = np.angle(velocity[lag:] * velocity[:-lag].conj())[both]
    gyro = np.interp(even + offset_s, time, heading)
    turn = (gyro[lag:] - gyro[:-lag])[both]
    if not len(turn):
        return
    by_course, by_gyro = float(np.quantile(np.abs(course), 0.8)), float(np.quantile(np.abs(turn), 0.8))
    if by_gyro > _WRONG_UNIT * max(by_course, _LEAST_TURN / 3.0):
        raise BadInputError(
            f"{name}: the gyroscope turns {by_gyro / max(by_course, 1e-9):.3g} times as much as the positions do: its "
            "rates look like degrees per second read as radians per second. Say the unit with `columns`"
        )
    if by_course > _LEAST_TURN and by_gyro < by_course / _WRONG_UNIT:
        raise BadInputError(
            f"{name}: the gyroscope turns {by_gyro / by_course:.2g} of what the positions do: its rates look like "
            "radians per second read as degrees per second. Say the unit with `columns`"
        )


_MOTION_HZ = 0.5
"""Frequency between accelerations of driving, which are slower, and those of bumps, Hz (chosen)."""
_LEAST_ACCELERATION = 1.0
"""Acceleration from which the yaw of the sensor is determined, root of its power, m/s2 sqrt(s) (chosen)."""
_MOST_YAW_SD = np.radians(15.0)
"""Largest standard deviation of a yaw that is used, rad (chosen)."""


@dataclass(frozen=True, slots=True)
class DrivenMotion:
    """How the vehicle moved, at the samples of the sensor."""

    speed: Floats
    """(n,) m/s."""
    acceleration: Complexes
    """(n,) ahead and to the left, x + i y, m/s2."""
    along_slope: Floats
    """(n,) rise of the ground ahead over a metre, by the map; NaN where not known."""
    left_slope: Floats
    """(n,) rise of it to the left."""


Mounting = tuple[Rotation, tuple[float, float, float], Floats]
"""How a sensor sits in a vehicle: what turns vectors of its axes into those of the vehicle (x ahead, y left, z up);
roll, pitch and yaw in degrees, NaN where not determined; (n, 3) upward in its axes, with the motion of the vehicle."""


def find_mounting(imu: EvenImu, attitude: Rotation, motion: DrivenMotion, moving: Mask) -> Mounting:
    """Find how the sensor, with its accelerometer, sits in the vehicle."""
    upward = upward_in_sensor(imu, attitude)
    rotation = levelling(upward[moving].mean(axis=0))
    yaw, yaw_sd = 0.0, float("nan")
    for _ in range(3):
        yaw, yaw_sd = _yaw(imu, rotation, upward, motion, moving)
        if not yaw_sd <= _MOST_YAW_SD:
            yaw = 0.0
        aligned = Rotation.from_euler("z", yaw) * rotation
        driven = np.stack([motion.acceleration.real, motion.acceleration.imag, np.zeros(len(motion.speed))], axis=1)
        upward = upward_in_sensor(imu, attitude, aligned.inv().apply(driven))
        rotation = _level(aligned.apply(upward), motion, moving) * aligned
    roll, pitch, turn = (float(angle) for angle in rotation.as_euler("ZYX", degrees=True)[::-1])
    return rotation, (roll, pitch, turn if yaw_sd <= _MOST_YAW_SD else float("nan")), upward


def level_force(imu: EvenImu, rotation: Rotation, upward: Floats) -> NDArray[np.complex128]:
    """Return the acceleration along the sensor's levelled axes, x + i y, (n,) m/s2; 0 in gaps.

    ``rotation``: levels the sensor; ``upward`` (n, 3): unit vectors in the sensor's axes.
    """
    level, up = rotation.apply(imu.force), rotation.apply(upward)
    level -= up * (level * up).sum(axis=1, keepdims=True)
    return np.asarray((level[:, 0] + 1j * level[:, 1]) * imu.known)


def _yaw(imu: EvenImu, rotation: Rotation, upward: Floats, motion: DrivenMotion, moving: Mask) -> tuple[float, float]:
    """Return the yaw of the levelled sensor in the vehicle and its standard deviation, rad."""
    felt = _band(level_force(imu, rotation, upward), imu.hertz)
    driven = _band(motion.acceleration, imu.hertz)
    use = moving & imu.known
    power = float((np.abs(driven[use]) ** 2).sum()) / imu.hertz
    if power < _LEAST_ACCELERATION**2:
        return 0.0, float("nan")
    both = (driven * felt.conj())[use].sum() / imu.hertz
    yaw = float(np.angle(both))
    across = (felt * np.exp(1j * yaw) * driven.conj()).imag[use]
    block = round(4.0 * imu.hertz)
    sums = np.add.reduceat(across, np.arange(0, len(across), block)) / imu.hertz
    return yaw, float(np.sqrt((sums**2).sum()) / power)


def _band(values: NDArray[np.complex128], hertz: float) -> NDArray[np.complex128]:
    """Keep what lies between the slow errors of the levelling and the bumps."""
    everywhere = np.ones(len(values), np.bool_)
    both = np.stack([values.real, values.imag], axis=1)
    fast = low_pass(both, everywhere, hertz, _MOTION_HZ)
    fast -= low_pass(fast, everywhere, hertz, _UP_HZ)
    return np.asarray(fast[:, 0] + 1j * fast[:, 1])


def _level(upward: Floats, motion: DrivenMotion, moving: Mask) -> Rotation:
    """Return the small rotation after which the vehicle is on average as tilted as the ground of its way."""
    norm = np.sqrt(1.0 + motion.along_slope**2 + motion.left_slope**2)
    tilted = np.stack([motion.along_slope / norm, motion.left_slope / norm], axis=1)
    known = np.asarray(np.isfinite(tilted).all(axis=1), np.bool_)
    if not (known & moving).any():
        known, tilted = np.ones_like(known), np.zeros_like(tilted)
    tilted = np.where(known[:, None], tilted, 0.0)
    weight = np.abs(motion.speed) * (moving & known)
    off = ((upward[:, :2] - tilted) * weight[:, None]).sum(axis=0) / max(weight.sum(), 1e-9)
    return Rotation.from_rotvec([off[1], -off[0], 0.0])
