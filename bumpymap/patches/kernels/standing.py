"""Compiled kernel: a heightmap in, the pixels of narrow things with steep sides out; see `find_standing`."""

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.patches.kernels.heightmap import detrend
from bumpymap.patches.kernels.lanes import set_all, set_map
from bumpytiles import helper, kernel, order_free

__all__ = ["StandingLimits", "StandingScratch", "mark_standing", "standing_scratch"]

Singles = NDArray[np.float32]
Bytes = NDArray[np.uint8]


class StandingLimits(NamedTuple):
    """Sizes of things; heights are as single precision has them, like the heights that they are compared with."""

    width: float
    """Radius of the disc that touches the surface beneath things, px."""
    foot: float
    """Farthest from a side to its foot, px."""
    raised: float
    """Pixels so high above that surface are those of things, m."""
    drop: float
    """What a side drops, m."""
    least: float
    """Pixels of things that are lower are left out, m."""
    share: float
    """Share of the pixels of a thing that lie on its sides, at least."""


class StandingScratch(NamedTuple):
    """Scratch, see `standing_scratch`."""

    level: Annotated[NDArray[np.float64], 2]
    """(rows, cols) heights above their plane."""
    above: Annotated[Singles, 2]
    """The same shape and precision of heights: above the plane, later above what lies beneath things; infinite where
    nothing is known."""
    low: Annotated[Singles, 2]
    """The same shape: lowest height within the disc."""
    beneath: Annotated[Singles, 2]
    """The same shape: depth of the surface beneath things."""
    line: Annotated[Singles, 1]
    """(cols + 2 * reach,) a row of pixels, infinite at both ends."""
    lowest: Annotated[Singles, 1]
    """(cols,) the lowest of that row within some pixels of each."""
    raised: Annotated[Bytes, 1]
    """((rows + 2) * (cols + 2),) pixels that are high enough, with one more on all sides that are not."""
    sides: Annotated[Bytes, 1]
    """The same shape: those above a place far lower."""
    thing: Annotated[NDArray[np.int32], 1]
    """(rows * cols,) pixels of one thing."""


def standing_scratch(rows: int, cols: int, radius: float) -> StandingScratch:
    """Make scratch for a heightmap and a disc of a radius [px]."""
    maps = [np.empty((rows, cols), np.float32) for _ in range(3)]
    padded = (rows + 2) * (cols + 2)
    return StandingScratch(
        level=np.empty((rows, cols)),
        above=maps[0],
        low=maps[1],
        beneath=maps[2],
        line=np.empty(cols + 2 * int(radius), np.float32),
        lowest=np.empty(cols, np.float32),
        raised=np.empty(padded, np.uint8),
        sides=np.empty(padded, np.uint8),
        thing=np.empty(rows * cols, np.int32),
    )


@order_free
def _lower(values: Singles, out: Singles) -> None:
    """Lower numbers to those of another row."""
    for c in range(len(out)):
        out[c] = min(out[c], values[c])


@helper
def _lowest_on_disc(values: Singles, radius: float, scratch: StandingScratch, out: Singles) -> None:
    """Fill the lowest value within a disc around each pixel."""
    (rows, cols), reach, line, lowest = values.shape, int(radius), scratch.line, scratch.lowest
    set_map(out, np.inf)
    set_all(line, np.inf)
    for r in range(rows):
        for c in range(cols):
            line[reach + c] = lowest[c] = values[r, c]
        for half in range(reach + 1):  # half the width of the disc
            if half > 0:
                _lower(line[reach - half : reach - half + cols], lowest)
                _lower(line[reach + half : reach + half + cols], lowest)
            for down in range(max(-reach, -r), min(reach, rows - 1 - r) + 1):
                if half * half + down * down <= radius * radius < (half + 1) * (half + 1) + down * down:
                    _lower(lowest, out[r + down])


@helper
def _fill_above(heights: Singles, radius: float, scratch: StandingScratch) -> None:
    """Fill how far each pixel is above the surface that a disc can touch from below: a morphological opening.

    At an edge above a slope, a disc touches only what lies lower: so the plane through all heights comes off first.
    """
    rows, cols = heights.shape
    level, above, low, beneath = scratch.level, scratch.above, scratch.low, scratch.beneath
    for r in range(rows):
        for c in range(cols):
            level[r, c] = heights[r, c]
    detrend(level)
    for r in range(rows):
        for c in range(cols):
            above[r, c] = np.inf if math.isnan(level[r, c]) else level[r, c]
    _lowest_on_disc(above, radius, scratch, low)
    for r in range(rows):
        for c in range(cols):
            low[r, c] = -low[r, c] if low[r, c] < np.inf else np.inf
    _lowest_on_disc(low, radius, scratch, beneath)  # upside down, for the highest
    for r in range(rows):
        for c in range(cols):
            above[r, c] += beneath[r, c]


@helper
def _follow_thing(start: int, wide: int, sides: Bytes, share: float, raised: Bytes, thing: NDArray[np.int32]) -> int:
    """List the raised pixels that hang together with one by sides and corners; returns how many stand, else 0.

    They are no longer marked as raised. Rows of pixels are ``wide``, with one on both ends that is never raised.
    """
    size, steep, at = 1, 0, 0
    thing[0] = start
    raised[start] = 0
    while at < size:
        steep += sides[thing[at]]
        for down in range(-1, 2):
            for right in range(-1, 2):
                k = thing[at] + down * wide + right
                if raised[k] > 0:
                    raised[k] = 0
                    thing[size] = k
                    size += 1
        at += 1
    return size if steep > share * size else 0


@kernel
def mark_standing(
    heights: Annotated[Singles, 2],
    limits: StandingLimits,
    scratch: StandingScratch,
    marks: Annotated[NDArray[np.bool_], 2],
) -> None:
    """Mark the pixels of things."""
    rows, cols = heights.shape
    above, raised, sides, thing = scratch.above, scratch.raised, scratch.sides, scratch.thing
    _fill_above(heights, limits.width, scratch)
    _lowest_on_disc(above, limits.foot, scratch, scratch.low)
    for k in range(len(raised)):
        raised[k] = 0
    for r in range(rows):
        first = (r + 1) * (cols + 2) + 1
        for c in range(cols):
            high = limits.raised < above[r, c] < np.inf
            raised[first + c] = high
            sides[first + c] = high and above[r, c] - scratch.low[r, c] > limits.drop
            marks[r, c] = False
    for start in range(len(raised)):
        if raised[start] > 0:
            for k in range(_follow_thing(start, cols + 2, sides, limits.share, raised, thing)):
                r, c = thing[k] // (cols + 2) - 1, thing[k] % (cols + 2) - 1
                marks[r, c] = above[r, c] >= limits.least
