"""The way of a drive: positions, heading by the gyroscope, wheels and stops put together by least squares.

Errors of a receiver wander, so their noise must not lengthen the way: speed and heading are smooth, and how smooth is
what makes the positions most probable.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array
from scipy.sparse.linalg import SuperLU, splu

from bumpymap.check.places import MetrePlaces, Scatter, scatter_of
from bumpymap.check.signals import EvenImu
from bumpymap.check.track_system import DRIFT, GLOBALS, OFFSET, SCALE, STATES, Knots, TrackProblem, TrackState
from bumpymap.core import WheelTrack

__all__ = ["DrivenTrack", "TrackStart", "drive_knots", "fit_track"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_KNOT_S = 0.25
_MOST_KNOTS = 20_000
_BESIDE_STOP_S = 2.5


def drive_knots(
    imu: EvenImu, heading: Floats, standing: Mask, wheels: WheelTrack | None, force: NDArray[np.complex128] | None
) -> Knots:
    """Return what the sensors say of a drive, four times a second.

    ``heading`` (n,): by the gyroscope, rad; ``force`` (n,): acceleration along the sensor's levelled axes, x + i y,
    m/s2.
    """
    seconds = imu.time[-1] - imu.time[0]
    count = int(np.clip(seconds / _KNOT_S, 8, _MOST_KNOTS)) + 1
    time = np.linspace(imu.time[0], imu.time[-1], count)
    direction = np.exp(1j * heading)
    total = np.concatenate([[0.0], np.cumsum(0.5 * (direction[1:] + direction[:-1]))]) / imu.hertz
    steps = np.diff(np.interp(time, imu.time, total))
    nearest = np.clip(np.round((time - imu.time[0]) * imu.hertz).astype(np.int64), 0, len(imu.time) - 1)
    stands = standing[nearest]
    beside = round(_BESIDE_STOP_S / (time[1] - time[0]))
    near = np.convolve(stands, np.ones(2 * beside + 1), mode="same") > 0
    gap = ~imu.known[nearest]
    changing = (near & ~stands)[1:] | (near & ~stands)[:-1] | gap[1:] | gap[:-1]
    speed = np.full(count, np.nan) if wheels is None else _wheel_speed(wheels, time)
    turned = np.interp(time, imu.time, heading)
    gained = np.full(count - 1, np.nan + 0j)
    if force is not None:
        felt = np.concatenate([[0.0], np.cumsum(0.5 * (force[1:] + force[:-1]))]) / imu.hertz
        gained = np.where(gap[1:] | gap[:-1], np.nan, np.diff(np.interp(time, imu.time, felt)))
    return Knots(time, steps, turned, gained, stands, changing, speed)


def _wheel_speed(wheels: WheelTrack, time: Floats) -> Floats:
    good = np.isfinite(wheels.speed) & np.isfinite(wheels.time)
    if good.sum() < 2:
        return np.full(len(time), np.nan)
    at, value = wheels.time[good], wheels.speed[good]
    speed = np.interp(time, at, value, left=np.nan, right=np.nan)
    gap = np.diff(at, prepend=-np.inf, append=np.inf)[np.searchsorted(at, time)]
    return np.where(gap > max(1.0, 3.0 * float(np.median(np.diff(at)))), np.nan, speed)


_TRIED_KNOTS = 2_400
"""Ten minutes: of a longer drive, candidates are tried on a part of this length."""
_STOP_RAD = 0.5
"""A start or a stop tells as much of the clocks as so much turning."""
_STEPS = 20
_SPEED_CHANGES = (0.02, 0.06, 0.2, 0.6)
"""Candidates of how fast the speed changes, beside what the acceleration says, m/s/sqrt(s)."""
_FIRST_CHANGES = (0.06, 0.2)
"""Candidates of a rough fit."""
_FIRST_OFFSETS_S = (-0.9, -0.45, 0.0, 0.45, 0.9)
"""A rough fit begins at these offsets beside the first estimate: vehicles that steer by skidding slip sideways in
turns, so that the course tells the offset to a second only."""
_SLIP_S = 0.016
"""Error that slip in turns leaves in an offset, s: root mean square over 20 simulated drives with RTK."""
_FORCE_CHANGE = 0.01
"""How fast the error of the acceleration changes, m/s2/sqrt(s)."""
_SD_KNOTS = 200
"""The error of the place changes slowly along the way: it is computed at so many knots."""
_AT_ONCE = 32
"""Errors are computed for so many stretches at once: each takes as much memory as the whole way."""


@dataclass(frozen=True, slots=True)
class TrackStart:
    """Where the fit begins."""

    offset_s: float
    heading_0: float
    """Angle to add to the gyroscope's heading, rad."""
    force: NDArray[np.complex128] | None = None
    """(n,) acceleration along the sensor's levelled axes, x + i y, m/s2; None without an accelerometer."""
    rough: bool = False
    """Try few candidates only."""
    spread_s: float = 0.0
    """``offset_spread_s`` of the rough fit before, s."""


