"""Compiled kernel helpers: whether pulses get through what is overhead, told from its points and those beneath them.

A wall that is seen from above has its points in a strip without ground; a bar, a wire or a branch has ground in it. So
the points around a pixel are put in order across the strip that those overhead lie along, and the part of it is found
where they outnumber the ground most. That holds as many points as it takes at any density: in a thin survey it is
looked for in more pixels.
"""

import math
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpytiles import helper

Floats = NDArray[np.float64]
Integers = NDArray[np.int32]

BENEATH = 3
"""Points overhead that one beneath outweighs: where pulses are hidden, fewer than one in four gets through."""
_CHANCE = 0.609
"""Where half of the pulses get through, points overhead outweigh those of the ground by m somewhere among n with a
chance of about n exp(-m _CHANCE): the log of the root of x^3 = x^2 + x + 1, for steps of +1 and -3 in turn."""
_BIN, _BINS = 0.025, 100
"""Width of the bins across a strip, m, and their number."""
_NARROWEST = 4
"""Bins of what hides the ground, at least: what is narrower than 0.1 m is a wire."""
_STRIP_POINTS, _LEAST_SIDE = 12.0, 1.0
"""Side of the square that is looked at: a strip as narrow as that and as long has so many points on average; m, at
least."""


_OVERLAP = 2
"""Pixels beyond the middle that half a square holds, so that a pixel beside a wall's end is not taken for the wall."""


class StripScratch(NamedTuple):
    """Points of a tile by pixel, and scratch; see `strip_scratch`."""

    head: Annotated[Integers, 2]
    """(pixels, pixels) a point of the pixel, -1 if it has none."""
    after: Annotated[Integers, 1]
    """(most points) another point of the same pixel, -1 after the last one."""
    weight: Annotated[Integers, 1]
    """(most points) 1 for a point overhead, -BENEATH for one beneath."""
    place: Annotated[Floats, 2]
    """(2, most points) columns and rows from the north-west corner of the tile, px."""
    across: Annotated[Integers, 1]
    """(_BINS + 1,) sums of the weights from one side of a strip on."""


def strip_scratch(pixels: int, most_points: int) -> StripScratch:
    """Make scratch for tiles of so many pixels along a side and so many points."""
    arrays: list[Any] = [np.empty((pixels, pixels), np.int32)]
    arrays += [np.empty(most_points, np.int32) for _ in range(2)]
    arrays += [np.empty((2, most_points)), np.empty(_BINS + 1, np.int32)]
    return StripScratch(*arrays)


@helper
def forget_points(scratch: StripScratch) -> None:
    """Begin a tile."""
    for r in range(scratch.head.shape[0]):
        for c in range(scratch.head.shape[1]):
            scratch.head[r, c] = -1


@helper
def add_point(n: int, pixel: tuple[int, int], x: float, y: float, weight: int, scratch: StripScratch) -> None:
    """Add the n-th point of a tile to a pixel (row, column); it lies so many columns and rows from the corner."""
    scratch.after[n], scratch.head[pixel] = scratch.head[pixel], n
    scratch.place[0, n], scratch.place[1, n], scratch.weight[n] = x, y, weight


@helper
def strip_half(density: float, pixel: float) -> int:
    """Pixels on either side of one that are looked at, by points per m2 and the side of a pixel, m."""
    side = max(_LEAST_SIDE, _STRIP_POINTS / (_NARROWEST * _BIN * density))
    return math.ceil(0.5 * (side / pixel - 1.0) - 1e-9)


@helper
def outweighs(over: int, beneath: int, least: float) -> bool:
    """Return whether points overhead outweigh those beneath by so much, and more where there are many."""
    return over - BENEATH * beneath >= least + math.log(over) / _CHANCE


class Window(NamedTuple):
    """Pixels that are looked at: rows and columns, the last ones not included."""

    top: int
    bottom: int
    left: int
    right: int


