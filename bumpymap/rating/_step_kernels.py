"""Compiled kernels: heights of a mosaic of tiles in; gradients, and steps from west to east, out; see ``steps``.

Each works on rows of the mosaic, a whole row at a time, which a processor does for several pixels at once. Steps from
north to south come from the transposed mosaic. Nothing here allocates: scratch arrays come from the caller.
"""

import math
from functools import cache
from itertools import product
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpytiles import helper, kernel

Floats = NDArray[np.float64]
Integers = NDArray[np.int32]

RUN = 4
"""Pixels before and after the middle one of a run."""
REACH = 4
"""Pixels on each side of a step that are looked at."""
SIDE = 2
"""Pixels from a step to what counts as its sides."""
UNKNOWN_NOISE = 0.15
"""Steps below this do not count where the noise of both sides is unknown, m."""
_RAMP = 0.4
"""A step counts in full from so much above the limit on, as a share of it."""
_BELIEVED, _CERTAIN = 0.7, 0.85
"""Shares of a step that must lie between its sides: below the first it does not count, from the second in full."""
_SURE = 3.0
"""Standard errors of a median between it and the height that counts as that of a side."""
_ASTRAY = 0.2
"""Share of the points of a side that may lie beyond that height."""
_BESIDE = 0.9
"""Pixels from the middle of a wall to those beside it."""
_LEAST_POINTS = 5
"""Known pixels on each side of a step."""
_LEAST_ON_RIDGE = 2
"""Known pixels on the line of a ridge."""
_ASTRAY_ON_RIDGE = 0.25
"""Share of them that may lie below the height that counts."""
_FOOT = 0.38
"""From the line of a ridge to the ground beside it, in widths of a level."""
_RIM = 2
"""Pixels along the edges where the rating underestimates a wall: 0.4 m of 3 m."""
_RUN_LENGTH = 2 * RUN + 1
_TURNS, _LISTS = 4, 5
"""A line moves up to so many quarters of a pixel to either side with every row; and the lists of places for each."""


class StepMosaic(NamedTuple):
    """Heights of tiles side by side."""

    heights: Annotated[Floats, 2]
    """(rows + 2 * RUN, cols) m; NaN in unknown pixels, and in the ``RUN`` rows before the first tile and after the last
    one."""
    pixels: int
    """Along a side of a tile."""
    level: float
    """Width of the levels on both sides of a step, px."""
    east: Annotated[Floats, 2]
    """(tiles, cols) gradient of the tile from one pixel to its eastern neighbour, m."""
    south: Annotated[Floats, 2]
    """The same to its southern neighbour."""


class RawSteps(NamedTuple):
    """Arrays that `find_raw_steps` fills."""

    least: Annotated[Floats, 2]
    """(rows, cols) the least step anywhere in the pixel, m; NaN where a side is unknown."""
    crest: Annotated[Floats, 2]
    """(rows, cols) height of a pixel above the runs three and four pixels on both sides of it, m; NaN if it is unknown,
    infinite if both sides are."""
    inside: Annotated[Floats, 3]
    """(tiles, tiles, (pixels - 2 * RUN) * (pixels - 2 * REACH)) size of the steps in the middle of the pixels whose
    support lies in the tile, m."""


class PeakScratch(NamedTuple):
    """Scratch for the points around a pixel, see `peak_scratch`."""

    limit: Annotated[Floats, 1]
    """(cols,) limits of a row, m."""
    felt: Annotated[Floats, 1]
    """(cols,) steps of a row that stand out, m."""
    patch: Annotated[Floats, 1]
    """(9 * width,) heights of the pixels around one, row by row, each brought to it along the slope of its tile."""
    values: Annotated[Floats, 2]
    """(3, longest list) known heights of a line and of its sides."""
    starts: Annotated[Integers, 1]
    """(45 + 1,) where each list of ``places`` begins; it and they are not changed. For each of nine angles there are
    the line of a ridge, the levels on its left and right, and those on the left and right of a step."""
    places: Annotated[Integers, 1]
    """Places in the patch."""


def peak_scratch(cols: int, level: float) -> PeakScratch:
    """Make scratch for `find_peaks` over rows of so many pixels, and levels of a width [px]."""
    starts, places = _places(level)
    longest, width = int(np.diff(starts).max()), 2 * _half_width(level) + 1
    return PeakScratch(
        np.empty(cols), np.empty(cols), np.empty(_RUN_LENGTH * width), np.empty((3, longest)), starts, places
    )


def _half_width(level: float) -> int:
    return math.floor(level * math.sqrt(2.0) + RUN)


