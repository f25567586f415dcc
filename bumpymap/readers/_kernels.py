"""Watch LAS records; sum the points of each flight line in each cell of a grid; level the heights of the lines.

The sums are integers of 0.1 mm, so that they do not depend on the order of the points. Sums that exceed 64 bits wrap
around; differences of them are right again.

Of scans: a sensor moves while it scans, and each point is measured from another place. Deskewing moves points to where
the sensor sees them at the time of the frame.
"""

from dataclasses import replace
from math import ceil
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import POINT_GROUND, PoseTrack, Scan
from bumpytiles import coordinates, helper, kernel, tile_index

Floats = Annotated[NDArray[np.float64], 1]
Bytes = Annotated[NDArray[np.uint8], 1]
Lines = Annotated[NDArray[np.uint16], 1]
Colours = Annotated[NDArray[np.uint32], 1]
Counts = Annotated[NDArray[np.int64], 1]
Records = Annotated[NDArray[np.uint8], 2]
Words = Annotated[NDArray[np.int32], 1]


class RecordRules(NamedTuple):
    """Checks of LAS records."""

    layout: Counts
    """(6,) byte and mask of the class, byte and mask of the withheld flag; first byte of the flight line, and the line
    of points where that is 0."""
    box: Counts
    """(4,) lowest and highest integer of x, then of y, that lie in the box of the file."""
    kinds: Bytes
    """(256,) kind of the points of each class."""


class LinedPoints(NamedTuple):
    """Points with their flight line, (n,) each."""

    x: Floats
    """m, as the two that follow."""
    y: Floats
    z: Floats
    kind: Bytes
    line: Lines


class ScaledLinedPoints(NamedTuple):
    """The same, with coordinates as integers of the file's own grid, see `bumpytiles.ScaledPoints`."""

    x: Words
    y: Words
    z: Words
    kind: Bytes
    line: Lines


class RecordCounts(NamedTuple):
    """Statistics so far; updated."""

    extremes: Counts
    """(6,) lowest and highest x, y and z."""
    counts: Counts
    """(4,) withheld, noise, outside, kept."""


@helper
def _word(records: Records, record: int, at: int) -> Any:
    """Return four bytes of a record as an integer."""
    return np.int32(
        np.uint32(records[record, at])
        | np.uint32(records[record, at + 1]) << np.uint32(8)
        | np.uint32(records[record, at + 2]) << np.uint32(16)
        | np.uint32(records[record, at + 3]) << np.uint32(24)
    )


@helper
def _is_dropped(records: Records, record: int, layout: Counts) -> Any:
    """Return whether a record is withheld or noise."""
    code = records[record, layout[0]] & layout[1]
    return records[record, layout[2]] & layout[3] != 0 or code == 7 or code == 18  # noqa: PLR1714


@kernel
def read_colours(records: Records, rules: RecordRules, at: int, shift: int, out: Colours) -> None:
    """Read the colours of the records that count, 3 x 16 bits from byte ``at``; they are shifted to 8 bits each."""
    to = 0
    for i in range(len(records)):
        if _is_dropped(records, i, rules.layout):
            continue
        colour = np.uint32(0)
        for k in range(at, at + 6, 2):
            value = np.uint32(records[i, k]) | np.uint32(records[i, k + 1]) << np.uint32(8)
            colour = colour << np.uint32(8) | min(value >> np.uint32(shift), np.uint32(255))
        out[to] = colour
        to += 1


@kernel
def filter_records(records: Records, rules: RecordRules, out: ScaledLinedPoints, seen: RecordCounts) -> None:
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
        to += 1
    counts[2] += outside
    counts[3] = to
    extremes[0], extremes[1], extremes[2] = x_min, x_max, y_min
    extremes[3], extremes[4], extremes[5] = y_max, z_min, z_max


CELL = 3.0
"""Side of a cell, m."""
QUANTA = 1e4
"""Steps of a coordinate in a metre."""
SUMS = 10
"""Sums of a cell: number of points, x, y, z, x x, x y, y y, x z, y z, z z."""
SLOTS = 1 << 13
"""Rows of a `CellTable`; a power of two."""
STRIP = 512
"""Points that are turned into metres at once."""
AXIS_BITS, LINE_BITS = 23, 17
"""Bits of a key: column and row of the cell, unique within 25,000 km; line number and ground flag."""
_AXIS_MASK = (1 << AXIS_BITS) - 1
_FULL = SLOTS * 3 // 4
_SHIFT = 64 - 13
"""Leaves 13 bits of a product of 64: the rows of a table of 8,192."""


Indices = Annotated[NDArray[np.int64], 1]
Rows = Annotated[NDArray[np.int64], 2]

Numbers = Annotated[NDArray[np.float64], 2]


class CellTable(NamedTuple):
    """A hash table of cells, (``SLOTS``,) rows."""

    keys: Indices
    """Key of the row; -1: empty."""
    sums: Rows
    """(``SLOTS``, ``SUMS``)."""
    state: Indices
    """(2,) the next point to add, and the rows in use."""


