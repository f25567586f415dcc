"""Points that wait until their block is complete: in memory up to a limit, beyond that in packs on disk.

*In memory.* Chunks wait, oldest first, with an index of the blocks in them. A chunk is freed when all of its blocks are
finished. One of which little is left, such as a coarse node of an octree that covers many blocks, or a chunk across the
border of a region that is not read yet, can be copied without the rest.
"""

from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpytiles.grid import BLOCK_TILES, Grid
from bumpytiles.grouping import GroupedPoints, PointPart, Scaling, TilePoints, columns_of, group_points, sort_block
from bumpytiles.pack import BlockKey, Column, Pack, write_pack

_TILES = BLOCK_TILES**2
_LEAST_ROOM = 0.25
"""Share of the limit that must be free once complete blocks are finished: rarely so often that it takes time."""
_COMPACTED = (0.5, 0.125)
"""Chunks are copied of which half is finished: no more is copied than freed. If that is not enough, also those of which
an eighth is: less time than to write the points and read them again."""
_SLICE = 1 << 20
"""Points that are read together from a block on disk that is too large to read as a whole."""


@dataclass(slots=True, eq=False)
class _WaitingChunk:
    """A chunk in memory."""

    number: int
    points: GroupedPoints
    places: dict[BlockKey, int]
    """Blocks that are not done, south-west first, with their places among those of ``points``."""

    def counts(self) -> NDArray[np.int64]:
        """Return the number of points of each of these blocks."""
        return np.asarray(np.diff(self.points.starts)[list(self.places.values())])


class TooManyPointsError(Exception):
    """One tile holds more points than fit into memory."""

    def __init__(self, col: int, row: int, points: int, allowed: int) -> None:
        super().__init__(f"tile ({col}, {row}) holds {points:,} points; there is room for {allowed:,}")
        self.points, self.allowed = points, allowed


@dataclass(frozen=True, slots=True)
class MemoryLimits:
    """How many points may be in memory, and where the others are written."""

    waiting_bytes: int
    """Most memory for points that wait: 14 bytes for one on the grid of its file, 26 for others, 4 for its colour."""
    block_points: int
    """Most points of one block that are sorted together."""
    scratch: Path
    """Folder for packs of points."""


