"""The way of a drive: positions, heading by the gyroscope, wheels and stops put together by least squares.

Errors of a receiver wander, so their noise must not lengthen the way: speed and heading are smooth, and how smooth is
what makes the positions most probable.

The state at each knot is east, north, speed, a turn beside the gyroscope's heading, the wandering error of the receiver
(east, north) and the error of the acceleration. For the whole drive: the scale of the wheels, how the direction of
driving lies in the sensor's levelled axes, the place of the antenna in the vehicle (ahead, left), the offset of the
clocks and its drift. An antenna ahead of the point that the vehicle turns about looks like a clock that is fast, as
long as the vehicle does not stop: starts and stops tell them apart.
"""

from dataclasses import dataclass, fields, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from bumpymap.check.inertial import EvenImu
from bumpymap.check.places import MetrePlaces, Scatter, scatter_of
from bumpymap.core import Floats, Mask, WheelTrack

STATES = 7
"""Unknowns at each knot: east, north, speed, turn, error east, error north, error of the acceleration."""
SCALE, ALONG_X, ALONG_Y, AHEAD, LEFT, OFFSET, DRIFT = range(7)
"""Unknowns of the whole drive, in order, after those of the knots."""
GLOBALS = 7
"""Number of them."""
_SLIP_M, _TURN_RAD = 0.02, 0.01
"""Slip across the heading, m/sqrt(s), and turn of the course from the heading, rad/sqrt(s), in a second (chosen)."""
_STOP_MPS = 0.01
"""Error of the speed at a stop, m/s (chosen)."""
_WHEEL_SHARE, _WHEEL_MPS = 0.05, 0.03
"""Error of the speed by wheels, as a share of it and in m/s (chosen)."""
_CHANGE = 12.0
"""Factor by which the speed may change faster beside a stop (chosen)."""
_WEAK = (0.3, 1.0, 1.0, 0.5, 0.3, 1.0, 1e-4)
"""Standard deviations of the unknowns of the whole drive before any measurement, in their order: scale of the wheels,
direction x and y, place of the antenna ahead and to the left, m, clock offset, s, and drift (chosen, wide)."""
_WEAK_SPEED, _WEAK_TURN = 5.0, 3.0
"""The same of the speed, m/s, and of the turn beside the heading, rad (chosen, wide)."""
_FORCE_MPS2 = 0.15
"""Error of the acceleration along the vehicle at first, of levelling and bias, m/s2 (chosen)."""


@dataclass(frozen=True, slots=True)
class Knots:
    """Readings of the sensors at evenly spaced times."""

    time: Floats
    """(k,) s, on the clock of the IMU."""
    steps: NDArray[np.complex128]
    """(k - 1,) seconds along the heading of the gyroscope from knot to knot: its direction, integrated."""
    heading: Floats
    """(k,) of the gyroscope, rad."""
    gained: NDArray[np.complex128]
    """(k - 1,) what the accelerations along the sensor's levelled axes (x + i y) add up to, m/s; NaN where unknown."""
    standing: Mask
    """(k,)"""
    changing: Mask
    """(k - 1,) beside a stop, or in a gap of the IMU."""
    wheels: Floats
    """(k,) speed by wheels, m/s; NaN where not known."""

    def between(self, part: slice) -> "Knots":
        """Return some of the knots, one after another."""
        every = len(self.time)
        values = (getattr(self, each.name) for each in fields(self))
        return Knots(*(each[part][: None if len(each) == every else part.stop - part.start - 1] for each in values))

    @property
    def step_s(self) -> float:
        """Seconds from knot to knot."""
        return float(self.time[1] - self.time[0])


State: TypeAlias = Floats
"""(STATES k + GLOBALS,) the unknowns: those of each knot, one knot after the other, so that the equations are a narrow
band, then those of the whole drive."""


def part_of(state: State, number: int) -> Floats:
    """Return one unknown of all knots, (k,), by its number in ``STATES``."""
    return state[number:-GLOBALS:STATES]


