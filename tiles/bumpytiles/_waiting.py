"""Points that wait in memory: chunks, oldest first, with an index of the blocks in them.

A chunk is freed when all of its blocks are finished. One of which little is left, such as a coarse node of an octree
that covers many blocks, or a chunk across the border of a region that is not read yet, can be copied without the rest.
"""

from collections.abc import Collection, Iterable, Iterator, KeysView

import numpy as np
from numpy.typing import NDArray

from bumpytiles.grouping import GroupedPoints
from bumpytiles.pack import BlockKey

__all__ = ["WaitingChunk", "WaitingPoints"]


class WaitingChunk:
    """A chunk in memory.

    Parameters
    ----------
    number : int
    points : GroupedPoints
    done : collection of BlockKey
        Blocks whose points are not needed.
    """

    __slots__ = ("_places", "number", "points")

    def __init__(self, number: int, points: GroupedPoints, done: Collection[BlockKey] = ()) -> None:
        self.number, self.points = number, points
        self._places = {key: place for place, key in enumerate(points.keys) if key not in done}

    @property
    def keys(self) -> KeysView[BlockKey]:
        """Blocks that are not finished, south-west first."""
        return self._places.keys()

    def place(self, key: BlockKey) -> int:
        """Return the place of a block that is not finished among those of ``points``."""
        return self._places[key]

    def counts(self) -> NDArray[np.int64]:
        """Return the number of points of each of ``keys``."""
        counts: NDArray[np.int64] = np.diff(self.points.starts)[list(self._places.values())]
        return counts

    def finish(self, key: BlockKey) -> None:
        """Forget a block."""
        del self._places[key]

    def compact(self, share: float) -> int:
        """Copy what is needed if at least a ``share`` of the points is not; return how many bytes that frees."""
        if len(self._places) == len(self.points.keys) or self.counts().sum() > (1 - share) * len(self.points):
            return 0
        before = self.points.size_bytes
        self.points = self.points.of_blocks(list(self._places.values()))
        self._places = {key: place for place, key in enumerate(self.points.keys)}
        return before - self.points.size_bytes


class WaitingPoints:
    """Chunks in memory."""

    def __init__(self) -> None:
        self._chunks: dict[int, WaitingChunk] = {}
        """By their ``id``, oldest first."""
        self._index: dict[BlockKey, list[WaitingChunk]] = {}
        self.size_bytes = 0
        """Memory that the points take."""

    def __iter__(self) -> Iterator[WaitingChunk]:
        """Iterate over the chunks, oldest first."""
        return iter(self._chunks.values())

    def __len__(self) -> int:
        """Return the number of chunks."""
        return len(self._chunks)

    @property
    def keys(self) -> KeysView[BlockKey]:
        """Blocks that are not finished."""
        return self._index.keys()

    def parts(self, key: BlockKey) -> list[tuple[GroupedPoints, int]]:
        """Return the points that hold some of a block, each with the place of the block in them."""
        return [(chunk.points, chunk.place(key)) for chunk in self._index.get(key, ())]

    def counts(self) -> NDArray[np.int64]:
        """Return row, column and number of points of each block of each chunk, (n, 3)."""
        found = [np.column_stack([np.array(list(chunk.keys), np.int64), chunk.counts()]) for chunk in self]
        return np.concatenate([np.empty((0, 3), np.int64), *found])

    def add(self, number: int, points: GroupedPoints, done: Collection[BlockKey]) -> None:
        """Add a chunk, unless all of its blocks are ``done``."""
        chunk = WaitingChunk(number, points, done)
        if not chunk.keys:
            return
        self._chunks[id(chunk)] = chunk
        self.size_bytes += points.size_bytes
        for key in chunk.keys:
            self._index.setdefault(key, []).append(chunk)

    def finish(self, key: BlockKey) -> None:
        """Forget a block, and the chunks that have no other blocks."""
        for chunk in self._index.pop(key, ()):
            chunk.finish(key)
            if not chunk.keys:
                del self._chunks[id(chunk)]
                self.size_bytes -= chunk.points.size_bytes

    def compact(self, share: float) -> None:
        """Copy what is needed of the chunks of which at least a ``share`` (0..1) is not."""
        for chunk in self:
            self.size_bytes -= chunk.compact(share)

    def drop(self, chunks: Iterable[WaitingChunk]) -> None:
        """Forget chunks."""
        keys: set[BlockKey] = set()
        for chunk in chunks:
            del self._chunks[id(chunk)]
            self.size_bytes -= chunk.points.size_bytes
            keys |= chunk.keys
        for key in keys:
            left = [chunk for chunk in self._index[key] if id(chunk) in self._chunks]
            if left:
                self._index[key] = left
            else:
                del self._index[key]
