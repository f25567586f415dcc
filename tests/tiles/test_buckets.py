"""Whatever waits in memory or on disk, and in whatever order it came: the same blocks come out."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from bumpytiles import (
    Grid,
    MemoryLimits,
    Pack,
    ScaledPoints,
    Scaling,
    TileBuckets,
    TooManyPointsError,
    group_points,
    group_scaled_points,
)

GRID = Grid(3.0)


def survey(seed, n=2000, span=150.0):
    rng = np.random.default_rng(seed)
    xyz = [np.round(rng.uniform(-span / 2, span / 2, n), 2) for _ in range(3)]
    return (*xyz, rng.random(n) < 0.3)


def chunks(columns, size):
    for start in range(0, len(columns[0]), size):
        yield tuple(column[start : start + size] for column in columns)


def flat(blocks):
    """Tiles and their points as bytes; a block may come in shares."""
    found = []
    for block in blocks:
        for t in range(len(block.col)):
            span = slice(block.starts[t], block.starts[t + 1])
            points = (block.easting[span], block.northing[span], block.upward[span], block.flag[span])
            found.append((int(block.col[t]), int(block.row[t]), *(array.tobytes() for array in points)))
    return sorted(found)


def in_memory(columns):
    buckets = TileBuckets(GRID)
    buckets.add(*columns)
    return flat(buckets.blocks())


@settings(max_examples=20)
@given(st.integers(0, 99), st.integers(20, 900), st.integers(20, 3000), st.integers(40, 3000))
def test_spilled_or_not_the_same_points_come_out(tmp_path_factory, seed, size, points, block_points):
    columns = survey(seed)
    scratch = tmp_path_factory.mktemp("scratch")
    buckets = TileBuckets(GRID, MemoryLimits(26 * points, block_points, scratch))
    for lot, chunk in enumerate(chunks(columns, size)):
        buckets.add_chunk(group_points(GRID, *chunk), lot)
        if buckets.is_full:
            buckets.spill()
    assert flat(buckets.blocks()) == in_memory(columns)
    if points < 2000 - size:
        assert list(scratch.iterdir())


@pytest.mark.parametrize(("offsets", "together"), [((0.0, 7.5), True), ((0.0, 7.5), False)])
def test_points_on_grids_of_files_can_be_spilled(tmp_path, offsets, together):
    """As integers, but in metres if those of several files must stay together."""
    buckets, plain = TileBuckets(GRID, MemoryLimits(14 * 500, 10_000, tmp_path)), TileBuckets(GRID)
    for number, offset in enumerate(offsets):
        rng = np.random.default_rng(number)
        x, y, z = rng.integers(-7000, 7000, (3, 1000)).astype(np.int32)
        scaling = Scaling((0.01,) * 3, (offset,) * 3, (1.0,) * 3)
        points = ScaledPoints(x, y, z, rng.random(1000) < 0.3, scaling)
        buckets.add_chunk(group_scaled_points(GRID, points), 0 if together else number)
        plain.add(*points.coordinates(), points.flag)
    while not buckets.is_empty:
        buckets.spill()
    buckets.wait()
    assert len(buckets.packs) == (1 if together else 2)
    assert {column.dtype for pack in buckets.packs for column in pack.columns[:3]} == {"<f8" if together else "<i4"}
    again = TileBuckets(GRID, packs=[Pack(pack.path) for pack in buckets.packs])
    assert flat(again.blocks()) == flat(plain.blocks())


def test_complete_blocks_are_finished_instead_of_spilled(tmp_path):
    west, east = survey(4, 400, 40.0), survey(5, 800, 40.0)
    east = (east[0] + 480.0, *east[1:])
    buckets = TileBuckets(GRID, MemoryLimits(26 * 500, 10_000, tmp_path))
    finished = []
    for number, chunk in enumerate([*chunks(west, 100), *chunks(east, 100)]):
        buckets.add_chunk(group_points(GRID, *chunk), number)
        if buckets.is_full:
            for key in [key for key in buckets.keys_in_memory() if key[1] < 5]:  # the west is read
                finished.extend(flat(buckets.block(key)))
                buckets.finish(key)
            buckets.compact()
            if buckets.must_spill:
                buckets.spill()
    assert sorted(finished) == in_memory(west)
    buckets.wait()  # packs are written in the background
    assert list(tmp_path.iterdir())  # of the east, some must wait
    for key in list(buckets.keys()):
        finished.extend(flat(buckets.block(key)))
        buckets.finish(key)
    assert sorted(finished) == sorted(in_memory(west) + in_memory(east))
    assert buckets.is_empty
    assert buckets.keys() == []


def test_one_tile_too_large_for_memory_says_so(tmp_path):
    n = 500
    buckets = TileBuckets(GRID, MemoryLimits(26 * 100, 400, tmp_path))
    buckets.add(np.linspace(0, 2.9, n), np.zeros(n), np.zeros(n), np.zeros(n, bool))
    with pytest.raises(TooManyPointsError, match=r"tile \(0, 0\) holds 500 points"):
        list(buckets.blocks())


def test_points_far_apart_are_grouped_too():
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-2e9, 2e9, (2, 50))
    grouped = group_points(GRID, x, y, np.arange(50.0), np.zeros(50, bool))
    assert grouped.keys == sorted(grouped.keys)
    for place, (row, col) in enumerate(grouped.keys):
        part = grouped.block(place, ("easting", "northing"))
        assert np.all(GRID.index(part.columns["easting"]) // 16 == col)
        assert np.all(GRID.index(part.columns["northing"]) // 16 == row)
    assert sorted(grouped.points["upward"].tolist()) == list(range(50))