@dataclass(frozen=True, slots=True)
class DrivenTrack:
    """The way of a drive, at evenly spaced knots."""

    time: Floats
    """(k,) s, on the clock of the IMU."""
    easting: Floats
    """(k,) m."""
    northing: Floats
    """(k,) m."""
    speed: Floats
    """(k,) m/s, negative backwards."""
    course: Floats
    """(k,) direction of driving, rad, east 0."""
    offset_s: float
    offset_sd_s: float
    offset_spread_s: float
    """How far the offsets of the other fits lie off, each weighed by how probable it is: large where several offsets
    explain the drive about as well."""
    drift: float
    drift_sd: float
    scatter: Scatter
    chosen: tuple[float, float]
    """How fast the speed changes, and the error of the acceleration (0: it was not used)."""
    _factor: SuperLU
    """Of the normal equations."""

    def way_sd(self, start_s: Floats, end_s: Floats) -> Floats:
        """Return standard deviations of the length of the way between times, m, (n,)."""
        found = np.zeros(len(start_s))
        for first in range(0, len(start_s), _AT_ONCE):
            some = slice(first, first + _AT_ONCE)
            weights = _between(self.time, start_s[some], end_s[some]) * (self.time[1] - self.time[0])
            found[some] = self._sd(weights * np.sign(self.speed), 2)
        return found

    def place_sd(self, at_s: Floats) -> Floats:
        """Return standard deviations of the place along one axis at some times, m, (n,)."""
        knot = np.unique(np.linspace(0, len(self.time) - 1, _SD_KNOTS).round().astype(np.int64))
        each = np.zeros(len(knot))
        for first in range(0, len(knot), _AT_ONCE):
            some = knot[first : first + _AT_ONCE]
            one = np.zeros((len(some), len(self.time)))
            one[np.arange(len(some)), some] = 1.0
            each[first : first + _AT_ONCE] = np.sqrt(0.5 * (self._sd(one, 0) ** 2 + self._sd(one, 1) ** 2))
        return np.asarray(np.interp(at_s, self.time[knot], each))

    def _sd(self, weights: Floats, part: int) -> Floats:
        k = len(self.time)
        right = np.zeros((STATES * k + GLOBALS, len(weights)))
        right[part:-GLOBALS:STATES] = weights.T
        return np.asarray(np.sqrt(np.maximum((right * self._factor.solve(right)).sum(axis=0), 0.0)))


def _between(time: Floats, start_s: Floats, end_s: Floats) -> Floats:
    """Return the share of the interval around each knot that lies between times, (n, k)."""
    half = 0.5 * (time[1] - time[0])
    low = np.maximum(start_s[:, None], time - half)
    return np.asarray(np.maximum(np.minimum(end_s[:, None], time + half) - low, 0.0) / (2.0 * half))


def fit_track(
    imu: EvenImu,
    heading: Floats,
    standing: Mask,
    places: MetrePlaces | None,
    wheels: WheelTrack | None,
    start: TrackStart,
) -> DrivenTrack:
    """Find the way of a drive, and the offset of the clocks with it.

    ``heading`` (n,): by the gyroscope, rad; any zero.
    """
    knots = drive_knots(imu, heading + start.heading_0, standing, wheels, start.force)
    scatter = Scatter(1.0, 1.0, 60.0) if places is None else scatter_of(places, imu.time, heading, start.offset_s)
    if places is None:
        blind = replace(knots, gained=np.full_like(knots.gained, np.nan))
        problem = TrackProblem(blind, None, scatter, _SPEED_CHANGES[-2], _FORCE_CHANGE, start.offset_s)
        return _track(problem, *_solve(problem, _first(knots, None, start))[:2], 0.0)
    problem, state, factor, spread_s = _best(knots, places, scatter, start)
    return _track(problem, state, factor, float(np.hypot(spread_s, start.spread_s)))


def _best(
    knots: Knots, places: MetrePlaces, scatter: Scatter, start: TrackStart
) -> tuple[TrackProblem, TrackState, SuperLU, float]:
    """Try how fast speed and errors change; return the most probable, and how far their clock offsets differ."""
    blind = replace(knots, gained=np.full_like(knots.gained, np.nan))
    felt = bool(np.isfinite(knots.gained).any())
    speeds = _FIRST_CHANGES if start.rough else _SPEED_CHANGES
    tries = [(own, speed, _FORCE_CHANGE) for own in ([knots] if felt else [blind]) for speed in speeds]
    tries += [(blind, speed, _FORCE_CHANGE) for speed in speeds if felt and not start.rough]
    part = _telling_part(knots)
    found: list[tuple[float, TrackProblem, TrackState, SuperLU]] = []
    for shift in _FIRST_OFFSETS_S if start.rough else (0.0,):
        begun = replace(start, offset_s=start.offset_s + shift)
        first = _first(knots.between(part), places, begun)
        for own, speed_change, force_change in tries:
            problem = TrackProblem(own.between(part), places, scatter, speed_change, force_change, begun.offset_s)
            state, factor, badness = _solve(problem, first)
            found.append((badness, problem, state, factor))
    best = min(range(len(found)), key=lambda number: found[number][0])
    badness, problem, state, factor = found[best]
    odds = np.exp(0.5 * (badness - np.array([one[0] for one in found])))
    off = np.array([one[2].whole[OFFSET] for one in found]) - state.whole[OFFSET]
    spread_s = float(np.sqrt((odds * off**2).sum() / odds.sum()))
    if part.stop - part.start < len(knots.time):
        problem = replace(problem, knots=tries[best % len(tries)][0])
        begins = [replace(start, offset_s=offset) for offset in (float(state.whole[OFFSET]), start.offset_s)]
        whole = [
            (begun, *_solve(replace(problem, offset_s=begun.offset_s), _first(knots, places, begun)))
            for begun in begins
        ]
        begun, state, factor, _ = min(whole, key=lambda one: one[-1])
        problem = replace(problem, offset_s=begun.offset_s)
    return problem, state, factor, spread_s


