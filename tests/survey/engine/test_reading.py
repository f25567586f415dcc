"""Reading ahead changes nothing but the time: order, statistics and refusals are those of reading chunk after chunk."""

import threading
from dataclasses import dataclass, field
from unittest.mock import Mock

import numpy as np
import pytest

from bumpymap.core.errors import BadInputError
from bumpymap.core.interrupts import SilentProgress
from bumpymap.core.types import PointCloud
from bumpymap.readers import Chunk, ChunkPoints, PointStats
from bumpymap.survey.engine.block_work import BlockWork
from bumpymap.survey.engine.plan import cut_ranges, single_task
from bumpymap.survey.engine.reading import OpenRange, RangeReader, refuse_no_points
from bumpytiles import Grid, TileBuckets

GRID = Grid()


@dataclass
class Info:
    path: str
    bounds: None = None
    sequential: bool = False
    parallel: bool = False


@dataclass
class Reader:
    """A file of some pieces of ten points each; fails where it is told to."""

    name: str
    pieces_held: int
    bad_fetch: int = -1
    bad_convert: int = -1
    bad_verify: bool = False
    log: list = field(default_factory=list)
    lock: threading.Lock = field(default_factory=threading.Lock)
    parallel: bool = False
    under_way: int = 0
    most_under_way: int = 0
    reading: int = 0

    @property
    def info(self):
        return Info(self.name, parallel=self.parallel)

    def chunks(self, points):
        return [Chunk(index, 10 * index, 10) for index in range(self.pieces_held)]

    def fetch(self, chunk):
        with self.lock:
            assert self.parallel or self.reading == 0, "two threads fetch at once"
            self.reading += 1
            self.under_way += 1
            self.most_under_way = max(self.most_under_way, self.under_way)
            self.log.append(chunk.index)
        with self.lock:
            self.reading -= 1
        if chunk.index == self.bad_fetch:
            raise BadInputError(f"{self.name} fetch {chunk.index}")
        return np.full(10, float(hash(self.name) % 7 + chunk.index))

    def take_hashed(self):
        return ()

    def convert(self, chunk, fetched):
        with self.lock:
            self.under_way -= 1
        if chunk.index == self.bad_convert:
            raise BadInputError(f"{self.name} convert {chunk.index}")
        return ChunkPoints(PointCloud(fetched, np.zeros(10), np.zeros(10), np.zeros(10, bool)), PointStats(points=10))

    def verify(self, stats):
        if self.bad_verify:
            raise BadInputError(f"{self.name} verify")


class Store(TileBuckets):
    """Notes what is added and dropped."""

    def __init__(self):
        super().__init__(GRID)
        self.calls = []

    def add_chunk(self, chunk, number=0):
        self.calls.append(number)
        super().add_chunk(chunk, number)

    def drop_from(self, first):
        self.calls.append(("drop", first))
        super().drop_from(first)


def read(readers, *, skip_bad, threads=2):
    """Read all files; gives their statistics, what the store was asked to do, and the files that are bad."""
    chunks = [reader.chunks(10) for reader in readers]
    unread, _ = cut_ranges(readers, chunks, None, {})
    ranges = [OpenRange(part, readers[part.file], chunks[part.file]) for part in unread]
    store, work = Store(), BlockWork(GRID, (), Mock(), "all")
    reading = RangeReader(single_task(unread, (), ()), ranges, store, work, {}, threads, SilentProgress())
    stats, bad = {}, {}
    for result in (*reading.run(skip_bad=skip_bad), reading.remainder()):
        stats |= result.stats
        if result.error is not None:
            bad[result.spans[0][0]] = str(result.error)
            if not skip_bad:
                break
    return stats, store.calls, bad


@pytest.mark.parametrize(
    ("faults", "says"),
    [
        ({"bad_fetch": 7}, "b fetch 7"),
        ({"bad_convert": 6, "bad_fetch": 7}, "b convert 6"),
        ({"bad_convert": 7, "bad_fetch": 6}, "b fetch 6"),
        ({"bad_convert": 0}, "b convert 0"),
        ({"bad_fetch": 0}, "b fetch 0"),
        ({"bad_verify": True}, "b verify"),
        ({"bad_fetch": 9, "bad_verify": True}, "b fetch 9"),
    ],
)
@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("parallel", [False, True])
def test_a_bad_file_is_refused_once_for_its_first_fault(faults, says, threads, parallel):
    def readers():
        return [Reader("a", 3), Reader("b", 10, **faults, parallel=parallel), Reader("c", 3, parallel=parallel)]

    stats, calls, bad = read(readers(), skip_bad=True, threads=threads)
    assert bad == {1: says}
    assert {file: own.points for file, own in stats.items()} == {0: 30, 2: 30}
    dropped = calls.index(("drop", 3))
    assert calls[:dropped] == list(range(dropped))
    assert calls[dropped + 1 :] == [dropped, dropped + 1, dropped + 2]
    assert read(readers(), skip_bad=False, threads=threads)[2] == {1: says}


@pytest.mark.parametrize(
    ("tallies", "says"),
    [
        ([PointStats(10, withheld=10)], r"of the 10 points of a, 10 are flagged as withheld\. Clear"),
        (
            [PointStats(10, withheld=4, noise=6), PointStats(5, noise=5)],
            r"of the 15 points of a, b, 4 are flagged as withheld and 11 are of class 7 or 18 \(noise\)\. Clear",
        ),
        ([PointStats(1000, not_a_number=1000)], r"of the 1,000 points of a, 1,000 are beams without return\. Is it"),
        ([PointStats(), PointStats()], r"every input was skipped \(a, b\)"),
        ([PointStats()] * 7, r"\(a, b, c, d, e and 2 more\)"),
    ],
)
def test_no_point_left(tallies, says):
    with pytest.raises(BadInputError, match=says):
        refuse_no_points([Reader(name, 1) for name in "abcdefg"[: len(tallies)]], tallies)
    refuse_no_points([Reader("a", 1)] * (len(tallies) + 1), [*tallies, PointStats(1)])
