"""The plan of reading: which chunks each task reads, and where other tasks may add points to the same blocks.

On a cluster, neighbouring files are read by one task as far as possible: the blocks between them are then complete in
the memory of one worker, and only those along the border of the task are exchanged through the disk.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.readers import Chunk, SurveyReader
from bumpytiles import BLOCK_TILES, BlockKey, Bounds, Grid

__all__ = ["ChunkRange", "ReadTask", "Spans", "cut_ranges", "range_points", "shared_tasks", "single_task"]

Spans = Mapping[int, Sequence[tuple[int, int]]]
"""For each file some ranges of chunks, as (first, last + 1)."""
LEAST_POINTS, _MOST = 2_000_000, 256_000_000
_RANGES_A_WORKER = 4
"""Ranges per worker: near the end some workers idle, for at most a quarter of a worker's share."""
_TASKS_A_WORKER = 2
"""Least tasks per worker, of files that are read together."""
_TASK_POINTS = 20_000_000
"""Points in a task of files, if that still makes two to four tasks per worker."""
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
    """True if the range is the whole file."""


@dataclass(frozen=True, slots=True, eq=False)
class ReadTask:
    """Ranges to read one after the other, and what the task must know of other ranges.

    There are several ranges of a file only where an earlier run has read what lies between them.
    """

    ranges: tuple[ChunkRange, ...]
    nearby: tuple[Bounds, ...] | None
    """Bounds in which other workers have or will have points: no block there is complete. None: everywhere."""
    finished: frozenset[BlockKey] = frozenset()
    """Blocks in their bounds that an earlier run has finished: their points are dropped."""
    waiting: frozenset[BlockKey] = frozenset()
    """Blocks of which an earlier run has left points on disk: they are not complete when the ranges are read."""


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


def single_task(
    unread: Sequence[ChunkRange], finished: Collection[BlockKey], waiting: Collection[BlockKey]
) -> ReadTask:
    """Return the task of a worker that reads everything; see `ReadTask`."""
    return ReadTask(tuple(unread), (), frozenset(finished), frozenset(waiting))


def shared_tasks(
    grid: Grid, unread: Sequence[ChunkRange], read: Sequence[ChunkRange], finished: Collection[BlockKey], workers: int
) -> Iterator[ReadTask]:
    """Yield tasks that any worker may do: for each of them all ranges of other tasks count as others'."""
    ranges = [*unread, *read]
    all_known = all(part.bounds for part in ranges)
    boxes = [part.bounds or Bounds(0, 0, 0, 0) for part in ranges]
    sides = np.array([(box.west, box.south, box.east, box.north) for box in boxes]).reshape(-1, 4).T
    keys = np.array(list(finished), np.int64).reshape(-1, 2)
    for numbers in _together(unread, sides, workers):
        own = [unread[number] for number in numbers.tolist()]
        nearby = _nearby(grid, sides, numbers) if all_known else None
        yield ReadTask(tuple(own), nearby, frozenset().union(*(_inside(grid, part.bounds, keys) for part in own)))


def _together(unread: Sequence[ChunkRange], sides: NDArray[np.float64], workers: int) -> Iterator[NDArray[np.int64]]:
    """Yield the indices of ranges that a task reads: neighbouring files together, any other range by itself."""
    whole = np.array([part.is_whole and part.bounds is not None for part in unread], np.bool_)
    points = np.array([part.points for part in unread], np.int64)
    total = int(points[whole].sum())
    tasks = np.clip(total // _TASK_POINTS, _TASKS_A_WORKER * workers, _RANGES_A_WORKER * workers)
    tasks = max(min(int(tasks), total // LEAST_POINTS), total // _MOST, 1)
    if whole.any():
        yield from _divided(np.flatnonzero(whole), points, sides, tasks)
    yield from np.flatnonzero(~whole)[:, None]


def _divided(
    numbers: NDArray[np.int64], points: NDArray[np.int64], sides: NDArray[np.float64], tasks: int
) -> Iterator[NDArray[np.int64]]:
    """Divide files among tasks: across the longer side of their area, in halves of about equally many points."""
    west, south, east, north = sides[:, numbers]
    across = (west + east, south + north)[int(np.ptp(west + east) < np.ptp(south + north))]
    numbers = numbers[np.argsort(across, kind="stable")]
    tasks = min(tasks, len(numbers))
    if tasks < 2:
        yield numbers
        return
    ends = np.cumsum(points[numbers])
    cut = 1 + int(np.argmin(np.abs(ends[:-1] - ends[-1] * (tasks // 2) / tasks)))
    yield from _divided(numbers[:cut], points, sides, tasks // 2)
    yield from _divided(numbers[cut:], points, sides, tasks - tasks // 2)


def _nearby(grid: Grid, sides: NDArray[np.float64], numbers: NDArray[np.int64]) -> tuple[Bounds, ...] | None:
    """Return the bounds of other ranges near some ranges; None if each of these shares all of its blocks with one."""
    reach = BLOCK_TILES * grid.tile_size + 2 * _MARGIN
    west, south, east, north = sides
    others = np.ones(len(west), np.bool_)
    others[numbers] = False
    found, covered = np.zeros(len(west), np.bool_), True
    for number in numbers.tolist():
        own = Bounds(*sides[:, number].tolist())
        near = others & (west <= own.east + reach) & (east >= own.west - reach)
        near &= (south <= own.north + reach) & (north >= own.south - reach)
        around = near & (west <= own.west) & (south <= own.south) & (east >= own.east) & (north >= own.north)
        covered = covered and bool(around.any())
        found |= near
    return None if covered else tuple(Bounds(*box) for box in sides[:, found].T.tolist())


def _inside(grid: Grid, box: Bounds | None, keys: NDArray[np.int64]) -> frozenset[BlockKey]:
    if box is not None:
        side = BLOCK_TILES * grid.tile_size
        row, col = keys[:, 0], keys[:, 1]
        inside = ((row + 1) * side >= box.south - _MARGIN) & (row * side <= box.north + _MARGIN)
        inside &= ((col + 1) * side >= box.west - _MARGIN) & (col * side <= box.east + _MARGIN)
        keys = keys[inside]
    return frozenset((row, col) for row, col in keys.tolist())
