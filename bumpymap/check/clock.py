"""How far the clock of the positions is off that of the inertial sensor: a first estimate by correlation.

The velocity by positions is compared with unit steps along the heading by the gyroscope: at the right offset they
differ by speed and by one constant turn. `track` refines the offset together with the way.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from bumpymap.check.places import MetrePlaces, smooth_velocity
from bumpymap.core import BadInputError

__all__ = ["ClockFit", "fit_clock", "refuse_wrong_unit"]

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Mask = NDArray[np.bool_]

_STEP_S = 0.1
_REACH_S = 3.0
"""Offsets up to this are searched, s."""
_WINDOW_S = 60.0
"""The heading may drift over longer times."""
_SMOOTH_S = 0.6
_SLOW_MPS = 0.15
_LEAST_SECONDS = 5.0
_WRONG_UNIT = 15.0
"""Turning that differs by more than this factor is another unit: 57.3 degrees are a radian."""
_LEAST_TURN = 0.5
"""rad: with less turning the unit is not judged."""


@dataclass(frozen=True, slots=True)
class ClockFit:
    """A first estimate of the offset of the clocks and of the heading."""

    offset_s: float
    """What to add to the times of the positions; 0 if it cannot be told."""
    sure: bool
    """Whether it could be told."""
    heading_0: float
    """What to add to the heading of the gyroscope for that of the positions (east is 0), rad."""


def fit_clock(places: MetrePlaces, time: Floats, heading: Floats, name: str) -> ClockFit:
    """Estimate the offset by the heading.

    Parameters
    ----------
    places : MetrePlaces
    time, heading : float64 arrays (n,)
        Of the gyroscope, s and rad.
    name : str
        Of the drive, for messages.

    Raises
    ------
    BadInputError
        Positions and sensor have no time in common.
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
        return ClockFit(0.0, sure=False, heading_0=0.0)
    group = ((even - first) // _WINDOW_S).astype(np.int64)
    offsets = np.arange(-_REACH_S, _REACH_S + 1e-9, 0.1)
    explained = np.array(
        [_explained(velocity * use, _steps(even, offset, time, heading, speed), group) for offset in offsets]
    )
    best = int(np.argmax(explained))
    sure = 0 < best < len(offsets) - 1 and _stands_out(explained, float((np.abs(velocity[use]) ** 2).sum()))
    offset = _peak(offsets, explained, best) if sure else 0.0
    unit = _steps(even, offset, time, heading, speed)
    turn = float(np.angle((velocity * use * unit.conj())[group == group[use][0]].sum()))
    return ClockFit(offset, sure, turn)


def _steps(even: Floats, offset: float, time: Floats, heading: Floats, speed: Floats) -> Complexes:
    """Return the velocity that heading and rough speed give, smoothed as that of the positions is."""
    raw = speed * np.exp(1j * np.interp(even + offset, time, heading))
    sigma = _SMOOTH_S / _STEP_S
    return np.asarray(gaussian_filter1d(raw.real, sigma) + 1j * gaussian_filter1d(raw.imag, sigma))


def _explained(velocity: Complexes, steps: Complexes, group: NDArray[np.int64]) -> float:
    """Return the power of the velocity that the steps explain with one factor and turn in each window."""
    product = velocity * steps.conj()
    both = np.bincount(group, product.real) + 1j * np.bincount(group, product.imag)
    power = np.bincount(group, np.abs(steps) ** 2)
    return float((np.abs(both) ** 2 / np.maximum(power, 1e-12)).sum())


def _stands_out(explained: Floats, power: float) -> bool:
    """Return whether the best offset explains more than chance: what is left must grow clearly to both sides."""
    left = power - explained
    best = int(np.argmin(left))
    return bool(min(left[0], left[-1]) - left[best] > 0.05 * max(left[best], 1e-3 * power))


def _peak(offsets: Floats, explained: Floats, best: int) -> float:
    """Return the top of the parabola through the best offset and its neighbours."""
    below, top, above = explained[best - 1 : best + 2]
    bend = below - 2.0 * top + above
    shift = 0.5 * (below - above) / bend if bend < 0 else 0.0
    return float(offsets[best] + shift * (offsets[1] - offsets[0]))


def refuse_wrong_unit(places: MetrePlaces, clock: ClockFit, time: Floats, heading: Floats, name: str) -> None:
    """Refuse a drive whose gyroscope turns in another unit than its course does.

    Raises
    ------
    BadInputError
        The turning of both differs by a factor that only a wrong unit explains.
    """
    even = np.arange(max(time[0], places.time[0]), min(time[-1], places.time[-1]), _STEP_S)
    velocity, known = smooth_velocity(places, even, 2.0)
    use = known & (np.abs(velocity) > 3.0 * _SLOW_MPS)
    lag = round(3.0 / _STEP_S)
    both = use[lag:] & use[:-lag]
    course = np.angle(velocity[lag:] * velocity[:-lag].conj())[both]
    gyro = np.interp(even + clock.offset_s, time, heading)
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
