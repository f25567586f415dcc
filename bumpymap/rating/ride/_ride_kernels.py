"""Compiled loops: a vehicle's wheels on the ground of patches; see ``bumpymap.rating.ride.operator`` for the model.

Nothing here allocates: scratch arrays come from the caller. Sums run in one fixed order, so the same patch gives the
same bits wherever it stands among others.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.rating.ride.operator import PitchSamples, Poses, WheelShape
from bumpytiles import helper, kernel

__all__ = ["PatchesToRide", "RideScratch", "VehicleGeometry", "normal_shares", "ride_patches", "ride_scratch"]

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int32]

_GROUP = 8
"""Patches that ride side by side: their envelopes lie together, so a processor adds for all of them at once."""


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
    """Scratch, see `ride_scratch`."""

    wide: Annotated[Singles, 2]
    """(nodes + 2 margin,) twice: heights at the nodes with a mirrored margin."""
    top: Annotated[Singles, 2]
    """(nodes, nodes) envelope of one patch."""
    envelope: Annotated[Singles, 2]
    """(nodes^2, group) envelopes of a group of patches."""
    bare: Annotated[Singles, 2]
    """The same of the bare ground."""
    members: Annotated[NDArray[np.int64], 1]
    """(group,) which patches these are."""
    sums: Annotated[Floats, 2]
    """(2, group) sums over samples."""


def ride_scratch(nodes: int, margin: int) -> RideScratch:
    """Make scratch for patches of so many nodes along a side."""
    wide = nodes + 2 * margin
    return RideScratch(
        np.empty((wide, wide), np.float32),
        np.empty((nodes, nodes), np.float32),
        np.zeros((nodes * nodes, _GROUP), np.float32),
        np.zeros((nodes * nodes, _GROUP), np.float32),
        np.empty(_GROUP, np.int64),
        np.empty((2, _GROUP)),
    )


@helper
def _lay_nodes(patch: Singles, fine: int, wide: Singles, margin: int) -> None:
    """Bilinear heights at the nodes of a patch, with a mirrored margin around them."""
    pixels = patch.shape[0]
    nodes = pixels * fine + 1
    period = 2 * (nodes - 1)
    for r in range(wide.shape[0]):
        row = (r - margin) % period
        row = min(row, period - row)
        y = row / fine - 0.5
        j = min(max(math.floor(y), 0), pixels - 2)
        up = np.float32(min(max(y - j, 0.0), 1.0))
        for c in range(wide.shape[1]):
            col = (c - margin) % period
            col = min(col, period - col)
            x = col / fine - 0.5
            i = min(max(math.floor(x), 0), pixels - 2)
            right = np.float32(min(max(x - i, 0.0), 1.0))
            north = patch[j, i] + (patch[j, i + 1] - patch[j, i]) * right
            south = patch[j + 1, i] + (patch[j + 1, i + 1] - patch[j + 1, i]) * right
            wide[r, c] = north + (south - north) * up


@helper
def _roll_wheel(wide: Singles, margin: int, wheel: WheelShape, top: Singles, out: Singles, lane: int) -> None:
    """Height of the lowest point of a wheel that touches the ground, at every node, into a lane of ``out``."""
    nodes = top.shape[0]
    for r in range(nodes):
        line = top[r]
        for c in range(nodes):
            line[c] = np.float32(-3e38)
        for o in range(len(wheel.row)):
            first = margin + wheel.col[o]
            ground = wide[r + margin + wheel.row[o], first : first + nodes]
            lift = wheel.rise[o]
            for c in range(nodes):
                line[c] = max(line[c], ground[c] + lift)
        for c in range(nodes):
            out[r * nodes + c, lane] = line[c]


@helper
def _pitch_sums(samples: PitchSamples, envelope: Singles, sums: Floats) -> None:
    """Sum the size and the square of every sample's pitch change, for a group of patches."""
    for lane in range(_GROUP):
        sums[0, lane] = sums[1, lane] = 0.0
    for s in range(len(samples.starts) - 1):
        a = b = c = d = e = f = g = h = np.float32(0.0)
        for k in range(samples.starts[s], samples.starts[s + 1]):
            w, at = samples.weight[k], envelope[samples.node[k]]
            a += w * at[0]
            b += w * at[1]
            c += w * at[2]
            d += w * at[3]
            e += w * at[4]
            f += w * at[5]
            g += w * at[6]
            h += w * at[7]
        for lane, value in enumerate((a, b, c, d, e, f, g, h)):
            size = np.float64(abs(value))
            sums[0, lane] += size
            sums[1, lane] += size * size


