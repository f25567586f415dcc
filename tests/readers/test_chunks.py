"""Pieces: read in any order, at any size, by anyone, they are the file that laspy reads."""

import subprocess
import sys

import laspy
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from survey_kinds import KINDS, write_kind

from bumpymap.core.errors import BadInputError, UsageError
from bumpymap.readers import Chunk, PointStats, ReadOptions, open_survey, reopen_survey
from bumpymap.readers.las import convert_records, record_rules
from bumpymap.readers.point_stats import OUTSIDE, LineRules
from bumpytiles import Bounds, Scaling

FORMATS = [("1.2", fmt) for fmt in range(4)] + [("1.3", 4), ("1.3", 5)] + [("1.4", fmt) for fmt in range(11)]
CORNER = np.array([500_000.0, 4_000_000.0, 0.0])
N = 3000


def survey(las, name="a.las", *, version="1.4", fmt=6, count=N, **more):
    """Random points of random classes, some withheld, on 300 m x 300 m x 30 m."""
    rng = np.random.default_rng(count + fmt)
    points = np.round(rng.uniform(0, [300, 300, 30], (count, 3)), 3) + CORNER
    classes = rng.choice(np.array([1, 2, 5, 7, 18], np.uint8), count)
    return las.write(name, points, version=version, fmt=fmt, classes=classes, withheld=rng.random(count) < 0.1, **more)


def oracle(path, unit=1.0):
    """What laspy reads, rounded, in metres; points that count alone."""
    data = laspy.read(path)
    axes = [
        np.round(np.asarray(data[name]) * data.header.scales[i] + data.header.offsets[i], 8) * unit
        for i, name in enumerate("XYZ")
    ]
    class_id, withheld = np.asarray(data.classification), np.asarray(data.withheld).astype(bool)
    keep = ~withheld & (class_id != 7) & (class_id != 18)
    return np.column_stack([*axes, class_id == 2])[keep], {
        "withheld": int(withheld.sum()),
        "noise": int((~withheld & ((class_id == 7) | (class_id == 18))).sum()),
        "not_a_number": 0,
    }


def merged(found):
    total = PointStats()
    for batch in found:
        total = total.merge(batch.stats)
    return total


def in_order(points):
    return points[np.lexsort(points.T)]


PACKINGS = [(*made, packing) for made in FORMATS for packing in ("plain", "chunks", "variable")]


@pytest.mark.parametrize(("version", "fmt", "packing"), PACKINGS)
def test_chunks_are_what_laspy_reads(las, laz, batches, table, version, fmt, packing):
    path = survey(las, version=version, fmt=fmt, geokeys={1024: 1, 3072: 2276})
    expected, dropped = oracle(path, 1200 / 3937)
    if packing != "plain":
        path = laz.pack(path, 256) if packing == "chunks" else laz.pack(path, counts=[1, 700, 299, 1500, 500])
    reader = open_survey(path)
    found = batches(reader, 700)
    assert np.array_equal(table(found), expected)
    total = merged(found)
    assert total.dropped == dropped
    assert total.points == N
    reader.verify(total)
    chunks = reader.chunks(700)
    assert [chunk.points for chunk in chunks] == [batch.stats.points for batch in found]
    assert [chunk.index for chunk in chunks] == list(range(len(chunks)))
    assert len(chunks) > 3


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_any_order_of_chunks_of_any_size_gives_the_same_points(tmp_path, batches, table, kind):
    rows = np.round(np.random.default_rng(5).uniform(0, 100, (400, 3)), 3) + CORNER
    reader = open_survey(write_kind(kind, tmp_path, rows))
    whole = batches(reader)
    rng = np.random.default_rng(1)
    for points in (1, 64, 399, 10_000):
        order = rng.permutation(len(reader.chunks(points)))
        mixed = batches(reader, points, order)
        if kind != "copc":  # its nodes come as they stand in the file, inside a chunk
            assert np.array_equal(table([mixed[i] for i in np.argsort(order)]), table(whole))
        assert np.array_equal(in_order(table(mixed)), in_order(table(whole)))
        assert merged(mixed) == merged(whole)
        back = batches(reader, points, np.argsort(order)[::-1])
        assert np.array_equal(in_order(table(back)), in_order(table(whole)))


def test_a_piece_of_no_points(las):
    with pytest.raises(UsageError, match="at least 1"):
        open_survey(las.write()).chunks(0)