class TileBuckets:
    """Collects points by block; yields whole blocks with their points sorted into tiles.

    Parameters
    ----------
    grid : Grid
    limits : MemoryLimits, optional
        None: all points stay in memory.
    packs : iterable of Pack
        Packs with points of an earlier run, or of other machines.

    Examples
    --------
    >>> import numpy as np
    >>> buckets = TileBuckets(Grid(tile_size=3.0))
    >>> buckets.add(np.array([0.5, 2.5, 3.0]), np.zeros(3), np.ones(3), np.zeros(3, bool))
    >>> [(int(c), int(n)) for block in buckets.blocks() for c, n in zip(block.col, np.diff(block.starts))]
    [(0, 2), (1, 1)]
    """

    def __init__(self, grid: Grid, limits: MemoryLimits | None = None, packs: Iterable[Pack] = ()) -> None:
        self.grid = grid
        self.limits = limits
        self.packs: list[Pack] = list(packs)
        self.done: set[BlockKey] = set()
        """Blocks whose points are no longer needed."""
        self._chunks: dict[_WaitingChunk, None] = {}
        """Those in memory, oldest first."""
        self._by_block: dict[BlockKey, list[_WaitingChunk]] = {}
        """The same, by the blocks that are not done."""
        self._bytes = 0
        """Memory that their points take."""
        self._spilling: Future[Pack] | None = None
        self._writer = ThreadPoolExecutor(1)

    def __len__(self) -> int:
        """Return the number of blocks that hold points."""
        return len(self.keys())

    def add(
        self,
        easting: NDArray[np.float64],
        northing: NDArray[np.float64],
        upward: NDArray[np.float64],
        flag: NDArray[np.uint8] | NDArray[np.bool_],
    ) -> None:
        """Add a chunk of points; coordinates (n,) in metres, ``flag`` (n,) belongs to them: True or 1 is flagged."""
        self.add_chunk(group_points(self.grid, easting, northing, upward, flag))

    def add_chunk(self, chunk: GroupedPoints, number: int = 0) -> None:
        """Add a grouped chunk. Numbers must not decrease; chunks of the same number stay together."""
        waiting = _WaitingChunk(number, chunk, {key: n for n, key in enumerate(chunk.keys) if key not in self.done})
        if waiting.places:
            self._chunks[waiting] = None
            self._bytes += chunk.size_bytes
        for key in waiting.places:
            self._by_block.setdefault(key, []).append(waiting)

    @property
    def is_full(self) -> bool:
        """True if points in memory take more than the limit: finish complete blocks, then ``compact``."""
        return self.limits is not None and self._bytes > self.limits.waiting_bytes

    @property
    def must_spill(self) -> bool:
        """True if too little is free after ``compact``: call ``spill``."""
        return self.limits is not None and self._bytes > (1 - _LEAST_ROOM) * self.limits.waiting_bytes

    def compact(self) -> None:
        """Free the memory of finished blocks in chunks with others, by copying these: only as much as is needed."""
        for share in _COMPACTED:
            for chunk in self._chunks if self.must_spill else ():
                whole = len(chunk.places) == len(chunk.points.keys)
                if not whole and chunk.counts().sum() <= (1 - share) * len(chunk.points):
                    self._bytes -= chunk.points.size_bytes
                    chunk.points = chunk.points.of_blocks(list(chunk.places.values()))
                    chunk.places = {key: place for place, key in enumerate(chunk.points.keys)}
                    self._bytes += chunk.points.size_bytes

    def spill(self) -> tuple[int, int]:
        """Start to write the older half of the points, without those of done blocks; return the first and last chunk.

        One pack is written at a time, in the background; ``wait`` adds it to ``packs``.
        """
        if self.limits is None:
            raise ValueError("without MemoryLimits there is no folder to spill to")
        self.wait()
        chosen = self._oldest()
        held: dict[BlockKey, list[tuple[GroupedPoints, int]]] = {}
        for chunk in chosen:
            for key, place in chunk.places.items():
                held.setdefault(key, []).append((chunk.points, place))
        held = {key: held[key] for key in sorted(held)}
        first, last = chosen[0].number, chosen[-1].number
        self._drop(chosen)
        path = self.limits.scratch / f"points-{first:08d}-{last:08d}.pack"
        self._spilling = self._writer.submit(_write, path, held, {"first": first, "last": last})
        return first, last

    def wait(self) -> Pack | None:
        """Wait until the last spill is on disk; return its pack, None if it was returned before."""
        if self._spilling is None:
            return None
        pack, self._spilling = self._spilling.result(), None
        self.packs.append(pack)
        return pack

    def finish(self, key: BlockKey) -> None:
        """Note that a block is done. Its points are freed when all blocks of their chunk are, or by ``compact``."""
        self.done.add(key)
        for chunk in self._by_block.pop(key, ()):
            del chunk.places[key]
            if not chunk.places:
                self._drop([chunk])

    def _drop(self, chunks: Iterable[_WaitingChunk]) -> None:
        """Forget chunks."""
        for chunk in chunks:
            del self._chunks[chunk]
            self._bytes -= chunk.points.size_bytes
            for key in chunk.places:
                self._by_block[key].remove(chunk)
                if not self._by_block[key]:
                    del self._by_block[key]

    def in_memory(self) -> NDArray[np.int64]:
        """Return row, column and number of points of each block of each chunk in memory, (n, 3)."""
        found = [np.column_stack([np.array(list(chunk.places), np.int64), chunk.counts()]) for chunk in self._chunks]
        return np.concatenate([np.empty((0, 3), np.int64), *found])

    def chunks_in_memory(self) -> set[int]:
        """Return the numbers of the chunks with points in memory that are not done."""
        return {chunk.number for chunk in self._chunks}

    def keys_in_memory(self) -> list[BlockKey]:
        """Return the blocks with points in memory that are not done, south-west first."""
        return sorted(self._by_block)

    @property
    def is_empty(self) -> bool:
        """True if no point is in memory."""
        return not self._chunks

    def keys(self) -> list[BlockKey]:
        """Return the blocks that hold points and are not done, south-west first."""
        self.wait()
        return sorted({*self._by_block, *(key for pack in self.packs for key in pack.keys)} - self.done)

    def points(self, key: BlockKey) -> int:
        """Return the number of points of a block, duplicates included."""
        in_memory = sum(chunk.points.count(chunk.places[key]) for chunk in self._by_block.get(key, ()))
        return in_memory + sum(pack.rows(key) for pack in self.packs)

    def flags(self, key: BlockKey) -> NDArray[np.bool_]:
        """Return which flags, up to 7, the points of each tile of a block have, (256, 8)."""
        seen = np.zeros(_TILES << 3, np.bool_)
        for part, _ in self._parts(key, ("tile", "flag")):
            seen[(part["tile"].astype(np.intp) << 3) | part["flag"]] = True
        return seen.reshape(_TILES, 8)

    def blocks(self) -> Iterator[TilePoints]:
        """Yield the blocks, south-west first."""
        for key in self.keys():
            yield from self.block(key)

    def block(self, key: BlockKey) -> Iterator[TilePoints]:
        """Yield a block in one piece, or some tiles at a time if it is too large to sort at once. Thread-safe.

        Raises
        ------
        TooManyPointsError
            A single tile is too large.
        """
        names = [column.name for column in columns_of(None, coloured=True)]
        if self.limits is None or self.points(key) <= self.limits.block_points:
            yield sort_block(self.grid, key, list(self._parts(key, names)))
            return
        for chosen in self._shares(key):
            parts = []
            for part, scaling in self._parts(key, names, _SLICE):
                wanted = chosen[part["tile"]]
                parts.append(PointPart({name: array[wanted] for name, array in part.items()}, scaling))
            yield sort_block(self.grid, key, parts)

    def _shares(self, key: BlockKey) -> Iterator[NDArray[np.bool_]]:
        """Yield masks (256,) that split the tiles of a block into groups of as many points as can be sorted."""
        most = self.limits.block_points if self.limits else self.points(key)
        counts = np.zeros(_TILES, np.int64)
        for part, _ in self._parts(key, ("tile",), _SLICE):
            counts += np.bincount(part["tile"], minlength=_TILES)
        if counts.max() > most:
            row, col = divmod(int(counts.argmax()), BLOCK_TILES)
            raise TooManyPointsError(key[1] * BLOCK_TILES + col, key[0] * BLOCK_TILES + row, int(counts.max()), most)
        share, held = np.zeros(_TILES, np.int64), 0
        for tile in range(1, _TILES):
            held += int(counts[tile - 1])
            full = held + counts[tile] > most
            share[tile] = share[tile - 1] + full
            held = 0 if full else held
        for number in range(int(share[-1]) + 1):
            chosen = (share == number) & (counts > 0)
            if chosen.any():
                yield chosen

    def _parts(self, key: BlockKey, names: Iterable[str], most: int | None = None) -> Iterator[PointPart]:
        names = tuple(names)
        for chunk in self._by_block.get(key, ()):
            yield chunk.points.block(chunk.places[key], names)
        for pack in self.packs:
            rows = pack.rows(key)
            for start in range(0, rows, most or max(rows, 1)):
                read = pack.read(key, names, start, None if most is None else start + most)
                numbers = pack.meta["scaling"]
                yield PointPart(read, None if numbers is None else Scaling.of(numbers))

    def _oldest(self) -> list[_WaitingChunk]:
        """Choose the oldest chunks, about half of the limit: all of a number, of one grid."""
        chosen: list[_WaitingChunk] = []
        held = 0
        for chunk in self._chunks:
            full = self.limits is not None and held >= self.limits.waiting_bytes // 2
            other = chosen and chunk.number != chosen[-1].number
            if other and (full or chunk.points.scaling != chosen[-1].points.scaling):
                break
            chosen.append(chunk)
            held += chunk.points.size_bytes
        return chosen


def _write(path: Path, held: dict[BlockKey, list[tuple[GroupedPoints, int]]], meta: dict[str, Any]) -> Pack:
    """Write points of blocks to a pack: on the grid of their file if they are of one, else in metres."""
    scalings = {chunk.scaling for entries in held.values() for chunk, _ in entries}
    scaling = scalings.pop() if len(scalings) == 1 else None
    noted = None if scaling is None else scaling.numbers().tolist()
    blocks = {key: sum(chunk.count(place) for chunk, place in entries) for key, entries in held.items()}

    def parts_of(column: Column) -> Iterator[NDArray[Any]]:
        for chunk, place in (entry for entries in held.values() for entry in entries):
            values = chunk.block(place, (column.name,))
            own = (values if scaling is not None else values.in_metres()).columns
            yield own[column.name] if own else np.zeros(chunk.count(place), column.dtype)

    coloured = any("colour" in chunk.points for entries in held.values() for chunk, _ in entries)
    write_pack(path, columns_of(scaling, coloured=coloured), blocks, parts_of, {**meta, "scaling": noted})
    return Pack(path)
