import numpy as np
from hypothesis import given, settings, strategies as st

from bumpytiles import Grid, ScaledPoints, Scaling, TileBuckets, group_scaled_points
from bumpytiles._sort_kernels import sort_tiles
from bumpytiles.scaling import coordinate

GRID = Grid(tile_size=3.0)


def survey(seed, n=3000, span=120.0, duplicates=0):
    rng = np.random.default_rng(seed)
    # Centimetre coordinates: many points on tile edges, as in real files.
    x = np.round(rng.uniform(-span / 2, span / 2, n), 2) + 500_000
    y = np.round(rng.uniform(-span / 2, span / 2, n), 2) + 4_000_000
    z = np.round(rng.normal(size=n), 3)
    flag = rng.random(n) < 0.5
    again = rng.integers(0, n, duplicates)
    return tuple(np.concatenate([column, column[again]]) for column in (x, y, z, flag))


def gather(columns, order, cuts):
    """Blocks of a survey that comes in ``order``, in chunks cut at ``cuts``."""
    buckets = TileBuckets(GRID)
    for part in np.split(order, cuts):
        buckets.add(*(column[part] for column in columns))
    return list(buckets.blocks())


def flatten(blocks):
    return [
        tuple(
            getattr(block, name).tobytes() for name in ("col", "row", "starts", "easting", "northing", "upward", "flag")
        )
        for block in blocks
    ]


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000), st.lists(st.integers(0, 3000), max_size=6))
def test_order_and_chunks_of_the_input_change_no_bit(seed, cuts):
    columns = survey(seed)
    expected = flatten(gather(columns, np.arange(3000), []))
    shuffled = np.random.default_rng(seed + 1).permutation(3000)
    assert flatten(gather(columns, shuffled, sorted(cuts))) == expected


def test_every_place_is_in_its_own_tile_once():
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


def test_of_two_points_of_one_place_the_flagged_one_stays():
    x = np.full(2, 1.0)
    for flags, kept in (([1, 0], 1), ([0, 1], 1), ([3, 2], 2), ([0, 3], 3), ([2, 1], 1)):
        buckets = TileBuckets(GRID)
        buckets.add(x, x, x, np.array(flags, np.uint8))
        (block,) = buckets.blocks()
        assert block.flag.tolist() == [kept]


def test_zero_and_minus_zero_are_one_place():
    buckets = TileBuckets(GRID)
    buckets.add(np.array([0.0, -0.0]), np.zeros(2), np.ones(2), np.zeros(2, bool))
    (block,) = buckets.blocks()
    assert block.starts.tolist() == [0, 1]


def test_points_with_one_hash_are_still_put_in_one_order(monkeypatch):
    monkeypatch.setattr("bumpytiles._sort_kernels.hash_point", lambda *_: np.uint64(0))
    monkeypatch.setattr("bumpytiles.grouping.sort_tiles", sort_tiles.plain)
    columns = tuple(column[:300] for column in survey(6, n=250, span=8.0, duplicates=50))
    expected = flatten(gather(columns, np.arange(300), []))
    assert flatten(gather(columns, np.arange(300)[::-1], [50])) == expected
    assert sum(len(b.easting) for b in gather(columns, np.arange(300), [])) == len(set(zip(*columns[:3], strict=True)))


SCALING = Scaling((0.01, 0.001, 0.0005), (500_000.0, -4.0, 123.456), (1.0, 0.3048, 0.9))


def scaled_survey(seed, n=3000, scaling=SCALING):
    rng = np.random.default_rng(seed)
    east, north = rng.integers(-6000, 6000, (2, n))
    return ScaledPoints(
        east.astype(np.int32),
        (20 * north).astype(np.int32),
        rng.integers(-500, 500, n).astype(np.int32),
        rng.random(n) < 0.5,
        scaling,
    )


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000), st.booleans())
def test_points_on_the_grid_of_their_file_give_the_bits_of_points_in_metres(seed, several):
    files = [scaled_survey(seed)]
    if several:
        files.append(
            scaled_survey(seed + 1, 500, Scaling((0.02, -0.005, 0.001), (500_000.0, 0.0, 0.0), (1.0, 1.0, 1.0)))
        )
    scaled, metres = TileBuckets(GRID), TileBuckets(GRID)
    for points in files:
        scaled.add_chunk(group_scaled_points(GRID, points))
        metres.add(*points.coordinates(), points.flag)
    assert flatten(scaled.blocks()) == flatten(metres.blocks())


@given(st.integers(-(1 << 31), (1 << 31) - 1), st.sampled_from([0.01, 0.001, 1e-7, -0.25, 3.0]), st.floats(-1e7, 1e7))
def test_a_coordinate_has_the_bits_of_numpy(integer, scale, offset):
    scaling = Scaling((1.0, scale, 1.0), (0.0, offset, 0.0), (1.0, 0.3048006096, 1.0))
    expected = np.round(np.array([integer]) * scale + offset, 8) * 0.3048006096
    assert coordinate(integer, scaling.numbers(), 1) == expected[0]
    assert scaling.coordinates(1, [integer])[0] == expected[0]
    assert Scaling.of(scaling.numbers().tolist()) == scaling


def test_tiles_with_points_and_with_flagged_points_are_counted():
    buckets = TileBuckets(GRID)
    assert buckets.flagged_share() == 0.0
    buckets.add(np.array([0.5, 1.0, 3.5, 100.0]), np.zeros(4), np.zeros(4), np.array([True, False, False, True]))
    assert buckets.flagged_share() == 2 / 3
    assert np.argwhere(buckets.flags((0, 0))).tolist() == [[0, 0], [0, 1], [1, 0]]
    assert buckets.points((0, 0)) == 3


def test_the_order_is_a_fair_sample():
    # The first tenth of a tile's points must spread like all of them; a sort by coordinate would not.
    rng = np.random.default_rng(8)
    x, y = rng.uniform(0, 3, 20_000), rng.uniform(0, 3, 20_000)
    buckets = TileBuckets(GRID)
    buckets.add(x, y, x * 0.0, np.zeros(20_000, bool))
    (block,) = buckets.blocks()
    first = slice(0, 2000)
    assert abs(block.easting[first].mean() - 1.5) < 4 * 0.866 / 2000**0.5
    assert abs(block.northing[first].mean() - 1.5) < 4 * 0.866 / 2000**0.5
