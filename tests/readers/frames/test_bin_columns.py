"""The number of columns of a .bin scan is told from its values: never wrong, and in doubt asked for."""

from pathlib import Path

import numpy as np
import pytest

from bumpymap.core import BadInputError, UsageError
from bumpymap.readers import read_scan
from bumpymap.readers.frames.kitti import find_columns

FILE = Path("a.bin")


def street(lines, columns, seed):
    """A made-up scan of a street, line by line: x, y, z, intensity, ring, time; (0, 0, 0) without a return."""
    rng = np.random.default_rng(seed)
    elevation = np.radians(np.linspace(rng.uniform(-30, -10), rng.uniform(2, 20), lines))[:, None]
    azimuth = np.linspace(-np.pi, np.pi, columns, endpoint=False)[None, :]
    wall = 6.0 + 8.0 * rng.uniform() + 3.0 * np.sign(np.sin(azimuth * rng.integers(3, 9)))
    ground = rng.uniform(0.5, 2.0) / np.maximum(np.tan(-elevation), 1e-3)
    reach = np.minimum(ground, wall / np.maximum(np.abs(np.sin(azimuth)), 0.05))
    reach = np.broadcast_to(reach, (lines, columns)) + rng.normal(scale=0.02, size=(lines, columns))
    flat = reach * np.cos(elevation)
    points = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), reach * np.sin(elevation)], axis=-1)
    points[(reach > 90.0) | (rng.uniform(size=reach.shape) < 0.05)] = 0.0
    rest = [
        rng.uniform(0.1, 0.4) + 0.1 * rng.uniform(size=reach.shape),
        np.broadcast_to(np.arange(lines)[:, None], reach.shape),
        np.broadcast_to((azimuth + np.pi) * 0.1 / (2 * np.pi), reach.shape),
    ]
    return np.concatenate([points, np.stack(rest, axis=-1)], axis=-1).astype(np.float32)


def seen(rows):
    return rows[(rows[:, :3] != 0.0).any(axis=1)]


def shuffled(grid):
    rows = seen(grid.reshape(-1, 6))
    return rows[np.random.default_rng(1).permutation(len(rows))]


def as_bytes(grid):
    rows = seen(grid.reshape(-1, 6)).copy()
    rows[:, 3] = np.rint(rows[:, 3] * 255)
    return rows


def with_nan(grid):
    rows = grid.reshape(-1, 6).copy()
    rows[(rows[:, :3] == 0.0).all(axis=1), :3] = np.nan
    return rows


def paired(grid):
    """Firing by firing: a low and a high line in turn."""
    half = len(grid) // 2
    order = np.column_stack([np.arange(half), np.arange(half) + half]).ravel()
    return seen(grid[order].transpose(1, 0, 2).reshape(-1, 6))


def ahead(grid):
    """70 degrees, as of a solid-state sensor; (0, 0, 0) without a return."""
    rows = grid.reshape(-1, 6)
    return rows[np.abs(rows[:, 5] - 0.05) < 0.01]


