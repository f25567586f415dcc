"""Points that wait for their block: in memory while there is room, in packs on disk beyond."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpytiles.grid import Grid, TileWindow
from bumpytiles.pack import BlockKey, Pack, PackWriter
from bumpytiles.split import BLOCK_TILES, POINT_COLUMNS, Part, Run, TilePoints, group_points, sort_block

__all__ = ["MemoryLimits", "TileBuckets", "TooManyPointsError"]

_TILES = BLOCK_TILES**2
_SLICE = 1 << 20
"""Points of a block on disk that are looked at together where the block as a whole is too large."""


class TooManyPointsError(Exception):
    """One tile holds more points than there is room for."""

    def __init__(self, col: int, row: int, points: int, allowed: int) -> None:
        super().__init__(f"tile ({col}, {row}) holds {points:,} points; there is room for {allowed:,}")
        self.points, self.allowed = points, allowed


@dataclass(slots=True)
class MemoryLimits:
    """How much may wait in memory, and what happens beyond."""

    points: int
    """Most points in memory."""
    block_points: int
    """Most points of one block that are put in order together."""
    scratch: Path
    """Folder for packs of points."""
    note: Callable[[int, int], dict[str, Any]] = lambda first, last: {"first": first, "last": last}
    """What a pack says about itself, given the first and the last lot in it."""
    complete: Callable[[BlockKey], bool] = field(default=lambda _: False)
    """Whether no more points of a block will come."""
    finish: Callable[[list[BlockKey]], None] = field(default=lambda _: None)
    """Called with complete blocks that are in memory as a whole, before room is made; they are forgotten after it."""


@dataclass(slots=True)
class _Waiting:
    """Runs in memory, oldest first, and where each block's points are in them."""

    runs: list[tuple[int, Run]] = field(default_factory=list)
    index: dict[BlockKey, list[tuple[Run, int]]] = field(default_factory=dict)
    points: int = 0

    def add(self, lot: int, run: Run) -> None:
        self.runs.append((lot, run))
        self.points += len(run)
        for place, key in enumerate(run.keys):
            self.index.setdefault(key, []).append((run, place))

    def drop(self, runs: list[tuple[int, Run]]) -> None:
        gone = {id(run) for _, run in runs}
        self.runs = [held for held in self.runs if id(held[1]) not in gone]
        self.points -= sum(len(run) for _, run in runs)
        for key in {key for _, run in runs for key in run.keys}:
            left = [held for held in self.index[key] if id(held[0]) not in gone]
            if left:
                self.index[key] = left
            else:
                del self.index[key]


