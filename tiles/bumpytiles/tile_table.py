"""All tiles of a run as one table, which is read from packs window by window and never held in memory as a whole."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpytiles.grid import BLOCK_TILES, Grid, TileWindow
from bumpytiles.pack import BlockKey, Column, MemoryPack, Pack, find_key, key_codes, keys_of


@dataclass(frozen=True, slots=True)
class _ColumnSource:
    """Packs that hold some columns of all blocks of a table."""

    packs: Sequence[Pack | MemoryPack]
    columns: Mapping[str, Column]
    pack: NDArray[np.int32]
    """(blocks,) which of the packs holds each block of the table."""
    start: NDArray[np.int64]
    """(blocks,) where the rows of each block begin there."""

    @classmethod
    def of(cls, packs: Sequence[Pack | MemoryPack]) -> "tuple[_ColumnSource, NDArray[np.int64], NDArray[np.int64]]":
        """Return the source, its blocks in order, and their numbers of rows; blocks without rows are left out.

        Of a block in several packs the last counts.
        """
        nothing = np.empty(0, np.int64)
        codes, counts, starts = (
            np.concatenate([nothing, *(getattr(pack, name) for pack in packs)])
            for name in ("codes", "counts", "starts")
        )
        number = np.repeat(np.arange(len(packs), dtype=np.int32), [len(pack.codes) for pack in packs])
        order = np.argsort(codes, kind="stable")
        order = order[np.append(np.diff(codes[order]) > 0, True)[: len(order)] & (counts[order] > 0)]
        columns = {column.name: column for column in packs[0].columns} if packs else {}
        return cls(packs, columns, number[order], starts[order]), codes[order], counts[order]

    def read(self, places: NDArray[np.int64], counts: NDArray[np.int64], names: Sequence[str]) -> dict[str, Any]:
        """Read columns of blocks with ``counts`` rows, joined; those that follow each other in a pack at once."""
        ends = np.cumsum(counts)
        found = {name: self.columns[name].empty(int(counts.sum())) for name in names}
        pack, start = self.pack[places], self.start[places]
        begins = np.flatnonzero((pack[1:] != pack[:-1]) | (start[1:] != start[:-1] + counts[:-1])) + 1
        for first, last in zip([0, *begins.tolist()], [*begins.tolist(), len(places)], strict=True):
            if first < last:
                rows = slice(int(ends[first] - counts[first]), int(ends[last - 1]))
                self.packs[pack[first]].fill({name: array[rows] for name, array in found.items()}, int(start[first]))
        return found


class TileTable:
    """A table with one row per tile, stored by block in any number of packs; of a block in several the last counts.

    Every pack has the columns ``col`` and ``row`` (tile indices), and others.

    Parameters
    ----------
    grid : Grid
    packs : sequence of Pack or MemoryPack
        At least one block with at least one tile.

    Raises
    ------
    ValueError
        There is no tile.
    """

    def __init__(self, grid: Grid, packs: Sequence[Pack | MemoryPack]) -> None:
        source, codes, counts = _ColumnSource.of(packs)
        self._set(grid, codes, counts, [source])

    def _set(
        self, grid: Grid, codes: NDArray[np.int64], counts: NDArray[np.int64], sources: Sequence[_ColumnSource]
    ) -> None:
        """Set all attributes, given blocks in order, their numbers of tiles, and where their columns are."""
        self.grid = grid
        self.tiles = int(counts.sum())
        """Number of tiles."""
        if not self.tiles:
            raise ValueError("a table needs at least one tile")
        self._codes, self._counts, self._sources = codes, counts, sources
        self._rows, self._cols = row, col = codes >> 32, (codes & 0xFFFFFFFF) - (1 << 31)
        edge = (row == row.min()) | (row == row.max()) | (col == col.min()) | (col == col.max())
        found = self._read(np.flatnonzero(edge), ("col", "row"))  # of the outermost blocks
        self.window = TileWindow.around(found["col"], found["row"])
        """The smallest window that contains every tile."""

    @classmethod
    def of(cls, grid: Grid, columns: Mapping[str, NDArray[Any]]) -> "TileTable":
        """Make a table of columns in memory, ``col`` and ``row`` included; one row per tile, in any order."""
        keys = np.stack([columns["row"], columns["col"]], axis=1) // BLOCK_TILES
        order = np.lexsort((keys[:, 1], keys[:, 0]))
        blocks, counts = np.unique(keys, axis=0, return_counts=True)
        described = [Column(name, array.dtype.str, array.shape[1:]) for name, array in columns.items()]
        arrays = {name: array[order] for name, array in columns.items()}
        return cls(grid, [MemoryPack(described, np.column_stack([blocks, counts]), arrays)])

    def with_columns(self, packs: Sequence[Pack]) -> "TileTable":
        """Return the table with further columns of the same tiles; of two columns of a name the added one counts.

        Parameters
        ----------
        packs : sequence of Pack
            All blocks of the table, with their rows in the same order.
        """
        added, codes, counts = _ColumnSource.of(packs)
        table = TileTable.__new__(TileTable)
        table._set(self.grid, codes, counts, [added, *self._sources])  # noqa: SLF001 (of the same class)
        return table

    def has(self, name: str) -> bool:
        """Return whether there is a column of this name."""
        return any(name in source.columns for source in self._sources)

    @property
    def keys(self) -> list[BlockKey]:
        """The blocks with tiles, south-west first."""
        return keys_of(self._codes)

    def count(self, key: BlockKey) -> int:
        """Return the number of tiles of a block."""
        place = find_key(self._codes, key)
        return 0 if place is None else int(self._counts[place])

    def holds(self, window: TileWindow) -> bool:
        """Return False if a window has no tiles; True if blocks that overlap it have tiles, perhaps outside it."""
        return len(self._places(window)) > 0

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
        part = _inside(self._read(self._places(window), wanted), window)
        col, row = part.pop("col"), part.pop("row")
        # One number per tile that increases in that order: sorting it takes a third of the time of sorting two columns.
        place = (window.row + window.rows - row) * window.cols + (col - window.col)
        order = np.argsort(place, kind="stable")
        if np.any(np.diff(place[order]) == 0):
            raise ValueError("two rows of the table are the same tile")
        found = {"col": col[order], "row": row[order]}
        for name in wanted[2:]:
            found[name] = part.pop(name)[order]
        return found

    def strips(self, most: int, window: TileWindow | None = None) -> Iterator[TileWindow]:
        """Cut the tiles in a window (None: all) into windows of at most ``most`` tiles (but at least a block).

        They are ordered from north to south, then from west to east. Each is one row of blocks high, clipped to the
        window, and as many blocks wide as fit; each tile is in exactly one of them.
        """
        window = window or self.window
        for run in self._runs(window):
            cols, counts = self._cols[run].tolist(), self._counts[run].tolist()
            row, start, held = int(self._rows[run.start]), cols[0], 0
            for col, tiles in zip(cols, counts, strict=True):
                if held and held + tiles > most:
                    yield _strip(row, start, col, window)
                    start, held = col, 0
                held += tiles
            yield _strip(row, start, cols[-1] + 1, window)

    def read_blocks(self, keys: Sequence[BlockKey], names: Sequence[str]) -> dict[str, NDArray[Any]]:
        """Read columns of blocks with tiles, joined in the order of ``keys``, the tiles of each in stored order."""
        codes = key_codes(np.array(keys, np.int64).reshape(-1, 2))
        return self._read(np.searchsorted(self._codes, codes), names)

    def _read(self, places: NDArray[np.int64], names: Sequence[str]) -> dict[str, NDArray[Any]]:
        """Read columns of blocks, given by their places in the table, joined."""
        counts, found, left = self._counts[places], dict[str, NDArray[Any]](), list(names)
        for source in self._sources:
            if own := [name for name in left if name in source.columns]:
                found |= source.read(places, counts, own)
                left = [name for name in left if name not in source.columns]
        return {name: found[name] for name in names}

    def _places(self, window: TileWindow) -> NDArray[np.int64]:
        """Return the places of the blocks that overlap a window, north row first, then west column first."""
        runs = [np.arange(run.start, run.stop) for run in self._runs(window)]
        return np.concatenate([np.empty(0, np.int64), *runs])

    def _runs(self, window: TileWindow) -> Iterator[slice]:
        """Yield the same places, one slice per row of blocks."""
        west, south = window.col // BLOCK_TILES, window.row // BLOCK_TILES
        east = (window.col + window.cols - 1) // BLOCK_TILES
        north = (window.row + window.rows - 1) // BLOCK_TILES
        for row in range(north, south - 1, -1):
            first, stop = np.searchsorted(self._rows, [row, row + 1])
            start, end = first + np.searchsorted(self._cols[first:stop], [west, east + 1])
            if start < end:
                yield slice(int(start), int(end))


def _strip(row: int, start: int, stop: int, window: TileWindow) -> TileWindow:
    """Clip blocks of a row, from column ``start`` up to but without ``stop``, to a window."""
    west, east = max(start * BLOCK_TILES, window.col), min(stop * BLOCK_TILES, window.col + window.cols)
    south, north = max(row * BLOCK_TILES, window.row), min((row + 1) * BLOCK_TILES, window.row + window.rows)
    return TileWindow(west, south, east - west, north - south)


def _inside(part: dict[str, NDArray[Any]], window: TileWindow) -> dict[str, NDArray[Any]]:
    """Return the rows of tiles that are in a window."""
    inside = (
        (part["col"] >= window.col)
        & (part["col"] < window.col + window.cols)
        & (part["row"] >= window.row)
        & (part["row"] < window.row + window.rows)
    )
    return part if inside.all() else {name: part.pop(name)[inside] for name in list(part)}
