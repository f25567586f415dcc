"""The ride operator: where a vehicle's wheels stand on a patch, and how fast its chassis pitches there.

Strategy. A patch goes on forever, mirrored at its edges, and a wheel's centre rolls on the envelope of that ground
(grey dilation with the wheel's shape: a cylinder, turned to the nearest of four directions). Everything after that is
linear in the envelope: the pitch of a side is the height of its front axle less that of its rear axle over the
wheelbase, the chassis takes the mean of both sides, follows it through its suspension (a spring and a damper), and what
counts is the change of its pitch per metre driven. So each *sample*, a place and a heading, is one row of a sparse
matrix over the nodes of the envelopes, the same for every patch, and the geometric C_r of a patch is the mean absolute
value of matrix times envelopes. The samples are spread evenly over the patch and all headings and are closed under the
symmetries of the square: a patch that is turned or mirrored gets the same answer.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bumpymap.core import AXES_DEG, Floats
from bumpymap.rating.vehicle_profile import Vehicle

Places = tuple[Floats, Floats, Floats]
"""Easting, northing [m] and heading [rad] of samples, (n,) each."""
CORNERS = (1, 1, -1, -1), (1, -1, 1, -1)
"""Forward (1) or rear (-1), and left (1) or right (-1), of the front left, front right, rear left, rear right wheel."""


class PitchSamples(NamedTuple):
    """Rows of a sparse matrix over the nodes (compressed rows), in groups."""

    starts: Annotated[NDArray[np.int32], 1]
    """(samples + 1,) where each row begins."""
    node: Annotated[NDArray[np.int32], 1]
    """(entries,) index into the flat (directions, nodes, nodes) envelopes."""
    weight: Annotated[NDArray[np.float32], 1]
    """(entries,) rad/m of pitch change per metre of height."""
    bounds: Annotated[NDArray[np.int64], 1]
    """(groups + 1,) where the rows of each group begin."""


class WheelShape(NamedTuple):
    """The lower half of a wheel (a cylinder) on the nodes of the envelope, in each of four directions."""

    starts: Annotated[NDArray[np.int32], 1]
    """(directions + 1,) where the nodes of each begin."""
    row: Annotated[NDArray[np.int32], 1]
    """(n,) nodes from the centre, along the rows."""
    col: Annotated[NDArray[np.int32], 1]
    """(n,) nodes from the centre, along the columns."""
    rise: Annotated[NDArray[np.float32], 1]
    """(n,) how much higher than its lowest point the wheel is there, negative, m."""


_WHEEL_NODES = 2.0
"""Nodes of the envelope along a wheel's radius, at least."""


@dataclass(frozen=True, slots=True)
class NodeLattice:
    """The nodes of a patch that is mirrored at its edges forever, for the wheels of a vehicle."""

    fine: int
    """Nodes along the side of a pixel."""
    nodes: int
    """Along the side of a patch, both edges among them."""
    step: float
    """Between nodes, m."""
    wheelbase: float
    track: float
    wheel: WheelShape

    @classmethod
    def of(cls, vehicle: Vehicle, tile_size: float, pixels: int) -> "NodeLattice":
        """Make the lattice of a vehicle for patches of one size."""
        wheel = vehicle.wheel
        fine = max(1, int(np.ceil(_WHEEL_NODES * tile_size / (pixels * wheel.radius_m) - 1e-9)))
        step = tile_size / (pixels * fine)
        shape = wheel_shape(wheel.radius_m, wheel.width_m, step)
        return cls(fine, pixels * fine + 1, step, vehicle.wheelbase_m, vehicle.track_m, shape)

    def read(self, x: Floats, y: Floats) -> tuple[NDArray[np.int64], Floats]:
        """Bilinear reads at places [m] of any shape: nodes and weights, one more axis of four corners."""
        across, up = x / self.step, y / self.step
        i, j = np.floor(across).astype(np.int64), np.floor(up).astype(np.int64)
        part_x, part_y = across - i, up - j
        node, weight = [], []
        for row, share_y in ((j, 1 - part_y), (j + 1, part_y)):
            for col, share_x in ((i, 1 - part_x), (i + 1, part_x)):
                node.append(self._mirrored(row) * self.nodes + self._mirrored(col))
                weight.append(share_y * share_x)
        return np.stack(node, axis=-1), np.stack(weight, axis=-1)

    def read_wheels(
        self, places: Places, forward: ArrayLike, left: ArrayLike, back: Floats | float = 0.0
    ) -> tuple[NDArray[np.int64], Floats]:
        """Read the envelopes under wheels at n samples, as `read` does, (n, k, 4).

        ``forward``, ``left``: 1 or -1, the corner of the vehicle; ``back``: how far behind the sample, m; each () or
        (k,).
        """
        x, y = beside(places, np.multiply(forward, self.wheelbase) / 2 - back, np.multiply(left, self.track) / 2)
        node, weight = self.read(x, y)
        side = self.step * (self.nodes - 1)
        mirrored, heading = (np.floor(x / side) + np.floor(y / side)) % 2 == 1, places[2][:, None]
        turn = wheel_turn(np.where(mirrored, -heading, heading))
        return node + (turn * self.nodes**2)[..., None], weight

    def _mirrored(self, index: NDArray[np.int64]) -> NDArray[np.int64]:
        """Mirror at the edge nodes, which lie on the patch's edges."""
        period = 2 * (self.nodes - 1)
        wrapped = index % period
        return np.minimum(wrapped, period - wrapped)


