"""Compiled loops: a vehicle's wheels on the ground of patches; see ``bumpymap.rating.ride.operator`` for the model.

Nothing here allocates: scratch arrays come from the caller. Sums run in one fixed order, so the same patch gives the
same bits wherever it stands among others.

Eight patches go side by side (*lanes*): a processor computes eight numbers as fast as one, but only where nothing
depends on their order. The sums over one patch keep their order, and so their bits; eight patches know nothing of each
other. Written out for eight, compiled code holds them in one register.
"""

import math
from collections.abc import Callable
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.rating.ride.operator import AxisSamples, PitchSamples, Poses, WheelShape
from bumpytiles import helper, kernel

LANES = 8
"""Patches side by side."""
Lanes = tuple[Any, Any, Any, Any, Any, Any, Any, Any]
"""A number of each of them."""


@helper
def same(value: Any) -> Lanes:
    """One number for all lanes."""
    return value, value, value, value, value, value, value, value


@helper
def load(values: Any, first: int) -> Lanes:
    """Eight numbers of an array, from a place on."""
    return (
        values[first],
        values[first + 1],
        values[first + 2],
        values[first + 3],
        values[first + 4],
        values[first + 5],
        values[first + 6],
        values[first + 7],
    )


@helper
def store(lanes: Lanes, out: Any, first: int) -> None:
    """Write eight numbers to an array, from a place on."""
    for lane, value in enumerate(lanes):
        out[first + lane] = value


@helper
def each2(function: Callable[..., Any], a: Lanes, b: Lanes) -> Lanes:
    """Apply a helper that takes two numbers to each lane."""
    return (
        function(a[0], b[0]),
        function(a[1], b[1]),
        function(a[2], b[2]),
        function(a[3], b[3]),
        function(a[4], b[4]),
        function(a[5], b[5]),
        function(a[6], b[6]),
        function(a[7], b[7]),
    )


@helper
def each3(function: Callable[..., Any], a: Lanes, b: Lanes, c: Lanes) -> Lanes:
    """Apply a helper that takes three numbers to each lane."""
    return (
        function(a[0], b[0], c[0]),
        function(a[1], b[1], c[1]),
        function(a[2], b[2], c[2]),
        function(a[3], b[3], c[3]),
        function(a[4], b[4], c[4]),
        function(a[5], b[5], c[5]),
        function(a[6], b[6], c[6]),
        function(a[7], b[7], c[7]),
    )


@helper
def each4(function: Callable[..., Any], a: Lanes, b: Lanes, c: Lanes, d: Lanes) -> Lanes:
    """Apply a helper that takes four numbers to each lane."""
    return (
        function(a[0], b[0], c[0], d[0]),
        function(a[1], b[1], c[1], d[1]),
        function(a[2], b[2], c[2], d[2]),
        function(a[3], b[3], c[3], d[3]),
        function(a[4], b[4], c[4], d[4]),
        function(a[5], b[5], c[5], d[5]),
        function(a[6], b[6], c[6], d[6]),
        function(a[7], b[7], c[7], d[7]),
    )


@helper
def _plus(a: Any, b: Any) -> Any:
    return a + b


@helper
def _with_part(total: Any, weight: Any, value: Any) -> Any:
    return total + weight * value


@helper
def _with_size(total: Any, value: Any) -> Any:
    return total + abs(value)


@helper
def _with_square(total: Any, value: Any) -> Any:
    wide = np.float64(value)
    return total + wide * wide


@helper
def add(total: Lanes, more: Lanes) -> Lanes:
    """Add numbers."""
    return each2(_plus, total, more)


@helper
def add_part(total: Lanes, weight: Any, values: Lanes) -> Lanes:
    """Add numbers times a weight."""
    return each3(_with_part, total, same(weight), values)


@helper
def add_size(total: Lanes, values: Lanes) -> Lanes:
    """Add absolute values."""
    return each2(_with_size, total, values)


@helper
def add_square(total: Lanes, values: Lanes) -> Lanes:
    """Add squares, in double precision."""
    return each2(_with_square, total, values)


Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int32]

GROUP = 2 * LANES
"""Patches that ride side by side: their heights lie together, so a processor computes all of them at once."""


class PatchesToRide(NamedTuple):
    """Patches."""

    known: Annotated[NDArray[np.bool_], 1]
    """(tiles,) whether to ride it; others keep what the results hold."""
    relief: Annotated[Singles, 3]
    """(tiles, pixels, pixels) plane-removed relief without holes, m."""
    fine: int
    """Nodes along the side of a pixel."""


