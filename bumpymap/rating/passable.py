"""Tiles that a vehicle can pass: between obstacles, over edges, on slopes and ground that it survives."""

from itertools import product

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    CLOSED_WHOLLY,
    FREE,
    OBSTACLE,
    STEP_EDGE,
    UNDECIDED,
    UNSEEN,
    Barred,
    VehicleBody,
    corners_join,
    loops,
    obstacle_reach,
    tiles_of,
    within,
)

_MOST_MARGIN = 0.45
"""Of a tile: what wide vehicles keep from tiles that their ground bars, so that corridors of one tile stay open."""


def settle_objects(objects: NDArray[np.uint8], pixels: int) -> NDArray[np.uint8]:
    """Decide the pixels at the borders of tiles whose few points make an obstacle only with those of the neighbour.

    ``objects`` (rows, cols): states of `bumpymap.core.ObjectStack`, tiles side by side, north row first; ``UNSEEN``
    where a tile is missing. They are returned without ``UNDECIDED``: obstacle beside an obstacle or another such pixel
    across the border, else free. ``pixels``: along a side of a tile.
    """
    undecided, near = objects == UNDECIDED, np.zeros(objects.shape, np.bool_)
    holds = np.pad((objects == OBSTACLE) | undecided, 1)
    rows, cols = (np.arange(size) % pixels for size in objects.shape)
    last = {-1: 0, 0: -1, 1: pixels - 1}  # the row or column of a tile beside which another tile begins
    for (down, row), (right, col) in product(last.items(), repeat=2):
        other = (rows == row)[:, None] | (cols == col)
        near |= other & holds[1 + down :, 1 + right :][: len(rows), : len(cols)]
    return np.where(undecided, np.where(near, np.uint8(OBSTACLE), np.uint8(FREE)), objects)


def find_passable(
    objects: NDArray[np.uint8],
    alone: NDArray[np.uint8],
    edge_usable: NDArray[np.bool_],
    body: VehicleBody,
    tile_size: float,
) -> NDArray[np.uint8]:
    """Sweep the vehicle through the free pixels of tiles that nothing else bars; return what bars the inner tiles.

    The vehicle is a disc of its width and a margin of 0.1 m on each side. Its middle keeps that radius from obstacles,
    those of neighbouring tiles too, and from unseen pixels and missing tiles. A tile is passable if its free pixels
    join two edges that can be crossed, or reach one such edge in a tile without obstacles (a dead end). Where there is
    no way and no obstacle in the tile or within that radius of it, the reason is what was not seen.

    ``objects`` (tiles * pixels, tiles * pixels): mosaic of a block and a ring of one tile around it, from
    `settle_objects`, north row first; ``UNSEEN`` where a tile is missing. ``alone`` (tiles - 2, tiles - 2): what bars
    the inner tiles apart from that, of `CostRule.barred`; it is kept. ``edge_usable`` (tiles - 2, tiles - 2, 4):
    whether their edges can be crossed: north, east, south, west. Obstacles farther than a tile (``tile_size``, m) are
    not seen, so a vehicle wider than two tiles finds too much room.
    """
    wanted = alone == Barred.NO
    if not wanted.any():
        return alone.copy()
    pixels = len(objects) // (len(alone) + 2)
    radius, corners = _reach(body, tile_size, pixels)
    stands, edges = (objects == OBSTACLE) | (objects == STEP_EDGE), np.ascontiguousarray(edge_usable, np.bool_)
    mask = within(stands | (objects == UNSEEN), radius).view(np.uint8)
    passable, blocked, near_obstacle = (np.zeros_like(wanted) for _ in range(3))
    loops.find_ways(np.ascontiguousarray(objects), mask, edges, wanted, corners, passable, blocked)
    if blocked.any():
        near_obstacle = np.asarray(tiles_of(within(stands, radius), pixels)[1:-1, 1:-1].any(axis=(2, 3)))
    return np.select(
        [~wanted, blocked & near_obstacle, blocked, ~passable],
        [alone, np.uint8(Barred.OBSTACLE), np.uint8(Barred.LITTLE_SEEN), np.uint8(Barred.STEP)],
        np.uint8(Barred.NO),
    )