def beside(places: Places, along: Floats | float, left: Floats | float) -> tuple[Floats, Floats]:
    """Return easting and northing, (n, k), of places so far ahead of n samples and to their left, () or (k,), m."""
    x, y, heading = (each[:, None] for each in places)
    cos, sin = np.cos(heading), np.sin(heading)
    return x + cos * along - sin * left, y + sin * along + cos * left


def spread_places(count: int, side: float) -> Places:
    """Places [m] and headings [rad], evenly spread (Halton), with all their turns by 90 degrees and mirror images."""
    u, v, w = (_halton(count, base) for base in (2, 3, 5))
    x, y, heading = (u - 0.5) * side, (v - 0.5) * side, w * np.pi / 2
    turned = []
    for px, py, angle in ((x, y, heading), (-x, y, np.pi - heading)):
        for cos, sin, turn in ((1, 0, 0.0), (0, 1, np.pi / 2), (-1, 0, np.pi), (0, -1, 3 * np.pi / 2)):
            turned.append((cos * px - sin * py, sin * px + cos * py, angle + turn))
    east, north, way = (np.concatenate(parts) for parts in zip(*turned, strict=True))
    return east + side / 2, north + side / 2, way


def _halton(count: int, base: int) -> Floats:
    """Give the first ``count`` numbers of van der Corput's sequence in a base."""
    left, share, total = np.arange(1, count + 1), 1.0, np.zeros(count)
    while left.any():
        share /= base
        total += share * (left % base)
        left //= base
    return total


def wheel_rows(
    lattice: NodeLattice, places: Places, signs: tuple[int, int, int, int], share: Floats, back: Floats
) -> PitchSamples:
    """Rows that give a sum over the heights of the wheels, behind and ahead of each sample.

    ``signs``: of the front left, front right, rear left, rear right wheel; ``share`` (k,): how much their heights
    count, per metre of it; ``back`` (k,): how far behind the sample, m.
    """
    nodes, weights = [], []
    for forward, left, sign in zip(*CORNERS, signs, strict=True):
        node, weight = lattice.read_wheels(places, forward, left, back)
        nodes.append(node.reshape(len(node), -1))
        weights.append((weight * (sign * share)[:, None]).reshape(len(node), -1))
    return _compressed(np.concatenate(nodes, axis=1), np.concatenate(weights, axis=1))