@cache
def _places(level: float) -> tuple[Integers, Integers]:
    """Return ``starts`` and ``places`` of the scratch."""
    width = 2 * _half_width(level) + 1
    lists: list[list[int]] = []
    for turn in range(-_TURNS, _TURNS + 1):
        lists += [[] for _ in range(_LISTS)]
        shear = turn / _TURNS
        wide = level * math.sqrt(1.0 + shear * shear)
        for down in range(-RUN, RUN + 1):
            quarters, middle, place = turn * down, shear * down, (RUN + down) * width + width // 2
            lists[-5] += range(place + ((quarters + 1) >> 2), place + ((quarters + 2) >> 2) + 1)
            for left, beside in ((-4, max(_FOOT * wide, 0.75)), (-2, _BESIDE)):
                lists[left] += range(place + math.ceil(middle - wide), place + math.floor(middle - beside) + 1)
                lists[left + 1] += range(place + math.ceil(middle + beside), place + math.floor(middle + wide) + 1)
    return np.cumsum([0, *map(len, lists)], dtype=np.int32), np.array([k for each in lists for k in each], np.int32)


class RowScratch(NamedTuple):
    """Scratch for a row of the mosaic, see `row_scratch`."""

    stack: Annotated[Floats, 2]
    """(9, cols) heights of a run of pixels."""
    padding: Annotated[Floats, 1]
    """(cols,) signs of what stands for an unknown pixel."""
    runs: Annotated[Floats, 1]
    """(cols + 2 * REACH,) medians of runs; NaN at both ends."""
    plain: Annotated[Floats, 1]
    """(cols,) steps in the middle of pixels."""


def row_scratch(cols: int) -> RowScratch:
    """Make scratch for rows of so many pixels."""
    runs = np.full(cols + 2 * REACH, np.nan)
    return RowScratch(np.empty((_RUN_LENGTH, cols)), np.empty(cols), runs, np.empty(cols))


@helper
def _split(values: Floats, first: int, last: int, pivot: float, with_equal: bool) -> int:
    """Bring what is below the pivot, or equal to it if asked, to the front of a part; returns where the rest begins."""
    at = first
    for i in range(first, last):
        value = values[i]
        values[i] = values[at]
        values[at] = value
        at += (value < pivot) | (with_equal & (value == pivot))
    return at