class TileBuckets:
    """Collects points by block; hands out whole blocks with their points sorted into tiles.

    Parameters
    ----------
    grid : Grid
    room : Room, optional
        None: everything stays in memory.
    packs : iterable of Pack
        Points of an earlier run, or of other machines.

    Examples
    --------
    >>> import numpy as np
    >>> buckets = TileBuckets(Grid(tile_size=3.0))
    >>> buckets.add(np.array([0.5, 2.5, 3.0]), np.zeros(3), np.ones(3), np.zeros(3, bool))
    >>> [(int(c), int(n)) for block in buckets.blocks() for c, n in zip(block.col, np.diff(block.starts))]
    [(0, 2), (1, 1)]
    """

    def __init__(self, grid: Grid, room: MemoryLimits | None = None, packs: Iterable[Pack] = ()) -> None:
        self.grid = grid
        self.room = room
        self.packs: list[Pack] = list(packs)
        self.done: set[BlockKey] = set()
        """Blocks whose points are not wanted any more."""
        self.settled: int | None = None
        """Lots before this one are final; None: all are. What is not final shares no pack with what is."""
        self._waiting = _Waiting()
        self._spilling: Future[Pack] | None = None
        self._writer = ThreadPoolExecutor(1)

    def __len__(self) -> int:
        """Count the blocks that hold points."""
        return len(self.keys())

    def add(
        self,
        easting: NDArray[np.float64],
        northing: NDArray[np.float64],
        upward: NDArray[np.float64],
        flag: NDArray[np.bool_],
    ) -> None:
        """Take a chunk of points; coordinates (n,) in metres, ``flag`` (n,) travels with them."""
        self.take(group_points(self.grid, easting, northing, upward, flag))

    def take(self, run: Run, lot: int = 0) -> None:
        """Take a grouped chunk. Lots come in growing order; a pack covers whole lots, from one to another."""
        self._waiting.add(lot, run)
        if self.room is not None and self._waiting.points > self.room.points:
            self._make_room(self.room)

    def flush(self) -> None:
        """Send everything to disk (there must be a `Room`)."""
        while self._waiting.runs and self.room is not None:
            self._make_room(self.room)
        self._settle()

    def forget(self, first: int) -> None:
        """Lose the points of the lots from ``first`` on, which must not be settled."""
        self._settle()
        self._waiting.drop([held for held in self._waiting.runs if held[0] >= first])
        for pack in [pack for pack in self.packs if pack.meta["first"] >= first]:
            self.packs.remove(pack)
            pack.path.unlink(missing_ok=True)

    def keys(self) -> list[BlockKey]:
        """Blocks that hold points and are not done, south-west first."""
        self._settle()
        return sorted({*self._waiting.index, *(key for pack in self.packs for key in pack.keys)} - self.done)

    def window(self) -> TileWindow:
        """Rectangle of whole blocks around all points (there must be some)."""
        rows, cols = (np.array(axis) for axis in zip(*{*self.keys(), *self.done}, strict=True))
        around = TileWindow.around(cols, rows)
        return TileWindow(*(side * BLOCK_TILES for side in (around.col, around.row, around.cols, around.rows)))

    def points(self, key: BlockKey) -> int:
        """Count the points of a block, duplicates among them."""
        in_memory = sum(int(np.diff(run.starts[place : place + 2])[0]) for run, place in self._held(key))
        return in_memory + sum(pack.rows(key) for pack in self.packs)

    def marks(self, key: BlockKey) -> tuple[int, int]:
        """Count a block's tiles with points, and those in which at least one point is flagged."""
        seen = np.zeros((2, _TILES), np.bool_)
        for part in self._parts(key, ("tile", "flag")):
            seen[0, part["tile"]] = True
            seen[1, part["tile"][part["flag"]]] = True
        tiles, flagged = np.count_nonzero(seen, axis=1).tolist()
        return tiles, flagged

    def flagged_share(self) -> float:
        """Share of the tiles holding points in which at least one point is flagged, 0..1 (0 without points)."""
        tiles, flagged = np.sum([self.marks(key) for key in self.keys()] or [(0, 0)], axis=0)
        return float(flagged / tiles) if tiles else 0.0

    def blocks(self) -> Iterator[TilePoints]:
        """Hand out the blocks, south-west first."""
        for key in self.keys():
            yield from self.block(key)

    def block(self, key: BlockKey) -> Iterator[TilePoints]:
        """Hand out a block: at once, or some tiles at a time where it is too large for that. Thread-safe.

        Raises
        ------
        TooManyPointsError
            One tile alone is too large.
        """
        most = self.room.block_points if self.room else None
        names = [column.name for column in POINT_COLUMNS]
        if most is None or self.points(key) <= most:
            yield sort_block(self.grid, key, list(self._parts(key, names)))
            return
        for chosen in self._shares(key, most):
            parts = []
            for part in self._parts(key, names, _SLICE):
                wanted = chosen[part["tile"]]
                parts.append({name: array[wanted] for name, array in part.items()})
            yield sort_block(self.grid, key, parts)

    def _shares(self, key: BlockKey, most: int) -> Iterator[NDArray[np.bool_]]:
        """Share out the tiles of a block so that no share holds more than ``most`` points; (256,) masks."""
        counts = np.zeros(_TILES, np.int64)
        for part in self._parts(key, ("tile",), _SLICE):
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

    def _parts(self, key: BlockKey, names: Iterable[str], most: int | None = None) -> Iterator[Part]:
        names = tuple(names)
        for run, place in self._held(key):
            part = run.part(place)
            yield {name: part[name] for name in names}
        for pack in self.packs:
            rows = pack.rows(key)
            for start in range(0, rows, most or max(rows, 1)):
                yield pack.read(key, names, start, None if most is None else start + most)

    def _held(self, key: BlockKey) -> list[tuple[Run, int]]:
        return self._waiting.index.get(key, [])

    def _make_room(self, room: MemoryLimits) -> None:
        """Finish what is complete, then send the older half of what waits to disk."""
        self._settle()
        chosen = self._oldest(room.points // 2)
        keys = sorted({key for _, run in chosen for key in run.keys} - self.done)
        ready = [key for key in keys if room.complete(key) and not any(pack.rows(key) for pack in self.packs)]
        if ready:
            room.finish(ready)
            self.done.update(ready)
        left = [key for key in keys if key not in self.done]
        held = {key: [entry for entry in self._held(key) if any(entry[0] is run for _, run in chosen)] for key in left}
        first, last = chosen[0][0], chosen[-1][0]
        self._waiting.drop(chosen)
        path = room.scratch / f"points-{first:08d}-{last:08d}.pack"
        self._spilling = self._writer.submit(
            _write, path, held, room.note(first, last) | {"first": first, "last": last}
        )

    def _oldest(self, points: int) -> list[tuple[int, Run]]:
        """Choose the oldest runs: at least so many points, whole lots where several fit, all of them final or none."""
        chosen: list[tuple[int, Run]] = []
        final = None
        held = 0
        for lot, run in self._waiting.runs:
            is_final = self.settled is None or lot < self.settled
            if chosen and (final != is_final or (held >= points and lot != chosen[-1][0])):
                break
            chosen.append((lot, run))
            final, held = is_final, held + len(run)
        return chosen

    def _settle(self) -> None:
        """Wait until what was sent to disk is there."""
        if self._spilling is not None:
            self.packs.append(self._spilling.result())
            self._spilling = None


def _write(path: Path, held: dict[BlockKey, list[tuple[Run, int]]], meta: dict[str, Any]) -> Pack:
    with PackWriter(path, POINT_COLUMNS, meta) as writer:
        for key, entries in held.items():
            parts = [run.part(place) for run, place in entries]
            rows = sum(len(part["tile"]) for part in parts)
            writer.add(key, rows, {c.name: [part[c.name] for part in parts] for c in POINT_COLUMNS})
    return Pack(path)
