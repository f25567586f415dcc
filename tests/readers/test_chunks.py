"""Chunks: read in any order, at any size, by anyone, they are the file that laspy reads; what is counted on the way."""

import json
from collections import Counter
from functools import reduce

import laspy
import numpy as np
import pytest
from hypothesis import given, strategies as st
from survey_kinds import KINDS, batches_of, table_of, write_kind

from bumpymap.core import BadInputError, UsageError, loops
from bumpymap.readers import LineSums, PointStats, ReadOptions, cell_indices, hash_survey, open_survey, point_stats
from bumpymap.readers.point_stats import LinedPoints
from bumpymap.readers.point_table import convert_points

FORMATS = [("1.2", fmt) for fmt in range(4)] + [("1.3", 4), ("1.3", 5)] + [("1.4", fmt) for fmt in range(11)]
CORNER = np.array([500_000.0, 4_000_000.0, 0.0])
N = 3000
DEEP = {3: 257, 7: 257, 10: 257}  # point formats whose colours have 16 bits here; others have 8 in the same fields


def survey(las, name="a.las", *, version="1.4", fmt=6, count=N, **more):
    """Random points of random classes, some withheld, on 300 m x 300 m x 30 m."""
    rng = np.random.default_rng(count + fmt)
    points = np.round(rng.uniform(0, [300, 300, 30], (count, 3)), 3) + CORNER
    classes = rng.choice(np.array([1, 2, 3, 4, 5, 6, 7, 18], np.uint8), count)
    if "red" in laspy.PointFormat(fmt).dimension_names:
        more |= dict(zip(("red", "green", "blue"), rng.integers(0, 256, (3, count)) * DEEP.get(fmt, 1), strict=True))
    return las.write(
        name, points, version=version, fmt=fmt, classification=classes, withheld=rng.random(count) < 0.1, **more
    )


def oracle(path, unit=1.0):
    """What laspy reads, rounded, in metres: all points, and the kind of those that count; how many are left out."""
    data = laspy.read(path)
    axes = [
        np.round(np.asarray(data[name]) * data.header.scales[i] + data.header.offsets[i], 8) * unit
        for i, name in enumerate("XYZ")
    ]
    class_id, withheld = np.asarray(data.classification), np.asarray(data.withheld).astype(bool)
    noise = ~withheld & np.isin(class_id, (7, 18))
    kinds = np.select([class_id == code for code in (2, 3, 4, 5, 6)], [1, 3, 3, 3, 2])
    dropped = {"withheld": int(withheld.sum()), "noise": int(noise.sum()), "not_a_number": 0}
    return np.column_stack([*axes, kinds]), ~withheld & ~noise, dropped


def check_extent(stats, table):
    """West, south, east, north and greatest height against numpy's, of (n, 3) with NaN left out."""
    low = np.fmin.reduce(table, axis=0, initial=np.inf)
    high = np.fmax.reduce(table, axis=0, initial=-np.inf)
    assert (stats.west, stats.south, stats.east, stats.north) == (*low[:2], *high[:2])
    assert stats.highest == np.fmax.reduce(np.abs(table[:, 2]), initial=0.0)


def joined(found):
    return table_of(batch.cloud for batch in found)


def merged(found):
    return reduce(PointStats.merge, [batch.stats for batch in found], PointStats())


