"""Find where the ground of a scan drops, and where it ends: nothing shows that it can be driven on from there."""

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import PolarSettings
from bumpymap.scan._drop_kernels import DropRule, DropScratch, GroundEnds, GroundPoints, find_drops
from bumpymap.scan._place_kernels import CellOrder, ZoneGrid
from bumpymap.scan.buffers import SectorBuffers

__all__ = ["ground_ends"]

_DIRECTIONS = 720
"""Directions in which the ground is followed."""
_SLOPE = 0.08
"""A drop is steeper than this, against the slope of the ground before it; hills are not. The view over an edge is as
steep 15 m away from a sensor that is 1.2 m high, so edges farther away are not found."""
_BELOW_M = -0.1
"""Beams to what lies behind an edge pass above the ground before it; so much may be an error, m."""
_SENSOR_M = 0.25
"""If the origin is less above the ground than this, it is not where the sensor is, m."""
_SHARE = 0.2
"""A cell has a drop if it is seen in such a share of its directions."""
_AROUND = 2
"""Ground that is missing between such near directions is a lost return, not an end."""


def ground_ends(
    ground: GroundPoints,
    by_cell: CellOrder,
    grid: ZoneGrid,
    settings: PolarSettings,
    height_m: float,
    buffers: SectorBuffers,
) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """Find the cells in which the ground drops by more than the clearance of the belly, and where it ends.

    Parameters
    ----------
    ground : GroundPoints
    by_cell : CellOrder
    grid : ZoneGrid
    settings : PolarSettings
    height_m : float
        Of the origin above the ground.
    buffers : SectorBuffers

    Returns
    -------
    drops : (cells,) bool
    end : (directions,) float32
        Distance at which the farthest ground in each direction ends, m; from sector 0 on, counter-clockwise.
    """
    cells = len(ground.slope)
    lowest = DropScratch(
        *(buffers.empty(name, grid.pixels**2, np.float32, rows=cells) for name in ("lowest_ground", "lowest_other"))
    )
    out = GroundEnds(np.zeros(cells, np.int32), np.empty(_DIRECTIONS, np.float32))
    below = _BELOW_M if height_m > _SENSOR_M else -np.inf
    find_drops(ground, by_cell, grid, DropRule(settings.belly_m, _SLOPE, below), lowest, out)
    seen = np.repeat(_DIRECTIONS / grid.sectors, grid.sectors * grid.rings)
    end = np.max([np.roll(out.end, step) for step in range(-_AROUND, _AROUND + 1)], axis=0)
    return out.drops >= _SHARE * seen, end
