"""Points to tiles, blocks and packs: in whatever order they came and wherever they wait, the same comes out."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from bumpytiles import (
    BLOCK_TILES,
    Bounds,
    Column,
    Grid,
    MemoryLimits,
    Pack,
    PackError,
    ScaledPoints,
    Scaling,
    TileBuckets,
    TileTable,
    TileWindow,
    TooManyPointsError,
    group_points,
    group_scaled_points,
    run_blocks,
    write_pack,
)

GRID = Grid(tile_size=3.0)


def survey(seed, n=3000, span=120.0, corner=(500_000, 4_000_000), *, duplicates=0):
    rng = np.random.default_rng(seed)
    # Centimetre coordinates: many points on tile edges, as in real files.
    x, y = (np.round(rng.uniform(-span / 2, span / 2, n), 2) + start for start in corner)
    columns = x, y, np.round(rng.normal(size=n), 3), rng.random(n) < 0.4
    again = rng.integers(0, n, duplicates)
    return tuple(np.concatenate([column, column[again]]) for column in columns)


def gather(columns, order, cuts):
    """Blocks of a survey that comes in ``order``, in chunks cut at ``cuts``."""
    buckets = TileBuckets(GRID)
    for part in np.split(order, cuts):
        buckets.add(*(column[part] for column in columns))
    return list(buckets.blocks())


def flatten(blocks):
    names = ("col", "row", "starts", "easting", "northing", "upward", "flag")
    return [tuple(getattr(block, name).tobytes() for name in names) for block in blocks]


@settings(max_examples=25)
@given(st.integers(0, 1000), st.lists(st.integers(0, 3000), max_size=6))
def test_order_and_chunks_of_the_input_change_no_bit(seed, cuts):
    columns = survey(seed)
    expected = flatten(gather(columns, np.arange(3000), []))
    shuffled = np.random.default_rng(seed + 1).permutation(3000)
    assert flatten(gather(columns, shuffled, sorted(cuts))) == expected


def test_every_place_is_in_its_own_tile_once_and_of_two_points_the_flagged_one_stays():
    columns = survey(5, duplicates=500)
    seen = []
    for block in gather(columns, np.random.default_rng(0).permutation(len(columns[0])), [700]):
        points = [block.easting, block.northing, block.upward]
        tile = np.repeat(np.arange(len(block.col)), np.diff(block.starts))
        assert (np.diff(block.starts) > 0).all()
        for axis, index in zip(points, (block.col, block.row), strict=False):
            np.testing.assert_array_equal(np.floor(axis / GRID.tile_size), index[tile])
        seen += zip(*points, strict=True)
    assert sorted(seen) == sorted(set(zip(*columns[:3], strict=True)))
    for flags, kept in (([1, 0], 1), ([0, 1], 1), ([3, 2], 2), ([0, 3], 3), ([2, 1], 1)):
        buckets = TileBuckets(GRID)
        buckets.add(np.array([0.0, -0.0]), np.ones(2), np.ones(2), np.array(flags, np.uint8))
        assert [block.flag.tolist() for block in buckets.blocks()] == [[kept]]


def test_points_with_one_hash_are_still_put_in_one_order():
    """Mirror images in the middle of a tile have one hash: their order is that of the coordinates."""
    one = np.random.default_rng(6).integers(1, 1500, (2, 30)) / 1000
    images = (one, one[::-1])
    x, y = np.concatenate(
        [np.stack([1.5 + i * a, 1.5 + j * b]) for a, b in images for i in (1, -1) for j in (1, -1)], 1
    )
    columns = x, y, np.zeros(len(x)), np.zeros(len(x), bool)
    (block,) = gather(columns, np.arange(len(x)), [])
    assert flatten(gather(columns, np.random.default_rng(7).permutation(len(x)), [50])) == flatten([block])
    places = np.stack([block.easting, block.northing], 1)
    alike = np.sort(np.abs(np.rint((places - 1.5) * 1e3)), axis=1)
    runs = np.split(places, np.flatnonzero((np.diff(alike, axis=0) != 0).any(1)) + 1)
    assert len(runs) == len({tuple(pair) for pair in alike.tolist()}) < len(places)
    assert all(sorted(run) == run for run in ([tuple(place) for place in part] for part in runs))


SCALING = Scaling((0.01, 0.001, 0.0005), (500_000.0, -4.0, 123.456), (1.0, 0.3048, 0.9))


def scaled_survey(seed, n=3000, scaling=SCALING):
    rng = np.random.default_rng(seed)
    east, north = rng.integers(-6000, 6000, (2, n))
    words = (axis.astype(np.int32) for axis in (east, 20 * north, rng.integers(-500, 500, n)))
    return ScaledPoints(*words, rng.random(n) < 0.5, scaling)


@settings(max_examples=25)
@given(st.integers(0, 1000), st.booleans())
def test_points_on_the_grid_of_their_file_give_the_bits_of_points_in_metres(seed, several):
    other = Scaling((0.02, -0.005, 0.001), (500_000.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    files = [scaled_survey(seed), *[scaled_survey(seed + 1, 500, other)] * several]
    scaled, metres = TileBuckets(GRID), TileBuckets(GRID)
    for points in files:
        scaled.add_chunk(group_scaled_points(GRID, points))
        metres.add(*points.coordinates(), points.flag)
    assert flatten(scaled.blocks()) == flatten(metres.blocks())


@given(st.integers(-(1 << 31), (1 << 31) - 1), st.sampled_from([0.01, 0.001, 1e-7, -0.25, 3.0]), st.floats(-1e7, 1e7))
def test_a_coordinate_has_the_bits_of_numpy(integer, scale, offset):
    scaling = Scaling((1.0, scale, 1.0), (0.0, offset, 0.0), (1.0, 0.3048006096, 1.0))
    expected = np.round(np.array([integer]) * scale + offset, 8) * 0.3048006096
    buckets, axis = TileBuckets(GRID), np.array([integer], np.int32)
    buckets.add_chunk(group_scaled_points(GRID, ScaledPoints(axis * 0, axis, axis * 0, axis.astype(np.uint8), scaling)))
    assert [block.northing.tolist() for block in buckets.blocks()] == [expected.tolist()]
    assert scaling.coordinates(1, [integer])[0] == expected[0]
    assert Scaling.of(scaling.numbers().tolist()) == scaling


def test_the_flags_that_the_points_of_tiles_have_are_known():
    buckets = TileBuckets(GRID)
    buckets.add(np.array([0.5, 1.0, 3.5, 100.0]), np.zeros(4), np.zeros(4), np.array([True, False, False, True]))
    assert np.argwhere(buckets.flags((0, 0))).tolist() == [[0, 0], [0, 1], [1, 0]]
    assert buckets.points((0, 0)) == 3


# ---- whatever waits in memory or on disk ----


def chunks(columns, size):
    return [tuple(column[start : start + size] for column in columns) for start in range(0, len(columns[0]), size)]


def flat(blocks):
    """Tiles and their points as bytes; a block may come in shares."""
    found = []
    for block in blocks:
        columns = (block.easting, block.northing, block.upward, block.flag)
        for col, row, start, end in zip(block.col, block.row, block.starts, block.starts[1:], strict=False):
            found.append((int(col), int(row), *(column[start:end].tobytes() for column in columns)))
    return sorted(found)


def in_memory(columns):
    return flat(gather(columns, np.arange(len(columns[0])), []))


@settings(max_examples=10)
@given(st.integers(0, 99), st.integers(20, 900), st.integers(20, 3000), st.integers(40, 3000))
def test_spilled_or_not_the_same_points_come_out(tmp_path_factory, seed, size, points, block_points):
    columns = survey(seed, 2000, 150.0)
    scratch = tmp_path_factory.mktemp("scratch")
    buckets = TileBuckets(GRID, MemoryLimits(26 * points, block_points, scratch))
    for lot, chunk in enumerate(chunks(columns, size)):
        buckets.add_chunk(group_points(GRID, *chunk), lot)
        if buckets.is_full:
            buckets.spill()
    assert flat(buckets.blocks()) == in_memory(columns)
    if points < 2000 - size:
        assert list(scratch.iterdir())


def test_complete_blocks_are_finished_instead_of_spilled(tmp_path):
    west, east = survey(4, 400, 40.0, (0, 0)), survey(5, 800, 40.0, (480, 0))
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
    buckets = TileBuckets(GRID, MemoryLimits(26 * 100, 400, tmp_path))
    buckets.add(np.linspace(0, 2.9, 500), *np.zeros((2, 500)), np.zeros(500, bool))
    with pytest.raises(TooManyPointsError, match=r"tile \(0, 0\) holds 500 points"):
        list(buckets.blocks())


def test_points_far_apart_are_grouped_too():
    x, y = np.random.default_rng(0).uniform(-2e9, 2e9, (2, 50))
    grouped = group_points(GRID, x, y, np.arange(50.0), np.zeros(50, bool))
    assert grouped.keys == sorted(grouped.keys)
    for place, key in enumerate(grouped.keys):
        part = grouped.block(place, ("northing", "easting"))
        for name, number in zip(("northing", "easting"), key, strict=True):
            assert np.all(GRID.index(part.columns[name]) // 16 == number)
    assert sorted(grouped.points["upward"].tolist()) == list(range(50))


# ---- the grid ----

coordinates = st.floats(-2e7, 2e7, allow_nan=False)
sizes = st.one_of(st.sampled_from([0.1, 0.3, 0.9, 1.5, 3.0, 1 / 3]), st.floats(0.05, 1000.0))


@given(coordinates, sizes)
def test_every_coordinate_lies_in_the_half_open_bounds_of_its_tile(coordinate, size):
    """What lies so little below a border that rounding may have put it there is on it."""
    grid = Grid(tile_size=size)
    (i,) = grid.index(np.array([coordinate]))
    bounds = grid.bounds(int(i), int(i))
    assert bounds.west - 5.01e-9 <= coordinate < bounds.east
    assert bounds.south - 5.01e-9 <= coordinate < bounds.north
    borders = np.array([bounds.west, np.nextafter(bounds.west, -np.inf), bounds.west - 1e-8])
    assert grid.index(borders).tolist() == [i, i, i - 1]
    assert grid.pixel(borders, grid.index(borders)).tolist() == [0, 0, grid.pixels - 1]


def test_bounds_of_a_tile_and_of_a_window_and_grids_that_cannot_be():
    grid = Grid(tile_size=3.0, pixels=15)
    assert grid.bounds(2, -1) == Bounds(6.0, -3.0, 9.0, 0.0)
    window = TileWindow.around(np.array([2, 4]), np.array([-1, 0]))
    assert window == TileWindow(2, -1, 3, 2)
    assert grid.window_bounds(window) == Bounds(6.0, -3.0, 15.0, 3.0)
    assert grid.pixel_size == pytest.approx(0.2)
    for size, pixels in ((0.0, 15), (-3.0, 15), (np.nan, 15), (np.inf, 15), (3.0, 0)):
        with pytest.raises(ValueError, match="must be"):
            Grid(tile_size=size, pixels=pixels)


# ---- running over blocks ----


def test_results_come_in_the_order_of_the_blocks_which_are_drawn_lazily_until_one_fails():
    for workers in (1, 2, 5):
        assert list(run_blocks(math.factorial, range(50), workers)) == [math.factorial(x) for x in range(50)]
    drawn = iter(range(100))
    results = run_blocks(math.factorial, drawn, 2)
    next(results)
    assert next(drawn) <= 5
    results.close()

    def fail_at_three(x):
        started.append(x)
        if x == 3:
            raise RuntimeError("three")

    started = []
    with pytest.raises(RuntimeError, match="three"):
        list(run_blocks(fail_at_three, range(1000), 2))
    assert len(started) < 20


# ---- packs and tables of tiles ----


COLUMNS = (Column("col", "<i8"), Column("row", "<i8"), Column("value", "<f4", (2,)))


def write(path, blocks, meta=None):
    rows = {key: len(columns["col"]) for key, columns in blocks.items()}
    write_pack(path, COLUMNS, rows, lambda column: [block[column.name] for block in blocks.values()], meta or {})
    return Pack(path)


def columns_of(tiles):
    col, row = np.array(tiles, dtype=np.int64).reshape(-1, 2).T
    return {"col": col, "row": row, "value": np.stack([col, row], axis=1).astype(np.float32)}


@pytest.fixture
def pack(tmp_path):
    return write(tmp_path / "a.pack", {(0, 0): columns_of([(1, 2), (3, 4)]), (-1, 2): columns_of([(33, -5)])}, {"n": 3})


def test_blocks_are_read_together_in_any_order_from_any_packs(tmp_path):
    rng = np.random.default_rng(1)
    sizes = [1, 2, 300, 1, 1, 0, 3, 40, 1, 2, 5, 1]
    blocks = {(n // 4 - 1, n % 4 - 2): columns_of(rng.integers(0, 99, (size, 2))) for n, size in enumerate(sizes)}
    packs = [write(tmp_path / str(first), dict(list(blocks.items())[first::3])) for first in range(3)]
    table, full = TileTable(Grid(), packs), [key for key in blocks if len(blocks[key]["col"])]
    for number in range(20):
        keys = [full[n] for n in rng.permutation(len(full))[: 1 + number]]
        for names in (["row", "value"], ["col"]):
            found = table.read_blocks(keys, names)
            assert list(found) == names
            for name in names:
                np.testing.assert_array_equal(found[name], np.concatenate([blocks[key][name] for key in keys]))


def test_added_columns_join_those_that_are_there_and_take_the_place_of_their_names(tmp_path):
    table = TileTable.of(Grid(), columns_of([(1, 2), (3, 4), (33, -5)]))
    more = (Column("value", "<i8"), Column("own", "|u1"))
    own = {"value": np.array([5, 6, 7]), "own": np.array([1, 2, 3])}
    write_pack(tmp_path / "b", more, {(-1, 2): 1, (0, 0): 2}, lambda column: [own[column.name]], {})
    found = table.with_columns([Pack(tmp_path / "b")]).read(["own", "value"])
    assert {name: values.tolist() for name, values in found.items()} == {
        "col": [3, 1, 33], "row": [4, 2, -5], "own": [3, 2, 1], "value": [7, 6, 5],
    }  # fmt: skip


def test_a_pack_appears_whole_or_not_at_all_and_damaged_it_is_refused(tmp_path, pack):
    columns = columns_of([(1, 2)])
    with pytest.raises(ValueError, match="rows need"):
        write_pack(tmp_path / "b", COLUMNS, {(0, 0): 5}, lambda column: [columns[column.name]], {})
    assert list(tmp_path.iterdir()) == [pack.path]
    content = pack.path.read_bytes()
    flipped = bytearray(content)
    flipped[-60] ^= 1
    for damaged in (b"", *(content[:keep] for keep in (4, 30, -1, -9, -40)), flipped):
        pack.path.write_bytes(damaged)
        with pytest.raises(PackError):
            Pack(pack.path)


tiles = st.sets(st.tuples(st.integers(-40, 40), st.integers(-40, 40)), min_size=1, max_size=60)


@given(tiles, st.integers(-45, 45), st.integers(-45, 45), st.integers(1, 60), st.integers(1, 60), st.integers(1, 600))
def test_a_window_and_its_strips_hold_each_of_its_tiles_once(chosen, col, row, cols, rows, most):
    table = TileTable.of(Grid(), columns_of(sorted(chosen)))
    assert table.tiles == len(chosen)
    assert table.window == TileWindow.around(*np.array(sorted(chosen)).T)
    window = TileWindow(col, row, cols, rows)
    inside = [(c, r) for c, r in chosen if col <= c < col + cols and row <= r < row + rows]
    expected = sorted(inside, key=lambda tile: (-tile[1], tile[0]))
    found = table.read(["value"], window)
    assert list(zip(found["col"].tolist(), found["row"].tolist(), strict=True)) == expected
    assert found["value"].tolist() == [list(tile) for tile in expected]
    held, corners = [], []
    for strip in table.strips(most, window):
        found = table.read([], strip)
        here = list(zip(found["col"].tolist(), found["row"].tolist(), strict=True))
        held += here
        corners.append((-strip.row, strip.col))
        assert len(here) <= most or len({(c // BLOCK_TILES, r // BLOCK_TILES) for c, r in here}) == 1
    assert corners == sorted(corners)
    assert sorted(held) == sorted(inside)
    assert table.holds(window) >= bool(held)


def test_blocks_without_tiles_do_not_count_and_the_same_tile_twice_is_refused(tmp_path):
    table = TileTable(Grid(), [write(tmp_path / "a", {(0, 0): columns_of([(1, 2)]), (9, 9): columns_of([])})])
    assert table.window == TileWindow(1, 2, 1, 1)
    assert not table.holds(TileWindow(144, 144, 16, 16))
    with pytest.raises(ValueError, match="same tile"):
        TileTable.of(Grid(), columns_of([(1, 4), (2, 4), (1, 4)])).read([])
