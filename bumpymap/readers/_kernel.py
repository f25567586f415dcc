"""Records to metres, and which points count: one pass over the bytes, without the interpreter's lock.

``convert_records`` decodes LAS records in strips that stay in the processor's cache and hands each to ``_sift``, which
watches every point and moves those that count to the front. Tables (PLY, PCD) come with their coordinates and need
``sift_points`` alone. Points keep their order.
"""

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpytiles import helper, kernel

__all__ = [
    "KEPT",
    "STRIP",
    "CountedPoints",
    "FilePoints",
    "RecordNumbers",
    "WatchCounts",
    "WatchRules",
    "convert_records",
    "filter_points",
]

_FIRST = 5
"""Place in ``counts`` of the number of the first point that is not finite; -1 where there is none."""
KEPT = 6
"""Place in ``counts`` of the points that count, so far."""
STRIP = 1024
"""Points that are decoded at once."""

_ROUND = 1e8
"""10 to the power of the decimals that a coordinate keeps (``columns.DECIMALS``)."""
_FINITE = float(np.finfo(np.float64).max)

Floats = Annotated[NDArray[np.float64], 1]
Bytes = Annotated[NDArray[np.uint8], 1]
Flags = Annotated[NDArray[np.bool_], 1]
Lines = Annotated[NDArray[np.uint16], 1]
Counts = Annotated[NDArray[np.int64], 1]
Records = Annotated[NDArray[np.uint8], 2]


class FilePoints(NamedTuple):
    """Points as a file holds them, (n,) each."""

    x: Floats
    """m, as the two that follow."""
    y: Floats
    z: Floats
    class_id: Bytes
    """LAS classes; 7 and 18 are noise, 2 is ground."""
    withheld: Flags
    line: Lines
    """Flight lines."""


class WatchRules(NamedTuple):
    """What points are held to."""

    box: Floats
    """(4,) west, south, east, north that every point must lie in, m."""
    nan_is_no_return: bool
    """A row with NaN does not count; otherwise it is bad, as infinite ones are."""
    start: int
    """Number of the first point in the file."""


class CountedPoints(NamedTuple):
    """Where points that count go, (n,) each; may be the arrays that they come from."""

    x: Floats
    """m, as the two that follow."""
    y: Floats
    z: Floats
    ground: Flags
    line: Lines


class WatchCounts(NamedTuple):
    """What was seen; brought up to date."""

    extremes: Floats
    """(5,) lowest easting and northing, highest easting and northing, largest distance of a height from zero, m."""
    counts: Counts
    """(7,) withheld, noise, not a number, outside, not finite, first not finite: as in ``PointStats``; those kept."""


class RecordNumbers(NamedTuple):
    """How LAS records become points."""

    place: Floats
    """(9,) scales, offsets and metres per unit of x, y and z."""
    layout: Counts
    """(6,) byte and mask of the class, byte and mask of the withheld flag; first byte of the flight line, and the line
    of points where that is 0."""


@helper
def _watch(e: float, n: float, u: float, number: int, rules: WatchRules, counts: Counts) -> bool:
    """Look closely at a point with which something may be wrong; False where it is no point."""
    box = rules.box
    if e < box[0] or n < box[1] or e > box[2] or n > box[3]:
        counts[3] += 1
    if not (np.isfinite(e) and np.isfinite(n) and np.isfinite(u)):
        if rules.nan_is_no_return and (np.isnan(e) or np.isnan(n) or np.isnan(u)):
            counts[2] += 1
            return False
        counts[4] += 1
        if counts[_FIRST] < 0:
            counts[_FIRST] = number
    return True


@helper
def _filter_point(
    points: FilePoints, total: int, start: int, rules: WatchRules, out: CountedPoints, watched: WatchCounts
) -> None:
    """Watch the first ``total`` points, the first of them number ``start``, and append those that count."""
    extremes, counts, box = watched.extremes, watched.counts, rules.box
    west, south, east, north, highest = extremes[0], extremes[1], extremes[2], extremes[3], extremes[4]
    # Nothing is wrong with a point in here; the others are looked at closely.
    inner_west, inner_south = max(box[0], -_FINITE), max(box[1], -_FINITE)
    inner_east, inner_north = min(box[2], _FINITE), min(box[3], _FINITE)
    to = counts[KEPT]
    for i in range(total):
        e, n, u = points.x[i], points.y[i], points.z[i]
        # In this order NaN leaves the extremes alone, as comparisons with it are false; it lies nowhere, too.
        west, east = min(west, e), max(east, e)
        south, north = min(south, n), max(north, n)
        highest = max(highest, abs(u))
        fine = inner_west <= e <= inner_east and inner_south <= n <= inner_north and abs(u) <= _FINITE
        if not fine and not _watch(e, n, u, start + i, rules, counts):
            continue
        if points.withheld[i]:
            counts[0] += 1
            continue
        code = points.class_id[i]
        if code == 7 or code == 18:  # noqa: PLR1714 (numba builds no set in a loop)
            counts[1] += 1
            continue
        out.x[to], out.y[to], out.z[to], out.ground[to] = e, n, u, code == 2
        out.line[to] = points.line[i]
        to += 1
    counts[KEPT] = to
    extremes[0], extremes[1], extremes[2], extremes[3], extremes[4] = west, south, east, north, highest


@kernel
def filter_points(points: FilePoints, rules: WatchRules, out: CountedPoints, watched: WatchCounts) -> None:
    """Watch points and keep those that count."""
    _filter_point(points, len(points.x), rules.start, rules, out, watched)


@helper
def _axis(records: Records, axis: int, first: int, count: int, place: Floats, out: Floats) -> None:
    """Coordinates of a strip: ``integer * scale + offset``, rounded to 1e-8 units, in metres.

    The same steps as ``numpy.round`` takes, so the same bits.
    """
    at, scale, offset, unit = 4 * axis, place[axis], place[3 + axis], place[6 + axis]
    for i in range(count):
        record = first + i
        word = (
            np.uint32(records[record, at])
            | np.uint32(records[record, at + 1]) << np.uint32(8)
            | np.uint32(records[record, at + 2]) << np.uint32(16)
            | np.uint32(records[record, at + 3]) << np.uint32(24)
        )
        out[i] = np.rint((np.int32(word) * scale + offset) * _ROUND) / _ROUND
    if unit != 1.0:
        for i in range(count):
            out[i] *= unit


@kernel
def convert_records(
    records: Records,
    numbers: RecordNumbers,
    rules: WatchRules,
    strip: FilePoints,
    out: CountedPoints,
    watched: WatchCounts,
) -> None:
    """Turn LAS records, uint8 (n, size), into points in metres and keep those that count.

    ``strip`` is scratch, (``STRIP``,) each.
    """
    total, layout = len(records), numbers.layout
    for first in range(0, total, STRIP):
        count = min(STRIP, total - first)
        _axis(records, 0, first, count, numbers.place, strip.x)
        _axis(records, 1, first, count, numbers.place, strip.y)
        _axis(records, 2, first, count, numbers.place, strip.z)
        for i in range(count):
            strip.class_id[i] = records[first + i, layout[0]] & layout[1]
            strip.withheld[i] = (records[first + i, layout[2]] & layout[3]) != 0
            line = np.int64(records[first + i, layout[4]]) | np.int64(records[first + i, layout[4] + 1]) << 8
            strip.line[i] = line if line != 0 else layout[5]
        _filter_point(strip, count, rules.start + first, rules, out, watched)
