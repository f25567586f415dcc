"""Tiles that a vehicle can pass: between obstacles, over edges, on slopes and ground that it survives; and zones.

A zone is ground that hangs together and that the vehicle cannot leave. The pixels on which its middle can be are
labelled strip by strip, each strip with the line of pixels to its north and the column to its west: areas that hang
together with those are the same piece. So only that frame and a number for each tile are kept, and the zones do not
depend on how the tiles are divided among strips.
"""

from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

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
from bumpytiles import BLOCK_TILES, BlockKey, Grid

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


_LAST = np.iinfo(np.int64).max


class ZoneFinder:
    """Finds the zones of tiles, which are added in strips: from north to south, and from west to east in a row.

    Parameters
    ----------
    grid : Grid
        Its tiles and pixels.
    body : VehicleBody
        The vehicle: where it is wide enough, areas hang together by the corners of pixels too, as routes take them.
    """

    def __init__(self, grid: Grid, body: VehicleBody) -> None:
        self._pixels = grid.pixels
        corners = corners_join(body.width_m, obstacle_reach(body.width_m), grid.pixel_size)
        self._together = ndimage.generate_binary_structure(2, 2 if corners else 1)
        self._south: dict[BlockKey, NDArray[np.int64]] = {}
        """Labels of the last line of blocks, by the block to the south."""
        self._east: dict[BlockKey, NDArray[np.int64]] = {}
        """Labels of the last column of the last strip, by the block to the east."""
        self._labels = 0
        self._pairs = [np.empty((2, 0), np.int64)]
        self._sizes, self._firsts = [np.zeros(1, np.int64)], [np.full(1, _LAST)]

    def add(
        self, block: BlockKey, col: NDArray[np.int64], row: NDArray[np.int64], passage: NDArray[np.uint8],
        passable: NDArray[np.bool_],
    ) -> NDArray[np.int32]:  # fmt: skip
        """Add the tiles of adjoining blocks of one row; return the label of the largest area of each, 0: none, (n,).

        ``block``: the westernmost; ``col``, ``row`` (n,): place of the tiles; ``passage`` (n, pixels, pixels): their
        areas, 0 where the middle of the vehicle cannot be, 1 in the largest; ``passable`` (n,): whether the vehicle
        can cross them.
        """
        px, side, count = self._pixels, BLOCK_TILES * self._pixels, len(col)
        line, column = (block[0] + 1) * BLOCK_TILES - 1 - row, col - block[1] * BLOCK_TILES
        blocks = int(column.max()) // BLOCK_TILES + 1
        canvas = np.zeros((BLOCK_TILES, px, blocks * BLOCK_TILES, px), np.bool_)
        canvas[line, :, column, :] = passage > 0
        # Labels of the pixels north of the strip, one more on each side, and of those west of it.
        nothing = np.zeros(side, np.int64)
        lines = [self._south.get((block[0], block[1] + each), nothing) for each in range(-1, blocks + 1)]
        north, west = np.concatenate([lines[0][-1:], *lines[1:-1], lines[-1][:1]]), self._east.get(block, nothing)
        framed = np.zeros((side + 1, blocks * side + 2), np.bool_)
        framed[1:, 1:-1] = canvas.reshape(side, -1)
        framed[0], framed[1:, 0] = north > 0, west > 0
        labels = np.empty(framed.shape, np.int32)
        found = int(ndimage.label(framed, self._together, output=labels))
        for known, own in ((north, labels[0]), (west, labels[1:, 0])):
            touched = np.flatnonzero(known)
            self._pairs.append(np.unique([known[touched], own[touched] + np.int64(self._labels)], axis=1))
        south, east = (self._numbered(edge) for edge in (labels[-1, 1:-1], labels[1:, -2]))
        self._south = {key: line for key, line in self._south.items() if key[0] <= block[0]}
        self._south |= {(block[0] - 1, block[1] + at): line for at, line in enumerate(south.reshape(blocks, side))}
        self._east = {(block[0], block[1] + blocks): east}
        largest = passage.reshape(count, -1) == 1
        at = largest.argmax(axis=1)
        down, right = np.divmod(at, px)
        label = np.where(largest[np.arange(count), at], labels[1 + line * px + down, 1 + column * px + right], 0)
        self._sizes.append(np.bincount(label[passable], minlength=found + 1)[1:])
        first = np.full(found + 1, _LAST)
        np.minimum.at(first, label, col - (row << 32))
        self._firsts.append(first[1:])
        label = self._numbered(label)
        self._labels += found
        return label.astype(np.int32)

    def _numbered(self, labels: NDArray[np.int32]) -> NDArray[np.int64]:
        """Return labels of a strip as labels of all; 0 stays 0."""
        return np.where(labels > 0, labels + np.int64(self._labels), 0)

    def numbers(self) -> NDArray[np.int32]:
        """Return the number of the zone of each label, from 0.

        1 is the zone with the most passable tiles; of two with as many, the one with the northmost, then westmost
        tile has the lower number. 0: an area that is the largest of no tile.
        """
        from scipy import sparse  # slow to load
        from scipy.sparse import csgraph

        one, other = np.concatenate(self._pairs, axis=1)
        labels = self._labels + 1
        joined = sparse.coo_array((np.ones(len(one), np.bool_), (one, other)), (labels, labels))
        pieces, piece = csgraph.connected_components(joined, directed=False)
        size = np.bincount(piece, np.concatenate(self._sizes), pieces)
        first = np.full(pieces, _LAST)
        np.minimum.at(first, piece, np.concatenate(self._firsts))
        order = np.lexsort((first, -size))
        order = order[first[order] < _LAST]
        number = np.zeros(pieces, np.int32)
        number[order] = np.arange(1, len(order) + 1)
        return np.asarray(number[piece])
