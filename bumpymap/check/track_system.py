"""The equations of a way: what positions, heading, wheels and stops say of it, as sparse least squares.

The state at each knot is east, north, speed, a turn beside the gyroscope's heading, the wandering error of the receiver
(east, north) and the error of the acceleration. For the whole drive: the scale of the wheels, how the direction of
driving lies in the sensor's levelled axes, the place of the antenna in the vehicle (ahead, left), the offset of the
clocks and its drift. An antenna ahead of the point that the vehicle turns about looks like a clock that is fast, as
long as the vehicle does not stop: starts and stops tell them apart.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from bumpymap.check.places import MetrePlaces, Scatter

__all__ = ["DRIFT", "GLOBALS", "OFFSET", "SCALE", "STATES", "Knots", "TrackProblem", "TrackState"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

STATES = 7
"""Unknowns at each knot: east, north, speed, turn, error east, error north, error of the acceleration."""
SCALE, ALONG_X, ALONG_Y, AHEAD, LEFT, OFFSET, DRIFT = range(7)
"""Unknowns of the whole drive, in order, after those of the knots."""
GLOBALS = 7
_SLIP_M = 0.02
"""A vehicle slips across its heading by this in a second, m/sqrt(s)."""
_TURN_RAD = 0.01
"""Its course leaves the heading by this in a second, rad/sqrt(s)."""
_STOP_MPS = 0.01
_WHEEL_SHARE, _WHEEL_MPS = 0.05, 0.03
"""Error of the speed by wheels."""
_CHANGE = 12.0
"""The speed may change so many times faster beside a stop."""
_WEAK = (0.3, 1.0, 1.0, 0.5, 0.3, 1.0, 1e-4)
"""Standard deviations of what is assumed of the whole drive before any measurement."""
_WEAK_SPEED, _WEAK_TURN = 5.0, 3.0
_FORCE_MPS2 = 0.15
"""Error of the acceleration along the vehicle at first: levelling, bias."""


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
        steps = slice(part.start, part.stop - 1)
        return Knots(
            self.time[part],
            self.steps[steps],
            self.heading[part],
            self.gained[steps],
            self.standing[part],
            self.changing[steps],
            self.wheels[part],
        )

    @property
    def step_s(self) -> float:
        """Seconds from knot to knot."""
        return float(self.time[1] - self.time[0])


@dataclass(frozen=True, slots=True)
class TrackState:
    """The unknowns: those of each knot, one knot after the other, and those of the whole drive."""

    values: Floats
    """(STATES k + GLOBALS,) so that the equations are a narrow band."""

    @property
    def count(self) -> int:
        """Knots."""
        return (len(self.values) - GLOBALS) // STATES

    def part(self, number: int) -> Floats:
        """Return one unknown of all knots, (k,), by its number in ``STATES``."""
        return self.values[number:-GLOBALS:STATES]

    @property
    def whole(self) -> Floats:
        """The unknowns of the whole drive, (GLOBALS,)."""
        return self.values[-GLOBALS:]


@dataclass(frozen=True, slots=True)
class TrackProblem:
    """The equations; from knots and positions."""

    knots: Knots
    places: MetrePlaces | None
    scatter: Scatter
    speed_change: float
    """The speed changes by this in a second, m/s/sqrt(s)."""
    force_change: float
    """The error of the acceleration changes by this in a second, m/s2/sqrt(s)."""
    offset_s: float
    """First estimate of the offset of the clocks, s."""

    def linear(self, state: TrackState) -> tuple[sparse.csr_array, Floats]:
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
        return float(np.log(self.speed_change * self.force_change * faster).sum())

    def _matrix(
        self, count: int, entries: list[tuple[NDArray[np.int64], NDArray[np.int64], Floats]]
    ) -> sparse.coo_array:
        row, col, value = (np.concatenate([entry[axis] for entry in entries]) for axis in range(3))
        return sparse.coo_array((value, (row, col)), shape=(count, STATES * len(self.knots.time) + GLOBALS))

    def _way(self, state: TrackState) -> tuple[sparse.coo_array, Floats]:
        """East and north change by the speed along the heading."""
        k = state.count
        east, north, speed, turn = (state.part(number) for number in range(4))
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

    def _smooth(self, state: TrackState) -> tuple[sparse.coo_array, Floats]:
        """Speed changes as the acceleration says or slowly; turn and errors change slowly."""
        k, step = state.count, self.knots.step_s
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
            6: (self.force_change * np.sqrt(step) * one, 1.0),
        }
        entries, left = [], []
        for place, (part, (sd, factor)) in enumerate(spreads.items()):
            row = number + place * (k - 1)
            entries += [(row, STATES * (number + 1) + part, 1.0 / sd), (row, STATES * number + part, -factor / sd)]
            values = state.part(part)
            left.append((values[1:] - factor * values[:-1]) / sd)
        sd, _ = spreads[2]
        gained, row = self.knots.gained[known], number[known]
        entries.append((row, STATES * row + 6, -(step / sd)[known]))
        for name, axis in ((ALONG_X, gained.real), (ALONG_Y, gained.imag)):
            entries.append((row, np.full(len(row), STATES * k + name), -axis / sd[known]))
            left[0][known] -= axis * state.whole[name] / sd[known]
        left[0][known] -= (state.part(6)[:-1] * step / sd)[known]
        return self._matrix(len(spreads) * (k - 1), entries), np.concatenate(left)

    def _stops(self, state: TrackState) -> tuple[sparse.coo_array, Floats]:
        """No speed at a stop; elsewhere that of the wheels, times their scale."""
        k = state.count
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
        speed, scale = state.part(2), state.whole[SCALE]
        left = np.concatenate([speed[stop] / _STOP_MPS, (speed[rolls] - scale * wheels) / sd])
        return self._matrix(len(stop) + len(rolls), entries), left

    def _weak(self, state: TrackState) -> tuple[sparse.coo_array, Floats]:
        """Return the equations of what is assumed before any measurement: each unknown is held by something."""
        k = state.count
        wander = self.scatter.wander_m
        col = np.concatenate([STATES * np.arange(k) + 2, [3, 4, 5, 6], STATES * k + np.arange(GLOBALS)])
        first = [_WEAK_TURN, wander, wander, _FORCE_MPS2]
        sd = np.concatenate([np.full(k, _WEAK_SPEED * np.sqrt(k)), first, _WEAK])
        guess = np.zeros(len(col))
        guess[[SCALE - GLOBALS, OFFSET - GLOBALS]] = 1.0, self.offset_s
        if self.places is None:  # nothing else says where, or how far a turn of the wheels takes the vehicle
            sd[SCALE - GLOBALS] = 1e-3
            col, sd, guess = (
                np.concatenate([two, all_]) for two, all_ in (([0, 1], col), ([1e-3] * 2, sd), ([0, 0], guess))
            )
        left = (state.values[col] - guess) / sd
        return self._matrix(len(col), [(np.arange(len(col)), col, 1.0 / sd)]), left

    def _receiver(self, state: TrackState, places: MetrePlaces) -> tuple[sparse.coo_array, Floats]:
        """Return the equations of the positions; one that lies far off counts less (Huber)."""
        k, step, first = state.count, self.knots.step_s, self.knots.time[0]
        since = places.time - 0.5 * (first + self.knots.time[-1])
        at = places.time + state.whole[OFFSET] + state.whole[DRIFT] * since
        (knot, share), (own_knot, own_share) = self._between(at), self._between(places.time + self.offset_s)
        inside = ((at >= first) & (at <= self.knots.time[-1])) / self.scatter.white_m
        ahead = np.exp(1j * np.interp(at, self.knots.time, self.knots.heading + state.part(3)))
        antenna = ahead * (state.whole[AHEAD] + 1j * state.whole[LEFT])
        number, whole = np.arange(len(at)), STATES * k
        entries, left = [], []
        for axis, (measured, arm, along, across) in enumerate(
            zip(*((part.real, part.imag) for part in (places.place, antenna, ahead, 1j * ahead)), strict=True)
        ):
            value, error = state.part(axis), state.part(4 + axis)
            seen = (1 - own_share) * error[own_knot] + own_share * error[own_knot + 1]
            miss = (1 - share) * value[knot] + share * value[knot + 1] + seen + arm - measured
            weight = inside * np.sqrt(np.minimum(1.0, 3.0 / np.maximum(np.abs(miss) * inside, 1e-9)))
            row = number + axis * len(at)
            for part, here, next_ in ((axis, knot, share), (4 + axis, own_knot, own_share)):
                entries += [(row, STATES * here + part, (1 - next_) * weight)]
                entries += [(row, STATES * (here + 1) + part, next_ * weight)]
            speed = (value[knot + 1] - value[knot]) / step
            whole_drive = ((AHEAD, along), (LEFT, across), (OFFSET, speed), (DRIFT, speed * since))
            entries += [(row, np.full(len(at), whole + name), slope * weight) for name, slope in whole_drive]
            left.append(miss * weight)
        return self._matrix(2 * len(at), entries), np.concatenate(left)

    def _between(self, at: Floats) -> tuple[NDArray[np.int64], Floats]:
        """Return the knot before each time, and how far it is to the next one, 0..1."""
        exact = np.clip((at - self.knots.time[0]) / self.knots.step_s, 0.0, len(self.knots.time) - 1.000001)
        return exact.astype(np.int64), exact - exact.astype(np.int64)
