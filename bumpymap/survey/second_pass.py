"""The second pass of a run: when all tiles are finished, each is looked at together with its neighbours.

A step at the border of two tiles belongs to both, a vehicle is wider than a pixel, and few points say more beside those
of the neighbours: none of that is known while the points of one block are measured. So each block is read once more
with a ring of tiles around it. What is added to a tile depends on the finished tiles alone, not on how they were
divided among files, tasks or machines.
"""

from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from threading import Lock
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Progress
from bumpymap.survey.engine import TileSink
from bumpytiles import BLOCK_TILES, BlockKey, Column, JoinedPack, Pack, TileTable, run_blocks

__all__ = ["KEPT_BYTES", "RING", "NeighbourRater", "NeighbourWindow", "add_neighbours"]

RING = 1
"""Width of the ring around a block, tiles."""
_GROUP_TILES = 256
"""Most tiles in a group of blocks: as many as a full block has."""
KEPT_BYTES = 8 << 20
"""Most bytes of blocks that are kept in memory: 24 full ones at 15 x 15 pixels."""
_SIDE = BLOCK_TILES + 2 * RING
_FILL: dict[str, Any] = {"f": np.nan, "u": 255, "i": 0}
"""Value of a missing tile, by the kind of a column."""


@dataclass(frozen=True, slots=True)
class NeighbourWindow:
    """The tiles of a block and of the ring around it, as arrays over the window."""

    columns: Mapping[str, NDArray[Any]]
    """(18, 18, ...) each, north row first; missing tiles are NaN, 255 in columns of bytes, 0 in other integers."""
    present: NDArray[np.bool_]
    """(18, 18) whether there is a tile."""

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.columns[name]

    def mosaic(self, name: str) -> NDArray[Any]:
        """Return a column of (pixels, pixels) maps as one image, north up."""
        values = self.columns[name]
        rows, cols, lines, samples = values.shape
        return np.ascontiguousarray(values.swapaxes(1, 2)).reshape(rows * lines, cols * samples)

    def inner(self, name: str) -> NDArray[Any]:
        """Return a column of the tiles of the block alone, (16, 16, ...)."""
        return self.columns[name][RING:-RING, RING:-RING]


class NeighbourRater(Protocol):
    """Rates the tiles of a block with their neighbours."""

    @property
    def needs(self) -> Sequence[str]:
        """Columns of the finished tiles that it reads."""

    @property
    def columns(self) -> Sequence[Column]:
        """Columns that it returns."""

    def leaves(self, own: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]] | None:
        """Return the columns of the tiles of a block, (n, ...) each, if neighbours do not matter to any; else None.

        ``own`` may lack the maps of heights.
        """

    def __call__(self, window: NeighbourWindow) -> dict[str, NDArray[Any]]:
        """Return the columns of the inner tiles, (16, 16, ...) each; those of missing tiles are ignored."""


def add_neighbours(
    table: TileTable, rating: NeighbourRater, folder: Path, threads: int, progress: Progress, kind: str = "neighbours"
) -> TileTable:  # fmt: skip
    """Rate all tiles with their neighbours; return the table with the new columns, whose packs are in ``folder``.

    The packs are named after ``kind``, which differs where one table is rated again.

    Raises
    ------
    OSError
        The packs cannot be written.
    """
    keys = sorted(table.pack_of)
    progress.start("comparing neighbours", len(keys))
    sink = TileSink(folder, kind, rating.columns)
    blocks = _Blocks(table, rating.needs)
    for rated in run_blocks(lambda group: _rate_group(blocks, rating, group), _groups(table, keys), threads):
        for key, columns in rated:
            sink.add(key, columns)
        progress.advance(len(rated))
    sink.flush()
    return TileTable(table.grid, [JoinedPack(table.pack_of, Pack(path)) for path in sink.new_packs()])


def _groups(table: TileTable, keys: Sequence[BlockKey]) -> Iterator[list[BlockKey]]:
    """Yield the blocks, those with few tiles in groups: the fixed time of a block then counts once for many."""
    group: list[BlockKey] = []
    held = 0
    for key in keys:
        tiles = table.pack_of[key].rows(key)
        if group and (held + tiles > _GROUP_TILES):
            yield group
            group, held = [], 0
        group.append(key)
        held += tiles
    yield group