def free_areas(
    objects: NDArray[np.uint8],
    alone: NDArray[np.uint8],
    barred: NDArray[np.uint8],
    body: VehicleBody,
    tile_size: float,
) -> NDArray[np.uint8]:
    """Find where the middle of the vehicle can be, pixel by pixel.

    It keeps the radius of `find_passable` from obstacles, steps and unseen pixels, and from tiles that their ground
    bars, but at most 0.45 tiles from those, so that corridors of one tile stay open. ``objects``, ``body``,
    ``tile_size`` are as there; ``alone`` (tiles, tiles): what bars the tiles of the mosaic apart from objects,
    `Barred.UNKNOWN` in missing tiles; ``barred`` (tiles - 2, tiles - 2): from `find_passable`: there are no areas in
    inner tiles that it closes as a whole.

    Returns uint8 (tiles - 2, tiles - 2, pixels, pixels): areas of pixels that hang together by their sides, and by
    their corners where `bumpymap.core.corners_join` holds, numbered in each tile from 1, the largest; 0 where the
    middle of the vehicle cannot be.
    """
    pixels = len(objects) // len(alone)
    radius, corners = _reach(body, tile_size, pixels)
    taken = within((objects == OBSTACLE) | (objects == STEP_EDGE) | (objects == UNSEEN), radius)
    near = _beside(np.isin(alone, CLOSED_WHOLLY), min(radius, _MOST_MARGIN * pixels), pixels)
    free = ~tiles_of(taken, pixels)[1:-1, 1:-1] & ~near & ~np.isin(barred, CLOSED_WHOLLY)[..., None, None]
    areas = np.empty(free.shape, np.uint8)
    loops.number_areas(np.ascontiguousarray(free).view(np.uint8), corners, areas)
    return areas


def close_split_tiles(
    areas: NDArray[np.uint8], barred: NDArray[np.uint8], body: VehicleBody, tile_size: float
) -> NDArray[np.uint8]:
    """Bar the tiles in which the middle of the vehicle cannot be, and those that obstacles split (``SPLIT``).

    Programs that read tiles alone step from one passable tile to any of the eight around it. So of two such tiles whose
    largest areas are not joined, the one with the smaller is barred: then every step between passable tiles is one that
    the vehicle can take.

    ``areas`` (tiles, tiles, pixels, pixels): from `free_areas`, of a block and a ring of one tile around it; 0 in
    missing tiles. ``barred`` (tiles, tiles): from `find_passable`; `Barred.UNKNOWN` in missing tiles. Returns it with
    the split tiles, without the ring.
    """
    largest = (areas == 1).sum(axis=(2, 3), dtype=np.int32)
    passable = barred == Barred.NO
    split = passable & (largest == 0)
    _, corners = _reach(body, tile_size, areas.shape[2])
    loops.close_split(np.ascontiguousarray(areas), largest, passable, corners, split)
    return np.where(split, np.uint8(Barred.SPLIT), barred)[1:-1, 1:-1]


def _reach(body: VehicleBody, tile_size: float, pixels: int) -> tuple[float, bool]:
    """Return the radius that a vehicle keeps from obstacles, px, and whether free pixels join by their corners too."""
    reach = obstacle_reach(body.width_m)
    return reach * pixels / tile_size, corners_join(body.width_m, reach, tile_size / pixels)


def _beside(marked: NDArray[np.bool_], reach: float, pixels: int) -> NDArray[np.bool_]:
    """Return which pixels of the inner tiles lie nearer than ``reach`` [px] to a marked tile around their own."""
    apart = np.stack([np.arange(pixels) + 0.5, np.zeros(pixels), np.arange(pixels)[::-1] + 0.5])
    rows, cols = (side - 2 for side in marked.shape)
    near = np.zeros((rows, cols, pixels, pixels), np.bool_)
    for down in range(3):
        for right in range(3):
            pixel = np.hypot(apart[down][:, None], apart[right]) < reach
            near |= marked[down : down + rows, right : right + cols, None, None] & pixel
    return near
