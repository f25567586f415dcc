"""Reading: files are cut into pieces, fetched one after the other, and converted and grouped beside that.

The decoder works in a process of its own and uses every core; conversion and grouping are compiled and hold no lock. So
all of them go on at once: one thread fetches the piece that comes next, some convert and group the pieces before it,
and this one takes what is ready. Pieces of all files have one number each, their *lot*, and are taken in that order.
"""

from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from bumpymap.core import BadInputError, Progress
from bumpymap.readers import Chunk, PointStats, SurveyReader, close as close_decoder
from bumpymap.survey.engine.coming import Coming
from bumpytiles import Bounds, Grid, Pack, Run, TileBuckets, group_points

__all__ = ["Intake", "Lot", "cut", "refuse_nothing"]

_LARGEST_KEPT = (1 << 25) - (1 << 16)
"""glibc's malloc keeps freed memory for the next array up to the size of the largest block that was ever freed, and to
32 MB at most. One is reserved and freed, untouched, since nothing else here is that large: without it the arrays of
every piece and block come from the system page by page (20 million points: 250,000 page faults, 0.5 s)."""
_NAMED = 5
"""A message names so many files."""
_WHY = {
    "withheld": "are flagged as withheld",
    "noise": "are of class 7 or 18 (noise)",
    "not_a_number": "are beams without return",
}


@dataclass(frozen=True, slots=True)
class Lot:
    """A piece of one of the files."""

    file: int
    """Which reader."""
    chunk: Chunk
    last: bool
    """The last one of its file."""


def cut(readers: Sequence[SurveyReader], points: int) -> list[Lot]:
    """Cut all files into pieces of about so many points."""
    lots = []
    for file, reader in enumerate(readers):
        chunks = reader.chunks(points)
        lots += [Lot(file, chunk, number == len(chunks) - 1) for number, chunk in enumerate(chunks)]
    return lots


def refuse_nothing(readers: Sequence[SurveyReader], tallies: Sequence[PointStats]) -> None:
    """Raise BadInputError where no point of any file counts; files that were skipped have empty tallies."""
    seen, dropped = sum(tally.points for tally in tallies), Counter[str]()
    for tally in tallies:
        dropped.update(tally.dropped)
    if seen > dropped.total():
        return
    names = [str(reader.info.path) for reader in readers]
    files = ", ".join(names[:_NAMED]) + (f" and {len(names) - _NAMED} more" if len(names) > _NAMED else "")
    if not seen:
        raise BadInputError(f"no point is left to map: every input was skipped ({files})")
    reasons = [f"{count:,} {_WHY[reason]}" for reason, count in dropped.items() if count]
    advice = "Clear flag or class in the file if they are ground after all"
    if dropped["not_a_number"] == seen:
        advice = "Is it the right file?"
    raise BadInputError(
        f"no point is left to map: of the {seen:,} points of {files}, {' and '.join(reasons)}. {advice}"
    )


