"""Memory is full: complete blocks make room, points go to disk only if that is not enough, and no point is lost."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from hypothesis import given, settings, strategies as st

from bumpymap.core.interrupts import SilentProgress
from bumpymap.core.types import PointCloud
from bumpymap.readers import Chunk, ChunkPoints, PointStats
from bumpymap.survey.engine.block_work import BlockWork, TileSink
from bumpymap.survey.engine.plan import ReadTask, cut_ranges
from bumpymap.survey.engine.reading import OpenRange, RangeReader
from bumpytiles import Bounds, Column, Grid, MemoryLimits, Pack, TileBuckets

GRID = Grid()
BLOCK = 48.0
BLOCKS = 10
"""Along the strip."""
FINE, COARSE = 600, 900
"""Points of a chunk of one place, and of the first one, which reaches everywhere."""
POINT_BYTES = 26
COLUMNS = (Column("col", "<i8"), Column("row", "<i8"), Column("count", "<i8"))


def rate(points, ground_only):
    counts = np.diff(points.starts)
    if ground_only:
        counts = np.add.reduceat(points.flag, points.starts[:-1], dtype=np.int64)
    return {"col": points.col, "row": points.row, "count": counts}


@dataclass
class Octree:
    """A strip of ground, read as an octree is: a coarse node of all of it, then places from west to east.

    A place begins 10 m west of a block, so that each reaches into two.
    """

    bounded: bool = True
    info = SimpleNamespace(
        path="octree", bounds=Bounds(-10, 0, BLOCK * BLOCKS, BLOCK), sequential=False, parallel=False
    )

    def chunks(self, _):
        boxes = [self.info.bounds, *(Bounds(BLOCK * n - 10, 0, BLOCK * n + 38, BLOCK) for n in range(BLOCKS))]
        sizes = [COARSE, *[FINE] * BLOCKS]
        starts = np.cumsum([0, *sizes])
        return [
            Chunk(n, int(starts[n]), sizes[n], boxes[n] if self.bounded else None) for n in range(len(sizes))
        ]  # fmt: skip

    def points(self, chunk):
        box = self.chunks(0)[chunk.index].bounds or Octree().chunks(0)[chunk.index].bounds
        rng = np.random.default_rng(chunk.index)
        x, y = rng.uniform(box.west, box.east, chunk.points), rng.uniform(0, BLOCK, chunk.points)
        return PointCloud(x, y, np.zeros(chunk.points), rng.random(chunk.points) < 0.3)

    def fetch(self, chunk):
        return self.points(chunk)

    def convert(self, chunk, fetched):
        return ChunkPoints(fetched, PointStats(points=chunk.points))

    def take_hashed(self):
        return ()

    def verify(self, stats):
        assert stats.points == COARSE + FINE * BLOCKS


def expected(reader):
    """Number of points, and of ground points, of every tile."""
    clouds = [reader.points(chunk) for chunk in reader.chunks(0)]
    x, y, ground = (np.concatenate([getattr(c, n) for c in clouds]) for n in ("easting", "northing", "is_ground"))
    tiles = np.column_stack([x // 3, y // 3]).astype(int)
    return [dict(zip(*counted(tiles[chosen]), strict=True)) for chosen in (np.ones(len(x), bool), ground)]


def counted(tiles):
    keys, counts = np.unique(tiles, axis=0, return_counts=True)
    return map(tuple, keys.tolist()), counts.tolist()


@dataclass
class Run:
    """One process: what it leaves on disk when it ends after some results."""

    folder: object
    points: int
    reader: Octree

    def read(self, spans=(), finished=(), waiting=(), most=None):
        """Read what is not in ``spans``; return the results, at most ``most``, and the store."""
        self.folder.mkdir()
        chunks = [self.reader.chunks(0)]
        unread, _ = cut_ranges([self.reader], chunks, None, {0: spans})
        ranges = [OpenRange(part, self.reader, chunks[0][part.first : part.stop]) for part in unread]
        store = TileBuckets(GRID, MemoryLimits(POINT_BYTES * self.points, 100_000, self.folder))
        store.done = set(finished)
        work = BlockWork(GRID, COLUMNS, rate, "auto")
        sinks = {kind: TileSink(self.folder, kind, COLUMNS) for kind in work.kinds}
        task = ReadTask(tuple(unread), (), frozenset(finished), frozenset(waiting))
        reading = RangeReader(task, ranges, store, work, sinks, 2, SilentProgress())
        results = []
        for result in reading.run():
            results.append(result)
            if len(results) == most:
                break
        else:
            rest = reading.remainder()
            results += [rest] if rest is not None else []
        return results, store, work


def tiles_of(results, kind):
    packs = [Pack(found[kind]) for result in results for found in [[p[0] for p in result.tiles if p]] if found]
    return [(key, pack.read(key, ["col", "row", "count"])) for pack in packs for key in pack.keys]


def finished(results):
    return {key for key, _ in tiles_of(results, 0)}


def counts(early, late):
    """Number of points of each tile; a tile that is rated twice is an error."""
    found = {}
    for columns in [*(columns for _, columns in early), *late]:
        for col, row, count in zip(*(columns[name].tolist() for name in ("col", "row", "count")), strict=True):
            assert (col, row) not in found
            found[col, row] = count
    return found


def rest_of(store, work, packs, done):
    store.packs = [Pack(path) for path in packs]
    store.done = set(done)
    return [columns["all"] for _, columns in work.finish(store, store.keys(), 2, ("all",))]


def test_an_octree_is_read_without_points_on_disk(tmp_path):
    """Though its first node reaches into every block, and many chunks across a border into two."""
    reader = Octree()
    results, store, work = Run(tmp_path / "run", COARSE + 4 * FINE, reader).read()
    assert [result.packs for result in results if result.packs] == []
    done = finished(results)
    assert len(done) >= BLOCKS // 2
    everything, ground = expected(reader)
    late = rest_of(store, work, [], done)
    assert counts(tiles_of(results, 0), late) == everything
    flagged = counts(tiles_of(results, 1), [])
    assert {tile: count for tile, count in flagged.items() if count} == {
        tile: count for tile, count in ground.items() if (tile[1] // 16, tile[0] // 16) in done
    }


def test_blocks_of_which_points_are_on_disk_are_finished_early_too(tmp_path):
    """The coarse node alone takes most of the memory, so it goes to disk."""
    reader = Octree()
    results, store, work = Run(tmp_path / "run", COARSE + FINE, reader).read()
    packs = [path for result in results for path, _ in result.packs]
    assert packs
    on_disk = {key for path in packs for key in Pack(path).keys}
    done = finished(results)
    assert len(done & on_disk) >= BLOCKS // 2
    assert counts(tiles_of(results, 0), rest_of(store, work, packs, done)) == expected(reader)[0]


@settings(max_examples=30, deadline=None)
@given(points=st.integers(FINE, COARSE + 6 * FINE), most=st.integers(1, 12), again=st.integers(FINE, 8 * FINE))
def test_a_run_that_ends_early_goes_on_without_losing_or_repeating_a_point(tmp_path_factory, points, most, again):
    reader, folder = Octree(), tmp_path_factory.mktemp("runs")
    first, _, _ = Run(folder / "first", points, reader).read(most=most)
    first = [result for result in first if result.in_memory is None]
    done = finished(first)
    spans = sorted((start, stop) for result in first for _, start, stop in result.spans)
    packs = [path for result in first for path, _ in result.packs]
    waiting = {key for path in packs for key in Pack(path).keys} - done
    second, store, work = Run(folder / "second", again, reader).read(spans, done, waiting, None)
    assert not finished(second) & (done | waiting)
    read = [span for result in (*first, *second) for span in result.spans]
    assert sorted(n for _, start, stop in read for n in range(start, stop)) == list(range(BLOCKS + 1))
    done |= finished(second)
    packs += [path for result in second for path, _ in result.packs]
    early = [*tiles_of(first, 0), *tiles_of(second, 0)]
    assert counts(early, rest_of(store, work, packs, done)) == expected(reader)[0]


def test_chunks_whose_blocks_are_finished_count_as_read(tmp_path):
    """Nothing is on disk but tiles, and yet a killed run does not read everything again."""
    first, _, _ = Run(tmp_path / "run", COARSE + 4 * FINE, Octree()).read()
    kept = [span for result in first if result.in_memory is None for span in result.spans]
    assert sum(stop - start for _, start, stop in kept) >= BLOCKS // 2
    assert all(start > 0 for _, start, _ in kept)  # points of the coarse node still wait
