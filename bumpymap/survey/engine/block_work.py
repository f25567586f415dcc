"""The work on each block, the heights around it, the packs of finished tiles, and messages when memory or disk run out.

Standing objects at the edge of a block depend on the tiles beside it, wherever a run cuts its points.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence, Set as AbstractSet
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import GROUND_SOURCE, Ground, OutputError, PatchStack, UsageError, photo_column, write_remedy
from bumpymap.patches import choose_tiles, join_stacks
from bumpymap.readers import LineSums
from bumpymap.survey.engine.budget import Budget, Workspace
from bumpytiles import (
    BLOCK_TILES,
    BlockKey,
    Column,
    Grid,
    Pack,
    PackError,
    TileBuckets,
    TilePoints,
    TileTable,
    TooManyPointsError,
    grouped_blocks,
    join_tiles,
    photo_of,
    run_blocks,
    write_pack,
)

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


_PACK_TILES = 16_384
"""Tiles in a pack: 22 MB at 15 x 15 pixels. A killed run loses no more than that."""

_JOINED_BLOCKS = 16
"""Blocks of which a column is written at once: at most 4 MB."""


class TileSink:
    """Writes finished blocks to packs ``tiles-KIND-NUMBER.pack``.

    ``kind``: what was measured, such as ``all`` points, or ``ground-early``: only ground, before reading was complete.
    """

    def __init__(self, folder: Path, kind: str, columns: Sequence[Column]) -> None:
        self._folder, self._kind, self._columns, self._number = folder, kind, tuple(columns), 0
        self._written: list[Path] = []
        self._held: dict[BlockKey, Mapping[str, NDArray[Any]]] = {}
        self._tiles = 0
        self._marks: dict[BlockKey, str] = {}

    def add(self, key: BlockKey, columns: Mapping[str, NDArray[Any]], marks: NDArray[np.uint8] | None = None) -> None:
        """Add a block; ``marks`` (256,) are those of its tiles, of `tile_marks`, if they are known."""
        self._held[key] = columns
        self._tiles += len(columns["col"])
        self._marks |= {} if marks is None else {key: marks.tobytes().hex()}
        if self._tiles >= _PACK_TILES:
            self.flush()

    def flush(self) -> None:
        """Write the blocks that are not written yet."""
        if not self._held:
            return
        path = self._folder / f"tiles-{self._kind}-{self._number:06d}.pack"
        blocks = {key: len(columns["col"]) for key, columns in self._held.items()}
        marks = [self._marks[key] for key in sorted(self._marks)]
        write_pack(path, self._columns, blocks, self._parts, {"kind": self._kind, "marks": marks})
        self._written.append(path)
        self._number += 1
        self._held, self._tiles, self._marks = {}, 0, {}

    def _parts(self, column: Column) -> Iterator[NDArray[Any]]:
        """Yield the held rows of a column, a few blocks at a time: the fixed time of a write counts once for them."""
        held = [columns[column.name] for columns in self._held.values()]
        for first in range(0, len(held), _JOINED_BLOCKS):
            yield np.concatenate(held[first : first + _JOINED_BLOCKS])

    def new_packs(self) -> list[Path]:
        """Return the packs that were written since the last call."""
        new, self._written = self._written, []
        return new


TileColumns = dict[str, NDArray[Any]]
ALL_POINTS, GROUND_POINTS, JOINED_POINTS = "all", "ground", "joined"
_GROUP_POINTS = 4096
"""Most points in a group of blocks that are rated together; a denser block is rated by itself."""


@dataclass(frozen=True, slots=True)
class BlockWork:
    """The work that is done on each block; picklable, because workers of a cluster do it too."""

    grid: Grid
    columns: tuple[Column, ...]
    """Of a finished tile."""
    rate: Callable[..., TileColumns]
    """Takes the points of some tiles, and whether only ground is measured; returns the columns of these tiles.

    If ``measure_all`` is given, it takes the measures of the tiles too, and the heights of those around them."""
    ground: Ground
    measure_all: Callable[[TilePoints], PatchStack] | None = None
    """Measures tiles from all of their points, if standing objects are found in their heights."""
    margin: int = 0
    """Tiles around a tile that its standing objects depend on then."""

    @property
    def kinds(self) -> tuple[str, ...]:
        """Points to measure before it is known which points the run will use: ``all``, ``ground``, or both."""
        return {"auto": (ALL_POINTS, GROUND_POINTS), "all": (ALL_POINTS,)}.get(self.ground, (GROUND_POINTS,))

    def surroundings(self, most_bytes: int) -> Surroundings | None:
        """Return what keeps the heights around blocks; None if they are not asked for."""
        if self.measure_all is None or ALL_POINTS not in self.kinds:
            return None
        return Surroundings(self.measure_all, self.margin, most_bytes)

    def finish(
        self,
        buckets: TileBuckets,
        keys: Sequence[BlockKey],
        threads: int,
        kinds: Sequence[str],
        around: Surroundings | None = None,
    ) -> Iterator[tuple[BlockKey, dict[str, TileColumns]]]:
        """Rate blocks for some of ``kinds``, of which each needs the same sorted points, in the given order.

        The blocks are done then, and their points are freed.
        """
        most = min(_GROUP_POINTS, buckets.limits.block_points if buckets.limits else _GROUP_POINTS)
        # The cloth filter needs each block by itself.
        groups = grouped_blocks(keys, buckets.points, 0 if self.ground == "csf" else most)
        beside = None if around is None or ALL_POINTS not in kinds else OpenBlocks(around, buckets, keys)
        for finished in run_blocks(lambda group: self._rate_group(buckets, group, kinds, beside), groups, threads):
            for key, columns in finished:
                yield key, columns
                if beside is not None:
                    beside.close(key, columns[ALL_POINTS])
                buckets.finish(key)

    def _rate_group(
        self, buckets: TileBuckets, keys: Sequence[BlockKey], kinds: Sequence[str], beside: OpenBlocks | None
    ) -> list[tuple[BlockKey, dict[str, TileColumns]]]:
        """Rate a block in the shares that it comes in, or small ones in one call."""
        column, known = photo_column(self.grid.pixels), () if beside is None else (beside.heights(keys),)
        rated = []
        for points, *patches in self._shares(buckets, keys, beside):
            columns = {}
            if GROUND_POINTS in kinds:
                columns[GROUND_POINTS] = self.rate(points, True)
            if ALL_POINTS in kinds:
                columns[ALL_POINTS] = self.rate(points, False, *patches, *known)
            photo = {column.name: photo_of(points)} if column in self.columns else {}
            rated.append({kind: own | photo for kind, own in columns.items()})
        joined = {kind: join_columns([share[kind] for share in rated]) for kind in kinds}
        tiles = joined[kinds[0]]
        blocks = np.stack([tiles["row"], tiles["col"]]) // BLOCK_TILES
        ends = 1 + np.flatnonzero((np.diff(blocks, axis=1) != 0).any(axis=0))
        pieces = {kind: {n: np.split(a, ends) for n, a in columns.items()} for kind, columns in joined.items()}
        return [
            (key, {kind: {n: split[number] for n, split in own.items()} for kind, own in pieces.items()})
            for number, key in enumerate(keys)
        ]

    def _shares(
        self, buckets: TileBuckets, keys: Sequence[BlockKey], beside: OpenBlocks | None
    ) -> Iterator[tuple[Any, ...]]:
        """Yield the points of a block in the shares that it comes in, or of small ones in one, and what is measured."""
        if beside is None:
            parts: Iterator[tuple[Any, ...]] = ((points,) for key in keys for points in self._points(buckets, key))
        else:
            parts = (share for key in keys for share in beside.block(key))
        if len(keys) == 1:
            yield from parts
            return
        points, *measured = zip(*parts, strict=True)
        yield join_tiles(points), *(join_stacks(own) for own in measured)

    def _points(self, buckets: TileBuckets, key: BlockKey) -> Iterator[TilePoints]:
        """Yield the points of a block: in one piece for the cloth filter, which would find other ground in a part."""
        most = buckets.limits.block_points if buckets.limits else None
        if self.ground == "csf" and most is not None and (points := buckets.points(key)) > most:
            side = BLOCK_TILES * self.grid.tile_size
            raise UsageError(
                f"`ground='csf'` takes squares of {side:g} m as a whole: the one at ({key[1] * side:.0f}, "
                f"{key[0] * side:.0f}) holds {points:,} points, and there is room for {most:,}. Raise `memory`, lower "
                "`threads`, or thin the survey"
            )
        return buckets.block(key)


def finished_tiles(work: BlockWork, space: Workspace, kind: str, *more: str) -> TileTable:
    """Return all tiles that a run has finished of a kind; blocks of which there are others of ``more`` kinds, so."""
    return TileTable(work.grid, [Pack(path) for name in (f"{kind}-early", kind, *more) for path in space.tiles(name)])


@dataclass(frozen=True, slots=True)
class MeasuredTiles:
    """The result of reading and measuring."""

    table: TileTable
    ground_only: bool
    from_all: int
    """Tiles measured from all of their points nevertheless, because that part of the survey is not classified; then
    the table has the column `GROUND_SOURCE`."""
    dropped: list[dict[str, int] | None]
    """For each input the number of dropped points by reason; None if it was skipped."""
    points: int
    """Number of points used; duplicates are included."""
    lines: LineSums
    """Sums to compare the flight lines of these points."""
    checksums: list[str | None]
    """Of each input, see `bumpymap.core.file_checksum`; None if it was skipped."""
    coloured: int
    """Number of points with a colour among those used."""

    @classmethod
    def of(cls, work: BlockWork, space: Workspace, record: Mapping[str, Any]) -> "MeasuredTiles":
        """Return what a run has finished, from the record in its workspace."""
        kind = GROUND_POINTS if record["ground_only"] else ALL_POINTS
        table = finished_tiles(work, space, kind, *([JOINED_POINTS] if record["from_all"] else []))
        if record["from_all"]:
            table = table.with_columns([Pack(path) for path in space.tiles(GROUND_SOURCE.name)])
        return cls(table, **{**record, "lines": LineSums.from_record(record["lines"])})


@contextmanager
def engine_errors(budget: Budget) -> Iterator[None]:
    """Turn a shortage of memory or disk into an error that says what to do."""
    try:
        yield
    except TooManyPointsError as error:
        raise UsageError(
            f"{error}: it is too dense for `memory='{budget.memory >> 20}MB'`. Raise `memory`, or thin the survey"
        ) from error
    except OSError as error:
        more = write_remedy(error, "Free some space, choose a larger disk with `scratch`, or raise `memory`")
        raise OutputError(f"cannot write temporary points to disk: {error}. {more}") from error
    except PackError as error:
        raise OutputError(
            f"temporary files of the run are missing or damaged: {error}. Run it again, with `overwrite=True`"
        ) from error