@dataclass(frozen=True, slots=True)
class TrackProblem:
    """The equations; from knots and positions."""

    knots: Knots
    places: MetrePlaces | None
    scatter: Scatter
    speed_change: float
    """The speed changes by this in a second, m/s/sqrt(s)."""
    offset_s: float
    """Estimate of the offset of the clocks that the positions are laid on the knots with, s."""
    held: tuple[float, float] | None = None
    """Offset and its standard deviation, s, where it is known by accelerations."""

    def linear(self, state: State) -> tuple[sparse.csr_array, Floats]:
        """Return derivatives and residuals of all equations, each divided by its standard deviation."""
        rows = [self._way(state), self._smooth(state), self._stops(state), self._weak(state)]
        if self.places is not None:
            rows.append(self._receiver(state, self.places))
        matrix = sparse.vstack([part for part, _ in rows], format="csr")
        return matrix, np.concatenate([left for _, left in rows])

    @property
    def log_spread(self) -> float:
        """Sum of the logarithms of those standard deviations that differ between candidates."""
        faster = np.where(np.isfinite(self.knots.gained), 1.0, np.where(self.knots.changing, _CHANGE, 1.0))
        return float(np.log(self.speed_change * faster).sum())

    def _matrix(
        self, count: int, entries: list[tuple[NDArray[np.int64], NDArray[np.int64], Floats]]
    ) -> sparse.coo_array:
        row, col, value = (np.concatenate([entry[axis] for entry in entries]) for axis in range(3))
        return sparse.coo_array((value, (row, col)), shape=(count, STATES * len(self.knots.time) + GLOBALS))

    def _way(self, state: State) -> tuple[sparse.coo_array, Floats]:
        """East and north change by the speed along the heading."""
        k = len(self.knots.time)
        east, north, speed, turn = (part_of(state, number) for number in range(4))
        along = self.knots.steps * np.exp(0.5j * (turn[1:] + turn[:-1]))
        mean = 0.5 * (speed[1:] + speed[:-1])
        sd = np.where(self.knots.changing, 5.0, 1.0) * _SLIP_M * np.sqrt(self.knots.step_s) + 0.002
        one, number = 1.0 / sd, np.arange(k - 1)
        entries = []
        for axis, way, across in ((0, along.real, -along.imag), (1, along.imag, along.real)):
            row = number + axis * (k - 1)
            entries += [(row, STATES * (number + 1) + axis, one), (row, STATES * number + axis, -one)]
            entries += [(row, STATES * (number + side) + 2, -0.5 * way * one) for side in (0, 1)]
            entries += [(row, STATES * (number + side) + 3, -0.5 * mean * across * one) for side in (0, 1)]
        left = np.concatenate([(np.diff(east) - mean * along.real) * one, (np.diff(north) - mean * along.imag) * one])
        return self._matrix(2 * (k - 1), entries), left

    def _smooth(self, state: State) -> tuple[sparse.coo_array, Floats]:
        """Speed changes as the acceleration says or slowly; turn and errors change slowly."""
        k, step = len(self.knots.time), self.knots.step_s
        number = np.arange(k - 1)
        known = np.isfinite(self.knots.gained)
        faster = np.where(self.knots.changing, _CHANGE, 1.0)
        keep = np.exp(-step / self.scatter.correlation_s)
        wander = np.full(k - 1, self.scatter.wander_m * np.sqrt(1.0 - keep**2))
        one = np.ones(k - 1)
        spreads = {
            2: (self.speed_change * np.sqrt(step) * np.where(known, 1.0, faster), 1.0),
            3: (_TURN_RAD * np.sqrt(step) * faster, 1.0),
            4: (wander, keep),
            5: (wander, keep),
            6: (_FORCE_CHANGE * np.sqrt(step) * one, 1.0),
        }
        entries, left = [], []
        for place, (part, (sd, factor)) in enumerate(spreads.items()):
            row = number + place * (k - 1)
            entries += [(row, STATES * (number + 1) + part, 1.0 / sd), (row, STATES * number + part, -factor / sd)]
            values = part_of(state, part)
            left.append((values[1:] - factor * values[:-1]) / sd)
        sd, _ = spreads[2]
        gained, row = self.knots.gained[known], number[known]
        entries.append((row, STATES * row + 6, -(step / sd)[known]))
        for name, axis in ((ALONG_X, gained.real), (ALONG_Y, gained.imag)):
            entries.append((row, np.full(len(row), STATES * k + name), -axis / sd[known]))
            left[0][known] -= axis * state[name - GLOBALS] / sd[known]
        left[0][known] -= (part_of(state, 6)[:-1] * step / sd)[known]
        return self._matrix(len(spreads) * (k - 1), entries), np.concatenate(left)

    def _stops(self, state: State) -> tuple[sparse.coo_array, Floats]:
        """No speed at a stop; elsewhere that of the wheels, times their scale."""
        k = len(self.knots.time)
        stop = np.flatnonzero(self.knots.standing)
        rolls = np.flatnonzero(np.isfinite(self.knots.wheels) & ~self.knots.standing)
        wheels = self.knots.wheels[rolls]
        sd = _WHEEL_SHARE * np.abs(wheels) + _WHEEL_MPS
        row = len(stop) + np.arange(len(rolls))
        entries = [
            (np.arange(len(stop)), STATES * stop + 2, np.full(len(stop), 1.0 / _STOP_MPS)),
            (row, STATES * rolls + 2, 1.0 / sd),
            (row, np.full(len(rolls), STATES * k + SCALE), -wheels / sd),
        ]
        speed, scale = part_of(state, 2), state[SCALE - GLOBALS]
        left = np.concatenate([speed[stop] / _STOP_MPS, (speed[rolls] - scale * wheels) / sd])
        return self._matrix(len(stop) + len(rolls), entries), left

    def _weak(self, state: State) -> tuple[sparse.coo_array, Floats]:
        """Return the equations of what is assumed before any measurement: each unknown is held by something."""
        k = len(self.knots.time)
        wander = self.scatter.wander_m
        col = np.concatenate([STATES * np.arange(k) + 2, [3, 4, 5, 6], STATES * k + np.arange(GLOBALS)])
        first = [_WEAK_TURN, wander, wander, _FORCE_MPS2]
        sd = np.concatenate([np.full(k, _WEAK_SPEED * np.sqrt(k)), first, _WEAK])
        guess = np.zeros(len(col))
        guess[[SCALE - GLOBALS, OFFSET - GLOBALS]] = 1.0, self.offset_s
        if self.held is not None:
            guess[OFFSET - GLOBALS], sd[OFFSET - GLOBALS] = self.held
        if self.places is None:  # nothing else says where, or how far a turn of the wheels takes the vehicle
            sd[SCALE - GLOBALS] = 1e-3
            col, sd, guess = (
                np.concatenate([two, all_]) for two, all_ in (([0, 1], col), ([1e-3] * 2, sd), ([0, 0], guess))
            )
        left = (state[col] - guess) / sd
        return self._matrix(len(col), [(np.arange(len(col)), col, 1.0 / sd)]), left

    def _receiver(self, state: State, places: MetrePlaces) -> tuple[sparse.coo_array, Floats]:
        """Return the equations of the positions; one that lies far off counts less (Huber)."""
        k = len(self.knots.time)
        since = places.time - 0.5 * (self.knots.time[0] + self.knots.time[-1])
        # Positions keep their knots while the offset moves them along the speed, which is smooth: the steps from knot
        # to knot follow the errors of the positions, and as a slope would tell more of the offset than is known.
        at, moved = (
            places.time + self.offset_s,
            state[OFFSET - GLOBALS] - self.offset_s + state[DRIFT - GLOBALS] * since,
        )
        knot, share = self._between(at)
        inside = ((at >= self.knots.time[0]) & (at <= self.knots.time[-1])) / self.scatter.white_m
        ahead = np.exp(1j * np.interp(at, self.knots.time, self.knots.heading + part_of(state, 3)))
        velocity = np.interp(at, self.knots.time, part_of(state, 2)) * ahead
        antenna = ahead * (state[AHEAD - GLOBALS] + 1j * state[LEFT - GLOBALS])
        number, whole = np.arange(len(at)), STATES * k
        entries, left = [], []
        parts = places.place, antenna, ahead, 1j * ahead, velocity
        for axis, (measured, arm, along, across, speed) in enumerate(
            zip(*((part.real, part.imag) for part in parts), strict=True)
        ):
            value = part_of(state, axis) + part_of(state, 4 + axis)
            miss = (1 - share) * value[knot] + share * value[knot + 1] + speed * moved + arm - measured
            weight = inside * np.sqrt(np.minimum(1.0, 3.0 / np.maximum(np.abs(miss) * inside, 1e-9)))
            row = number + axis * len(at)
            for part in (axis, 4 + axis):
                entries += [(row, STATES * knot + part, (1 - share) * weight)]
                entries += [(row, STATES * (knot + 1) + part, share * weight)]
            whole_drive = ((AHEAD, along), (LEFT, across), (OFFSET, speed), (DRIFT, speed * since))
            entries += [(row, np.full(len(at), whole + name), slope * weight) for name, slope in whole_drive]
            left.append(miss * weight)
        return self._matrix(2 * len(at), entries), np.concatenate(left)

    def _between(self, at: Floats) -> tuple[NDArray[np.int64], Floats]:
        """Return the knot before each time, and how far it is to the next one, 0..1."""
        exact = np.clip((at - self.knots.time[0]) / self.knots.step_s, 0.0, len(self.knots.time) - 1.000001)
        return exact.astype(np.int64), exact - exact.astype(np.int64)