class VehicleGeometry(NamedTuple):
    """Lengths of a vehicle, m."""

    wheelbase: float
    track: float
    belly_half: float
    """Half of the belly's length."""
    clearance: float


class RideScratch(NamedTuple):
    """Scratch for a group of patches, see `ride_scratch`; the last axis of heights is the patch."""

    relief: Annotated[Singles, 3]
    """(pixels, pixels, group) m."""
    wide: Annotated[Singles, 3]
    """(nodes + 2 margin,) twice and group: heights at the nodes with a mirrored margin, m."""
    envelope: Annotated[Singles, 2]
    """(directions nodes^2, group) heights of the lowest point of a wheel in each direction, m."""
    bare: Annotated[Singles, 2]
    """(nodes^2, group) heights at the nodes, m."""
    members: Annotated[NDArray[np.int64], 1]
    """(group,) which patches these are."""
    rides: Annotated[Floats, 2]
    """(6, group) what a group's rides are."""


def ride_scratch(pixels: int, nodes: int, margin: int, directions: int) -> RideScratch:
    """Make scratch for patches of so many pixels and nodes along a side, and wheels in so many directions."""
    wide = nodes + 2 * margin
    return RideScratch(
        np.zeros((pixels, pixels, GROUP), np.float32),
        np.empty((wide, wide, GROUP), np.float32),
        np.empty((directions * nodes * nodes, GROUP), np.float32),
        np.empty((nodes * nodes, GROUP), np.float32),
        np.empty(GROUP, np.int64),
        np.empty((6, GROUP)),
    )


@helper
def _between(a: Any, b: Any, share: Any) -> Any:
    return a + (b - a) * share


@helper
def _higher(low: Any, ground: Any, lift: Any) -> Any:
    return max(low, ground + lift)


@helper
def _pitch(fl: Any, fr: Any, rl: Any, rr: Any) -> Any:
    return fl + fr - rl - rr


@helper
def _roll(fl: Any, fr: Any, rl: Any, rr: Any) -> Any:
    return fl - fr + rl - rr


@helper
def _twist(fl: Any, fr: Any, rl: Any, rr: Any) -> Any:
    return fl - fr - rl + rr


@helper
def _sum(fl: Any, fr: Any, rl: Any, rr: Any) -> Any:
    return fl + fr + rl + rr


@helper
def over(a: Any, b: Any) -> Any:
    """One number over another, for `each2`."""
    return a / b


@helper
def _above(ground: Any, level: Any, ahead: Any, pitch: Any) -> Any:
    return ground - level - ahead * pitch


@helper
def _larger(least: Any, above: Any, clearance: Any) -> Any:
    return max(least, above / clearance)


@helper
def take_group(patches: PatchesToRide, first: int, scratch: RideScratch) -> int:
    """Fill the scratch with the next known patches from the ``first`` on, a group at most; return their number."""
    pixels, held = patches.relief.shape[1], 0
    for t in range(first, len(patches.known)):
        if held == GROUP:
            break
        if patches.known[t]:
            for r in range(pixels):
                for c in range(pixels):
                    scratch.relief[r, c, held] = patches.relief[t, r, c]
            scratch.members[held] = t
            held += 1
    return held


@helper
def lay_nodes(fine: int, nodes: int, scratch: RideScratch) -> None:
    """Bilinear heights at the nodes of a group of patches, with a mirrored margin around them."""
    relief, wide = scratch.relief, scratch.wide
    pixels, sides = relief.shape[0], wide.shape[0]
    margin, period = (sides - nodes) // 2, 2 * (nodes - 1)
    for row in range(nodes):
        y = row / fine - 0.5
        j = min(max(math.floor(y), 0), pixels - 2)
        up = np.float32(min(max(y - j, 0.0), 1.0))
        for col in range(nodes):
            x = col / fine - 0.5
            i = min(max(math.floor(x), 0), pixels - 2)
            right = np.float32(min(max(x - i, 0.0), 1.0))
            for first in (0, LANES):
                share = same(right)
                north = each3(_between, load(relief[j, i], first), load(relief[j, i + 1], first), share)
                south = each3(_between, load(relief[j + 1, i], first), load(relief[j + 1, i + 1], first), share)
                height = each3(_between, north, south, same(up))
                store(height, wide[row + margin, col + margin], first)
                store(height, scratch.bare[row * nodes + col], first)
    for r in range(sides):
        row = (r - margin) % period
        row = min(row, period - row) + margin
        for c in range(sides):
            col = (c - margin) % period
            col = min(col, period - col) + margin
            if row != r or col != c:
                for lane in range(GROUP):
                    wide[r, c, lane] = wide[row, col, lane]


