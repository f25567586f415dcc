"""Which tiles a vehicle can pass: between obstacles, over edges, on slopes and ground that it survives."""

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Barred, VehicleBody
from bumpymap.rating._passable_kernels import InnerTiles, Mosaic, find_ways, grow_scratch, settle

__all__ = ["MARGIN_M", "find_passable", "settle_objects"]

MARGIN_M = 0.1
"""Room between vehicle and obstacle, m: half a pixel of 0.2 m, for an obstacle fills its pixel only in part."""


def settle_objects(objects: NDArray[np.uint8], pixels: int) -> NDArray[np.uint8]:
    """Decide the pixels at the borders of tiles whose few points make an obstacle only with those of the neighbour.

    Parameters
    ----------
    objects : uint8 (rows, cols)
        States of `bumpymap.core.ObjectStack`, tiles side by side, north row first; ``UNSEEN`` where a tile is missing.
    pixels : int
        Pixels along a side of a tile.

    Returns
    -------
    uint8 (rows, cols)
        The same without ``UNDECIDED``: obstacle beside an obstacle or another such pixel across the border, else free.
    """
    out = np.empty_like(objects)
    settle(np.ascontiguousarray(objects), pixels, out)
    return out


def find_passable(
    objects: NDArray[np.uint8],
    alone: NDArray[np.uint8],
    edge_usable: NDArray[np.bool_],
    body: VehicleBody,
    tile_size: float,
) -> NDArray[np.uint8]:
    """Sweep the vehicle through the free pixels of tiles that nothing else bars.

    The vehicle is a disc of its width and a margin of 0.1 m on each side. Its middle keeps that radius from obstacles,
    those of neighbouring tiles too, and from unseen pixels and missing tiles. A tile is passable if its free pixels
    join two edges that can be crossed, or reach one such edge in a tile without obstacles (a dead end). Where there is
    no way and no obstacle in the tile or within that radius of it, the reason is what is unknown.

    Parameters
    ----------
    objects : uint8 (tiles * pixels, tiles * pixels)
        Mosaic of a block and a ring of one tile around it, from `settle_objects`, north row first; ``UNSEEN`` where a
        tile is missing.
    alone : uint8 (tiles - 2, tiles - 2)
        What bars the inner tiles apart from that, of `CostRule.barred`; it is kept.
    edge_usable : bool (tiles - 2, tiles - 2, 4)
        Whether the edges of the inner tiles can be crossed: north, east, south, west.
    body : VehicleBody
        Its width, m.
    tile_size : float
        m; obstacles farther than a tile are not seen, so a vehicle wider than two tiles finds too much room.

    Returns
    -------
    uint8 (tiles - 2, tiles - 2)
        What bars the inner tiles, a `Barred`.
    """
    wanted = alone == Barred.NO
    if not wanted.any():
        return alone.copy()
    pixels = len(objects) // (len(alone) + 2)
    found = InnerTiles(
        np.ascontiguousarray(edge_usable, np.bool_), wanted, *(np.empty(alone.shape, np.bool_) for _ in range(3))
    )
    radius = (0.5 * body.width_m + MARGIN_M) * pixels / tile_size
    mosaic = Mosaic(np.ascontiguousarray(objects), pixels, radius)
    rows, cols = objects.shape
    find_ways(mosaic, found, grow_scratch(rows, cols, pixels, radius))
    return np.select(
        [~wanted, found.near_obstacle, found.blocked, ~found.passable],
        [alone, np.uint8(Barred.OBSTACLE), np.uint8(Barred.UNKNOWN), np.uint8(Barred.STEP)],
        np.uint8(Barred.NO),
    )