ORDERS = {
    "organised": lambda grid: grid.reshape(-1, 6),
    "returns": lambda grid: seen(grid.reshape(-1, 6)),
    "by azimuth": lambda grid: grid.transpose(1, 0, 2).reshape(-1, 6),
    "paired": paired,
    "ahead": ahead,
    "shuffled": shuffled,
    "bytes": as_bytes,
    "nan": with_nan,
    "thin": lambda grid: seen(grid.reshape(-1, 6))[::17],
}


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(("lines", "columns"), [(16, 900), (32, 512), (40, 450), (64, 512), (128, 256)])
def test_made_up_scans_of_any_order_are_told(order, lines, columns):
    rows = ORDERS[order](street(lines, columns, seed=lines))
    rows = rows[: len(rows) // 60 * 60]  # the size fits every width
    for width in (4, 5, 6):
        values = np.ascontiguousarray(rows[:, :width]).ravel()
        assert find_columns(FILE, values, None) == width
    extra = np.column_stack([rows[:, :4], np.arange(len(rows)) % 977, np.arange(len(rows)) * 7919 % 3000, rows[:, 4:]])
    for other in (rows[:, :3], extra[:, :7], extra.astype(np.float32)):
        with pytest.raises(BadInputError, match="columns"):
            find_columns(FILE, np.ascontiguousarray(other, np.float32).ravel(), None)


@pytest.mark.parametrize("seed", range(12))
def test_whatever_the_file_no_answer_is_wrong(seed):
    """Random sizes, cuts and orders: the right width, or a refusal."""
    rng = np.random.default_rng(seed)
    told = 0
    for _ in range(25):
        grid = street(int(rng.choice([2, 16, 31, 64])), int(rng.integers(8, 700)), int(rng.integers(1 << 30)))
        rows = list(ORDERS.values())[rng.integers(len(ORDERS))](grid)
        width = int(rng.integers(4, 7))
        begin = int(rng.integers(0, len(rows) // 2 + 1))
        values = np.ascontiguousarray(rows[begin:, :width]).ravel()
        cut = int(rng.integers(0, 2) * rng.integers(1, width))
        values = values[: max(len(values) - cut, 1)]
        try:
            found = find_columns(FILE, values, None)
        except BadInputError:
            continue
        assert found == width or not values.any() or (cut and len(values) < 200)
        told += 1
    assert told >= 5


def test_numbers_that_no_scan_has_are_refused_unless_the_user_says_the_columns():
    values = np.random.default_rng(4).uniform(-50.0, 50.0, 60 * 400).astype(np.float32)
    with pytest.raises(BadInputError, match=r"fit none of these columns.*4 or 5 or 6 columns.* say `columns=4`"):
        find_columns(FILE, values, None)
    with pytest.raises(BadInputError, match=r"may have 4 or 5 or 6 columns .* Say it: `columns=4`"):
        find_columns(FILE, np.ones(60, np.float32), None)
    assert [find_columns(FILE, values, width) for width in (4, 5, 6)] == [4, 5, 6]


@pytest.mark.parametrize("width", [4, 5, 6])
def test_a_truncated_file_is_refused_though_its_size_fits_another_width(width):
    rows = ORDERS["returns"](street(32, 512, 1))
    values = np.ascontiguousarray(rows[:, :width]).ravel()
    cuts = [
        cut
        for cut in range(1, 60)
        if (len(values) - cut) % width and any((len(values) - cut) % w == 0 for w in (4, 5, 6))
    ]
    for cut in cuts[:10]:
        with pytest.raises(BadInputError, match=f"lie in {width} columns .* is it truncated"):
            find_columns(FILE, values[:-cut], None)


def test_a_size_that_fits_no_width_is_refused():
    with pytest.raises(BadInputError, match="no multiple of 4, 5 or 6"):
        find_columns(FILE, np.ones(7, np.float32), None)


def test_what_the_user_says_counts():
    values = np.random.default_rng(1).uniform(-5.0, 5.0, 60).astype(np.float32)
    with pytest.raises(BadInputError, match="no multiple of the 20 bytes of a point of 5 columns"):
        find_columns(FILE, values[:48], 5)
    with pytest.raises(UsageError, match="`columns` is 7"):
        find_columns(FILE, values, 7)


@pytest.mark.parametrize("width", [4, 5, 6])
@pytest.mark.parametrize("order", ORDERS)
def test_a_width_that_the_values_contradict_is_refused_though_the_user_says_it(order, width):
    rows = ORDERS[order](street(64, 512, 7))
    values = np.ascontiguousarray(rows[: len(rows) // 60 * 60, :width]).ravel()
    assert find_columns(FILE, values, width) == width
    for other in {4, 5, 6} - {width}:
        with pytest.raises(BadInputError, match=f"lie in {width} columns .* not in {other}, .* Say `columns={width}`"):
            find_columns(FILE, values, other)


@pytest.mark.parametrize("width", [4, 5, 6])
def test_a_file_is_read_with_its_columns(tmp_path, width):
    rows = street(64, 300, 5).reshape(-1, 6)
    rows[:, :width].tofile(tmp_path / "a.bin")
    scan = read_scan(tmp_path / "a.bin")
    kept = seen(rows)
    kept = kept[np.hypot(kept[:, 0], kept[:, 1]) >= 0.5]
    np.testing.assert_array_equal(scan.points, kept[:, :3])
    np.testing.assert_array_equal(scan.intensity, kept[:, 3])
    assert (scan.time is None) == (width < 6)
    if scan.time is not None:
        np.testing.assert_array_equal(scan.time, kept[:, 5])


def test_a_sixth_column_that_is_no_time_is_none(tmp_path):
    rows = street(64, 300, 5).reshape(-1, 6)
    rows[:, 4] -= 0.5  # not rings: normals, perhaps
    rows.tofile(tmp_path / "a.bin")
    assert read_scan(tmp_path / "a.bin", columns=6).time is None


@pytest.mark.realdata
@pytest.mark.parametrize("folder", ["kitti_labelled", "solid_state_labelled"])
def test_real_scans_have_four_columns(shared_data, folder):
    """Also with columns that were made up, and cut so that the size fits every width."""
    for file in sorted((shared_data / "scans" / folder).glob("*.bin")):
        rows = np.fromfile(file, "<f4").reshape(-1, 4)
        rows = rows[: len(rows) // 60 * 60]
        wide = np.column_stack([rows, np.arange(len(rows)) // 2000, np.linspace(0, 0.1, len(rows))]).astype(np.float32)
        for width in (4, 5, 6):
            assert find_columns(file, np.ascontiguousarray(wide[:, :width]).ravel(), None) == width