@helper
def _smallest(values: Floats, place: int) -> float:
    """Return the number that stands at a place when all are sorted; their order is changed."""
    first, last = 0, len(values)
    while True:
        a, b, c = values[first], values[(first + last) // 2], values[last - 1]
        pivot = max(min(a, b), min(max(a, b), c))
        at = _split(values, first, last, pivot, False)
        if place < at:
            last = at
            continue
        first = _split(values, at, last, pivot, True)
        if place < first:
            return float(pivot)


@helper
def _take_known(values: Floats, n: int, out: Floats) -> int:
    """Put the known ones of some values behind the first n of a list; returns how many it then holds."""
    for i in range(len(values)):
        out[n] = values[i]
        n += not math.isnan(values[i])
    return n


@helper
def _quantile(values: Floats, n: int, share: float, least: int) -> float:
    """Value with a share of the first n at or below it; NaN with fewer than ``least``. Their order is changed."""
    return _smallest(values[:n], int(share * (n - 1))) if n >= least else np.nan


@kernel
def find_quantiles(
    across: Annotated[Floats, 3],
    along: Annotated[Floats, 3],
    share: float,
    least: int,
    out: Annotated[Floats, 2],
    scratch: Annotated[Floats, 1],
) -> None:
    """Fill, for each tile, the value with a share of the known ones at or below it; NaN with fewer than ``least``.

    ``across`` is (tiles, tiles, n), ``along`` the same with rows and columns of tiles exchanged; ``scratch`` takes
    2 n + 1 numbers.
    """
    for row in range(out.shape[0]):
        for col in range(out.shape[1]):
            n = _take_known(along[col, row], _take_known(across[row, col], 0, scratch), scratch)
            out[row, col] = _quantile(scratch, n, share, least)


@kernel
def find_gradients(
    heights: Annotated[Floats, 2],
    pixels: int,
    apart: int,
    least: int,
    middle: Annotated[Floats, 2],
    spread: Annotated[Floats, 2],
    scratch: Annotated[Floats, 1],
) -> None:
    """Fill, for each tile, the median difference to the pixel ``apart`` pixels farther east, m; 0 where there is none.

    ``spread`` takes the median distance of the differences from it, m; NaN with fewer than ``least``. ``scratch`` takes
    pixels^2 numbers.
    """
    for row in range(middle.shape[0]):
        for col in range(middle.shape[1]):
            n = 0
            for r in range(row * pixels, (row + 1) * pixels):
                for c in range(col * pixels, (col + 1) * pixels - apart):
                    scratch[n] = heights[r, c + apart] - heights[r, c]
                    n += not math.isnan(scratch[n])
            usual = _quantile(scratch, n, 0.5, 1) if n > 0 else 0.0
            for i in range(n):
                scratch[i] = abs(scratch[i] - usual)
            middle[row, col], spread[row, col] = usual, _quantile(scratch, n, 0.5, least)


@helper
def _gather(heights: Floats, slope: Floats, ahead: float, padding: Floats, out: Floats) -> None:
    """Bring a row of heights to the middle row of a run.

    Unknown pixels become infinite, up and down in turn, so that the median of nine is that of the known ones.
    """
    for c in range(len(out)):
        height, sign = heights[c] - ahead * slope[c], padding[c]
        unknown = height != height  # noqa: PLR0124 - false for NaN; a test without a branch
        out[c] = sign * np.inf if unknown else height
        padding[c] = -sign if unknown else sign


@helper
def _put_in_order(low: Floats, high: Floats) -> None:
    """Exchange the numbers of two rows where the first is the higher one."""
    for c in range(len(low)):
        a, b = low[c], high[c]
        low[c] = min(a, b)
        high[c] = max(a, b)


@helper
def _medians(heights: Floats, slope: Floats, scratch: RowScratch) -> None:
    """Fill the medians of the known ones of nine pixels in a column, each brought to the middle along the slope."""
    stack, padding, out = scratch.stack, scratch.padding, scratch.runs
    length = len(stack)  # as a constant, it would have the compiler unroll these loops, for two seconds
    middle = length // 2
    for c in range(len(padding)):
        padding[c] = 1.0
    for k in range(length):
        _gather(heights[k], slope, float(k - middle), padding, stack[k])
    for place in range(middle + 1):  # the lowest of all nine to the front, then the lowest of the rest
        for other in range(place + 1, length):
            _put_in_order(stack[place], stack[other])
    for c in range(len(padding)):
        pair = 0.5 * (stack[middle - 1, c] + stack[middle, c])  # of an even number; of none it is NaN
        out[REACH + c] = stack[middle, c] if padding[c] > 0.0 else pair


@helper
def _bend(a: float, b: float, c: float, d: float) -> float:
    """Slope on which four heights agree, the nearest first, m per pixel; 0 if they do not."""
    one, two, three = b - a, c - b, d - c
    agree = ((one > 0.0) & (two > 0.0) & (three > 0.0)) | ((one < 0.0) & (two < 0.0) & (three < 0.0))
    size = min(abs(one), abs(two), abs(three))
    bend = 0.0
    if agree:
        bend = size if one > 0.0 else -size
    return bend


@helper
def _mean(near: float, far: float) -> float:
    """Return the mean of two heights; of the known one, if one is."""
    height = 0.5 * (near + far)
    height = near if math.isnan(far) else height
    return far if math.isnan(near) else height


@helper
def _unknown(near: float, far: float) -> float:
    """Return how many of the pixels of a side come before the first known one, 2 at most."""
    return (2.0 if math.isnan(far) else 1.0) if math.isnan(near) else 0.0


@helper
def _lowest(a: float, b: float, c: float, d: float) -> float:
    """Return the least of the known ones of four heights; infinite if none is."""
    return min(np.inf, a, b, c, d)


@helper
def _share(surely: float, step: float) -> float:
    """Return how far to believe a step of which so much is sure, 0 to 1."""
    share = (surely - _BELIEVED * step) / ((_CERTAIN - _BELIEVED) * step) if step > 0.0 else 1.0
    return min(max(share, 0.0), 1.0)


@helper
def _find_crests(heights: Floats, runs: Floats, slope: Floats, crest: Floats) -> None:
    """Fill how far the pixels of a row lie above the runs three and four pixels on both sides of them."""
    for c in range(len(crest)):
        right, left = _mean(runs[c + 7], runs[c + 8]) - 3.5 * slope[c], _mean(runs[c + 1], runs[c]) + 3.5 * slope[c]
        crest[c] = heights[c] - max(-np.inf, left, right)


@helper
def _compare_sides(runs: Floats, slope: Floats, third: float, fourth: float, plain: Floats, least: Floats) -> None:
    """Fill the steps of a row: in the middle of pixels, and the least ones.

    ``third`` and ``fourth`` are 0 if so many pixels of a side must be above, or below, those of the other side, else
    infinite.
    """
    for c in range(len(plain)):
        s = slope[c]
        a, b, e, f = runs[c + 5] - s, runs[c + 6] - 2.0 * s, runs[c + 7] - 3.0 * s, runs[c + 8] - 4.0 * s
        bend_right = _bend(a, b, e, f)
        a, b, e, f = a - bend_right, b - 2.0 * bend_right, e - 3.0 * bend_right, f - 4.0 * bend_right
        apart = 2.0 + _unknown(a, b)
        right, right_low = _mean(a, b), _lowest(a, b, e + third, f + fourth)
        right_high = -_lowest(-a, -b, third - e, fourth - f)
        a, b, e, f = runs[c + 3] + s, runs[c + 2] + 2.0 * s, runs[c + 1] + 3.0 * s, runs[c] + 4.0 * s
        bend_left = _bend(a, b, e, f)
        a, b, e, f = a - bend_left, b - 2.0 * bend_left, e - 3.0 * bend_left, f - 4.0 * bend_left
        apart += _unknown(a, b)
        left, left_low = _mean(a, b), _lowest(a, b, e + third, f + fourth)
        left_high = -_lowest(-a, -b, third - e, fourth - f)
        plain[c] = abs(right - left)
        # Over unknown pixels, a rise may be a slope.
        surely = max(right_low - left_high, left_low - right_high) * (2.0 / apart)
        usual = 0.5 * abs(right_low + right_high - left_low - left_high) * (2.0 / apart)
        # The slope on the left is counted away from the pixel, too.
        reduced = surely * _share(surely, usual) - 0.5 * abs(bend_right + bend_left)
        least[c] = np.nan if surely == np.inf else max(reduced, 0.0)


@kernel
def find_raw_steps(mosaic: StepMosaic, side: int, out: RawSteps, scratch: RowScratch) -> None:
    """Fill the steps from west to east at every pixel; ``side`` pixels, 2 to 4, are one side of a step."""
    pixels, width = mosaic.pixels, mosaic.pixels - 2 * REACH
    third, fourth = 0.0 if side >= 3 else np.inf, 0.0 if side >= 4 else np.inf
    for row in range(mosaic.east.shape[0]):
        for line in range(pixels):
            r = row * pixels + line
            _medians(mosaic.heights[r : r + _RUN_LENGTH], mosaic.south[row], scratch)
            _compare_sides(scratch.runs, mosaic.east[row], third, fourth, scratch.plain, out.least[r])
            _find_crests(mosaic.heights[r + RUN], scratch.runs, mosaic.east[row], out.crest[r])
            if RUN <= line < pixels - RUN:
                for col in range(out.inside.shape[1]):
                    for c in range(width):
                        out.inside[row, col, (line - RUN) * width + c] = scratch.plain[col * pixels + REACH + c]


@helper
def _stands_out(step: float, limit: float) -> float:
    """Share of a step that counts, 0 to 1: none up to the limit, all from 1.4 times that."""
    share = (step / limit - 1.0) / _RAMP if limit > 0.0 else 1.0
    return min(max(share, 0.0), 1.0)


@helper
def _keep_peaks(least: Floats, limit: Floats, felt: Floats) -> None:
    """Keep the steps of a row that are the highest of three and stand out from noise; 0 elsewhere."""
    n = len(least)
    for c in range(n):
        step = least[c]
        before = least[c - 1] if c > 0 else -1.0
        behind = least[c + 1] if c < n - 1 else -1.0
        felt[c] = 0.0 if (step < before) | (step < behind) else step * _stands_out(step, limit[c])


@helper
def _rank(n: int) -> int:
    """Place of the height that counts as that of a side, in so many in order: see `_gap`."""
    return max(0, math.floor(min(0.5 * (n - _SURE * math.sqrt(n)), _ASTRAY * n)))


@helper
def _bring(line: Floats, first: int, east: float, south: float, out: Floats) -> None:
    """Fill heights brought to a pixel that lies ``first`` pixels to the west of them, from another row."""
    for k in range(len(out)):
        out[k] = line[k] - east * np.int32(first + k) - south


@helper
def _fill_patch(mosaic: StepMosaic, r: int, c: int, patch: Floats) -> None:
    """Fill the heights around a pixel."""
    row, width, cols = r // mosaic.pixels, len(patch) // _RUN_LENGTH, mosaic.heights.shape[1]
    east, south, half = mosaic.east[row, c], mosaic.south[row, c], width // 2
    first, last = max(-c, -half), min(cols - 1 - c, half)
    if last - first < 2 * half:
        for k in range(len(patch)):
            patch[k] = np.nan
    for down in range(-RUN, RUN + 1):
        start = (down + RUN) * width + half
        line = mosaic.heights[r + RUN + down, c + first : c + last + 1]
        _bring(line, first, east, south * down, patch[start + first : start + last + 1])


@helper
def _list(turn: int, which: int, scratch: PeakScratch) -> Integers:
    """Return one of the five lists of places for an angle."""
    k = (turn + _TURNS) * _LISTS + which
    return scratch.places[scratch.starts[k] : scratch.starts[k + 1]]


@helper
def _known_heights(patch: Floats, places: Integers, out: Floats) -> int:
    """Put the known heights of some places into a list; returns how many there are."""
    n = 0
    for k in range(len(places)):
        out[n] = patch[places[k]]
        n += out[n] == out[n]  # false for NaN
    return n


@helper
def _known_sides(
    patch: Floats, one: Integers, other: Integers, before: Floats, behind: Floats
) -> tuple[int, int, float, float]:
    """Put the known heights of both sides, as many places each, into lists; returns how many, and their sums."""
    left = right = 0
    lower = upper = 0.0
    for k in range(len(one)):
        a, b = patch[one[k]], patch[other[k]]
        before[left], behind[right] = a, b
        lower += a if a == a else 0.0  # noqa: PLR0124 - false for NaN
        upper += b if b == b else 0.0  # noqa: PLR0124
        left += a == a  # noqa: PLR0124
        right += b == b  # noqa: PLR0124
    return left, right, lower, upper


@helper
def _gap(turn: int, least: float, scratch: PeakScratch) -> float:
    """Height between the points of both sides of a pixel, as it surely is at least, m; negative if not above ``least``.

    A side is a parallelogram of 9 rows, as wide as a level, along a wall that moves ``turn`` / 4 pixels to the east
    with every row. Of its known pixels in order of height, that one counts which is ``_SURE`` standard errors of the
    median from the middle, or has ``_ASTRAY`` of them beyond it, whichever is farther out.
    """
    patch, values = scratch.patch, scratch.values
    sides = _list(turn, 3, scratch), _list(turn, 4, scratch)
    left, right, lower, upper = _known_sides(patch, sides[0], sides[1], values[0], values[1])
    if min(left, right) < _LEAST_POINTS:
        return -np.inf
    before, behind = values[0, :left], values[1, :right]
    first, other = _rank(left), _rank(right)
    if upper * left < lower * right:
        before, behind, first, other = behind, before, other, first
    # Where too many lie beyond both ends of a part of that height, wherever it is, there is no need to sort.
    middle, half = 0.5 * (lower / left + upper / right), 0.499 * least
    below = above = 0
    for i in range(len(behind)):
        below += behind[i] < middle + half
    for i in range(len(before)):
        above += before[i] > middle - half
    if below > other and above > first:
        return -np.inf
    return _smallest(behind, other) - _smallest(before, len(before) - 1 - first)


@helper
def _believed(step: float, scratch: PeakScratch) -> float:
    """Share of a step that the points on both of its sides bear out, 0 to 1, at the angle that suits them best."""
    best = 0.0
    for k in range(5):
        turn = 2 * ((k + 1) // 2) * (1 if k % 2 else -1)
        best = max(best, _share(_gap(turn, _BELIEVED * step, scratch), step))
        if best >= 1.0:
            return 1.0
    return best


@helper
def _buried(patch: Floats, places: Integers, height: float, margin: float) -> bool:
    """Return True if a height is surely less than a margin above what counts as the height of a side of a ridge."""
    count = 0
    for k in range(len(places)):
        count += height - patch[places[k]] <= margin
    return count > _rank(len(places))


@helper
def _ridge(turn: int, guess: float, least: float, scratch: PeakScratch) -> float:
    """Height of a ridge along a line through a pixel, m; 0 where the points do not bear it out.

    It is the median of the pixels on the line, in 9 rows, above that of the higher side. The line moves ``turn`` / 4
    pixels to the east with every row. Sides are as in `_gap`, less what is next to the line.

    Returns 0 early where the ridge is surely no higher than ``least``: soonest with a ``guess`` just above a quarter of
    the line. Neither changes the height of a higher one.
    """
    patch, values = scratch.patch, scratch.values
    before, behind = _list(turn, 1, scratch), _list(turn, 2, scratch)
    top = _known_heights(patch, _list(turn, 0, scratch), values[0])
    line, low, place = values[0, :top], 0, math.floor(_ASTRAY_ON_RIDGE * top)
    if top < _LEAST_ON_RIDGE:
        return 0.0
    for i in range(top):
        low += line[i] <= guess
    height = guess if low > place else _smallest(line, place)
    if _buried(patch, before, height, _BELIEVED * least) or _buried(patch, behind, height, _BELIEVED * least):
        return 0.0
    left, right, _, _ = _known_sides(patch, before, behind, values[1], values[2])
    if min(left, right) < _LEAST_POINTS:
        return 0.0
    one, other = values[1, :left], values[2, :right]
    high = max(_smallest(one, left - 1 - _rank(left)), _smallest(other, right - 1 - _rank(right)))
    surely = _smallest(line, place) - high
    if surely <= _BELIEVED * least:
        return 0.0
    foot = max(_smallest(one, (left - 1) // 2), _smallest(other, (right - 1) // 2))
    step = max(_smallest(line, top // 2) - foot, 0.0)
    return step * _share(surely, step)


@helper
def _highest_ridge(ground: float, least: float, scratch: PeakScratch) -> float:
    """Height of the ridge through a pixel at the angle that suits it best, m; 0 if none is higher than ``least``."""
    ridge = least
    for turn in range(-_TURNS, _TURNS + 1):
        ridge = max(ridge, _ridge(turn, ground + _BELIEVED * ridge, ridge, scratch))
    return ridge if ridge > least else 0.0


@helper
def _limit_of_sides(before: float, behind: float) -> float:
    """Root mean square of the limits of both sides of a pixel, m; of the known one, if one is."""
    known = int(math.isfinite(before)) + int(math.isfinite(behind))
    first = 0.0 if math.isnan(before) else before * before
    second = 0.0 if math.isnan(behind) else behind * behind
    return math.sqrt((first + second) / known) if known > 0 else UNKNOWN_NOISE


@helper
def _part_of_tile(k: int, pixels: int) -> int:
    """Return to which part of a tile a column of its pixels belongs, as in the last axis of what `find_peaks` fills."""
    if k == 0 or k == pixels - 1:
        return 0 if k == 0 else 1
    return 2 if k < _RIM or k >= pixels - _RIM else 3


@helper
def _step_at(
    mosaic: StepMosaic, r: int, c: int, crest: float, least: float, scratch: PeakScratch
) -> tuple[float, float]:
    """Return the step or ridge at a pixel, m; NaN if it is unknown, less than ``least`` where it is surely lower.

    The second height is that of the same step where its points bear out any part of it.
    """
    felt: float = scratch.felt[c]
    limit: float = scratch.limit[c]
    borne_out = 0.0
    is_step = felt > max(least, 0.0)
    if is_step:
        _fill_patch(mosaic, r, c, scratch.patch)
        share = _believed(felt, scratch)
        borne_out = felt if share > 0.0 else 0.0
        felt *= share
    if crest > limit:
        if not is_step:
            _fill_patch(mosaic, r, c, scratch.patch)
        ridge = _highest_ridge(mosaic.heights[r + RUN, c] - crest, max(limit, felt, least), scratch)
        felt = max(felt, ridge * _stands_out(ridge, limit))
    return felt, max(felt, borne_out)


@helper
def _fill_limits(limit: Floats, pixels: int, limits: Floats) -> None:
    """Fill the limits of a row of pixels from those of its tiles."""
    cols = len(limits)
    for c in range(cols):
        before = limit[(c - SIDE) // pixels] if c >= SIDE else np.nan
        behind = limit[(c + SIDE) // pixels] if c + SIDE < cols else np.nan
        limits[c] = _limit_of_sides(before, behind)


@kernel
def find_peaks(
    mosaic: StepMosaic,
    raw: RawSteps,
    limit: Annotated[Floats, 2],
    closing: float,
    highest: Annotated[Floats, 3],
    closed: Annotated[NDArray[np.uint8], 2],
    scratch: PeakScratch,
) -> None:
    """Fill the highest step of tiles, or ridge if that is higher, m; negative where none is known.

    A step counts where it is the highest of three in its row and stands out.

    ``highest`` is (tiles, tiles, 4): in the pixels of the western border, of the eastern one, in ``_RIM`` pixels along
    both of them, and in all. In the outer ring of tiles only the borders to the inner ones are filled.

    ``limit`` is (tiles, tiles): steps of that height do not count, m. That of a pixel is between those of the tiles two
    pixels before and behind it.

    ``closed`` is (rows, cols), filled with 0: the same pixels are 2 where the step is ``closing`` m high, and 1 where
    it is if the points bear out any part of it.
    """
    cols, pixels, limits = raw.least.shape[1], mosaic.pixels, scratch.limit
    for row in range(1, limit.shape[0] - 1):
        _fill_limits(limit[row], pixels, limits)
        highest[row, :, :] = -1.0
        # Nothing is higher than what nobody asks for.
        highest[row, 0, 0] = highest[row, limit.shape[1] - 1, 1] = np.inf
        highest[row, 0, 2:] = highest[row, limit.shape[1] - 1, 2:] = np.inf
        for r in range(row * pixels, (row + 1) * pixels):
            _keep_peaks(raw.least[r], limits, scratch.felt)
            for c in range(cols):
                part, found = _part_of_tile(c % pixels, pixels), highest[row, c // pixels]
                if found[part] == np.inf:
                    continue
                asked = min(found[part], closing)
                if scratch.felt[c] > asked or raw.crest[r, c] > limits[c]:
                    step, borne_out = _step_at(mosaic, r, c, raw.crest[r, c], asked, scratch)
                    closed[r, c] = (borne_out >= closing) + (step >= closing)
                    for k in range(part, 4):
                        if (k == part or k > 1) and step > found[k]:
                            found[k] = step


_LEAST_OF_SIDE, _LEAST_OF_HALF = 6, 8
"""Known pixels on each side of a jump; and where half of the line is looked at."""
_SAME = 0.65
"""Of a jump, the least difference of the mean levels of both sides: a narrow ditch bends their planes, and has less."""
_MOST_REST, _MOST_REST_HALF = 0.25, 0.15
"""Most distance of the pixels from the planes of their sides, as a share of the jump (root mean square); and where half
of the line is looked at."""
_MOST_SPREAD = 0.5
"""The same from the mean levels of both sides, as a share of their difference."""
_MOST_REST_IN_LINE, _IN_LINE = 0.4, 5
"""As ``_MOST_REST``, of a jump that continues one, and how far from that it may lie, px."""
_SURELY, _SURELY_HALF = 2.0, 4.0
"""Standard errors of the jump beyond what closes, likewise."""
_CREST = 0.9
"""A pixel is on the line of a jump if the levels differ so much of what they do at the pixels across the line."""


class JumpSides(NamedTuple):
    """Pixels on both sides of lines through a pixel, see `jump_sides`."""

    starts: Annotated[Integers, 1]
    """(49,) where the pixels of each part of a side begin: of eight lines, both sides, each before the middle, beside
    it and behind it."""
    place: Annotated[Integers, 1]
    """Places of the pixels in a patch around the pixel."""
    across: Annotated[Floats, 1]
    along: Annotated[Floats, 1]
    """From the pixel to them, across the line and along it, px."""


class TileSlopes(NamedTuple):
    """Tiles in which to look for jumps, (tiles, tiles) each."""

    east: Annotated[Floats, 2]
    """Usual rise from a pixel to the next one in the east, m."""
    south: Annotated[Floats, 2]
    """The same to the south, m."""
    is_wanted: Annotated[NDArray[np.bool_], 2]


class JumpScratch(NamedTuple):
    """Scratch for the points around a pixel, see `jump_scratch`."""

    level: Annotated[Floats, 2]
    """(rows, cols) difference of the levels of both sides, m."""
    patch: Annotated[Floats, 2]
    """(2, size^2) heights of the pixels around one, less the slope of its tile, 0 where unknown; and 1 where known."""
    parts: Annotated[Floats, 2]
    """(3, 48) sum of the heights of each part of a side, number of known pixels, and sum of the squared heights."""


def jump_scratch(rows: int, cols: int, width: float) -> JumpScratch:
    """Make scratch for a mosaic of so many pixels."""
    size = 2 * _jump_reach(width) + 1
    return JumpScratch(np.zeros((rows, cols)), np.empty((2, size * size)), np.empty((3, 48)))


def _jump_reach(width: float) -> int:
    return math.ceil(math.hypot(width, RUN + 0.5))


@cache
def jump_sides(width: float) -> JumpSides:
    """Return the pixels up to ``width`` px beside lines of nine pixels at eight angles."""
    reach = _jump_reach(width)
    down, right = (places.ravel() for places in np.mgrid[-reach : reach + 1, -reach : reach + 1])
    parts = []
    for angle in np.arange(8) * (math.pi / 8.0):
        c, s = round(math.cos(angle), 6), round(math.sin(angle), 6)
        across, along = c * right + s * down, c * down - s * right
        for sign, first, last in product((-1.0, 1.0), (-RUN - 0.5, -0.5, 0.5), (-0.5, 0.5, RUN + 0.5)):
            if 0.0 < last - first <= RUN:
                inside = (sign * across > 0.4) & (sign * across <= width) & (along > first) & (along <= last)
                parts.append((np.flatnonzero(inside), across[inside], along[inside]))
    place, across, along = (np.concatenate(each) for each in zip(*parts, strict=True))
    starts = np.cumsum([0, *(len(part[0]) for part in parts)], dtype=np.int32)
    return JumpSides(starts, place.astype(np.int32), across, along)


class SidePlane(NamedTuple):
    """The plane through the known pixels of one side."""

    n: float
    at_line: float
    """Height of the plane at the middle of the line, m."""
    rest: float
    """Sum of the squared distances from the plane, m^2."""
    error: float
    """Squared standard error of ``at_line`` over the variance of a pixel."""


@helper
def _side_plane(first: int, last: int, sides: JumpSides, patch: Floats) -> SidePlane:
    """Fit a plane through the known pixels of some parts of a side of a line; ``n`` is 0 if they span none."""
    n = u = v = z = uu = uv = vv = uz = vz = zz = 0.0
    for k in range(sides.starts[first], sides.starts[last]):
        w, h = patch[1, sides.place[k]], patch[0, sides.place[k]]
        a, b = w * sides.across[k], w * sides.along[k]
        n, u, v, z = n + w, u + a, v + b, z + h
        uu, uv, vv = uu + a * a, uv + a * b, vv + b * b
        uz, vz, zz = uz + a * h, vz + b * h, zz + h * h
    mu, mv, mz = u / n, v / n, z / n
    uu, uv, vv, uz, vz, zz = uu - u * mu, uv - u * mv, vv - v * mv, uz - u * mz, vz - v * mz, zz - z * mz
    det = uu * vv - uv * uv
    if det <= 1e-6 * uu * vv:
        return SidePlane(0.0, 0.0, 0.0, 0.0)
    across, along = (uz * vv - vz * uv) / det, (vz * uu - uz * uv) / det
    error = 1.0 / n + (mu * mu * vv - 2.0 * mu * mv * uv + mv * mv * uu) / det
    rest = max(zz - across * uz - along * vz, 0.0)
    return SidePlane(n, mz - across * mu - along * mv, rest, error)


@helper
def _fill_jump_patch(
    heights: Floats, r: int, c: int, slope: tuple[float, float], closing: float, patch: Floats
) -> bool:
    """Fill the heights around a pixel; returns False, and fills nothing, if those of 5 x 5 pixels differ too little."""
    size = int(math.sqrt(patch.shape[1]))
    reach, low, high = size // 2, np.inf, -np.inf
    for down in range(-2, 3):
        for right in range(-2, 3):
            h = heights[r + down, c + right] - slope[0] * right - slope[1] * down
            low, high = min(low, h), max(high, h)  # NaN is neither
    if low < np.inf and high - low < closing:
        return False
    base = low if low < np.inf else 0.0
    for down in range(-reach, reach + 1):
        line = heights[r + down, c - reach : c + reach + 1]
        first = (down + reach) * size
        for k in range(size):
            h = line[k] - slope[0] * (k - reach) - slope[1] * down
            known = h == h  # noqa: PLR0124 - false for NaN
            patch[0, first + k] = h - base if known else 0.0
            patch[1, first + k] = 1.0 if known else 0.0
    return True


@helper
def _jump_along(line: int, part: tuple[int, int], closing: float, sides: JumpSides, scratch: JumpScratch) -> float:
    """Return the difference of the levels of both sides of a line, m, if it closes; 0 if not, and less if in doubt.

    ``part`` are the first and the last of its three parts, the latter not included.
    """
    whole = part[1] - part[0] == 3
    one, other = 6 * line + part[0], 6 * line + 3 + part[0]
    count = part[1] - part[0]
    before = behind = n = m = squares = 0.0
    for k in range(count):
        before, n = before + scratch.parts[0, one + k], n + scratch.parts[1, one + k]
        behind, m = behind + scratch.parts[0, other + k], m + scratch.parts[1, other + k]
        squares += scratch.parts[2, one + k] + scratch.parts[2, other + k]
    if min(n, m) < (_LEAST_OF_SIDE if whole else _LEAST_OF_HALF):
        return 0.0
    level = behind / m - before / n
    spread = (squares - before * before / n - behind * behind / m) / (n + m)
    if abs(level) < closing or spread > _MOST_SPREAD * _MOST_SPREAD * level * level:
        return 0.0
    near = _side_plane(one, one + count, sides, scratch.patch)
    far = _side_plane(other, other + count, sides, scratch.patch)
    if near.n == 0.0 or far.n == 0.0:
        return 0.0
    jump = far.at_line - near.at_line
    if jump < 0.0:
        level, jump = -level, -jump
    rest = (near.rest + far.rest) / (n + m - 6.0)
    error = math.sqrt(rest * (near.error + far.error))
    surely, share = (_SURELY, _MOST_REST) if whole else (_SURELY_HALF, _MOST_REST_HALF)
    if min(level, jump) >= closing + surely * error and level > _SAME * jump and rest <= share * share * jump * jump:
        return level
    perhaps = whole and min(level, jump) >= closing and rest <= _MOST_REST_IN_LINE * _MOST_REST_IN_LINE * jump * jump
    return -level if perhaps else 0.0


@helper
def _jump(closing: float, sides: JumpSides, scratch: JumpScratch) -> float:
    """Return the difference of the levels of both sides of a pixel, m, at the line on which it is most; 0: none closes.

    It is negative if a line closes, but not surely.

    A jump closes if the planes of both sides differ by ``closing`` and some standard errors more at the line, and so do
    their levels, and if little is left beside the planes. Halves of the line tell it close to the corner of a step.
    """
    for k in range(len(sides.starts) - 1):
        n = total = squares = 0.0
        for i in range(sides.starts[k], sides.starts[k + 1]):
            n += scratch.patch[1, sides.place[i]]
            h = scratch.patch[0, sides.place[i]]
            total, squares = total + h, squares + h * h
        scratch.parts[0, k], scratch.parts[1, k], scratch.parts[2, k] = total, n, squares
    most = least = 0.0
    for line in range(8):
        found = _jump_along(line, (0, 3), closing, sides, scratch)
        most, least = max(most, found), min(least, found)
        most = max(most, _jump_along(line, (0, 2), closing, sides, scratch))
        most = max(most, _jump_along(line, (1, 3), closing, sides, scratch))
    return most if most > 0.0 else least


@helper
def _is_sure_near(level: Floats, r: int, c: int, near: int) -> bool:
    """Return whether a line that surely closes lies within some pixels."""
    for row in range(r - near, r + near + 1):
        for col in range(c - near, c + near + 1):
            if level[row, col] > 0.0:
                return True
    return False


@kernel
def find_jumps(
    heights: Annotated[Floats, 2],
    pixels: int,
    slopes: TileSlopes,
    closing: float,
    sides: JumpSides,
    marks: Annotated[NDArray[np.bool_], 2],
    scratch: JumpScratch,
) -> None:
    """Mark the lines along which the ground jumps by ``closing`` m, where all points of both sides are taken together.

    ``heights`` and ``marks`` are (rows, cols) of pixels; the latter come filled with False. Where few points leave it
    in doubt, a line closes that continues one. In the outer ring of tiles only the pixels next to the inner ones are
    marked, and no more looked at than that takes.
    """
    rows, cols, level = heights.shape[0], heights.shape[1], scratch.level
    reach = int(math.sqrt(scratch.patch.shape[1])) // 2
    near = max(min(_IN_LINE, pixels - 2 - reach), 1)
    outer = pixels - 1 - near
    for r in range(outer, rows - outer):
        for c in range(outer, cols - outer):
            row, col = r // pixels, c // pixels
            if slopes.is_wanted[row, col]:
                slope = slopes.east[row, col], slopes.south[row, col]
                if _fill_jump_patch(heights, r, c, slope, closing, scratch.patch):
                    level[r, c] = _jump(closing, sides, scratch)
    for r in range(pixels - 1, rows - pixels + 1):
        for c in range(pixels - 1, cols - pixels + 1):
            own, higher = level[r, c], False
            for down in range(-1, 2):
                for right in range(-1, 2):
                    higher |= abs(own) < _CREST * abs(level[r + down, c + right])
            marks[r, c] = not higher and (own > 0.0 or (own < 0.0 and _is_sure_near(level, r, c, near)))