class _Blocks:
    """Reads blocks of a table, and keeps the last few: the windows of two blocks side by side have six in common."""

    def __init__(self, table: TileTable, names: Sequence[str]) -> None:
        self.table = table
        self._names = ("col", "row", *names)
        self._kept: OrderedDict[BlockKey, dict[str, NDArray[Any]]] = OrderedDict()
        self._bytes = 0
        self._lock = Lock()

    def read(self, key: BlockKey) -> dict[str, NDArray[Any]]:
        """Read the columns of a block."""
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        found = self.table.pack_of[key].read(key, self._names)
        with self._lock:
            if key not in self._kept:
                self._kept[key] = found
                self._bytes += _size(found)
            while self._bytes > KEPT_BYTES:
                self._bytes -= _size(self._kept.popitem(last=False)[1])
        return found

    def read_together(self, keys: Sequence[BlockKey]) -> dict[str, NDArray[Any]]:
        """Read the columns of some blocks without maps of heights, joined."""
        if len(keys) == 1:
            return self.read(keys[0])
        return self.table.read_blocks(keys, [name for name in self._names if name != "heights"])


def _size(columns: Mapping[str, NDArray[Any]]) -> int:
    return sum(array.nbytes for array in columns.values())


def _rate_group(
    blocks: _Blocks, rating: NeighbourRater, keys: Sequence[BlockKey]
) -> list[tuple[BlockKey, dict[str, NDArray[Any]]]]:
    """Return the new columns of some blocks, in the order of their tiles."""
    own = blocks.read_together(keys)
    place = {name: own[name] for name in ("col", "row")}
    if (left := rating.leaves(own)) is None:
        if len(keys) > 1:
            return [rated for key in keys for rated in _rate_group(blocks, rating, [key])]
        return [(keys[0], _rate_block(blocks, rating, keys[0], place))]
    columns = left | place
    ends = np.cumsum([blocks.table.pack_of[key].rows(key) for key in keys]).tolist()
    return [
        (key, {name: array[start:stop] for name, array in columns.items()})
        for key, (start, stop) in zip(keys, pairwise([0, *ends]), strict=True)
    ]


def _rate_block(
    blocks: _Blocks, rating: NeighbourRater, key: BlockKey, own: dict[str, NDArray[Any]]
) -> dict[str, NDArray[Any]]:
    """Return the new columns of a block, in the order of its tiles, of which ``own`` are column and row."""
    rated = rating(_read_window(blocks, rating.needs, key))
    line, column = _cells(key, own)
    return {part.name: rated[part.name][line - RING, column - RING] for part in rating.columns} | own


def _cells(key: BlockKey, tiles: Mapping[str, NDArray[np.int64]]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return line and column of tiles in the window around a block, from its north-west corner."""
    north, west = (key[0] + 1) * BLOCK_TILES + RING - 1, key[1] * BLOCK_TILES - RING
    return north - tiles["row"], tiles["col"] - west


def _read_window(blocks: _Blocks, names: Sequence[str], key: BlockKey) -> NeighbourWindow:
    """Put the tiles of a block and of the ring around it together."""
    columns: dict[str, NDArray[Any]] = {}
    present = np.zeros((_SIDE, _SIDE), np.bool_)
    around = [(key[0] + down, key[1] + right) for down in (-1, 0, 1) for right in (-1, 0, 1)]
    for beside in (found for found in around if found in blocks.table.pack_of):
        part = blocks.read(beside)
        line, column = _cells(key, part)
        inside = np.flatnonzero((line >= 0) & (line < _SIDE) & (column >= 0) & (column < _SIDE))
        if not len(inside):
            continue
        cells = line[inside], column[inside]
        present[cells] = True
        for name in names:
            values = part[name]
            if name not in columns:
                columns[name] = np.full((_SIDE, _SIDE, *values.shape[1:]), _FILL[values.dtype.kind], values.dtype)
            columns[name][cells] = values if beside == key else values[inside]
    return NeighbourWindow(columns, present)
