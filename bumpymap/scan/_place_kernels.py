"""Compiled loops over the points of a scan: where each lies on the polar grid.

``place_points`` finds the cell (zone, ring, sector) and the pixel of every point, ``sort_points`` lists the points by
cell. Nothing here allocates: scratch arrays come from the caller.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpytiles import helper, kernel

__all__ = [
    "BLOCK",
    "CellOrder",
    "ZoneGrid",
    "place_points",
    "point_directions",
    "sort_points",
    "turn_of",
]

Floats = Annotated[NDArray[np.float64], 1]
ScanPoints = Annotated[NDArray[np.float32], 2]
Integers = Annotated[NDArray[np.int32], 1]
Counts = Annotated[NDArray[np.int64], 1]

BLOCK = 512
"""Points whose distance and direction are found at once: they stay in the nearest cache."""
_EIGHTH = math.sqrt(2.0) - 1.0
"""Tangent of an eighth of a half turn."""


class ZoneGrid(NamedTuple):
    """The polar grid."""

    edges: Floats
    """(zones + 1,) where zones begin, and the last one ends, m; half-open."""
    sectors: Counts
    """(zones,) of each zone, as the next."""
    rings: Counts
    start: float
    """Where sector 0 starts, as a share of a turn."""
    pixels: int
    """Rows (outwards) and columns (counter-clockwise) of a sector."""


class CellOrder(NamedTuple):
    """The points by cell, in the scan's order inside each."""

    starts: Counts
    """(cells + 2,) cell c has ``order[starts[c]:starts[c + 1]]``; the last entry is scratch."""
    order: Integers
    """(points,)."""


@helper
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


@kernel
def point_directions(points: ScanPoints, reach: Floats, total: Floats) -> None:
    """Sum the horizontal unit vectors of the points whose distance is in ``reach`` (from, below), m.

    ``points`` (points, 3): m; ``reach`` (2,): m; ``total`` (2,): filled: sums of x and of y.
    """
    sx = sy = 0.0
    for i in range(len(points)):
        x, y = np.float64(points[i, 0]), np.float64(points[i, 1])
        r = math.sqrt(x * x + y * y)
        if reach[0] <= r < reach[1] and r > 0.0:  # straight above or below has no direction
            sx += x / r
            sy += y / r
    total[0], total[1] = sx, sy


@kernel
def place_points(
    points: ScanPoints, grid: ZoneGrid, cell: Integers, pixel: Integers, polar: Annotated[NDArray[np.float64], 2]
) -> None:
    """Find the cell and the pixel of every point.

    ``points`` (points, 3): m; ``cell`` (points,): filled: its number, by zone, ring, sector, -1 outside the grid;
    ``pixel`` (points,): filled: ``row * pixels + column``; ``polar`` (2, ``BLOCK``): scratch: distance and turn of so
    many points at a time.
    """
    edges, sectors, rings, pixels = grid.edges, grid.sectors, grid.rings, grid.pixels
    zones = len(sectors)
    for begin in range(0, len(points), BLOCK):
        some = points[begin : begin + BLOCK]
        distance, turns = polar[0, : len(some)], polar[1, : len(some)]
        for i in range(len(some)):
            x, y = np.float64(some[i, 0]), np.float64(some[i, 1])
            distance[i] = math.sqrt(x * x + y * y)
            turn = turn_of(x, y) - grid.start
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
            outward = (r - edges[zone]) / (edges[zone + 1] - edges[zone]) * rings[zone]
            ring = min(int(outward), rings[zone] - 1)
            around = turns[i] * sectors[zone]
            sector = min(int(around), sectors[zone] - 1)
            row = min(int((outward - ring) * pixels), pixels - 1)
            column = min(int((around - sector) * pixels), pixels - 1)
            cell[at] = np.int32(first + ring * sectors[zone] + sector)
            pixel[at] = np.int32(row * pixels + column)


@kernel
def sort_points(cell: Integers, out: CellOrder) -> None:
    """List the points by cell, -1 outside the grid; ``out.starts`` comes as zeros."""
    starts, order = out.starts, out.order
    for i in range(len(cell)):
        if cell[i] >= 0:
            starts[cell[i] + 2] += 1
    for c in range(2, len(starts)):
        starts[c] += starts[c - 1]
    for i in range(len(cell)):
        if cell[i] >= 0:
            order[starts[cell[i] + 1]] = np.int32(i)
            starts[cell[i] + 1] += 1