@helper
def roll_wheel(nodes: int, wheel: WheelShape, scratch: RideScratch) -> None:
    """Height of the lowest point of a wheel that touches the ground, for each direction and node of a group."""
    wide, margin = scratch.wide, (scratch.wide.shape[0] - nodes) // 2
    at = 0
    for turn in range(len(wheel.starts) - 1):
        for r in range(nodes):
            for c in range(nodes):
                low = high = same(np.float32(-3e38))
                for o in range(wheel.starts[turn], wheel.starts[turn + 1]):
                    # Unsigned: without code for negative indices.
                    row, col = np.uintp(r + margin + wheel.row[o]), np.uintp(c + margin + wheel.col[o])
                    ground, lift = wide[row, col], same(wheel.rise[o])
                    low = each3(_higher, low, load(ground, 0), lift)
                    high = each3(_higher, high, load(ground, LANES), lift)
                store(low, scratch.envelope[at], 0)
                store(high, scratch.envelope[at], LANES)
                at += 1


@helper
def sample_means(samples: PitchSamples | AxisSamples, first: int, last: int, envelope: Singles, rides: Floats) -> None:
    """Fill mean absolute value and root mean square of the samples from first to last, for a group of patches."""
    number = last - first
    sizes = more_sizes = squares = more_squares = same(0.0)
    for s in range(first, last):
        low = high = same(np.float32(0.0))
        for k in range(samples.starts[s], samples.starts[s + 1]):
            weight, at = samples.weight[k], envelope[np.uintp(samples.node[k])]
            low, high = add_part(low, weight, load(at, 0)), add_part(high, weight, load(at, LANES))
        sizes, more_sizes = add_size(sizes, low), add_size(more_sizes, high)
        squares, more_squares = add_square(squares, low), add_square(more_squares, high)
    store(sizes, rides[0], 0)
    store(more_sizes, rides[0], LANES)
    store(squares, rides[1], 0)
    store(more_squares, rides[1], LANES)
    for lane in range(GROUP):
        rides[0, lane] = rides[0, lane] / number
        rides[1, lane] = math.sqrt(rides[1, lane] / number)


@helper
def _read(node: Integers, weight: Singles, values: Singles, first: int) -> Lanes:
    total = same(0.0)
    for k in range(4):
        total = add_part(total, weight[k], load(values[np.uintp(node[k])], first))
    return total


@helper
def _pose_numbers(poses: Poses, geometry: VehicleGeometry, scratch: RideScratch, first: int) -> None:
    """Fill root mean squares of pitch, roll and twist [rad], and how far the ground reaches to the belly."""
    pitches = rolls = twists = strike = same(0.0)
    envelope, rides = scratch.envelope, scratch.rides
    number = poses.wheel_node.shape[0]
    for p in range(number):
        fl = _read(poses.wheel_node[p, 0], poses.wheel_weight[p, 0], envelope, first)
        fr = _read(poses.wheel_node[p, 1], poses.wheel_weight[p, 1], envelope, first)
        rl = _read(poses.wheel_node[p, 2], poses.wheel_weight[p, 2], envelope, first)
        rr = _read(poses.wheel_node[p, 3], poses.wheel_weight[p, 3], envelope, first)
        pitch = each2(over, each4(_pitch, fl, fr, rl, rr), same(2.0 * geometry.wheelbase))
        roll = each2(over, each4(_roll, fl, fr, rl, rr), same(2.0 * geometry.track))
        twist = each2(over, each4(_twist, fl, fr, rl, rr), same(2.0 * geometry.wheelbase))
        pitches, rolls, twists = add_square(pitches, pitch), add_square(rolls, roll), add_square(twists, twist)
        level = each2(over, each4(_sum, fl, fr, rl, rr), same(4.0))
        for place in range(3):
            ground = _read(poses.belly_node[p, place], poses.belly_weight[p, place], scratch.bare, first)
            ahead = same((1 - place) * geometry.belly_half)
            strike = each3(_larger, strike, each4(_above, ground, level, ahead, pitch), same(geometry.clearance))
    store(pitches, rides[2], first)
    store(rolls, rides[3], first)
    store(twists, rides[4], first)
    store(strike, rides[5], first)
    for k in range(2, 5):
        for lane in range(first, first + LANES):
            rides[k, lane] = math.sqrt(rides[k, lane] / number)