_KNOT_S, _MOST_KNOTS = 0.25, 20_000
"""Time between knots, s, and most of them, which 83 minutes take; longer drives have wider steps (chosen)."""
_BESIDE_STOP_S = 2.5
"""Time beside a stop in which the speed changes fast, s (chosen)."""


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
"""Knots of the part of a longer drive that candidates are tried on: ten minutes (chosen)."""
_STOP_RAD = 0.5
"""Turning that determines the clocks as well as a start or a stop does, rad (chosen)."""
_STEPS = 20
"""Most steps of the iteration (chosen; it ends by itself before)."""
_MOVED_S = 0.02
"""Change of the offset from which positions take other knots, s (chosen)."""
_SPEED_CHANGES = (0.02, 0.06, 0.2, 0.6)
"""Candidates of how fast the speed changes, beside what the acceleration says, m/s/sqrt(s) (chosen: steps of
about 3)."""
_FIRST_CHANGES = _SPEED_CHANGES[1:3]
"""Candidates of a rough fit."""
_FIRST_OFFSETS_S = (-0.9, -0.45, 0.0, 0.45, 0.9)
"""A rough fit begins at these offsets beside the first estimate: vehicles that steer by skidding slip sideways in
turns, so that the course tells the offset to a second only."""
_SLIP_S = 0.016
"""Error that slip in turns leaves in an offset, s: root mean square over 20 simulated drives with RTK."""
_FORCE_CHANGE = 0.01
"""Change of the error of the acceleration in a second, m/s2/sqrt(s) (chosen)."""
_SD_KNOTS = 200
"""Number of knots at which the error of the place is computed: it changes slowly along the way."""
_AT_ONCE = 32
"""Number of stretches whose errors are computed at once: each takes as much memory as the whole way."""


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
    """The way of a drive, at evenly spaced knots, (k,) each."""

    time: Floats
    """s, on the clock of the IMU."""
    easting: Floats
    northing: Floats
    speed: Floats
    """m/s, negative backwards."""
    course: Floats
    """Direction of driving, rad, east 0."""
    offset_s: float
    offset_sd_s: float
    offset_spread_s: float
    """Difference of the offsets of the other fits, each weighed by how probable it is: large where several offsets
    explain the drive about as well."""
    drift: float
    drift_sd: float
    scatter: Scatter
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
        problem = TrackProblem(blind, None, scatter, _SPEED_CHANGES[-2], start.offset_s)
        return _track(problem, *_solve(problem, _first(knots, None, start))[:2], 0.0)
    problem, state, factor, spread_s = _best(knots, places, scatter, start)
    return _track(problem, state, factor, float(np.hypot(spread_s, start.spread_s)))


