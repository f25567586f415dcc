"""The plan of reading: which chunks each task reads, and where other tasks may add points to the same blocks."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.readers import Chunk, SurveyReader
from bumpytiles import BLOCK_TILES, BlockKey, Bounds, Grid

__all__ = ["ChunkRange", "ReadTask", "Spans", "cut_ranges", "range_points", "shared_tasks", "single_tasks"]

Spans = Mapping[int, Sequence[tuple[int, int]]]
"""For each file some ranges of chunks, as (first, last + 1)."""
LEAST_POINTS, _MOST = 2_000_000, 256_000_000
_RANGES_A_WORKER = 4
"""Ranges per worker: near the end some workers idle, for at most a quarter of a worker's share."""
_MARGIN = 1.01
"""How far outside its bounds a point may lie, m; as in `BlockCompletion`."""


@dataclass(frozen=True, slots=True)
class ChunkRange:
    """Consecutive chunks of a file."""

    file: int
    """Index of its reader."""
    first: int
    """Its first chunk."""
    stop: int
    """Its last chunk + 1."""
    points: int
    bounds: Bounds | None
    """Bounds of its points, m; None if they are not known."""
    is_whole: bool
    """Whether the range is the whole file."""


@dataclass(frozen=True, slots=True, eq=False)
class ReadTask:
    """A range to read, and what the task must know of other ranges."""

    range: ChunkRange
    nearby: tuple[Bounds, ...] | None
    """Bounds in which other workers have or will have points: no block there is complete. None: everywhere."""
    finished: frozenset[BlockKey] = frozenset()
    """Blocks in its bounds that an earlier run has finished: their points are dropped."""


def range_points(points: int, workers: int) -> int:
    """Return the most points of a range when ``points`` are distributed among ``workers``."""
    return max(LEAST_POINTS, min(_MOST, points // (_RANGES_A_WORKER * workers)))


def cut_ranges(
    readers: Sequence[SurveyReader], chunks: Sequence[Sequence[Chunk]], most: int | None, done: Spans
) -> tuple[list[ChunkRange], list[ChunkRange]]:
    """Cut the chunks that are not ``done`` into ranges of about ``most`` points at most; a small file is one range.

    A file that can only be decoded from its start is one range, however large it is.

    Returns
    -------
    list of ChunkRange
        Ranges to read.
    list of ChunkRange
        Ranges that are done.
    """
    unread: list[ChunkRange] = []
    read: list[ChunkRange] = []
    for file, (reader, own) in enumerate(zip(readers, chunks, strict=True)):
        at = 0
        for first, stop in [*sorted(done.get(file, ())), (len(own), len(own))]:
            limit = None if reader.info.sequential else most
            unread += (_range(file, reader, own, *span) for span in _cut(own, at, first, limit))
            if first < stop:
                read.append(_range(file, reader, own, first, stop))
            at = stop
    return unread, read


def _cut(chunks: Sequence[Chunk], first: int, stop: int, most: int | None) -> Iterator[tuple[int, int]]:
    held = 0
    for number in range(first, stop):
        if held and most is not None and held + chunks[number].points > most:
            yield first, number
            first, held = number, 0
        held += chunks[number].points
    if first < stop:
        yield first, stop


def _range(file: int, reader: SurveyReader, chunks: Sequence[Chunk], first: int, stop: int) -> ChunkRange:
    own = chunks[first:stop]
    bounds = _around([chunk.bounds for chunk in own]) or reader.info.bounds
    return ChunkRange(file, first, stop, sum(chunk.points for chunk in own), bounds, stop - first == len(chunks))


def _around(boxes: Sequence[Bounds | None]) -> Bounds | None:
    known = [box for box in boxes if box is not None]
    if not known or len(known) < len(boxes):
        return None
    return Bounds(
        min(box.west for box in known),
        min(box.south for box in known),
        max(box.east for box in known),
        max(box.north for box in known),
    )


def single_tasks(
    unread: Sequence[ChunkRange], read: Sequence[ChunkRange], finished: Collection[BlockKey]
) -> Iterator[ReadTask]:
    """Yield the tasks of a worker that reads everything: only ranges read by an earlier run count as others'."""
    known = [box.bounds for box in read if box.bounds is not None]
    nearby = tuple(known) if len(known) == len(read) else None
    keys = frozenset(finished)
    return (ReadTask(part, nearby, keys) for part in unread)


def shared_tasks(
    grid: Grid, unread: Sequence[ChunkRange], read: Sequence[ChunkRange], finished: Collection[BlockKey]
) -> Iterator[ReadTask]:
    """Yield tasks that any worker may do: for each of them all other ranges count as others'."""
    ranges = [*unread, *read]
    all_known = all(part.bounds for part in ranges)
    boxes = [part.bounds or Bounds(0, 0, 0, 0) for part in ranges]
    sides = np.array([(box.west, box.south, box.east, box.north) for box in boxes]).reshape(-1, 4).T
    keys = np.array(list(finished), np.int64).reshape(-1, 2)
    for number, part in enumerate(unread):
        nearby = _nearby(grid, sides, number) if all_known else None
        yield ReadTask(part, nearby, _inside(grid, part.bounds, keys))


def _nearby(grid: Grid, sides: NDArray[np.float64], number: int) -> tuple[Bounds, ...] | None:
    """Return the bounds of other ranges near a range; None if it shares all of its blocks with one of them."""
    reach = BLOCK_TILES * grid.tile_size + 2 * _MARGIN
    west, south, east, north = sides
    own = Bounds(*sides[:, number].tolist())
    near = (west <= own.east + reach) & (east >= own.west - reach)
    near &= (south <= own.north + reach) & (north >= own.south - reach)
    near[number] = False
    around = near & (west <= own.west) & (south <= own.south) & (east >= own.east) & (north >= own.north)
    if around.any():
        return None
    return tuple(Bounds(*box) for box in sides[:, near].T.tolist())


def _inside(grid: Grid, box: Bounds | None, keys: NDArray[np.int64]) -> frozenset[BlockKey]:
    if box is not None:
        side = BLOCK_TILES * grid.tile_size
        row, col = keys[:, 0], keys[:, 1]
        inside = ((row + 1) * side >= box.south - _MARGIN) & (row * side <= box.north + _MARGIN)
        inside &= ((col + 1) * side >= box.west - _MARGIN) & (col * side <= box.east + _MARGIN)
        keys = keys[inside]
    return frozenset((row, col) for row, col in keys.tolist())