@pytest.mark.parametrize("packing", ["plain", "chunks", "variable"])
@pytest.mark.parametrize(("version", "fmt"), FORMATS)
def test_chunks_are_what_laspy_reads(las, version, fmt, packing):
    path = survey(las, version=version, fmt=fmt, geokeys={1024: 1, 3072: 2276})
    expected, counts, dropped = oracle(path, 1200 / 3937)
    if packing != "plain":
        path = las.pack(path, 256) if packing == "chunks" else las.pack(path, counts=[1, 700, 299, 1500, 500])
    reader = open_survey(path, ReadOptions(colour=True))
    found = batches_of(reader, 700)
    assert np.array_equal(joined(found), expected[counts])
    if reader.has_colour:
        data = laspy.read(path)
        red, green, blue = (np.asarray(data[name], int) // DEEP.get(fmt, 1) for name in ("red", "green", "blue"))
        colours = np.concatenate([batch.points.colour for batch in found])
        np.testing.assert_array_equal(colours, (red << 16 | green << 8 | blue)[counts])
    assert reader.has_colour == (fmt in {2, 3, 5, 7, 8, 10})
    total = merged(found)
    check_extent(total, expected)
    assert total.dropped == dropped
    assert total.points == N
    reader.verify(total)
    chunks = reader.chunks(700)
    assert [chunk.points for chunk in chunks] == [batch.stats.points for batch in found]
    assert [chunk.index for chunk in chunks] == list(range(len(chunks)))
    assert len(chunks) > 3


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("points", [64, 10_000])
def test_any_order_of_chunks_of_any_size_gives_the_same_points(tmp_path, kind, points):
    rng = np.random.default_rng(points)
    path = write_kind(kind, tmp_path, np.round(rng.uniform(0, 100, (400, 3)), 3) + CORNER)
    reader = open_survey(path)
    whole = batches_of(open_survey(path))
    order = rng.permutation(len(reader.chunks(points)))
    mixed = batches_of(reader, points, order)
    assert np.array_equal(joined([mixed[i] for i in np.argsort(order)]), joined(whole))
    assert merged(mixed) == merged(whole)
    reader.verify(merged(mixed))
    assert reader.checksum() == hash_survey(path)


def test_long_points_make_small_chunks_and_are_whole(las):
    """However long a point is, a chunk fits into memory."""
    path = survey(las, count=200)
    expected, data = joined(batches_of(open_survey(path))), path.read_bytes()
    start = int.from_bytes(data[96:100], "little")
    wide = np.zeros((200, 65_000), np.uint8)
    wide[:, :30] = np.frombuffer(data[start:], np.uint8).reshape(200, 30)
    path.write_bytes(data[:start] + wide.tobytes())
    reader = open_survey(las.patch(path, 105, "<H", 65_000))
    assert all(chunk.points * 65_000 <= 1 << 26 for chunk in reader.chunks())
    assert np.array_equal(joined(batches_of(reader)), expected)
    with pytest.raises(UsageError, match="at least 1"):
        reader.chunks(0)
    path.write_bytes(data[:-40])
    with pytest.raises(BadInputError, match="points"):
        batches_of(open_survey(path))


# ---- what is counted of points, and the verdict on a file ----


numbers = st.one_of(st.floats(-150, 150), st.sampled_from([np.nan, np.inf, -np.inf, 1e12, -1e12, 101.0, -1.0, 51.5]))
rows = st.lists(st.tuples(numbers, numbers, numbers, st.sampled_from([0, 1, 2, 7, 18])), max_size=40)


def batch(points, *, first=0):
    x, y, z, class_id = np.array(points, float).reshape(-1, 4).T.copy()
    return convert_points((x, y, z), class_id, first, nan_is_no_return=False, kinds=ReadOptions().kinds)


@given(rows, st.data())
def test_stats_of_parts_add_up_however_they_are_grouped(points, data):
    cut = sorted(data.draw(st.lists(st.integers(0, len(points)), max_size=4)))
    edges = zip([0, *cut], [*cut, len(points)], strict=True)
    parts = [batch(points[low:high], first=low).stats for low, high in edges]
    whole = batch(points).stats
    check_extent(whole, np.array(points, float).reshape(-1, 4))
    assert PointStats.from_record(json.loads(json.dumps(whole.to_record()))) == whole
    mixed = data.draw(st.permutations(parts))
    assert reduce(PointStats.merge, parts, PointStats()) == whole
    assert reduce(lambda total, part: part.merge(total), mixed, PointStats()) == whole
    assert whole.bad == any(part.bad for part in parts)


# ---- sums of flight lines ----


def cloud(n=20_000, side=90.0):
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, side, (2, n)).round(3) + np.array([[-41.0], [4_000_000.0]])
    z = (2_000 + rng.normal(size=n)).round(3)
    return LinedPoints(x, y, z, rng.integers(0, 2, n).astype(np.uint8), rng.integers(0, 3, n).astype(np.uint16))