def _best(
    knots: Knots, places: MetrePlaces, scatter: Scatter, start: TrackStart
) -> tuple[TrackProblem, State, SuperLU, float]:
    """Try how fast speed and errors change; return the most probable, and how far their clock offsets differ."""
    blind = replace(knots, gained=np.full_like(knots.gained, np.nan))
    felt = bool(np.isfinite(knots.gained).any())
    speeds = _FIRST_CHANGES if start.rough else _SPEED_CHANGES
    tries = [(knots if felt else blind, speed) for speed in speeds]
    tries += [(blind, speed) for speed in speeds if felt and not start.rough]
    part = _telling_part(knots)
    found: list[tuple[float, TrackProblem, State, SuperLU]] = []
    for shift in _FIRST_OFFSETS_S if start.rough else (0.0,):
        begun = replace(start, offset_s=start.offset_s + shift)
        first = _first(knots.between(part), places, begun)
        for own, speed_change in tries:
            problem = TrackProblem(own.between(part), places, scatter, speed_change, begun.offset_s)
            state, factor, badness = _solve(problem, first)
            found.append((badness, problem, state, factor))
    best = min(range(len(found)), key=lambda number: found[number][0])
    badness, problem, state, factor = found[best]
    with_force = [one for one in found if np.isfinite(one[1].knots.gained).any()]
    if with_force and not np.isfinite(problem.knots.gained).any():
        # Steady driving may fit best without accelerations, but those of starts and stops determine the clock.
        _, _, felt_state, own = min(with_force, key=lambda one: one[0])
        problem = replace(problem, held=(float(felt_state[OFFSET - GLOBALS]), _sd_of(OFFSET, own)))
        state, factor, _ = _solve(problem, state)
    odds = np.exp(0.5 * (badness - np.array([one[0] for one in found])))
    off = np.array([one[2][OFFSET - GLOBALS] for one in found]) - found[best][2][OFFSET - GLOBALS]
    spread_s = float(np.sqrt((odds * off**2).sum() / odds.sum()))
    if part.stop - part.start < len(knots.time):
        problem = replace(problem, knots=tries[best % len(tries)][0])
        begins = [replace(start, offset_s=offset) for offset in (float(state[OFFSET - GLOBALS]), start.offset_s)]
        whole = [
            (begun, *_solve(replace(problem, offset_s=begun.offset_s), _first(knots, places, begun)))
            for begun in begins
        ]
        begun, state, factor, _ = min(whole, key=lambda one: one[-1])
        problem = replace(problem, offset_s=begun.offset_s)
    return problem, state, factor, spread_s


