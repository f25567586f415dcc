"""Kernels that surveys and scans share: random numbers, RANSAC, the filling of holes.

RANSAC (Fischler and Bolles 1981) draws three points at a time and keeps the plane that most points lie near. Its
generator is seeded by the tile or the sector, so the same points give the same plane in any company; it scores
candidates on a sample of the points, and stops when a better one has become improbable.
"""

import math

import numpy as np
from numpy.typing import NDArray

from bumpytiles import helper

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int32]
Plane = tuple[float, float, float, float]
"""Unit normal (a, b, c), upward, and d of a x + b y + c z + d = 0; all zero where there is none."""

NO_PLANE: Plane = (0.0, 0.0, 0.0, 0.0)
_MISS_PROBABILITY = 1e-4
"""Accepted probability that no candidate was drawn from inliers alone."""
_LEAST_AREA = 2e-3
"""Twice the least area that a candidate's three points must span, m^2."""


@helper
def next_random(state: np.uint64) -> tuple[np.uint64, np.uint64]:
    """One step of splitmix64: the new state and 64 mixed bits."""
    state = state + np.uint64(0x9E3779B97F4A7C15)
    z = state
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return state, z ^ (z >> np.uint64(31))


@helper
def _three_below(bits: np.uint64, n: int) -> tuple[int, int, int]:
    """Turn 63 random bits into three numbers from 0 to n - 1."""
    mask, width, size = np.uint64(0x1FFFFF), np.uint64(21), np.uint64(n)
    i = ((bits & mask) * size) >> width
    j = (((bits >> width) & mask) * size) >> width
    k = (((bits >> np.uint64(42)) & mask) * size) >> width
    return np.int64(i), np.int64(j), np.int64(k)  # type: ignore[return-value]


@helper
def _count_near(sample: Singles, n: int, plane: tuple[np.float32, ...], reach: np.float32) -> np.int32:
    """Count the first n points of the sample with ``|a x + b y + c z + d| <= reach``."""
    x, y, z = sample[0, :n], sample[1, :n], sample[2, :n]
    a, b, c, d = plane
    hits = np.int32(0)
    for i in range(n):
        hits = np.int32(hits + np.int32(abs(a * x[i] + b * y[i] + c * z[i] + d) <= reach))
    return hits


@helper
def best_candidate(
    x: Floats, y: Floats, z: Floats, sample: Singles, threshold: float, seed: np.uint64, most: int, unit: bool
) -> Plane:
    """Return the plane through three of the points that has the most of the sample near it; zeros where none has any.

    Single precision is enough to count: coordinates start amid the points, so it errs by 1e-7 of a tile's side.

    Parameters
    ----------
    x, y, z : (n,) float64
        Points to draw from, centred, m.
    sample : (3, room) float32
        Points to score on; the first ``min(n, room)`` are there.
    threshold : float
        Distance of an inlier, m.
    most : int
        Candidates at most.
    unit : bool
        Score with normals of unit length; otherwise the threshold is multiplied by their length, which is faster.
    """
    n = min(len(x), sample.shape[1])
    best, plane = np.int32(0), NO_PLANE
    state, needed, drawn = seed, most, 0
    while drawn < needed:
        drawn += 1
        state, bits = next_random(state)
        i, j, k = _three_below(bits, len(x))
        ux, uy, uz = x[j] - x[i], y[j] - y[i], z[j] - z[i]
        vx, vy, vz = x[k] - x[i], y[k] - y[i], z[k] - z[i]
        a, b, c = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = math.sqrt(a * a + b * b + c * c)
        if length < _LEAST_AREA:
            continue
        if unit:
            length = -length if c < 0.0 else length
            a, b, c, length = a / length, b / length, c / length, 1.0
        d = -(a * x[i] + b * y[i] + c * z[i])
        singles = np.float32(a), np.float32(b), np.float32(c), np.float32(d)
        hits = _count_near(sample, n, singles, np.float32(threshold * length))
        if hits > best:
            best = hits
            length = -length if c < 0.0 else length
            plane = (a / length, b / length, c / length, d / length)
            clean = (hits / n) ** 3  # chance that all three of a draw are inliers
            if clean >= 1.0 - 1e-9:
                break
            needed = min(most, 1 + int(math.log(_MISS_PROBABILITY) / math.log(1.0 - clean)))
    return plane


@helper
def fill_holes(heights: Floats | Singles, depth: int, holes: Integers, values: Floats | Singles) -> int:
    """Fill NaN pixels in place with the mean of their known 8 neighbours, from the rim inwards, ``depth`` rings deep.

    Scratch of one number a pixel: places of the holes, and what fills them. Sums run in the precision of the heights.
    Returns the number of pixels still unknown.
    """
    size = heights.shape[0]
    zero, one = heights.dtype.type(0.0), heights.dtype.type(1.0)
    missing = 0
    for r in range(size):
        for c in range(size):
            if math.isnan(heights[r, c]):
                holes[missing] = r * size + c
                missing += 1
    for _ in range(depth):
        if missing == 0:
            break
        for k in range(missing):
            row, col = holes[k] // size, holes[k] % size
            total, known = zero, zero
            for r in range(max(0, row - 1), min(size, row + 2)):
                for c in range(max(0, col - 1), min(size, col + 2)):
                    h = heights[r, c]
                    total += h if h == h else zero  # noqa: PLR0124 - no branch, for it could not be foreseen
                    known += one if h == h else zero  # noqa: PLR0124
            values[k] = total / known if known > zero else np.nan
        left = 0
        for k in range(missing):
            heights[holes[k] // size, holes[k] % size] = values[k]
            if math.isnan(values[k]):
                holes[left] = holes[k]
                left += 1
        missing = left
    return missing
