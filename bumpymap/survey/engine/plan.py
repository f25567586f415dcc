"""The plan of reading: which chunks each task reads, and where other tasks may add points to the same blocks.

On a cluster, neighbouring files are read by one task as far as possible: the blocks between them are then complete in
the memory of one worker, and only those along the border of the task are exchanged through the disk.
"""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from bumpymap.readers import Chunk, SurveyReader
from bumpytiles import BlockKey, Bounds

Spans = Mapping[int, Sequence[tuple[int, int]]]
"""For each file some ranges of chunks, as (first, last + 1)."""
LEAST_POINTS, _MOST = 2_000_000, 256_000_000
_RANGES_A_WORKER = 4
"""Ranges per worker: near the end some workers idle, for at most a quarter of a worker's share."""
_TASKS_A_WORKER = 2
"""Least tasks per worker, of files that are read together."""
_TASK_POINTS = 20_000_000
"""Points in a task of files, if that still makes two to four tasks per worker."""


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
    """Blocks that an earlier run has finished: their points are dropped."""
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
        limit = math.inf if most is None or reader.info.sequential else most
        past = sorted(done.get(file, ()))
        read += (_range(file, reader, own, first, stop) for first, stop in past)
        gaps = pairwise([0, *(number for span in past for number in span), len(own)])
        for first, stop in list(gaps)[::2]:
            held, at = 0, first
            for number in range(first, stop):
                if held and held + own[number].points > limit:
                    unread.append(_range(file, reader, own, at, number))
                    at, held = number, 0
                held += own[number].points
            if at < stop:
                unread.append(_range(file, reader, own, at, stop))
    return unread, read


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


def shared_tasks(
    unread: Sequence[ChunkRange], read: Sequence[ChunkRange], finished: Collection[BlockKey], workers: int
) -> Iterator[ReadTask]:
    """Yield tasks that any worker may do: for each of them all ranges of other tasks count as others'.

    Files are divided across the longer side of their area, so that those of a task are neighbours.
    """
    whole = [part for part in unread if part.is_whole]
    boxes = [part.bounds for part in whole]
    area = _around(boxes)
    total = sum(part.points for part in whole)
    tasks = min(max(total // _TASK_POINTS, _TASKS_A_WORKER * workers), _RANGES_A_WORKER * workers)
    tasks = max(min(tasks, total // LEAST_POINTS), total // _MOST, 1)
    if area is not None:
        wide = area.east - area.west > area.north - area.south
        whole.sort(key=lambda part: _middle(part, across=wide))
    shares: dict[int, list[ChunkRange]] = {}
    begun = 0
    for part in whole:
        shares.setdefault((2 * begun + part.points) * tasks // (2 * total + 1), []).append(part)
        begun += part.points
    every = [*unread, *read]
    for own in (*shares.values(), *([part] for part in unread if not part.is_whole)):
        places = {(part.file, part.first) for part in own}
        others = [part.bounds for part in every if (part.file, part.first) not in places]
        nearby = tuple(box for box in others if box is not None)
        yield ReadTask(tuple(own), nearby if len(nearby) == len(others) else None, frozenset(finished))


def _middle(part: ChunkRange, *, across: bool) -> float:
    box = part.bounds
    if box is None:
        return 0.0
    return box.west + box.east if across else box.south + box.north
