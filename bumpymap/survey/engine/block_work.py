"""The work on each block, the packs of finished tiles, and the messages when memory or disk run out."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import GROUND_SOURCE, Ground, OutputError, PatchStack, UsageError, photo_column, write_remedy
from bumpymap.patches import join_stacks
from bumpymap.readers import LineSums
from bumpymap.survey.engine.budget import Budget, Workspace
from bumpymap.survey.engine.surroundings import OpenBlocks, Surroundings, join_columns
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
