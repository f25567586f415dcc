"""Sums of the points of each flight line in each cell of a grid, and heights without the offset of their line.

The sums are integers of 0.1 mm, so that they do not depend on the order of the points. Sums that exceed 64 bits wrap
around; differences of them are right again.
"""

import math
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpytiles import coordinate, helper, kernel

__all__ = [
    "AXIS_BITS",
    "CELL",
    "LINE_BITS",
    "QUANTA",
    "SLOTS",
    "SUMS",
    "CellTable",
    "Corrections",
    "LinedPoints",
    "ScaledLinedPoints",
    "add_points",
    "add_scaled_points",
    "correct_heights",
]

CELL = 3.0
"""Side of a cell, m."""
QUANTA = 1e4
"""Steps of a coordinate in a metre."""
SUMS = 10
"""Sums of a cell: number of points, x, y, z, x x, x y, y y, x z, y z, z z."""
SLOTS = 1 << 13
"""Rows of a `CellTable`; a power of two."""
AXIS_BITS, LINE_BITS = 23, 17
"""Bits of a key: column and row of the cell, unique within 25,000 km; line number and ground flag."""
_AXIS_MASK = (1 << AXIS_BITS) - 1
_FULL = SLOTS * 3 // 4
_SHIFT = 64 - 13

Floats = Annotated[NDArray[np.float64], 1]
Flags = Annotated[NDArray[np.bool_], 1]
Lines = Annotated[NDArray[np.uint16], 1]
Indices = Annotated[NDArray[np.int64], 1]
Rows = Annotated[NDArray[np.int64], 2]
Words = Annotated[NDArray[np.int32], 1]
Places = Annotated[NDArray[np.int32], 1]
Numbers = Annotated[NDArray[np.float64], 2]


class LinedPoints(NamedTuple):
    """Points with their flight line, (n,) each."""

    x: Floats
    """m, as the two that follow."""
    y: Floats
    z: Floats
    ground: Flags
    line: Lines


class ScaledLinedPoints(NamedTuple):
    """The same, with coordinates as integers of the file's own grid, see `bumpytiles.ScaledPoints`."""

    x: Words
    y: Words
    z: Words
    ground: Flags
    line: Lines


class CellTable(NamedTuple):
    """A hash table of cells, (``SLOTS``,) rows."""

    keys: Indices
    """Key of the row; -1: empty."""
    sums: Rows
    """(``SLOTS``, ``SUMS``)."""
    state: Indices
    """(2,) the next point to add, and the rows in use."""


class Corrections(NamedTuple):
    """What to subtract from the heights of each line."""

    place: Places
    """(65536,) row of each line in ``numbers``; -1: nothing to subtract."""
    numbers: Numbers
    """(lines, 5) offset [m], east and north of the place where it applies [m], slopes to the east and north [m/m]."""


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
def _add(x: float, y: float, z: float, row: Any, sums: Rows) -> None:
    """Add a point, whose place is that in its cell, to a row."""
    e, n = np.int64(np.rint(x * QUANTA)), np.int64(np.rint(y * QUANTA))
    u = np.int64(np.rint(z * QUANTA))
    sums[row, 0] += 1
    sums[row, 1] += e
    sums[row, 2] += n
    sums[row, 3] += u
    sums[row, 4] += e * e
    sums[row, 5] += e * n
    sums[row, 6] += n * n
    sums[row, 7] += e * u
    sums[row, 8] += n * u
    sums[row, 9] += u * u


@helper
def _key(col: float, row: float, line: int, ground: bool) -> Any:
    key = (np.int64(col) & _AXIS_MASK) << (AXIS_BITS + LINE_BITS)
    key |= (np.int64(row) & _AXIS_MASK) << LINE_BITS
    return key | (np.int64(line) << 1) | np.int64(ground)


@kernel
def add_points(points: LinedPoints, table: CellTable) -> None:
    """Add points, from the one that ``state`` names, until all are added or the table is full."""
    i, key_before, row = table.state[0], np.int64(-1), np.int64(0)
    while i < len(points.x) and table.state[1] < _FULL:
        x, y = points.x[i], points.y[i]
        col, line = math.floor(x / CELL), math.floor(y / CELL)
        key = _key(col, line, points.line[i], points.ground[i])
        if key != key_before:
            row, key_before = _row_of(key, table), key
        _add(x - col * CELL, y - line * CELL, points.z[i], row, table.sums)
        i += 1
    table.state[0] = i


@kernel
def add_scaled_points(points: ScaledLinedPoints, scaling: Floats, table: CellTable) -> None:
    """Do the same with points of a file's own grid, see `bumpytiles.Scaling.numbers`."""
    i, key_before, row = table.state[0], np.int64(-1), np.int64(0)
    while i < len(points.x) and table.state[1] < _FULL:
        x, y = coordinate(points.x[i], scaling, 0), coordinate(points.y[i], scaling, 1)
        col, line = math.floor(x / CELL), math.floor(y / CELL)
        key = _key(col, line, points.line[i], points.ground[i])
        if key != key_before:
            row, key_before = _row_of(key, table), key
        _add(x - col * CELL, y - line * CELL, coordinate(points.z[i], scaling, 2), row, table.sums)
        i += 1
    table.state[0] = i


@kernel
def correct_heights(points: LinedPoints, corrections: Corrections) -> None:
    """Subtract the offset of each point's line from its height."""
    numbers = corrections.numbers
    for i in range(len(points.x)):
        row = corrections.place[points.line[i]]
        if row >= 0:
            east, north = points.x[i] - numbers[row, 1], points.y[i] - numbers[row, 2]
            points.z[i] -= numbers[row, 0] + numbers[row, 3] * east + numbers[row, 4] * north
