"""The ride operator: where a vehicle's wheels stand on a patch, how fast its chassis pitches there, rolls and lifts.

Strategy. A patch goes on forever, mirrored at its edges, and a wheel's centre rolls on the envelope of that ground
(grey dilation with the wheel's shape: a cylinder, turned to the nearest of four directions). Everything after that is
linear in the envelope: the pitch of a side is the height of its front axle less that of its rear axle over the
wheelbase, the chassis takes the mean of both sides, follows it through its suspension (a spring and a damper), and what
counts is the change of its pitch per metre driven. So each *sample*, a place and a heading, is one row of a sparse
matrix over the nodes of the envelopes, the same for every patch, and the geometric C_r of a patch is the mean absolute
value of matrix times envelopes. The samples are spread evenly over the patch and all headings and are closed under the
symmetries of the square: a patch that is turned or mirrored gets the same answer.

*Motion* at several speeds is more rows over the same rolled wheels (``motion_operator.cpp``):

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
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bumpymap.core import Floats, loops
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
            samples=samples,
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
    return np.asarray(response / response.sum())


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
    return np.sqrt(scale) * np.cos(np.pi * (i + 0.5) * k / pixels)


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


def roll_over(relief_map: NDArray[np.float32], operator: RideOperator) -> Rides:
    """Roll a vehicle over patches.

    ``relief_map`` (n, pixels, pixels): plane-removed relief without holes, m; patches with NaN are left out.
    """
    patches = np.ascontiguousarray(relief_map, np.float32)
    known = _without_holes(patches)
    motions = np.full((len(relief_map), 1, 2), np.nan)
    stands = np.full((len(relief_map), 3), np.nan)
    loops.ride_patches(known, patches, operator, operator, motions, stands)
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
        starts, node, weight, bounds = zip(*groups, strict=True)
        rows, ends = (np.cumsum(np.concatenate(([0], *map(np.diff, each)))) for each in (starts, bounds))
        samples = PitchSamples(rows.astype(np.int32), np.concatenate(node), np.concatenate(weight), ends)
        return cls(tuple(speeds), lattice.fine, lattice.wheel, samples)


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
    return np.asarray(high_pass * low_pass * transition * step)


def felt_response(frequency: NDArray[np.floating]) -> NDArray[np.complex128]:
    """Return the weighted acceleration [m/s2] for a vertical motion of 1 m at frequencies [Hz], up to 10 Hz."""
    p: NDArray[Any] = 1j * frequency / WEIGHTED_BAND_HZ[1]
    cut = _second_order(p, _CUT_Q[0]) * _second_order(p, _CUT_Q[1])
    return np.asarray((2j * np.pi * frequency) ** 2 * weighting_wk(frequency) / cut)


def _second_order(p: NDArray[Any], quality: float) -> NDArray[Any]:
    return np.asarray(1 + p / quality + p**2)


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