def _sd_of(name: int, factor: SuperLU) -> float:
    """Return the standard deviation of an unknown of the whole drive by the equations alone."""
    end = np.zeros(factor.shape[0])
    end[name - GLOBALS] = 1.0
    return float(np.sqrt(max(float(factor.solve(end)[name - GLOBALS]), 0.0)))


def _telling_part(knots: Knots) -> slice:
    """Return the part of a long drive that turns and stops most: what is tried is tried there alone."""
    if len(knots.time) <= _TRIED_KNOTS:
        return slice(0, len(knots.time))
    stops = knots.standing[1:] != knots.standing[:-1]
    turned = np.abs(np.diff(knots.heading)) * ~(knots.standing[1:] | knots.standing[:-1])
    total = np.concatenate([[0.0], np.cumsum(turned + _STOP_RAD * stops)])
    first = int(np.argmax(total[_TRIED_KNOTS - 1 :] - total[: 1 - _TRIED_KNOTS]))
    return slice(first, first + _TRIED_KNOTS)


def _first(knots: Knots, places: MetrePlaces | None, start: TrackStart) -> State:
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
    return values


def _solve(problem: TrackProblem, state: State) -> tuple[State, SuperLU, float]:
    """Return the best state, the factor of its normal equations, and minus twice its log likelihood."""
    factor, before = None, 0.0
    for _ in range(_STEPS):
        if abs(float(state[OFFSET - GLOBALS]) - problem.offset_s) > _MOVED_S:
            problem = replace(problem, offset_s=float(state[OFFSET - GLOBALS]))
        matrix, left = problem.linear(state)
        factor = splu(
            sparse.csc_array(matrix.T @ matrix),
            permc_spec="NATURAL",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        step = factor.solve(matrix.T @ left)
        shift = float(step[OFFSET - GLOBALS])
        # the offset of the clocks enters the equations bent: where a step takes back the last one, it is halved
        state = state - (0.5 if shift * before < 0.0 else 1.0) * step
        before = shift
        moved = max(np.abs(step[axis:-GLOBALS:STATES]).max() for axis in (0, 1))
        if moved < 2e-3 and abs(shift) < 5e-4:
            break
    if factor is None:
        raise AssertionError("there is at least one step")
    _, left = problem.linear(state)
    badness = float(left @ left) + float(np.log(np.abs(factor.U.diagonal())).sum())
    return state, factor, badness + 2.0 * problem.log_spread


def _track(problem: TrackProblem, state: State, factor: SuperLU, spread_s: float) -> DrivenTrack:
    knots = problem.knots
    east, north, speed, turn = (part_of(state, number) for number in range(4))
    return DrivenTrack(
        time=knots.time,
        easting=east,
        northing=north,
        speed=speed,
        course=knots.heading + turn,
        offset_s=float(state[OFFSET - GLOBALS]),
        offset_sd_s=float(np.sqrt(_sd_of(OFFSET, factor) ** 2 + spread_s**2 + _SLIP_S**2)),
        offset_spread_s=spread_s,
        drift=float(state[DRIFT - GLOBALS]),
        drift_sd=_sd_of(DRIFT, factor),
        scatter=problem.scatter,
        _factor=factor,
    )