@kernel
def ride_patches(
    patches: PatchesToRide,
    wheel: WheelShape,
    samples: PitchSamples,
    axes: AxisSamples,
    poses: Poses,
    geometry: VehicleGeometry,
    rides: Annotated[Floats, 2],
    scratch: RideScratch,
) -> None:
    """Roll a vehicle over patches.

    ``rides`` (tiles, 6 or 14) is filled: mean and root mean square of the pitch change [rad/m]; root mean square of
    pitch, roll and twist [rad]; reach of the ground towards the belly (1: it touches); mean pitch change by axis.
    """
    nodes = patches.relief.shape[1] * patches.fine + 1
    held = take_group(patches, 0, scratch)
    while held > 0:
        lay_nodes(patches.fine, nodes, scratch)
        roll_wheel(nodes, wheel, scratch)
        sample_means(samples, 0, len(samples.starts) - 1, scratch.envelope, scratch.rides)
        _pose_numbers(poses, geometry, scratch, 0)
        _pose_numbers(poses, geometry, scratch, LANES)
        for lane in range(held):
            for k in range(6):
                rides[scratch.members[lane], k] = scratch.rides[k, lane]
        for axis in range(rides.shape[1] - 6):
            sample_means(axes, axes.bounds[axis], axes.bounds[axis + 1], scratch.envelope, scratch.rides)
            for lane in range(held):
                rides[scratch.members[lane], 6 + axis] = scratch.rides[0, lane]
        held = take_group(patches, scratch.members[held - 1] + 1, scratch)


@kernel
def normal_shares(z: Annotated[Floats, 1], share: Annotated[Floats, 1]) -> None:
    """Fill the share of the standard normal distribution below each z, both (n,)."""
    for i in range(len(z)):
        share[i] = 0.5 * math.erfc(-z[i] / math.sqrt(2.0))


@helper
def _node_height(heights: Floats, fine: int, i: int, j: int) -> float:
    """Bilinear height between the centres of pixels at a node, ``fine`` of which lie along a pixel, m."""
    row, col = i / fine - 0.5, j / fine - 0.5
    top, left = math.floor(row), math.floor(col)
    south, east = row - top, col - left
    a, b = heights[top, left], heights[top, left + 1]
    a, b = a + (heights[top + 1, left] - a) * south, b + (heights[top + 1, left + 1] - b) * south
    height: float = a + (b - a) * east
    return height


@kernel
def roll_along(
    heights: Annotated[Floats, 2],
    place: Annotated[Floats, 2],
    turn: Annotated[NDArray[np.int64], 1],
    fine: int,
    wheel: WheelShape,
    envelope: Annotated[Floats, 3],
    known: Annotated[NDArray[np.bool_], 3],
    low: Annotated[Floats, 1],
) -> None:
    """Fill the lowest point of wheels at n places, m; NaN where one meets ground that is not known.

    ``heights`` (rows, cols): m; ``place`` (n, 2): row and column, pixels, a wheel and two pixels or more from all
    edges; ``turn`` (n,): the direction of ``wheel``. ``envelope`` and ``known``, at first False, hold the wheel in each
    direction on each of (rows fine + 1, cols fine + 1) nodes.
    """
    for k in range(len(place)):
        to = turn[k]
        row, col = place[k, 0] * fine, place[k, 1] * fine
        i, j = math.floor(row), math.floor(col)
        south, east = row - i, col - j
        total = 0.0
        for down in range(2):
            for right in range(2):
                if not known[to, i + down, j + right]:
                    highest = -math.inf
                    for n in range(wheel.starts[to], wheel.starts[to + 1]):
                        ground = _node_height(heights, fine, i + down + wheel.row[n], j + right + wheel.col[n])
                        lift = ground + wheel.rise[n]
                        if math.isnan(lift):
                            highest = lift
                            break
                        highest = max(highest, lift)
                    known[to, i + down, j + right] = True
                    envelope[to, i + down, j + right] = highest
                weight = (south if down == 1 else 1.0 - south) * (east if right == 1 else 1.0 - east)
                total += envelope[to, i + down, j + right] * weight
        low[k] = total
