"""Zones: pieces of ground that hang together and that the vehicle cannot leave.

The pixels on which its middle can be are labelled strip by strip, each strip with the line of pixels to its north and
the column to its west: areas that hang together with those are the same piece. So only that frame and a number for
each tile are kept, and the zones do not depend on how the tiles are divided among strips.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from bumpymap.core import VehicleBody, corners_join, obstacle_reach
from bumpytiles import BLOCK_TILES, BlockKey, Grid

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