@helper
def _read(node: Integers, weight: Singles, values: Singles, lane: int) -> float:
    total = 0.0
    for k in range(4):
        total += weight[k] * values[node[k], lane]
    return total


@helper
def _pose_numbers(
    poses: Poses, geometry: VehicleGeometry, envelope: Singles, bare: Singles, lane: int, out: Floats
) -> None:
    """Root mean squares of pitch, roll and twist [rad], and how far the ground reaches to the belly (1: it touches)."""
    pitches = rolls = twists = 0.0
    strike = 0.0
    number = poses.wheel_node.shape[0]
    for p in range(number):
        fl = _read(poses.wheel_node[p, 0], poses.wheel_weight[p, 0], envelope, lane)
        fr = _read(poses.wheel_node[p, 1], poses.wheel_weight[p, 1], envelope, lane)
        rl = _read(poses.wheel_node[p, 2], poses.wheel_weight[p, 2], envelope, lane)
        rr = _read(poses.wheel_node[p, 3], poses.wheel_weight[p, 3], envelope, lane)
        pitch = (fl + fr - rl - rr) / (2.0 * geometry.wheelbase)
        roll = (fl - fr + rl - rr) / (2.0 * geometry.track)
        twist = (fl - fr - rl + rr) / (2.0 * geometry.wheelbase)
        pitches += pitch * pitch
        rolls += roll * roll
        twists += twist * twist
        level = 0.25 * (fl + fr + rl + rr)
        for place in range(3):
            ground = _read(poses.belly_node[p, place], poses.belly_weight[p, place], bare, lane)
            strike = max(strike, (ground - level - (1 - place) * geometry.belly_half * pitch) / geometry.clearance)
    out[2], out[3], out[4] = math.sqrt(pitches / number), math.sqrt(rolls / number), math.sqrt(twists / number)
    out[5] = strike


@helper
def _lay_patch(patches: PatchesToRide, t: int, wheel: WheelShape, scratch: RideScratch, lane: int) -> None:
    """Put the envelope and the bare ground of a patch into a lane of the group's."""
    nodes, margin = scratch.top.shape[0], (scratch.wide.shape[0] - scratch.top.shape[0]) // 2
    _lay_nodes(patches.relief[t], patches.fine, scratch.wide, margin)
    _roll_wheel(scratch.wide, margin, wheel, scratch.top, scratch.envelope, lane)
    for r in range(nodes):
        for c in range(nodes):
            scratch.bare[r * nodes + c, lane] = scratch.wide[r + margin, c + margin]


@kernel
def ride_patches(
    patches: PatchesToRide,
    wheel: WheelShape,
    samples: PitchSamples,
    poses: Poses,
    geometry: VehicleGeometry,
    rides: Annotated[Floats, 2],
    scratch: RideScratch,
) -> None:
    """Roll a vehicle over patches.

    ``rides`` (tiles, 6) is filled: mean and root mean square of the pitch change [rad/m]; root mean square of pitch,
    roll and twist [rad]; reach of the ground towards the belly (1: it touches).
    """
    tiles, number = len(patches.known), len(samples.starts) - 1
    t = 0
    while t < tiles:
        held = 0
        while t < tiles and held < _GROUP:
            if patches.known[t]:
                _lay_patch(patches, t, wheel, scratch, held)
                scratch.members[held] = t
                held += 1
            t += 1
        if held == 0:
            continue
        _pitch_sums(samples, scratch.envelope, scratch.sums)
        for lane in range(held):
            ride = rides[scratch.members[lane]]
            ride[0] = scratch.sums[0, lane] / number
            ride[1] = math.sqrt(scratch.sums[1, lane] / number)
            _pose_numbers(poses, geometry, scratch.envelope, scratch.bare, lane, ride)


@kernel
def normal_shares(z: Annotated[Floats, 1], share: Annotated[Floats, 1]) -> None:
    """Fill the share of the standard normal distribution below each z, both (n,)."""
    for i in range(len(z)):
        share[i] = 0.5 * math.erfc(-z[i] / math.sqrt(2.0))
