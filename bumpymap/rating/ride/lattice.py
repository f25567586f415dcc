"""Samples of a patch that goes on forever: places, headings, and what each reads of the nodes under the wheels."""

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["NodeLattice", "PitchSamples", "Places", "WheelShares", "spread_places", "wheel_rows"]

Floats = NDArray[np.float64]
Places = tuple[Floats, Floats, Floats]
"""Easting, northing [m] and heading [rad] of samples, (n,) each."""


class PitchSamples(NamedTuple):
    """Rows of a sparse matrix over the nodes (compressed rows)."""

    starts: Annotated[NDArray[np.int32], 1]
    """(samples + 1,) where each row begins."""
    node: Annotated[NDArray[np.int32], 1]
    """(entries,) index into the flat (nodes, nodes) envelope."""
    weight: Annotated[NDArray[np.float32], 1]
    """(entries,) rad/m of pitch change per metre of height."""


class WheelShares(NamedTuple):
    """How much the heights of the wheels count in a sample."""

    sign: tuple[int, int, int, int]
    """Of each wheel: front left, front right, rear left, rear right."""
    share: Annotated[NDArray[np.floating], 1]
    """(k,) per metre of height."""
    back: Annotated[NDArray[np.floating], 1]
    """(k,) how far behind the sample, m."""


@dataclass(frozen=True, slots=True)
class NodeLattice:
    """The nodes of a patch that is mirrored at its edges forever."""

    nodes: int
    step: float

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

    def _mirrored(self, index: NDArray[np.int64]) -> NDArray[np.int64]:
        """Mirror at the edge nodes, which lie on the patch's edges."""
        period = 2 * (self.nodes - 1)
        wrapped = index % period
        return np.minimum(wrapped, period - wrapped)


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
    lattice: NodeLattice, places: Places, wheels: WheelShares, wheelbase: float, track: float
) -> PitchSamples:  # fmt: skip
    """Rows that give a sum over the heights of the wheels, behind and ahead of each sample."""
    x, y, heading = places
    nodes, weights = [], []
    for (forward, left), sign in zip(((1, 1), (1, -1), (-1, 1), (-1, -1)), wheels.sign, strict=True):
        along, beside = forward * wheelbase / 2 - wheels.back, left * track / 2
        east = x[:, None] + np.cos(heading)[:, None] * along - np.sin(heading)[:, None] * beside
        north = y[:, None] + np.sin(heading)[:, None] * along + np.cos(heading)[:, None] * beside
        node, weight = lattice.read(east, north)
        nodes.append(node.reshape(len(x), -1))
        weights.append((weight * (sign * wheels.share)[:, None]).reshape(len(x), -1))
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
    return PitchSamples(starts.astype(np.int32), (keys % size).astype(np.int32), total.astype(np.float32))