def test_long_points_make_small_chunks(las, laz, batches, table):
    """However long a point is, a chunk fits into memory."""
    path = survey(las, count=200)
    data = bytearray(path.read_bytes())
    las.patch(path, 105, "<H", 65_000)
    start = int.from_bytes(data[96:100], "little")
    rows = np.frombuffer(data[start:], np.uint8).reshape(200, 30)
    wide = np.zeros((200, 65_000), np.uint8)
    wide[:, :30] = rows
    path.write_bytes(path.read_bytes()[:start] + wide.tobytes())
    reader = open_survey(path)
    chunks = reader.chunks()
    assert all(chunk.points * 65_000 <= 1 << 26 for chunk in chunks)
    small = survey(las, "b.las", count=200)
    assert np.array_equal(table(batches(reader)), table(batches(open_survey(small))))


@pytest.mark.parametrize("piece", [7, 100, 4096])
def test_records_that_reads_cut_are_whole_again(las, batches, table, monkeypatch, piece):
    path = survey(las)
    expected = table(batches(open_survey(path)))
    monkeypatch.setattr("bumpymap.readers.las._PIECE_BYTES", piece)
    assert np.array_equal(table(batches(open_survey(path))), expected)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) - 40])
    with pytest.raises(BadInputError, match="points"):
        batches(open_survey(path))


@settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    integers=st.lists(st.tuples(*[st.integers(-(2**31), 2**31 - 1)] * 3), min_size=1, max_size=9),
    scale=st.floats(1e-7, 1.0) | st.floats(-1.0, -1e-7),
    offset=st.floats(-1e7, 1e7),
    unit=st.sampled_from([1.0, 0.3048, 1200 / 3937]),
    marks=st.lists(st.tuples(st.sampled_from([0, 2, 7, 18]), st.sampled_from([0, 4])), min_size=9, max_size=9),
    sides=st.none() | st.tuples(*[st.integers(-(2**31), 2**31 - 1)] * 4),
    cut=st.integers(0, 9),
)
def test_records_are_what_numpy_makes_of_them(integers, scale, offset, unit, marks, sides, cut):
    words = np.array(integers, "<i4")
    records = np.zeros((len(words), 30), np.uint8)
    records[:, :12] = words.view(np.uint8)
    records[:, 16], records[:, 15] = np.array(marks)[: len(words)].T
    scaling = Scaling((scale,) * 3, (offset,) * 3, (unit,) * 3)
    expected = np.round(words * np.float64(scale) + offset, 8) * unit
    box = None if sides is None else Bounds(*(np.round(np.array(sides) * scale + offset, 8) * unit).tolist())
    pieces = (records[:cut], records[cut:])
    rules = record_rules(layered=True, line=0, scaling=scaling, bounds=box, kinds=ReadOptions().kinds)
    lines = LineRules(measure=False, corrections=())
    batch = convert_records(pieces, Chunk(0, 5, len(words)), rules, scaling, lines)
    stats = batch.stats
    assert stats.points == len(words)
    x, y, z = expected.T
    assert (stats.west, stats.south, stats.east, stats.north) == (x.min(), y.min(), x.max(), y.max())
    assert stats.highest == np.abs(z).max()
    if box is not None:
        away = (
            (x < box.west - OUTSIDE) | (x > box.east + OUTSIDE) | (y < box.south - OUTSIDE) | (y > box.north + OUTSIDE)
        )
        assert stats.outside == away.sum()
    withheld, noise = records[:, 15] == 4, np.isin(records[:, 16], (7, 18))
    assert (stats.withheld, stats.noise) == (withheld.sum(), (noise & ~withheld).sum())
    kept = ~(withheld | noise) & (not stats.bad)
    cloud = batch.cloud
    assert np.array_equal(np.column_stack([cloud.easting, cloud.northing, cloud.upward]), expected[kept])
    kinds = np.select([records[kept, 16] == code for code in (2, 3, 4, 5, 6)], [1, 3, 3, 3, 2])
    assert np.array_equal(cloud.kind, kinds)


def test_workers_open_a_file_again_without_its_notes(las, caplog):
    path = las.write(points=np.array([[-99.1, 19.4, 10.0]]), scale=1e-7, offset=(0, 0, 0))
    noted = open_survey(path)
    assert "degrees" in caplog.text
    caplog.clear()
    again = reopen_survey(path, ReadOptions())
    assert not caplog.text
    assert again.info == noted.info
    assert again.chunks() == noted.chunks()


def test_las_loads_no_library_that_it_does_not_need(las):
    path = las.write("a.laz")
    code = (
        "import sys; from pathlib import Path; from bumpymap.readers import open_survey\n"
        "reader = open_survey(Path(sys.argv[1])); chunk = reader.chunks()[0]\n"
        "print(reader.convert(chunk, reader.fetch(chunk)).stats.points)\n"
        "print({'laspy', 'fsspec', 'pypcd4'} & set(sys.modules))"
    )
    run = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["7", "set()"]
