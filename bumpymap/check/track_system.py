"""The equations of a way: what positions, heading, wheels and stops say of it, as sparse least squares.

The state at each knot is east, north, speed, a turn beside the gyroscope's heading, and the wandering error of the
receiver (east, north); one scale of the wheels, one offset of the clocks and one drift of it are added.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from bumpymap.check.places import MetrePlaces, Scatter

__all__ = ["Knots", "TrackProblem", "TrackState"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_SLIP_M = 0.02
"""A vehicle slips across its heading by this in a second, m/sqrt(s)."""
_TURN_RAD = 0.01
"""Its course leaves the heading by this in a second, rad/sqrt(s)."""
_STOP_MPS = 0.01
_WHEEL_SHARE, _WHEEL_MPS = 0.05, 0.03
"""Error of the speed by wheels."""
_CHANGE = 12.0
"""The speed may change so many times faster beside a stop."""
_WEAK = {"speed": 5.0, "turn": 3.0, "scale": 0.3, "offset": 0.3, "drift": 1e-4}
"""Standard deviations of what is assumed before any measurement."""


@dataclass(frozen=True, slots=True)
class Knots:
    """What the sensors say at evenly spaced times."""

    time: Floats
    """(k,) s, on the clock of the IMU."""
    steps: NDArray[np.complex128]
    """(k - 1,) seconds along the heading of the gyroscope from knot to knot: its direction, integrated."""
    standing: Mask
    """(k,)"""
    changing: Mask
    """(k - 1,) beside a stop, or in a gap of the IMU."""
    wheels: Floats
    """(k,) speed by wheels, m/s; NaN where not known."""

    @property
    def step_s(self) -> float:
        """Seconds from knot to knot."""
        return float(self.time[1] - self.time[0])


@dataclass(frozen=True, slots=True)
class TrackState:
    """The unknowns: six at each knot, one knot after the other, and three numbers."""

    values: Floats
    """(6 k + 3,) so that the equations are a narrow band."""

    @property
    def count(self) -> int:
        """Knots."""
        return (len(self.values) - 3) // 6

    def part(self, number: int) -> Floats:
        """Return east (0), north (1), speed (2), turn (3) or an error of the receiver (4, 5), (k,)."""
        return self.values[number:-3:6]

    @property
    def offset_s(self) -> float:
        """Offset of the clocks at the middle of the drive."""
        return float(self.values[-2])

    @property
    def drift(self) -> float:
        """Seconds of offset in a second."""
        return float(self.values[-1])


@dataclass(frozen=True, slots=True)
class TrackProblem:
    """The equations; from knots and positions."""

    knots: Knots
    places: MetrePlaces | None
    scatter: Scatter
    speed_change: float
    """The speed changes by this in a second, m/s/sqrt(s)."""
    offset_s: float
    """First estimate of the offset of the clocks, s."""

    def linear(self, state: TrackState) -> tuple[sparse.csr_array, Floats]:
        """Return derivatives and residuals of all equations, each divided by its standard deviation."""
        rows = [self._way(state), self._smooth(state), self._stops(state), self._weak(state)]
        if self.places is not None:
            rows.append(self._receiver(state, self.places))
        matrix = sparse.vstack([part for part, _ in rows], format="csr")
        return matrix, np.concatenate([left for _, left in rows])

    def _matrix(
        self, count: int, entries: list[tuple[NDArray[np.int64], NDArray[np.int64], Floats]]
    ) -> sparse.coo_array:
        row, col, value = (np.concatenate([entry[axis] for entry in entries]) for axis in range(3))
        return sparse.coo_array((value, (row, col)), shape=(count, 6 * len(self.knots.time) + 3))

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
            entries += [(row, 6 * (number + 1) + axis, one), (row, 6 * number + axis, -one)]
            entries += [(row, 6 * (number + side) + 2, -0.5 * way * one) for side in (0, 1)]
            entries += [(row, 6 * (number + side) + 3, -0.5 * mean * across * one) for side in (0, 1)]
        left = np.concatenate([(np.diff(east) - mean * along.real) * one, (np.diff(north) - mean * along.imag) * one])
        return self._matrix(2 * (k - 1), entries), left

    def _smooth(self, state: TrackState) -> tuple[sparse.coo_array, Floats]:
        """Speed, turn and errors of the receiver change slowly."""
        k, step = state.count, self.knots.step_s
        number = np.arange(k - 1)
        faster = np.where(self.knots.changing, _CHANGE, 1.0)
        keep = np.exp(-step / self.scatter.correlation_s)
        wander = np.full(k - 1, self.scatter.wander_m * np.sqrt(1.0 - keep**2))
        spreads = {
            2: (np.hypot(self.speed_change, 1e-4) * np.sqrt(step) * faster, 1.0),
            3: (_TURN_RAD * np.sqrt(step) * faster, 1.0),
            4: (wander, keep),
            5: (wander, keep),
        }
        entries, left = [], []
        for place, (part, (sd, factor)) in enumerate(spreads.items()):
            row = number + place * (k - 1)
            entries += [(row, 6 * (number + 1) + part, 1.0 / sd), (row, 6 * number + part, -factor / sd)]
            values = state.part(part)
            left.append((values[1:] - factor * values[:-1]) / sd)
        return self._matrix(4 * (k - 1), entries), np.concatenate(left)

    def _stops(self, state: TrackState) -> tuple[sparse.coo_array, Floats]:
        """No speed at a stop; elsewhere that of the wheels, times their scale."""
        k = state.count
        stop = np.flatnonzero(self.knots.standing)
        rolls = np.flatnonzero(np.isfinite(self.knots.wheels) & ~self.knots.standing)
        wheels = self.knots.wheels[rolls]
        sd = _WHEEL_SHARE * np.abs(wheels) + _WHEEL_MPS
        row = len(stop) + np.arange(len(rolls))
        entries = [
            (np.arange(len(stop)), 6 * stop + 2, np.full(len(stop), 1.0 / _STOP_MPS)),
            (row, 6 * rolls + 2, 1.0 / sd),
            (row, np.full(len(rolls), 6 * k), -wheels / sd),
        ]
        speed, scale = state.part(2), state.values[-3]
        left = np.concatenate([speed[stop] / _STOP_MPS, (speed[rolls] - scale * wheels) / sd])
        return self._matrix(len(stop) + len(rolls), entries), left

    def _weak(self, state: TrackState) -> tuple[sparse.coo_array, Floats]:
        """What is assumed before any measurement, so that each unknown is held by something."""
        k = state.count
        col = np.concatenate([6 * np.arange(k) + 2, [3, 4, 5, 6 * k, 6 * k + 1, 6 * k + 2]])
        wander = self.scatter.wander_m
        tail = [_WEAK["turn"], wander, wander, _WEAK["scale"], _WEAK["offset"], _WEAK["drift"]]
        sd = np.concatenate([np.full(k, _WEAK["speed"] * np.sqrt(k)), tail])
        guess = np.zeros(len(col))
        guess[-3:-1] = 1.0, self.offset_s
        if self.places is None:  # nothing else says where
            col, sd = np.concatenate([[0, 1], col]), np.concatenate([[1e-3, 1e-3], sd])
            guess = np.concatenate([[0.0, 0.0], guess])
        left = (state.values[col] - guess) / sd
        return self._matrix(len(col), [(np.arange(len(col)), col, 1.0 / sd)]), left

    def _receiver(self, state: TrackState, places: MetrePlaces) -> tuple[sparse.coo_array, Floats]:
        """Return the equations of the positions; one that lies far off counts less (Huber)."""
        k, step = state.count, self.knots.step_s
        first = self.knots.time[0]
        middle = 0.5 * (first + self.knots.time[-1])
        at = places.time + state.offset_s + state.drift * (places.time - middle)
        exact = np.clip((at - first) / step, 0.0, k - 1.000001)
        knot = exact.astype(np.int64)
        share = exact - knot
        count = len(at)
        inside = ((at >= first) & (at <= self.knots.time[-1])).astype(np.float64)
        entries, left = [], []
        for axis, measured in ((0, places.place.real), (1, places.place.imag)):
            value, error = state.part(axis), state.part(4 + axis)
            miss = (1 - share) * (value + error)[knot] + share * (value + error)[knot + 1] - measured
            weight = inside / self.scatter.white_m
            weight *= np.sqrt(np.minimum(1.0, 3.0 / np.maximum(np.abs(miss) * weight, 1e-9)))
            row = np.arange(count) + axis * count
            for part in (axis, 4 + axis):
                entries += [(row, 6 * knot + part, (1 - share) * weight), (row, 6 * knot + 6 + part, share * weight)]
            speed = (value[knot + 1] - value[knot]) / step * weight
            entries += [(row, np.full(count, 6 * k + 1), speed)]
            entries += [(row, np.full(count, 6 * k + 2), speed * (places.time - middle))]
            left.append(miss * weight)
        return self._matrix(2 * count, entries), np.concatenate(left)
