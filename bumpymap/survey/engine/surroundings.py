"""Heights around blocks: standing objects at its edge depend on the tiles beside it, wherever a run cuts its points."""

from collections.abc import Callable, Iterator, Mapping, Sequence, Set as AbstractSet
from concurrent.futures import Future
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import PatchStack
from bumpymap.patches import choose_tiles
from bumpytiles import BLOCK_TILES, BlockKey, Pack, TileBuckets, TilePoints

Heights = Mapping[str, NDArray[Any]]
"""``col`` and ``row`` (n,) of tiles and their ``heights`` (n, pixels, pixels), m."""
_NAMES = ("col", "row", "heights")
_POINT_BYTES = 25
"""Size of a sorted point."""


def blocks_around(key: BlockKey) -> list[BlockKey]:
    """Return the nine blocks that a block is the middle of."""
    return [(key[0] + up, key[1] + right) for up in (-1, 0, 1) for right in (-1, 0, 1)]


class Surroundings:
    """Keeps the heights at the edges of finished blocks, whose points are gone, until all around them are finished.

    ``measure``: measures tiles from all of their points; ``margin``: tiles around a block that are asked for;
    ``most_bytes``: most memory for the points of blocks that were measured for their neighbours, and are not rated yet.
    """

    def __init__(self, measure: Callable[[TilePoints], PatchStack], margin: int, most_bytes: int) -> None:
        self.measure, self.most_bytes, self._margin = measure, most_bytes, margin
        self.packs: Sequence[Pack] = ()
        """Tiles that others have finished, or an earlier run."""
        self._kept: dict[BlockKey, Heights] = {}
        self._lock = Lock()

    def keep(self, key: BlockKey, columns: Heights, waiting: AbstractSet[BlockKey]) -> None:
        """Keep the edge of a finished block, but no longer than blocks beside it hold points; these are ``waiting``."""
        col, row = columns["col"] - key[1] * BLOCK_TILES, columns["row"] - key[0] * BLOCK_TILES
        edge = np.minimum(np.minimum(col, row), BLOCK_TILES - 1 - np.maximum(col, row)) < self._margin
        with self._lock:
            self._kept[key] = {name: columns[name][edge] for name in _NAMES}
            for beside in blocks_around(key):
                if waiting.isdisjoint(blocks_around(beside)):
                    self._kept.pop(beside, None)

    def of_finished(self, key: BlockKey) -> Heights | None:
        """Return the heights at the edge of a finished block, or of all of it; None if it is not finished."""
        with self._lock:
            if (kept := self._kept.get(key)) is not None:
                return kept
        packs = [pack for pack in self.packs if pack.rows(key)]
        return packs[-1].read(key, _NAMES) if packs else None

    def near(self, points: TilePoints, blocks: Sequence[BlockKey]) -> TilePoints:
        """Return the tiles that lie within the margin of some blocks."""
        wanted = np.zeros(len(points.col), np.bool_)
        for row, col in blocks:
            up, right = points.row - row * BLOCK_TILES, points.col - col * BLOCK_TILES
            low, high = np.minimum(up, right), np.maximum(up, right)
            wanted |= (low >= -self._margin) & (high < BLOCK_TILES + self._margin)
        return choose_tiles(points, wanted)


class OpenBlocks:
    """The heights around blocks while they are rated, on several threads: each is measured once, if room allows."""

    def __init__(self, around: Surroundings, buckets: TileBuckets, keys: Sequence[BlockKey]) -> None:
        self._around, self._buckets, self._keys = around, buckets, set(keys)
        self._waiting = set(buckets.keys())
        self._heights: dict[BlockKey, Future[Heights | None]] = {}
        self._measured: dict[BlockKey, tuple[TilePoints, PatchStack]] = {}
        self._bytes = 0
        self._lock = Lock()

    def block(self, key: BlockKey) -> Iterator[tuple[TilePoints, PatchStack]]:
        """Yield the points of a block, in the shares that it comes in, and their tiles measured."""
        self._heights_of(key)
        with self._lock:
            held = self._measured.pop(key, None)
            self._bytes -= 0 if held is None else _POINT_BYTES * len(held[0].flag)
        if held is not None:
            yield held
        else:
            yield from ((points, self._around.measure(points)) for points in self._buckets.block(key))

    def heights(self, keys: Sequence[BlockKey]) -> Heights:
        """Return the heights of blocks, and of the tiles around them."""
        wanted = dict.fromkeys(beside for key in keys for beside in blocks_around(key))
        return join_columns([heights for beside in wanted if (heights := self._heights_of(beside)) is not None])

    def close(self, key: BlockKey, columns: Heights) -> None:
        """Keep no more of a rated block than its edge."""
        self._waiting.discard(key)
        self._around.keep(key, columns, self._waiting)
        with self._lock:
            self._heights.pop(key, None)

    def _heights_of(self, key: BlockKey) -> Heights | None:
        """Return the heights of a block; those of a finished one are not held here once more."""
        with self._lock:
            is_open = key in self._heights
        if not is_open and (finished := self._around.of_finished(key)) is not None:
            return finished
        with self._lock:
            is_first = key not in self._heights
            future = self._heights.setdefault(key, Future())
        if is_first:
            try:
                future.set_result(self._find(key))
            except BaseException as error:  # noqa: BLE001 (for whoever waits for it)
                future.set_exception(error)
        return future.result()

    def _find(self, key: BlockKey) -> Heights | None:
        if (finished := self._around.of_finished(key)) is not None:  # meanwhile
            return finished
        if not self._buckets.points(key):
            return None
        found = []
        for points in self._buckets.block(key):
            asked = points
            if key not in self._keys:
                asked = self._around.near(points, [beside for beside in blocks_around(key) if beside in self._keys])
            measured = self._around.measure(asked)
            found.append({name: getattr(measured, name) for name in _NAMES})
        if key in self._keys and len(found) == 1:
            with self._lock:  # until it is rated; those that wait longest go if there is no room
                self._measured[key] = points, measured
                self._bytes += _POINT_BYTES * len(points.flag)
                while self._bytes > self._around.most_bytes and len(self._measured) > 1:
                    longest, _ = self._measured.pop(next(iter(self._measured)))
                    self._bytes -= _POINT_BYTES * len(longest.flag)
        return join_columns(found)


def join_columns(parts: Sequence[Mapping[str, NDArray[Any]]]) -> Mapping[str, NDArray[Any]]:
    """Join the columns of several shares of tiles."""
    return parts[0] if len(parts) == 1 else {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