def _compressed(node: NDArray[np.int64], weight: Floats) -> PitchSamples:
    """Put (samples, entries) together: one entry for each node of a sample, in the order of the nodes."""
    samples = node.shape[0]
    size = int(node.max()) + 1
    flat = (np.arange(samples)[:, None] * size + node).ravel()
    order = np.argsort(flat, kind="stable")
    sorted_flat = flat[order]
    first = np.flatnonzero(np.diff(sorted_flat, prepend=-1))
    total = np.add.reduceat(weight.ravel()[order], first)
    keys = sorted_flat[first]
    felt = np.abs(total) > 1e-9 * np.abs(total).max()
    keys, total = keys[felt], total[felt]
    starts = np.searchsorted(keys // size, np.arange(samples + 1))
    entries = (keys % size).astype(np.int32), total.astype(np.float32)
    return PitchSamples(starts.astype(np.int32), *entries, np.array([0, samples]))


def joined(parts: Sequence[PitchSamples]) -> PitchSamples:
    """Put the rows of parts one after the other, and their groups."""
    starts, node, weight, bounds = zip(*parts, strict=True)
    rows, groups = (np.cumsum(np.concatenate(([0], *map(np.diff, ends)))) for ends in (starts, bounds))
    return PitchSamples(rows.astype(np.int32), np.concatenate(node), np.concatenate(weight), groups)


_RIDE_SAMPLES, _POSE_SAMPLES = 128, 16
"""Samples before the eight symmetries."""
_MOST_TAPS, _SETTLED = 400, 0.01
"""Longest response of a chassis, steps; it ends sooner where pitch and its change are settled to this share."""
_TURNS = 4
"""Directions of wheels in half a turn: 0, 45, 90 and 135 degrees."""


@dataclass(frozen=True, slots=True)
class RideOperator:
    """All that the ride of one vehicle over patches of one size takes."""

    fine: int
    """Nodes along the side of a pixel."""
    wheel: WheelShape
    samples: PitchSamples
    """Groups: all; then the same rows by the nearest of ``AXES_DEG``."""
    wheel_node: Annotated[NDArray[np.int32], 3]
    """(poses, 4 wheels, 4 corners): front left, front right, rear left, rear right; bilinear reads of the nodes."""
    wheel_weight: Annotated[NDArray[np.float32], 3]
    """The same shape."""
    belly_node: Annotated[NDArray[np.int32], 3]
    """(poses, 3 places, 4 corners): front end, middle, rear end of the belly."""
    belly_weight: Annotated[NDArray[np.float32], 3]
    """The same shape."""
    wheelbase: float
    track: float
    belly_half: float
    """Half of the belly's length, m."""
    clearance: float
    noise_gain: float
    """Root mean square of the pitch change over the standard deviation of heights that know nothing of each other,
    where wheels are points, rad/m per m."""

    @classmethod
    def of(cls, vehicle: Vehicle, tile_size: float, pixels: int) -> "RideOperator":
        """Make the operator of a vehicle."""
        lattice, half = NodeLattice.of(vehicle, tile_size, pixels), vehicle.belly.length_m / 2
        places, poses = (spread_places(count, tile_size) for count in (_RIDE_SAMPLES, _POSE_SAMPLES))
        samples = pitch_change(lattice, places, chassis_response(vehicle, lattice.step / 2))
        wheel_node, wheel_weight = lattice.read_wheels(poses, *CORNERS)
        belly_node, belly_weight = lattice.read(*beside(poses, np.array([1, 0, -1]) * half, 0.0))
        return cls(
            fine=lattice.fine,
            wheel=lattice.wheel,
            samples=joined((samples, _by_axis(samples, places[2]))),
            wheel_node=wheel_node.astype(np.int32),
            wheel_weight=wheel_weight.astype(np.float32),
            belly_node=belly_node.astype(np.int32),
            belly_weight=belly_weight.astype(np.float32),
            wheelbase=lattice.wheelbase,
            track=lattice.track,
            belly_half=half,
            clearance=vehicle.belly.clearance_m,
            noise_gain=_noise_gain(samples, pixels, lattice.fine),
        )


def wheel_turn(heading: Floats) -> NDArray[np.int64]:
    """Return the direction of `WheelShape`, from 0, that is nearest to each heading [rad]."""
    return np.rint(heading / (np.pi / _TURNS)).astype(np.int64) % _TURNS


def wheel_shape(radius: float, width: float, step: float) -> WheelShape:
    """Return the lower half of a wheel [m] on nodes that are ``step`` m apart, each as wide as that."""
    reach = int(radius / step + 1e-9)
    offset = np.arange(-reach, reach + 1)
    row, col = (axis.ravel() for axis in np.meshgrid(offset, offset, indexing="ij"))
    turn = np.pi / _TURNS * np.arange(_TURNS)[:, None]
    along, beside = (
        step * (col * a + row * b) for a, b in ((np.cos(turn), np.sin(turn)), (-np.sin(turn), np.cos(turn)))
    )
    under = (np.abs(along) <= radius * (1 + 1e-9)) & (np.abs(beside) <= (width + step) / 2 * (1 + 1e-9))
    rise = np.sqrt(np.maximum(radius**2 - along**2, 0.0)) - radius
    direction, node = np.nonzero(under)
    starts = np.searchsorted(direction, np.arange(_TURNS + 1))
    shape = row[node].astype(np.int32), col[node].astype(np.int32), rise[under].astype(np.float32)
    return WheelShape(starts.astype(np.int32), *shape)


def chassis_response(vehicle: Vehicle, way: float) -> Floats:
    """How much the chassis pitches, step by step of ``way`` [m], after its rockers pitched by one in the first step.

    I theta'' = 2 k (phi - theta) + 2 b (phi' - theta') with both rockers' spring k and damper b, I the chassis' moment
    of pitch, phi the mean pitch of the rockers. Exact for a rocker that turns evenly during a step. The taps sum to 1.
    """
    _, inertia, _ = vehicle.chassis.inertia_kgm2
    spring = 2 * vehicle.rocker.stiffness_nm_per_rad / inertia
    damper = 2 * vehicle.rocker.damping_nms_per_rad / inertia
    seconds = way / vehicle.speed_mps
    if spring <= 0:
        return np.ones(1)
    # State: theta, theta', phi, phi'.
    change = np.array([[0, 1, 0, 0], [-spring, -damper, spring, damper], [0, 0, 0, 1], [0, 0, 0, 0]])
    step = _exponential(change * seconds)
    state, before, taps = np.array([0.0, 0.0, 0.0, 1 / seconds]), 0.0, []
    for _ in range(_MOST_TAPS):
        state = step @ state
        taps.append(state[0] - before)
        before, state[3] = state[0], 0.0
        if abs(before - 1) < _SETTLED and abs(state[1]) * seconds < _SETTLED:
            break
    response = np.array(taps)
    scaled: Floats = response / response.sum()
    return scaled


def _exponential(matrix: Floats) -> Floats:
    """Exponential of a small matrix: a Taylor series of its 2^-k-th part, squared k times."""
    halvings = max(0, int(np.ceil(np.log2(max(np.abs(matrix).sum(axis=1).max(), 1e-300)))) + 4)
    part = matrix / 2.0**halvings
    total = term = np.eye(len(matrix))
    for n in range(1, 18):
        term = term @ part / n
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return total


def pitch_change(lattice: NodeLattice, places: Places, taps: Floats) -> PitchSamples:
    """Rows that give the change of the chassis' pitch per metre at each sample; ``taps``: for steps of half a node."""
    # The chassis' change in a step is the taps over the rockers' changes before it, each a difference of two pitches.
    way = lattice.step / 2
    shares = np.diff(taps, prepend=0.0, append=0.0) / way
    back = way * (np.arange(len(shares), dtype=np.float64) - 0.5)
    return wheel_rows(lattice, places, (1, 1, -1, -1), shares / (2 * lattice.wheelbase), back)


def _by_axis(samples: PitchSamples, heading: Floats) -> PitchSamples:
    """Put the samples in the order of their axes.

    ``heading`` (samples,) is counted from the columns to the rows, rad; a way and its opposite are on one axis.
    """
    width = AXES_DEG[1] - AXES_DEG[0]
    # The north row of a patch comes first, so its rows count southwards.
    axis = np.rint((90.0 + np.degrees(heading)) / width).astype(np.int64) % len(AXES_DEG)
    order = np.argsort(axis, kind="stable")
    length = np.diff(samples.starts)[order]
    starts = np.concatenate(([0], np.cumsum(length)))
    entry = np.arange(starts[-1]) + np.repeat(samples.starts[order] - starts[:-1], length)
    bounds = np.searchsorted(axis[order], np.arange(len(AXES_DEG) + 1))
    return PitchSamples(starts.astype(np.int32), samples.node[entry], samples.weight[entry], bounds)


def _noise_gain(samples: PitchSamples, pixels: int, fine: int) -> float:
    """Take the root of the mean sum of squares of what the pixels' heights are worth to each sample.

    Turns and mirror images only swap the pixels: the samples before the symmetries are enough.
    """
    spread = interpolation(pixels, fine)
    nodes = len(spread)
    rows = np.zeros((_RIDE_SAMPLES, nodes * nodes))
    entries = samples.starts[: _RIDE_SAMPLES + 1]
    row = np.repeat(np.arange(_RIDE_SAMPLES), np.diff(entries))
    rows[row, samples.node[: entries[-1]] % nodes**2] = samples.weight[: entries[-1]]
    worth = spread.T @ rows.reshape(-1, nodes, nodes) @ spread
    return float(np.sqrt((worth**2).sum() / _RIDE_SAMPLES))


def cosines(pixels: int) -> Floats:
    """Orthonormal cosines (DCT-II), (order, pixel): those of a line that is mirrored at its ends."""
    k, i = np.arange(pixels)[:, None], np.arange(pixels)[None, :]
    scale = np.where(k == 0, 1.0, 2.0) / pixels
    waves: Floats = np.sqrt(scale) * np.cos(np.pi * (i + 0.5) * k / pixels)
    return waves


def interpolation(pixels: int, fine: int) -> Floats:
    """Weights (nodes, pixels) that turn a line of pixels into nodes: linear between centres, level outside of them."""
    place = np.arange(pixels * fine + 1) / fine - 0.5
    low = np.clip(np.floor(place), 0, pixels - 2).astype(np.int64)
    part = np.clip(place - low, 0.0, 1.0)
    weights = np.zeros((len(place), pixels))
    rows = np.arange(len(place))
    weights[rows, low] = 1 - part
    weights[rows, low + 1] += part
    return weights