def by_hand(points):
    """Dict of (column, row, line, ground) to the ten sums, in Python's own integers."""
    found = {}
    for x, y, z, ground, line in zip(*points, strict=True):
        col, row = int(np.floor(x / 3)), int(np.floor(y / 3))
        e, n, u = (int(np.rint(value * 1e4)) for value in (x - col * 3.0, y - row * 3.0, z))
        own = found.setdefault((col, row, int(line), bool(ground)), [0] * 10)
        for place, value in enumerate((1, e, n, u, e * e, e * n, n * n, e * u, n * u, u * u)):
            own[place] += value
    return found


def as_dict(sums):
    rows = sums.rows()
    cols, own = cell_indices(rows[:, 0] >> 17)
    keys = zip(cols, own, rows[:, 0] >> 1 & 0xFFFF, rows[:, 0] & 1 == 1, strict=True)
    return {tuple(key): sums.tolist() for key, sums in zip(keys, rows[:, 1:], strict=True)}


@pytest.mark.parametrize(("points", "side", "least"), [(3_000, 20.0, 1), (4 * loops.SLOTS, 3_000.0, 3 * loops.SLOTS)])
def test_the_sums_are_those_made_by_hand(points, side, least):
    """Also of more cells than the table holds."""
    points = cloud(points, side=side)
    found = as_dict(LineSums.of(points))
    assert found == by_hand(points)
    assert len(found) > least


@pytest.mark.parametrize("most", [50_000, 200, 40])
@pytest.mark.parametrize("seed", [0, 1])
def test_any_chunks_in_any_order_give_the_same_sample(monkeypatch, most, seed):
    """Half of them stored meanwhile."""
    monkeypatch.setattr(point_stats, "MOST_ROWS", most)
    monkeypatch.setattr(point_stats, "_WAITING_ROWS", 2 * most)
    points, rng = cloud(), np.random.default_rng(seed)
    whole = LineSums.of(points).merged()
    assert len(whole.rows()) <= most
    assert (whole.step > 1) == (most < 5_000)
    joined = [LineSums(), LineSums()]
    for number, chosen in enumerate(np.array_split(rng.permutation(len(points.x)), rng.integers(2, 30))):
        part = LinedPoints(*(np.ascontiguousarray(array[chosen]) for array in points))
        joined[number % 2] = joined[number % 2].merge(LineSums.of(part))
    stored = LineSums.from_record(json.loads(json.dumps(joined[0].to_record())))
    again = joined[1].merge(stored).merged()
    assert again.step == whole.step
    assert np.array_equal(again.rows(), whole.rows())


def write(las, fmt, ids, *, source=0):
    path = las.write(version="1.4" if fmt > 5 else "1.2", fmt=fmt)
    content = laspy.read(path)
    content.point_source_id = np.array(ids, np.uint16)
    content.header.file_source_id = source
    content.write(path)
    return path


@pytest.mark.parametrize(
    ("fmt", "packed"),
    [*((fmt, packed) for fmt in (0, 1, 3, 6, 7) for packed in ("las", "laz")), (6, "octree"), (7, "octree")],
)
def test_lines_of_files(las, fmt, packed):
    path = write(las, fmt, [1, 2, 700, 65535, 0, 0, 0], source=9)
    path = {"las": lambda: path, "laz": lambda: las.pack(path, chunk=3), "octree": lambda: las.octree(path)}[packed]()
    reader = open_survey(path, ReadOptions(lines=True))
    assert sum(len(cloud.easting) for cloud in reader.clouds(3)) == 7
    counts = Counter()
    for (_, _, line, _), sums in as_dict(reader.lines).items():
        counts[line] += sums[0]
    assert counts == {1: 1, 2: 1, 700: 1, 65535: 1, 9: 3}
    quiet = open_survey(path)
    list(quiet.clouds())
    assert quiet.lines.size == 0
