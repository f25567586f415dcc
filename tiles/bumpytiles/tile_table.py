"""All tiles of a run as one table, which is read from packs window by window and never held in memory as a whole."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpytiles.grid import Grid, TileWindow
from bumpytiles.pack import BlockKey, MemoryPack, Pack
from bumpytiles.split import BLOCK_TILES

__all__ = ["TileTable"]


class TileTable:
    """A table with one row per tile, stored by block in any number of packs; each block is in one of them.

    Every pack has the columns ``col`` and ``row`` (tile indices), and others.

    Parameters
    ----------
    grid : Grid
    packs : sequence of Pack or MemoryPack
        At least one block with at least one tile.
    """

    def __init__(self, grid: Grid, packs: Sequence[Pack | MemoryPack]) -> None:
        self.grid = grid
        self.pack_of: dict[BlockKey, Pack | MemoryPack] = {
            key: pack for pack in packs for key in pack.keys if pack.rows(key)
        }
        self.tiles = sum(pack.rows(key) for key, pack in self.pack_of.items())
        """Number of tiles."""
        if not self.tiles:
            raise ValueError("a table needs at least one tile")
        self._rows, self._cols = np.ascontiguousarray(np.array(sorted(self.pack_of), dtype=np.int64).T)
        self.window = self._tight_window()
        """The smallest window that contains every tile."""

    @classmethod
    def of(cls, grid: Grid, columns: Mapping[str, NDArray[Any]]) -> "TileTable":
        """Make a table of columns in memory, ``col`` and ``row`` included; one row per tile, in any order."""
        pack = MemoryPack()
        rows, cols = columns["row"] // BLOCK_TILES, columns["col"] // BLOCK_TILES
        order = np.lexsort((cols, rows))
        new = np.flatnonzero(np.diff(rows[order]) | np.diff(cols[order])) + 1
        for members in np.split(order, new):
            key = (int(rows[members[0]]), int(cols[members[0]])) if len(members) else (0, 0)
            pack.add(key, {name: array[members] for name, array in columns.items()})
        return cls(grid, [pack])

    def holds(self, window: TileWindow) -> bool:
        """Return False if a window has no tiles; True if blocks that overlap it have tiles, perhaps outside it."""
        return next(self._runs(window), None) is not None

    def read(self, names: Sequence[str], window: TileWindow | None = None) -> dict[str, NDArray[Any]]:
        """Read columns of the tiles in a window (None: of all), north row first, then west column first.

        ``col`` and ``row`` are always included. For a window without tiles the arrays are empty.

        Raises
        ------
        ValueError
            Two of the rows are the same tile.
        """
        window = window or self.window
        wanted = tuple(dict.fromkeys(("col", "row", *names)))
        parts = [self._part(key, wanted, window) for run in self._runs(window) for key in run]
        if not parts:
            some = (int(self._rows[0]), int(self._cols[0]))
            parts = [self.pack_of[some].read(some, wanted, 0, 0)]
        # Each part is released as soon as it is joined: the parts take most of the memory.
        col, row = (np.concatenate([part.pop(name) for part in parts]) for name in ("col", "row"))
        # One number per tile that increases in that order: sorting it takes a third of the time of sorting two columns.
        place = (window.row + window.rows - row) * window.cols + (col - window.col)
        order = np.argsort(place, kind="stable")
        if np.any(np.diff(place[order]) == 0):
            raise ValueError("two rows of the table are the same tile")
        found = {"col": col[order], "row": row[order]}
        for name in wanted[2:]:
            found[name] = np.concatenate([part.pop(name) for part in parts])[order]
        return found

    def strips(self, most: int, window: TileWindow | None = None) -> Iterator[TileWindow]:
        """Cut the tiles in a window (None: all) into windows of at most ``most`` tiles (but at least a block).

        They are ordered from north to south, then from west to east. Each is one row of blocks high, clipped to the
        window, and as many blocks wide as fit; each tile is in exactly one of them.
        """
        window = window or self.window
        for run in self._runs(window):
            start, held = run[0], 0
            for key in run:
                tiles = self.pack_of[key].rows(key)
                if held and held + tiles > most:
                    yield _strip(start, key[1], window)
                    start, held = key, 0
                held += tiles
            yield _strip(start, run[-1][1] + 1, window)

    def _part(self, key: BlockKey, wanted: Sequence[str], window: TileWindow) -> dict[str, NDArray[Any]]:
        """Read columns of the tiles of a block that are in a window."""
        part = self.pack_of[key].read(key, wanted)
        west, south = key[1] * BLOCK_TILES, key[0] * BLOCK_TILES
        if _strip(key, key[1] + 1, window) == TileWindow(west, south, BLOCK_TILES, BLOCK_TILES):
            return part
        inside = (
            (part["col"] >= window.col)
            & (part["col"] < window.col + window.cols)
            & (part["row"] >= window.row)
            & (part["row"] < window.row + window.rows)
        )
        return {name: array[inside] for name, array in part.items()}

    def _runs(self, window: TileWindow) -> Iterator[list[BlockKey]]:
        """Yield the blocks that overlap a window, one list per row, north row first; each from west to east."""
        west, south = window.col // BLOCK_TILES, window.row // BLOCK_TILES
        east = (window.col + window.cols - 1) // BLOCK_TILES
        north = (window.row + window.rows - 1) // BLOCK_TILES
        for row in range(north, south - 1, -1):
            first, stop = np.searchsorted(self._rows, [row, row + 1])
            start, end = first + np.searchsorted(self._cols[first:stop], [west, east + 1])
            if start < end:
                yield [(row, col) for col in self._cols[start:end].tolist()]

    def _tight_window(self) -> TileWindow:
        """Return the smallest window around all tiles, from those of the outermost blocks."""
        row, col = self._rows, self._cols
        edge = (row == row.min()) | (row == row.max()) | (col == col.min()) | (col == col.max())
        keys = zip(row[edge].tolist(), col[edge].tolist(), strict=True)
        found = [self.pack_of[key].read(key, ("col", "row")) for key in keys]
        return TileWindow.around(
            np.concatenate([part["col"] for part in found]), np.concatenate([part["row"] for part in found])
        )


def _strip(start: BlockKey, stop: int, window: TileWindow) -> TileWindow:
    """Clip blocks of one row, from ``start`` up to but without block column ``stop``, to a window."""
    row, col = start
    west, east = max(col * BLOCK_TILES, window.col), min(stop * BLOCK_TILES, window.col + window.cols)
    south, north = max(row * BLOCK_TILES, window.row), min((row + 1) * BLOCK_TILES, window.row + window.rows)
    return TileWindow(west, south, east - west, north - south)