@helper
def _row_of(key: Any, table: CellTable) -> Any:
    """Return the row of a key, which is added if it is new."""
    row = np.int64((np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(_SHIFT))
    while table.keys[row] != key:
        if table.keys[row] == -1:
            table.keys[row] = key
            table.state[1] += 1
            break
        row = (row + 1) & (SLOTS - 1)
    return row


@helper
def _key(col: int, row: int, line: int, ground: bool) -> Any:
    key = (np.int64(col) & _AXIS_MASK) << (AXIS_BITS + LINE_BITS)
    key |= (np.int64(row) & _AXIS_MASK) << LINE_BITS
    return key | (np.int64(line) << 1) | np.int64(ground)


@helper
def _add(points: LinedPoints, table: CellTable) -> Any:
    """Add points until the table is full; return how many were added.

    Neighbours in a file are neighbours on the ground: sums of points in one cell are added up before they are stored.
    """
    i, n = 0, len(points.x)
    while i < n and table.state[1] < _FULL:
        line, ground = points.line[i], points.kind[i] == POINT_GROUND
        col, row = tile_index(points.x[i], CELL), tile_index(points.y[i], CELL)
        west, south = col * CELL, row * CELL
        east, north = (col + 1.0) * CELL, (row + 1.0) * CELL
        count = s1 = s2 = s3 = s4 = s5 = s6 = s7 = s8 = s9 = np.int64(0)
        while i < n:
            x, y = points.x[i], points.y[i]
            same = points.line[i] == line and (points.kind[i] == POINT_GROUND) == ground
            if count > 0 and not (same and west <= x < east and south <= y < north):
                break
            e, u = np.int64(np.rint((x - west) * QUANTA)), np.int64(np.rint(points.z[i] * QUANTA))
            m = np.int64(np.rint((y - south) * QUANTA))
            count, s1, s2, s3 = count + 1, s1 + e, s2 + m, s3 + u
            s4, s5, s6 = s4 + e * e, s5 + e * m, s6 + m * m
            s7, s8, s9 = s7 + e * u, s8 + m * u, s9 + u * u
            i += 1
        sums = table.sums[_row_of(_key(col, row, line, ground), table)]
        sums[0] += count
        sums[1] += s1
        sums[2] += s2
        sums[3] += s3
        sums[4] += s4
        sums[5] += s5
        sums[6] += s6
        sums[7] += s7
        sums[8] += s8
        sums[9] += s9
    return i


@kernel
def add_points(points: LinedPoints, table: CellTable) -> None:
    """Add points, from the one that ``state`` names, until all are added or the table is full."""
    first = table.state[0]
    rest = LinedPoints(points.x[first:], points.y[first:], points.z[first:], points.kind[first:], points.line[first:])
    table.state[0] = first + _add(rest, table)


@kernel
def add_scaled_points(points: ScaledLinedPoints, scaling: Floats, strip: Numbers, table: CellTable) -> None:
    """Do the same with points of a file's own grid, see `bumpytiles.Scaling.numbers`; ``strip`` (3, STRIP): scratch."""
    first, added, wanted = table.state[0], 0, 0
    while added == wanted and first < len(points.x):
        wanted = min(STRIP, len(points.x) - first)
        last = first + wanted
        x, y, z = strip[0][:wanted], strip[1][:wanted], strip[2][:wanted]
        there = LinedPoints(x, y, z, points.kind[first:last], points.line[first:last])
        coordinates(points.x[first:last], scaling, 0, there.x)
        coordinates(points.y[first:last], scaling, 1, there.y)
        coordinates(points.z[first:last], scaling, 2, there.z)
        added = _add(there, table)
        first += added
    table.state[0] = first


@kernel
def move_points(
    points: Annotated[NDArray[np.float32], 2],
    time: Annotated[NDArray[np.float32], 1],
    transforms: Annotated[NDArray[np.float64], 3],
    start: np.float64,
    step: np.float64,
    moved: Annotated[NDArray[np.float32], 2],
) -> None:
    """Move each point by the transform at its time.

    Parameters
    ----------
    points : (n, 3) float32
    time : (n,) float32
        s; from ``start`` to ``start + (k - 1) * step``.
    transforms : (k, 3, 4) float64
        At times ``start``, ``start + step`` and so on; in between, points are interpolated along a line.
    start, step : float
        s
    moved : (n, 3) float32
        Output.
    """
    last = transforms.shape[0] - 2
    for i in range(points.shape[0]):
        place = (np.float64(time[i]) - start) / step
        k = min(max(int(place), 0), last)
        share = place - k
        for row in range(3):
            first = transforms[k, row, 3]
            second = transforms[k + 1, row, 3]
            for column in range(3):
                value = np.float64(points[i, column])
                first += transforms[k, row, column] * value
                second += transforms[k + 1, row, column] * value
            moved[i, row] = np.float32(first + share * (second - first))


_STEP_S = 1e-3
"""Interval at which poses are computed. Points between them move along lines: at 3 rad/s, 0.1 mm off at 100 m."""


def deskew(scan: Scan, motion: PoseTrack) -> Scan:
    """Move the points of a scan to where they are seen from the pose at the time of the frame.

    Parameters
    ----------
    scan : Scan
        With the time of each point.
    motion : PoseTrack
        Poses of the sensor; time 0 is that of the frame.

    Returns
    -------
    Scan
        The same scan if it has no times, or if the poses do not cover them.
    """
    if scan.time is None or not len(scan.points):
        return scan
    start, end = float(scan.time.min()), float(scan.time.max())
    times = np.linspace(start, end, max(ceil((end - start) / _STEP_S), 1) + 1)
    if not motion.covers(np.append(times, 0.0)).all():
        return scan
    poses = motion.at(np.append(times, 0.0))
    relative = np.linalg.inv(poses[-1]) @ poses[:-1]
    moved = np.empty_like(scan.points)
    step = max(end - start, _STEP_S) / (len(times) - 1)
    move_points(
        scan.points, scan.time, np.ascontiguousarray(relative[:, :3]), np.float64(start), np.float64(step), moved
    )
    return replace(scan, points=moved)