class Intake:
    """Reads lots into buckets; a file that breaks in the middle leaves none of its points.

    Parameters
    ----------
    readers : sequence of SurveyReader
    lots : sequence of Lot
        From `cut`.
    grid : Grid
    refuse : callable
        Told of a bad file; raises, or notes that it is skipped.
    may_skip : bool
        Whether ``refuse`` may return. Points of a file are then not final before its last piece was judged.
    """

    def __init__(
        self,
        readers: Sequence[SurveyReader],
        lots: Sequence[Lot],
        grid: Grid,
        refuse: Callable[[SurveyReader, BadInputError], None],
        *,
        may_skip: bool,
    ) -> None:
        self._readers, self._lots, self._grid = readers, lots, grid
        self._refuse, self._may_skip = refuse, may_skip
        self.tallies = [PointStats() for _ in readers]
        """Of each file, as far as it was read."""
        self.skipped: set[int] = set()
        """Files that were refused."""
        self.flagged = False
        """Whether any point so far is ground."""
        self._noted: dict[int, tuple[PointStats, bool]] = {}
        self._first = {lot.file: number for number, lot in reversed(list(enumerate(lots)))}
        self._coming = Coming(grid, self._parts())

    def complete(self, key: tuple[int, int]) -> bool:
        """Whether no lot that is still to be read reaches a block."""
        return self._coming.complete(key)

    def note(self, first: int, last: int) -> dict[str, Any]:
        """Give what a pack must remember of the lots in it: their tallies by file, whether any point is ground."""
        tallies: dict[int, PointStats] = {}
        flagged = False
        for number in range(first, last + 1):
            tally, marked = self._noted.pop(number, (PointStats(), False))
            file = self._lots[number].file
            tallies[file] = tallies.get(file, PointStats()).merge(tally)
            flagged |= marked
        return {"tallies": {str(file): tally.to_record() for file, tally in tallies.items()}, "flagged": flagged}

    def restore(self, packs: Sequence[Pack]) -> int:
        """Take up where an earlier run was broken off; gives the first lot that is to be read."""
        done = 0
        for pack in packs:
            for file, record in pack.meta["tallies"].items():
                self.tallies[int(file)] = self.tallies[int(file)].merge(PointStats.from_record(record))
            self.flagged |= pack.meta["flagged"]
            done = int(pack.meta["last"]) + 1
        for number in range(done):
            self._mark_read(number)
        return done

    def read(self, buckets: TileBuckets, start: int, threads: int, progress: Progress) -> None:
        """Read the lots from ``start`` on.

        Raises
        ------
        BadInputError
            A file is bad and may not be skipped. That no point is left is no matter of some lots: `refuse_nothing`.
        """
        buckets.settled = self._first[self._lots[start].file] if self._may_skip and start < len(self._lots) else None
        np.empty(_LARGEST_KEPT, np.uint8)
        pending: deque[tuple[int, Future[tuple[Run, PointStats, bool]]]] = deque()
        fetcher, pool = ThreadPoolExecutor(1), ThreadPoolExecutor(threads)
        try:
            for number, coming in self._fetched(start, fetcher):
                lot = self._lots[number]
                if lot.file in self.skipped:
                    continue  # refused while this was fetched
                try:
                    fetched = coming.result()
                except BadInputError as error:
                    self._drain(pending, 0, buckets, progress)
                    if lot.file not in self.skipped:
                        self._give_up(lot.file, error, buckets)
                    continue
                pending.append((number, pool.submit(self._prepare, self._readers[lot.file], lot.chunk, fetched)))
                del fetched, coming
                self._drain(pending, threads, buckets, progress)
            self._drain(pending, 0, buckets, progress)
        finally:
            fetcher.shutdown(cancel_futures=True)
            pool.shutdown(cancel_futures=True)
            close_decoder()

    def _fetched(self, start: int, fetcher: ThreadPoolExecutor) -> Iterator[tuple[int, Future[Any]]]:
        """Give lots in order, each with what is fetched of it; while one is dealt with the next is fetched."""
        ahead: deque[tuple[int, Future[Any]]] = deque()
        for number, lot in enumerate(self._lots[start:], start):
            if lot.file in self.skipped:
                continue
            ahead.append((number, fetcher.submit(self._readers[lot.file].fetch, lot.chunk)))
            if len(ahead) > 1:
                yield ahead.popleft()
        yield from ahead

    def _prepare(self, reader: SurveyReader, chunk: Chunk, fetched: Any) -> tuple[Run, PointStats, bool]:
        batch = reader.convert(chunk, fetched)
        cloud = batch.cloud
        run = group_points(self._grid, cloud.easting, cloud.northing, cloud.upward, cloud.is_ground)
        return run, batch.tally, bool(run.points["flag"].any())

    def _drain(
        self,
        pending: deque[tuple[int, Future[tuple[Run, PointStats, bool]]]],
        most: int,
        buckets: TileBuckets,
        progress: Progress,
    ) -> None:
        """Take what is ready, in order, until at most ``most`` lots are under way."""
        while len(pending) > most:
            number, future = pending.popleft()
            lot = self._lots[number]
            if lot.file in self.skipped:
                continue
            try:
                run, tally, flagged = future.result()
            except BadInputError as error:
                self._give_up(lot.file, error, buckets)
                continue
            self._noted[number] = (tally, flagged)
            self.flagged |= flagged
            self.tallies[lot.file] = self.tallies[lot.file].merge(tally)
            progress.advance(lot.chunk.points)
            buckets.take(run, number)
            self._judge(number, buckets)

    def _judge(self, number: int, buckets: TileBuckets) -> None:
        lot = self._lots[number]
        if not self._may_skip:
            self._mark_read(number)
        if not lot.last:
            return
        try:
            self._readers[lot.file].judge(self.tallies[lot.file])
        except BadInputError as error:
            self._give_up(lot.file, error, buckets)
            return
        if self._may_skip:
            buckets.settled = number + 1
            for own in range(self._first[lot.file], number + 1):
                self._mark_read(own)

    def _give_up(self, file: int, error: BadInputError, buckets: TileBuckets) -> None:
        self._refuse(self._readers[file], error)
        self.skipped.add(file)
        self.tallies[file] = PointStats()
        buckets.forget(self._first[file])
        for number in range(self._first[file], len(self._lots)):
            if self._lots[number].file != file:
                break
            self._noted.pop(number, None)
            self._mark_read(number)

    def _parts(self) -> list[Bounds | None]:
        """Bounds of what is kept account of: of each piece that has its own, else of the file as a whole."""
        self._part: list[int | None] = []
        bounds: list[Bounds | None] = []
        for lot in self._lots:
            own = lot.chunk.bounds
            if own is None and not lot.last:
                self._part.append(None)
                continue
            self._part.append(len(bounds))
            bounds.append(own or self._readers[lot.file].info.bounds)
        return bounds

    def _mark_read(self, number: int) -> None:
        part = self._part[number]
        if part is not None:
            self._coming.read(part)
