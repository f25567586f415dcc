"""The number of columns of a .bin scan is told from its values: never wrong, and in doubt asked for."""

import numpy as np
import pytest

from bumpymap.core import BadInputError, Robot
from bumpymap.readers import read_scan


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
    "by azimuth": lambda grid: grid.transpose(1, 0, 2).reshape(-1, 6),
    "paired": paired,
    "ahead": ahead,
    "shuffled": shuffled,
    "bytes": as_bytes,
    "nan": with_nan,
    "thin": lambda grid: seen(grid.reshape(-1, 6))[::17],
}


def read(path, values, columns=None):
    """The points, intensities and times of a file of these values."""
    np.ascontiguousarray(values, np.float32).tofile(path)
    return read_scan(path, Robot(0.0), columns)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(("lines", "columns"), [(16, 900), (64, 512)])
def test_made_up_scans_of_any_order_are_told_and_another_width_is_refused(tmp_path, order, lines, columns):
    rows = ORDERS[order](street(lines, columns, seed=lines))
    rows = rows[: len(rows) // 60 * 60]  # the size fits every width
    kept = seen(rows[np.isfinite(rows[:, 0])])
    for width in (4, 5, 6):
        scan = read(tmp_path / "a.bin", rows[:, :width])
        np.testing.assert_array_equal(scan.points, kept[:, :3])
        np.testing.assert_array_equal(scan.intensity, kept[:, 3])
        assert (scan.time is None) == (width < 6)
        for other in {4, 5, 6} - {width}:
            with pytest.raises(BadInputError, match=f"fit {width} of 4, 5 or 6 columns"):
                read(tmp_path / "a.bin", rows[:, :width], other)
    with pytest.raises(BadInputError, match="fit none of 4, 5 or 6 columns"):
        read(tmp_path / "a.bin", rows[:, :3])


@pytest.mark.parametrize("seed", range(6))
def test_whatever_the_file_no_answer_is_wrong(tmp_path, seed):
    """Random sizes, cuts and orders: the right width, or a refusal."""
    rng = np.random.default_rng(seed)
    told = 0
    for _ in range(25):
        grid = street(int(rng.choice([2, 16, 31, 64])), int(rng.integers(8, 700)), int(rng.integers(1 << 30)))
        rows = list(ORDERS.values())[rng.integers(len(ORDERS))](grid)
        width = int(rng.integers(4, 7))
        rows = rows[int(rng.integers(0, len(rows) // 2 + 1)) :, :width]
        values = rows.ravel()
        cut = int(rng.integers(0, 2) * rng.integers(1, width))
        try:
            found = read(tmp_path / "a.bin", values[: max(len(values) - cut, 1)])
        except BadInputError:
            continue
        kept = seen(rows[np.isfinite(rows[:, 0])])[:, :3]
        assert cut == 0 or len(values) < 200
        assert np.array_equal(found.points, kept) or cut
        told += 1
    assert told >= 5


def test_numbers_that_no_scan_has_are_refused_unless_the_user_says_the_columns(tmp_path):
    values = np.random.default_rng(4).uniform(-50.0, 50.0, 60 * 400)
    for wrong, words in ((values, "fit none of"), (np.ones(60), "fit 4 or 5 or 6 of"), (np.ones(7), "fit none of")):
        with pytest.raises(BadInputError, match=words):
            read(tmp_path / "a.bin", wrong)
    for width in (4, 5, 6):
        scan = read(tmp_path / "a.bin", values, width)
        np.testing.assert_array_equal(scan.points, values.reshape(-1, width)[:, :3].astype(np.float32))
        assert scan.time is None  # the columns are not rings and times
    with pytest.raises(BadInputError, match="48 float32 values"):
        read(tmp_path / "a.bin", values[:48], 5)


@pytest.mark.realdata
@pytest.mark.parametrize("folder", ["kitti_labelled", "solid_state_labelled"])
def test_real_scans_have_four_columns(shared_data, tmp_path, folder):
    """Also with columns that were made up, and cut so that the size fits every width."""
    for file in sorted((shared_data / "scans" / folder).glob("*.bin")):
        rows = np.fromfile(file, "<f4").reshape(-1, 4)
        rows = rows[: len(rows) // 60 * 60]
        wide = np.column_stack([rows, np.arange(len(rows)) // 2000, np.linspace(0, 0.1, len(rows))])
        for width in (4, 5, 6):
            scan = read(tmp_path / "a.bin", wide[:, :width])
            np.testing.assert_array_equal(scan.points, seen(rows)[:, :3])
