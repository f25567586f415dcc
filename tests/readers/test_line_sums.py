"""Sums of flight lines: against sums by hand, however the points come, and from files."""

import json

import laspy
import numpy as np
import pytest

from bumpymap.readers import LineCorrection, LineSums, ReadOptions, cell_indices, open_survey, point_stats
from bumpymap.readers._kernels import SLOTS, LinedPoints


def cloud(n=20_000, side=90.0, lines=3, seed=0, corner=(-41.0, 4_000_000.0)):
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, side, (2, n)).round(3) + np.array(corner)[:, None]
    z = (2_000 + rng.normal(size=n)).round(3)
    return LinedPoints(x, y, z, rng.integers(0, 2, n).astype(np.uint8), rng.integers(0, lines, n).astype(np.uint16))


def part(points, chosen):
    return LinedPoints(*(np.ascontiguousarray(array[chosen]) for array in points))


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


def test_the_sums_are_those_made_by_hand():
    points = cloud(3_000, side=20.0)
    assert as_dict(LineSums.of(points)) == by_hand(points)


def test_more_cells_than_the_table_holds():
    points = cloud(4 * SLOTS, side=3_000.0)
    found = as_dict(LineSums.of(points))
    assert found == by_hand(points)
    assert len(found) > 3 * SLOTS


@pytest.mark.parametrize("most", [50_000, 200, 40])
@pytest.mark.parametrize("seed", [0, 1])
def test_any_chunks_in_any_order_give_the_same_sample(monkeypatch, most, seed):
    monkeypatch.setattr(point_stats, "MOST_ROWS", most)
    monkeypatch.setattr(point_stats, "_WAITING_ROWS", 2 * most)
    points, rng = cloud(), np.random.default_rng(seed)
    whole = LineSums.of(points).merged()
    assert len(whole.rows()) <= most
    assert (whole.step > 1) == (most < 5_000)
    chunks = np.array_split(rng.permutation(len(points.x)), rng.integers(2, 30))
    joined = [LineSums(), LineSums()]
    for number, chosen in enumerate(chunks):
        joined[number % 2] = joined[number % 2].merge(LineSums.of(part(points, chosen)))
    again = joined[1].merge(joined[0]).merged()
    assert again.step == whole.step
    assert np.array_equal(again.rows(), whole.rows())


def test_sums_survive_storing():
    sums = LineSums.of(cloud())
    again = LineSums.from_record(json.loads(json.dumps(sums.to_record())))
    assert np.array_equal(again.rows(), sums.rows())
    empty = LineSums.from_record(LineSums().to_record())
    assert len(empty.rows()) == 0


def write(las, fmt, ids, *, source=0, name="a.las", scale=0.001):
    path = las.write(name=name, version="1.4" if fmt > 5 else "1.2", fmt=fmt, scale=scale)
    with laspy.open(path) as file:
        content = file.read()
    content.point_source_id = np.array(ids, np.uint16)
    content.header.file_source_id = source
    content.write(path)
    return path


@pytest.mark.parametrize(
    ("fmt", "packed"),
    [*((fmt, packed) for fmt in (0, 1, 3, 6, 7) for packed in ("las", "laz")), (6, "octree"), (7, "octree")],
)
def test_lines_of_files(las, laz, fmt, packed):
    ids = [1, 2, 700, 65535, 0, 0, 0]
    path = write(las, fmt, ids, source=9)
    path = {"las": lambda: path, "laz": lambda: laz.pack(path, chunk=3), "octree": lambda: laz.octree(path)}[packed]()
    reader = open_survey(path, ReadOptions(lines=True))
    clouds = list(reader.clouds(3))
    assert sum(len(own.easting) for own in clouds) == 7
    counts = {}
    for (_, _, line, _), sums in as_dict(reader.lines).items():
        counts[line] = counts.get(line, 0) + sums[0]
    assert counts == {1: 1, 2: 1, 700: 1, 65535: 1, 9: 3}
    quiet = open_survey(path)
    list(quiet.clouds())
    assert quiet.lines.size == 0


def test_corrections_are_subtracted_in_metres(las):
    path = write(las, 1, [1, 1, 2, 2, 3, 3, 3])
    corrections = (
        LineCorrection(1, 0.25, 500_000.0, 4_000_000.0, 0.1, 0.0),
        LineCorrection(3, -1.0, 0.0, 0.0, 0.0, 0.0),
    )
    options = ReadOptions(crs="EPSG:2276", z_unit="us-ft")
    (plain,) = open_survey(path, options).clouds()
    options = ReadOptions(crs="EPSG:2276", z_unit="us-ft", corrections=corrections)
    (corrected,) = open_survey(path, options).clouds()
    taken = plain.upward - corrected.upward
    slope = 0.1 * (plain.easting[:2] - 500_000)
    assert np.allclose(taken, [*(0.25 + slope), 0, 0, -1, -1, -1], atol=1e-9)
    assert np.array_equal(plain.easting, corrected.easting)
