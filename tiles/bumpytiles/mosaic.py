"""All tiles of a run as one table that is never in memory as a whole: read by window, assembled from packs."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpytiles.grid import Grid, TileWindow
from bumpytiles.pack import BlockKey, MemoryPack, Pack
from bumpytiles.split import BLOCK_TILES

__all__ = ["Mosaic"]


class Mosaic:
    """Rows of tiles, by block, from any number of packs; each block stands in one of them.

    Every pack has the columns ``col`` and ``row`` (tile indices) beside others.

    Parameters
    ----------
    grid : Grid
    packs : sequence of Pack or MemoryPack
        At least one block with at least one tile.
    """

    def __init__(self, grid: Grid, packs: Sequence[Pack | MemoryPack]) -> None:
        self.grid = grid
        self._home: dict[BlockKey, Pack | MemoryPack] = {key: pack for pack in packs for key in pack.keys}
        self.tiles = sum(pack.rows(key) for key, pack in self._home.items())
        """Number of tiles."""
        if not self.tiles:
            raise ValueError("a mosaic needs at least one tile")
        self._blocks = np.array(sorted(self._home), dtype=np.int64)
        self.window = self._tight_window()
        """The smallest window that holds every tile."""

    @classmethod
    def of(cls, grid: Grid, columns: Mapping[str, NDArray[Any]]) -> "Mosaic":
        """Make a mosaic of columns in memory; one row a tile, in any order, ``col`` and ``row`` among them."""
        pack = MemoryPack()
        keys = np.stack([columns["row"] // BLOCK_TILES, columns["col"] // BLOCK_TILES], axis=1)
        for key in np.unique(keys, axis=0):
            members = (keys == key).all(axis=1)
            pack.add((int(key[0]), int(key[1])), {name: array[members] for name, array in columns.items()})
        return cls(grid, [pack])

    def read(self, names: Sequence[str], window: TileWindow | None = None) -> dict[str, NDArray[Any]]:
        """Read columns of the tiles in a window (None: of all), north row first, then west column first.

        ``col`` and ``row`` are always among the columns. A window without tiles gives arrays without rows.
        """
        window = window or self.window
        wanted = tuple(dict.fromkeys(("col", "row", *names)))
        parts = []
        for key in self._keys_in(window):
            part = self._home[key].read(key, wanted)
            inside = (
                (part["col"] >= window.col)
                & (part["col"] < window.col + window.cols)
                & (part["row"] >= window.row)
                & (part["row"] < window.row + window.rows)
            )
            parts.append(part if inside.all() else {name: array[inside] for name, array in part.items()})
        if not parts:
            some = self._blocks[0]
            parts = [self._home[int(some[0]), int(some[1])].read((int(some[0]), int(some[1])), wanted, 0, 0)]
        joined = {name: np.concatenate([part[name] for part in parts]) for name in wanted}
        order = np.lexsort((joined["col"], -joined["row"]))
        return {name: array[order] for name, array in joined.items()}

    def strips(self, most: int) -> Iterator[TileWindow]:
        """Cut the tiles into windows of at most ``most`` tiles (but at least a block), north-west first.

        A window is one row of blocks high, and as many blocks wide as fit; each tile lies in just one of them.
        """
        for row in np.unique(self._blocks[:, 0])[::-1]:
            cols = np.sort(self._blocks[self._blocks[:, 0] == row, 1])
            start, held = int(cols[0]), 0
            for col in cols.tolist():
                rows = self._home[int(row), col].rows((int(row), col))
                if held and held + rows > most:
                    yield self._strip(int(row), start, col)
                    start, held = col, 0
                held += rows
            yield self._strip(int(row), start, int(cols[-1]) + 1)

    @staticmethod
    def _strip(row: int, start: int, stop: int) -> TileWindow:
        return TileWindow(start * BLOCK_TILES, row * BLOCK_TILES, (stop - start) * BLOCK_TILES, BLOCK_TILES)

    def _keys_in(self, window: TileWindow) -> list[BlockKey]:
        west, south = window.col // BLOCK_TILES, window.row // BLOCK_TILES
        east = (window.col + window.cols - 1) // BLOCK_TILES
        north = (window.row + window.rows - 1) // BLOCK_TILES
        row, col = self._blocks.T
        first, last = np.searchsorted(row, [south, north + 1])
        inside = np.flatnonzero((col[first:last] >= west) & (col[first:last] <= east)) + first
        return [(int(r), int(c)) for r, c in self._blocks[inside]]

    def _tight_window(self) -> TileWindow:
        """Look at the tiles of the outermost blocks only."""
        row, col = self._blocks.T
        rim = (row == row.min()) | (row == row.max()) | (col == col.min()) | (col == col.max())
        found = []
        for r, c in self._blocks[rim]:
            key = (int(r), int(c))
            found.append(self._home[key].read(key, ("col", "row")))
        return TileWindow.around(
            np.concatenate([part["col"] for part in found]), np.concatenate([part["row"] for part in found])
        )
