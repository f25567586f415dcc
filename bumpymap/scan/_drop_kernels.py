"""Compiled loop that finds where the ground of a scan drops: ditches, steps down, edges.

What lies behind an edge is not seen, and a plane that is fitted to both sides passes over it. Therefore the ground is
followed outwards, direction by direction: if what is seen next lies too far below where the ground should go on, there
is an edge in between. Nothing here allocates: scratch arrays come from the caller.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.scan._place_kernels import CellOrder, ZoneGrid
from bumpytiles import kernel

Integers = Annotated[NDArray[np.int32], 1]
Singles = Annotated[NDArray[np.float32], 2]


class GroundPoints(NamedTuple):
    """The points of a scan, and the slope of the ground."""

    points: Singles
    """(points, 3) m."""
    pixel: Integers
    """(points,) as `place_points` gives it."""
    is_ground: Annotated[NDArray[np.bool_], 1]
    """(points,)"""
    slope: Annotated[NDArray[np.float64], 2]
    """(cells, 2) along x and y; 0 where it is not known."""


class DropRule(NamedTuple):
    """Limits of a drop."""

    least: float
    """Less is none, m."""
    slope: float
    """A drop is steeper than this, against the slope of the ground before it."""
    below: float
    """The beam to what lies below passes the last ground before it above this, against that ground, m. If not, the
    ground goes on, and what is seen below is a reflection in it; -inf where the height of the sensor is not known."""
    directions: int
    """In which the ground is followed."""


@kernel
def find_drops(
    ground: GroundPoints,
    by_cell: CellOrder,
    grid: ZoneGrid,
    rule: DropRule,
    lowest_ground: Singles,
    lowest_other: Singles,
    drops: Integers,
) -> None:
    """Follow the ground outwards: count the drops in every cell.

    A drop counts for the last cell before it, and for the cell of what is seen below. ``lowest_ground``,
    ``lowest_other`` (cells, pixels^2): scratch: heights by pixel, m; ``drops`` (cells,): zeros; filled: in how many
    directions the ground drops in the cell.
    """
    points, pixel, slope = ground.points, ground.pixel, ground.slope
    pixels, zones = grid.pixels, len(grid.sectors)
    lowest_ground[:] = np.inf
    lowest_other[:] = np.inf
    for cell in range(len(by_cell.starts) - 2):
        for i in range(by_cell.starts[cell], by_cell.starts[cell + 1]):
            p = by_cell.order[i]
            if ground.is_ground[p]:
                lowest_ground[cell, pixel[p]] = min(lowest_ground[cell, pixel[p]], points[p, 2])
            else:
                lowest_other[cell, pixel[p]] = min(lowest_other[cell, pixel[p]], points[p, 2])
    for direction in range(rule.directions):
        share = (direction + 0.5) / rule.directions
        turn = 2.0 * math.pi * (share + grid.start)
        cos, sin = math.cos(turn), math.sin(turn)
        known, last_r, last_z, last_slope = False, 0.0, 0.0, 0.0
        last_cell, marked, first = -1, -1, 0
        for zone in range(zones):
            around = share * grid.sectors[zone]
            sector = int(around)
            column = int((around - sector) * pixels)
            step = (grid.edges[zone + 1] - grid.edges[zone]) / (grid.rings[zone] * pixels)
            for ring in range(grid.rings[zone]):
                cell = first + ring * grid.sectors[zone] + sector
                for row in range(pixels):
                    k = row * pixels + column
                    r = grid.edges[zone] + (ring * pixels + row + 0.5) * step
                    on_ground = lowest_ground[cell, k] < np.inf
                    z = np.float64(lowest_ground[cell, k] if on_ground else lowest_other[cell, k])
                    if z == np.inf:
                        continue
                    if known:
                        drop = last_z + last_slope * (r - last_r) - z
                        beam = z * last_r / r - last_z
                        if drop > rule.least and drop > rule.slope * (r - last_r) and beam > rule.below:
                            drops[last_cell] += marked != last_cell
                            drops[cell] += cell not in (last_cell, marked)
                            marked = cell
                    if on_ground:
                        known, last_r, last_z, last_cell = True, r, z, cell
                        last_slope = slope[cell, 0] * cos + slope[cell, 1] * sin
            first += grid.sectors[zone] * grid.rings[zone]
