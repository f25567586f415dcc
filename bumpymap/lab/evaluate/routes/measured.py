"""The ground that is driven over, and what the ride model says of it as it was measured.

The map predicts C_r of the ground without the survey's noise; the drives run over heights that contain it. The
prediction without noise correction is for the same heights as the drives, so the ratio of both predictions is the part
of the noise in the difference between map and drive.
"""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import OBSTACLE, TileField
from bumpymap.lab.simulate import fill_gaps
from bumpymap.rating import RideModel, less_floor, roll_over

__all__ = ["OBSTACLE_M", "driven_field", "driven_heights", "ride_without_correction"]

Floats = NDArray[np.float64]
OBSTACLE_M = 1.0
"""Height by which pixels with an obstacle are raised, m: no vehicle climbs it."""
_MANY_POINTS = 10.0
"""Points per pixel; without a correction of noise they have no effect."""


def driven_heights(heights: NDArray[np.floating], objects: NDArray[np.uint8]) -> Floats:
    """Return the ground to drive over: gaps filled, obstacles raised.

    Parameters
    ----------
    heights : array (rows, cols)
        m, NaN where no point fell.
    objects : uint8 (rows, cols)
        States of the pixels; `OBSTACLE` is raised.
    """
    raised: Floats = fill_gaps(heights) + OBSTACLE_M * (objects == OBSTACLE)
    return raised


def driven_field(field: TileField, floor: float) -> TileField:
    """Return a map's tiles without the floor of the vehicle [rad/m], which simulated drives do not have."""
    ends = (field.c_r, field.c_r_low, field.c_r_high)
    c_r, low, high = (less_floor(values, floor).astype(np.float32) for values in ends)
    return replace(field, c_r=c_r, c_r_low=low, c_r_high=high)


def ride_without_correction(model: RideModel, heights: NDArray[np.floating], known: NDArray[np.bool_]) -> Floats:
    """Predict C_r of tiles from their heights as measured, as if these had no noise.

    Parameters
    ----------
    model : RideModel
    heights : array (rows * pixels, cols * pixels)
        m, NaN where no point fell; gaps are filled tile by tile.
    known : bool (rows, cols)
        Tiles to predict; each holds a known height.

    Returns
    -------
    array (rows, cols)
        rad/m; NaN elsewhere.
    """
    pixels, size = model.calibration.pixels, model.calibration.tile_size
    rows, cols = known.shape
    tiles = heights.reshape(rows, pixels, cols, pixels).swapaxes(1, 2)[known]
    out = np.full(known.shape, math.nan)
    if not len(tiles):
        return out
    filled = np.stack([fill_gaps(tile) for tile in tiles])
    axis = np.arange(pixels) - (pixels - 1) / 2
    norm = pixels * float(axis @ axis)
    east, south = filled.sum(axis=1) @ axis / norm, filled.sum(axis=2) @ axis / norm
    plane = filled.mean(axis=(1, 2))[:, None, None] + east[:, None, None] * axis + south[:, None, None] * axis[:, None]
    slope = np.degrees(np.arctan(np.hypot(east, south) * pixels / size))
    rides = roll_over((filled - plane).astype(np.float32), model.operator)
    found = model.correction.predict(rides, slope, np.zeros(len(tiles)), np.full(len(tiles), _MANY_POINTS))
    out[known] = np.exp(found.log_c_r)
    return out