def _telling_part(knots: Knots) -> slice:
    """Return the part of a long drive that turns and stops most: what is tried is tried there alone."""
    if len(knots.time) <= _TRIED_KNOTS:
        return slice(0, len(knots.time))
    stops = knots.standing[1:] != knots.standing[:-1]
    turned = np.abs(np.diff(knots.heading)) * ~(knots.standing[1:] | knots.standing[:-1])
    total = np.concatenate([[0.0], np.cumsum(turned + _STOP_RAD * stops)])
    first = int(np.argmax(total[_TRIED_KNOTS - 1 :] - total[: 1 - _TRIED_KNOTS]))
    return slice(first, first + _TRIED_KNOTS)


def _first(knots: Knots, places: MetrePlaces | None, start: TrackStart) -> TrackState:
    k = len(knots.time)
    values = np.zeros(STATES * k + GLOBALS)
    values[STATES * k + SCALE] = 1.0
    values[STATES * k + OFFSET] = start.offset_s
    speed = np.nan_to_num(knots.wheels)
    if places is not None:
        at = knots.time - start.offset_s
        place = np.interp(at, places.time, places.place)
        values[0:-GLOBALS:STATES], values[1:-GLOBALS:STATES] = place.real, place.imag
        lag = max(round(2.0 / knots.step_s), 1)
        ahead, behind = np.minimum(np.arange(k) + lag, k - 1), np.maximum(np.arange(k) - lag, 0)
        moved = place[ahead] - place[behind]
        way = np.concatenate([[0.0], np.cumsum(knots.steps)])
        speed = (moved * np.exp(-1j * np.angle(way[ahead] - way[behind]))).real / ((ahead - behind) * knots.step_s)
    values[2:-GLOBALS:STATES] = np.where(knots.standing, 0.0, speed)
    return TrackState(values)


def _solve(problem: TrackProblem, state: TrackState) -> tuple[TrackState, SuperLU, float]:
    """Return the best state, the factor of its normal equations, and minus twice its log likelihood."""
    factor, before = None, 0.0
    for _ in range(_STEPS):
        matrix, left = problem.linear(state)
        factor = splu(
            csc_array(matrix.T @ matrix),
            permc_spec="NATURAL",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        step = factor.solve(matrix.T @ left)
        shift = float(step[OFFSET - GLOBALS])
        # the offset of the clocks enters the equations bent: where a step takes back the last one, it is halved
        state = replace(state, values=state.values - (0.5 if shift * before < 0.0 else 1.0) * step)
        before = shift
        moved = max(np.abs(step[axis:-GLOBALS:STATES]).max() for axis in (0, 1))
        if moved < 2e-3 and abs(shift) < 5e-4:
            break
    if factor is None:
        raise AssertionError("there is at least one step")
    _, left = problem.linear(state)
    badness = float(left @ left) + float(np.log(np.abs(factor.U.diagonal())).sum())
    return state, factor, badness + 2.0 * problem.log_spread


def _track(problem: TrackProblem, state: TrackState, factor: SuperLU, spread_s: float) -> DrivenTrack:
    knots = problem.knots
    east, north, speed, turn = (state.part(number) for number in range(4))
    course = knots.heading + turn
    ends = np.zeros((len(state.values), 2))
    ends[[OFFSET - GLOBALS, DRIFT - GLOBALS], [0, 1]] = 1.0
    spread = np.sqrt(np.maximum((ends * factor.solve(ends)).sum(axis=0), 0.0))
    return DrivenTrack(
        time=knots.time,
        easting=east,
        northing=north,
        speed=speed,
        course=course,
        offset_s=float(state.whole[OFFSET]),
        offset_sd_s=float(np.sqrt(spread[0] ** 2 + spread_s**2 + _SLIP_S**2)),
        offset_spread_s=spread_s,
        chosen=(problem.speed_change, problem.force_change if np.isfinite(knots.gained).any() else 0.0),
        drift=float(state.whole[DRIFT]),
        drift_sd=float(spread[1]),
        scatter=problem.scatter,
        _factor=factor,
    )
