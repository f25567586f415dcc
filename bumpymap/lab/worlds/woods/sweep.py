"""The truth about a made-up wood: its obstacle pixels, and where a disc of the vehicle's width gets through."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, label

from bumpymap.lab.worlds.woods.wood import Wood

__all__ = ["swept_tiles", "true_pixels"]


def true_pixels(wood: Wood, low: float, high: float, pixel: float, parts: int = 4) -> NDArray[np.bool_]:
    """Return which pixels of the wood hold anything between two heights above ground, north row first.

    Parameters
    ----------
    wood : Wood
    low, high : float
        m.
    pixel : float
        Side of a pixel, m.
    parts : int
        A pixel is looked at in so many rows and columns.
    """
    fine = wood.blocked(low, high, pixel / parts)
    rows = len(fine) // parts
    return np.asarray(fine.reshape(rows, parts, rows, parts).any(axis=(1, 3)))


def swept_tiles(
    wood: Wood, low: float, high: float, width: float, tile: float, step: float = 0.05
) -> NDArray[np.bool_]:
    """Return through which tiles a disc can be swept among the true obstacles, (tiles, tiles), north row first.

    Its middle gets from one side of the tile to another; in a tile without obstacles it is enough that it fits.

    Parameters
    ----------
    wood : Wood
    low, high : float
        Heights between which a thing is in the way, m.
    width : float
        Diameter of the disc, m.
    tile, step : float
        Side of a tile, and of the cells of the sweep, m.
    """
    blocked = wood.blocked(low, high, step)
    free = distance_transform_edt(~blocked) * step > 0.5 * width
    side = round(tile / step)
    count = len(free) // side
    out = np.zeros((count, count), np.bool_)
    for row in range(count):
        for col in range(count):
            cells = np.s_[row * side : (row + 1) * side, col * side : (col + 1) * side]
            parts, found = label(free[cells])
            sides = [set(edge) - {0} for edge in (parts[0], parts[-1], parts[:, 0], parts[:, -1])]
            met = [sum(number in edge for edge in sides) for number in range(1, found + 1)]
            out[row, col] = max(met, default=0) >= (2 if blocked[cells].any() else 1)
    return out
