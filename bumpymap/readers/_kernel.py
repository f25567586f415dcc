"""Which points count: one pass over the bytes, without the interpreter's lock.

``filter_records`` takes LAS records, whose coordinates stay integers; ``filter_points`` takes points in metres, such as
those of tables (PLY, PCD). Both watch every point and keep those that count, in their order.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpytiles import helper, kernel

__all__ = [
    "KEPT",
    "CountedPoints",
    "CountedRecords",
    "FilePoints",
    "RecordCounts",
    "RecordRules",
    "WatchCounts",
    "WatchRules",
    "filter_points",
    "filter_records",
]

_FIRST = 5
"""Place in ``counts`` of the number of the first point that is not finite; -1 where there is none."""
KEPT = 6
"""Place in ``counts`` of the points that count, so far."""
_FINITE = float(np.finfo(np.float64).max)

Floats = Annotated[NDArray[np.float64], 1]
Bytes = Annotated[NDArray[np.uint8], 1]
Flags = Annotated[NDArray[np.bool_], 1]
Lines = Annotated[NDArray[np.uint16], 1]
Counts = Annotated[NDArray[np.int64], 1]
Records = Annotated[NDArray[np.uint8], 2]
Words = Annotated[NDArray[np.int32], 1]


class FilePoints(NamedTuple):
    """Points as a file holds them, (n,) each."""

    x: Floats
    """m, as the two that follow."""
    y: Floats
    z: Floats
    class_id: Bytes
    """LAS classes; 7 and 18 are noise."""
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
    kinds: Bytes
    """(256,) kind of the points of each class."""


class CountedPoints(NamedTuple):
    """Where points that count go, (n,) each; may be the arrays that they come from."""

    x: Floats
    """m, as the two that follow."""
    y: Floats
    z: Floats
    kind: Bytes
    line: Lines


class WatchCounts(NamedTuple):
    """What was seen; brought up to date."""

    extremes: Floats
    """(5,) lowest easting and northing, highest easting and northing, largest distance of a height from zero, m."""
    counts: Counts
    """(7,) withheld, noise, not a number, outside, not finite, first not finite: as in ``PointStats``; those kept."""
    classes: Counts
    """(256,) points that count, by class."""


class RecordRules(NamedTuple):
    """What LAS records are held to."""

    layout: Counts
    """(6,) byte and mask of the class, byte and mask of the withheld flag; first byte of the flight line, and the line
    of points where that is 0."""
    box: Counts
    """(4,) lowest and highest integer of x, then of y, that lie in the box of the file."""
    kinds: Bytes
    """(256,) kind of the points of each class."""


class CountedRecords(NamedTuple):
    """Where records that count go, (n,) each."""

    x: Words
    """Integers of the file's grid, as the two that follow."""
    y: Words
    z: Words
    kind: Bytes
    line: Lines


class RecordCounts(NamedTuple):
    """What was seen; brought up to date."""

    extremes: Counts
    """(6,) lowest and highest x, y and z."""
    counts: Counts
    """(4,) withheld, noise, outside, kept."""
    classes: Counts
    """(256,) points that count, by class."""


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


@kernel
def filter_points(points: FilePoints, rules: WatchRules, out: CountedPoints, watched: WatchCounts) -> None:
    """Watch points and append those that count."""
    extremes, counts, box = watched.extremes, watched.counts, rules.box
    west, south, east, north, highest = extremes[0], extremes[1], extremes[2], extremes[3], extremes[4]
    # Nothing is wrong with a point in here; the others are looked at closely.
    inner_west, inner_south = max(box[0], -_FINITE), max(box[1], -_FINITE)
    inner_east, inner_north = min(box[2], _FINITE), min(box[3], _FINITE)
    to = counts[KEPT]
    for i in range(len(points.x)):
        e, n, u = points.x[i], points.y[i], points.z[i]
        # In this order NaN leaves the extremes alone, as comparisons with it are false; it lies nowhere, too.
        west, east = min(west, e), max(east, e)
        south, north = min(south, n), max(north, n)
        highest = max(highest, abs(u))
        fine = inner_west <= e <= inner_east and inner_south <= n <= inner_north and abs(u) <= _FINITE
        if not fine and not _watch(e, n, u, rules.start + i, rules, counts):
            continue
        if points.withheld[i]:
            counts[0] += 1
            continue
        code = points.class_id[i]
        if code == 7 or code == 18:  # noqa: PLR1714 (numba builds no set in a loop)
            counts[1] += 1
            continue
        out.x[to], out.y[to], out.z[to], out.kind[to] = e, n, u, rules.kinds[code]
        out.line[to] = points.line[i]
        watched.classes[code] += 1
        to += 1
    counts[KEPT] = to
    extremes[0], extremes[1], extremes[2], extremes[3], extremes[4] = west, south, east, north, highest


@helper
def _word(records: Records, record: int, at: int) -> Any:
    """Return four bytes of a record as an integer."""
    return np.int32(
        np.uint32(records[record, at])
        | np.uint32(records[record, at + 1]) << np.uint32(8)
        | np.uint32(records[record, at + 2]) << np.uint32(16)
        | np.uint32(records[record, at + 3]) << np.uint32(24)
    )


@kernel
def filter_records(records: Records, rules: RecordRules, out: CountedRecords, seen: RecordCounts) -> None:
    """Watch LAS records, uint8 (n, size), and append those that count."""
    layout, box, extremes, counts = rules.layout, rules.box, seen.extremes, seen.counts
    to, outside = counts[3], 0
    x_min, x_max, y_min = np.int32(extremes[0]), np.int32(extremes[1]), np.int32(extremes[2])
    y_max, z_min, z_max = np.int32(extremes[3]), np.int32(extremes[4]), np.int32(extremes[5])
    for i in range(len(records)):
        x, y, z = _word(records, i, 0), _word(records, i, 4), _word(records, i, 8)
        x_min, x_max = min(x_min, x), max(x_max, x)
        y_min, y_max = min(y_min, y), max(y_max, y)
        z_min, z_max = min(z_min, z), max(z_max, z)
        if not (box[0] <= x <= box[1] and box[2] <= y <= box[3]):
            outside += 1
        if records[i, layout[2]] & layout[3]:
            counts[0] += 1
            continue
        code = records[i, layout[0]] & layout[1]
        if code == 7 or code == 18:  # noqa: PLR1714 (numba builds no set in a loop)
            counts[1] += 1
            continue
        line = np.int64(records[i, layout[4]]) | np.int64(records[i, layout[4] + 1]) << 8
        out.x[to], out.y[to], out.z[to], out.kind[to] = x, y, z, rules.kinds[code]
        out.line[to] = line if line != 0 else layout[5]
        seen.classes[code] += 1
        to += 1
    counts[2] += outside
    counts[3] = to
    extremes[0], extremes[1], extremes[2] = x_min, x_max, y_min
    extremes[3], extremes[4], extremes[5] = y_max, z_min, z_max