@helper
def hides_ground(
    r: int, c: int, half: int, least: tuple[float, float], is_low: bool, pixel: float, scratch: StripScratch
) -> bool:
    """Return whether what is overhead in a pixel hides the ground.

    Points overhead must outweigh those beneath by ``least`` in a part of the strip around those of the pixel: by a
    number, and more where there are many points; or, if there is a share, by that share of them and no less than the
    number. One half of the square around the pixel will do, or a smaller one of what is low: at a corner walls meet.
    """
    size, near = scratch.head.shape[0], max(half // 2, _OVERLAP)
    parts = 6 if is_low else 5
    for part in range(parts if half > _OVERLAP else 1):
        # All of the square, its halves, and one of half its side.
        north, south = (_OVERLAP if part == 1 else half), (_OVERLAP if part == 2 else half)
        west, east = (_OVERLAP if part == 3 else half), (_OVERLAP if part == 4 else half)
        if part == 5:
            north = south = west = east = near
        window = Window(max(0, r - north), min(size, r + south + 1), max(0, c - west), min(size, c + east + 1))
        if _strip_weighs(r, c, window, least, pixel, scratch):
            return True
    return False


@helper
def _strip_weighs(
    r: int, c: int, window: Window, least: tuple[float, float], pixel: float, scratch: StripScratch
) -> bool:
    """Return whether points overhead outweigh those beneath in the strip of a window around those of a pixel."""
    n, own = 0, 0
    x0, y0, own_x, own_y = c + 0.5, r + 0.5, 0.0, 0.0
    sx = sy = xx = xy = yy = 0.0
    for row in range(window.top, window.bottom):
        for col in range(window.left, window.right):
            i = scratch.head[row, col]
            while i >= 0:
                if scratch.weight[i] > 0:
                    x, y = scratch.place[0, i] - x0, scratch.place[1, i] - y0
                    n, sx, sy = n + 1, sx + x, sy + y
                    xx, xy, yy = xx + x * x, xy + x * y, yy + y * y
                    if row == r and col == c:
                        own, own_x, own_y = own + 1, own_x + x, own_y + y
                i = scratch.after[i]
    if n < least[0] or own == 0:
        return False
    # Across the strip is the direction in which the points vary least.
    xx, xy, yy = xx - sx * sx / n, xy - sx * sy / n, yy - sy * sy / n
    spread = 0.5 * (xx + yy) - math.sqrt(0.25 * (xx - yy) * (xx - yy) + xy * xy)
    a, b = (spread - yy, xy) if xx < yy else (xy, spread - xx)
    length = math.sqrt(a * a + b * b)
    scale = pixel / _BIN / length if length > 0.0 else 0.0
    a, b = a * scale, b * scale
    middle = 0.5 * _BINS - a * (x0 + own_x / own) - b * (y0 + own_y / own)
    sums = scratch.across
    for k in range(_BINS + 1):
        sums[k] = 0
    for row in range(window.top, window.bottom):
        for col in range(window.left, window.right):
            i = scratch.head[row, col]
            while i >= 0:
                across = middle + a * scratch.place[0, i] + b * scratch.place[1, i]
                if 0.0 <= across < _BINS:
                    sums[int(across) + 1] += scratch.weight[i]
                i = scratch.after[i]
    number, share = least
    return _holds_part(max(number, share * n) if share > 0.0 else number + math.log(n) / _CHANCE, sums)


@helper
def _holds_part(least: float, sums: Integers) -> bool:
    """Return whether a part of a strip around or beside its middle weighs so much; sums its weights."""
    for k in range(_BINS):
        sums[k + 1] += sums[k]
    lowest = sums[0]
    for k in range(_NARROWEST, _BINS + 1):
        if k - _NARROWEST <= _BINS // 2 + 1:
            lowest = min(lowest, sums[k - _NARROWEST])
        if k >= _BINS // 2 and sums[k] - lowest >= least:
            return True
    return False
