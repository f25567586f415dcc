"""Compiled loops over the points of a scan: where each lies on the polar grid.

``place_points`` finds the cell (zone, ring, sector) and the pixel of every point, ``sort_points`` lists the points by
cell, ``count_labels`` goes through the labels of each. Nothing here allocates: scratch arrays come from the caller.
"""

import math

import numpy as np
from numpy.typing import NDArray

from bumpytiles import entry, inner

__all__ = ["count_labels", "place_points", "point_directions", "sort_points", "turn_of"]

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int32]

_EIGHTH = math.sqrt(2.0) - 1.0
"""Tangent of an eighth of a half turn."""


@inner
def turn_of(x: float, y: float) -> float:
    """Angle from the x axis towards y as a share of a full turn, -0.5 to 0.5; 0 at the origin.

    The arctangent's own series, after the angle was folded into an eighth of a half turn: as exact as is asked for,
    without a call to a library whose last bit differs between machines, and without a branch that could be foreseen
    wrongly.
    """
    ax, ay = abs(x), abs(y)
    high, low = max(ax, ay), min(ax, ay)
    folded = low > _EIGHTH * high
    above, below = (low - high, low + high) if folded else (low, high)
    t = above / (below if below > 0.0 else 1.0)
    q = t * t
    s = 1 / 19 - q * (1 / 21)
    s = 1 / 11 - q * (1 / 13 - q * (1 / 15 - q * (1 / 17 - q * s)))
    s = 1 / 3 - q * (1 / 5 - q * (1 / 7 - q * (1 / 9 - q * s)))
    angle = t * (1.0 - q * s) * (0.5 / math.pi) + (0.125 if folded else 0.0)
    angle = 0.25 - angle if ay > ax else angle
    angle = 0.5 - angle if x < 0.0 else angle
    return -angle if y < 0.0 else angle


@entry("f4:2 f8:1 f8:1")
def point_directions(points: Singles, reach: Floats, total: Floats) -> None:
    """Sum the horizontal unit vectors of the points whose distance is in ``reach`` (from, below), m.

    Parameters
    ----------
    points : (points, 3) float32
        m.
    reach : (2,) float64
        m.
    total : (2,) float64
        Filled: sums of x and of y.
    """
    sx = sy = 0.0
    for i in range(len(points)):
        x, y = np.float64(points[i, 0]), np.float64(points[i, 1])
        r = math.sqrt(x * x + y * y)
        if reach[0] <= r < reach[1]:
            sx += x / r
            sy += y / r
    total[0], total[1] = sx, sy


@entry("f4:2 f8:1 i8:1 i8:1 f8 i8 f8:2 i4:1 i4:1")
def place_points(
    points: Singles,
    edges: Floats,
    sectors: NDArray[np.int64],
    rings: NDArray[np.int64],
    start: float,
    pixels: int,
    polar: Floats,
    cell: Integers,
    pixel: Integers,
) -> None:
    """Find the cell and the pixel of every point.

    Parameters
    ----------
    points : (points, 3) float32
        m.
    edges : (zones + 1,) float64
        Where zones begin, and the last one ends, m; half-open.
    sectors, rings : (zones,) int64
        Of each zone.
    start : float
        Where sector 0 starts, as a share of a turn.
    pixels : int
        Rows (outwards) and columns (counter-clockwise) of a sector.
    polar : (2, block) float64
        Scratch: distance and turn of so many points at a time.
    cell : (points,) int32
        Filled: number of the cell, by zone, ring, sector; -1 outside the grid.
    pixel : (points,) int32
        Filled: ``row * pixels + column``.
    """
    zones, block = len(sectors), polar.shape[1]
    for begin in range(0, len(points), block):
        some = points[begin : begin + block]
        distance, turns = polar[0, : len(some)], polar[1, : len(some)]
        for i in range(len(some)):
            x, y = np.float64(some[i, 0]), np.float64(some[i, 1])
            distance[i] = math.sqrt(x * x + y * y)
            turn = turn_of(x, y) - start
            turn = turn + 1.0 if turn < 0.0 else turn
            turns[i] = turn + 1.0 if turn < 0.0 else turn
        for i in range(len(some)):
            r, at = distance[i], begin + i
            cell[at], pixel[at] = -1, 0
            if not edges[0] <= r < edges[zones]:
                continue
            zone, first = 0, 0
            while r >= edges[zone + 1]:
                first += sectors[zone] * rings[zone]
                zone += 1
            out = (r - edges[zone]) / (edges[zone + 1] - edges[zone]) * rings[zone]
            ring = min(int(out), rings[zone] - 1)
            around = turns[i] * sectors[zone]
            sector = min(int(around), sectors[zone] - 1)
            row = min(int((out - ring) * pixels), pixels - 1)
            column = min(int((around - sector) * pixels), pixels - 1)
            cell[at] = np.int32(first + ring * sectors[zone] + sector)
            pixel[at] = np.int32(row * pixels + column)


@entry("i4:1 i8:1 i4:1")
def sort_points(cell: Integers, starts: NDArray[np.int64], order: Integers) -> None:
    """List the points by cell, in the scan's order inside each.

    Parameters
    ----------
    cell : (points,) int32
        -1 outside the grid.
    starts : (cells + 2,) int64
        Zeros. Filled: cell c has ``order[starts[c]:starts[c + 1]]``; the last entry is scratch.
    order : (points,) int32
        Filled.
    """
    for i in range(len(cell)):
        if cell[i] >= 0:
            starts[cell[i] + 2] += 1
    for c in range(2, len(starts)):
        starts[c] += starts[c - 1]
    for i in range(len(cell)):
        if cell[i] >= 0:
            order[starts[cell[i] + 1]] = np.int32(i)
            starts[cell[i] + 1] += 1


@entry("u2:1 i4:1 i8:1 i8:1 i4:1 i2:1")
def count_labels(
    label: NDArray[np.uint16],
    order: Integers,
    starts: NDArray[np.int64],
    cells: NDArray[np.int64],
    tally: Integers,
    most: NDArray[np.int16],
) -> None:
    """Find the most frequent label of each listed sector, the smallest of equals.

    Parameters
    ----------
    label : (points,) uint16
        Below 32,768.
    order, starts, cells
        As in ``measure_sectors``.
    tally : (32768,) int32
        Scratch, zeros before and after.
    most : (sectors,) int16
        Filled.
    """
    for s in range(len(cells)):
        first, last = starts[cells[s]], starts[cells[s] + 1]
        best, count = 0, 0
        for i in range(first, last):
            mine = int(label[order[i]])
            tally[mine] += 1
            if tally[mine] > count or (tally[mine] == count and mine < best):
                best, count = mine, tally[mine]
        for i in range(first, last):
            tally[label[order[i]]] = 0
        most[s] = best
