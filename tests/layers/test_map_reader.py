from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from pyproj import CRS
from route_maps import bare_map, write_folder

from bumpymap.core import NO_TILE, Georeference
from bumpymap.layers import open_map
from bumpytiles import Grid, TileWindow

BANDS = ("c_r", "c_r_low", "c_r_high", "p_fail", "obstacle")
SMALL = Grid(3.0, 4)


@pytest.fixture(scope="module")
def made(make_field):
    return make_field(50, 37, grid=SMALL, seed=8)


@pytest.fixture(scope="module")
def folder(made, tmp_path_factory):
    return write_folder(tmp_path_factory.mktemp("route") / "layers", made)


def same(first, second):
    return all(np.array_equal(getattr(first, name), getattr(second, name), equal_nan=True) for name in BANDS) and (
        np.array_equal(first.barred, second.barred)
    )


def test_every_tile_lies_where_it_was_measured(folder, made):
    found = open_map(folder)
    field = found.read(found.window)
    row = found.window.row + found.window.rows - 1 - made.patches.row
    col = made.patches.col - found.window.col
    held = np.zeros(field.barred.shape, bool)
    held[row, col] = True
    assert np.array_equal(field.barred == NO_TILE, ~held)
    columns = made.lone_columns()
    assert np.array_equal(field.barred[row, col], columns["barred"])
    for name in BANDS:
        assert np.array_equal(getattr(field, name)[row, col], columns[name], equal_nan=True), name
        assert np.isnan(getattr(field, name)[~held]).all()


@pytest.mark.parametrize("piece", [7, 512])
def test_a_window_is_a_piece_of_the_whole_also_beyond_the_map(folder, monkeypatch, piece):
    found = open_map(folder)
    whole = found.window
    around = TileWindow(whole.col - 7, whole.row - 5, whole.cols + 20, whole.rows + 9)
    field, heights, objects = found.read(around), found.heights(around), found.objects(around)
    monkeypatch.setattr("bumpymap.layers.map_reader._PIECE", piece)  # read at once
    rng = np.random.default_rng(1)
    for _ in range(10):
        top, left = int(rng.integers(0, 40)), int(rng.integers(0, 60))
        rows, cols = int(rng.integers(1, around.rows - top + 1)), int(rng.integers(1, around.cols - left + 1))
        window = TileWindow(around.col + left, around.row + around.rows - top - rows, cols, rows)
        part = found.read(window)
        for name in ("barred", *BANDS):
            expected = getattr(field, name)[top : top + rows, left : left + cols]
            assert np.array_equal(getattr(part, name), expected, equal_nan=True)
        pixels = np.s_[4 * top : 4 * (top + rows), 4 * left : 4 * (left + cols)]
        assert np.array_equal(found.heights(window), heights[pixels], equal_nan=True)
        assert np.array_equal(found.objects(window), objects[pixels])


def test_a_map_in_feet_lies_on_the_grid_in_metres(tmp_path, make_field):
    unit = 1200 / 3937
    feet = Georeference(CRS.from_epsg(2229), unit, unit)
    made = make_field(6, 5, grid=SMALL, west=655_000, south=187_000, georeference=feet)
    found = open_map(write_folder(tmp_path / "feet", made))
    assert found.window == TileWindow(655_000, 187_000, 6, 5)
    assert found.to_grid(1000.0, 3937.0) == pytest.approx((304.8006096, 1200.0))
    assert found.to_crs(*found.to_grid(12.5, -7.0)) == pytest.approx((12.5, -7.0))


def test_longitude_and_latitude_of_the_central_meridian():
    """On the central meridian of a UTM zone the scale is 0.9996 and longitude does not depend on northing."""
    place = bare_map()
    longitude, latitude = place.to_lonlat(np.array([500_000.0, 500_000.0]), np.array([0.0, 2_000_000.0]))
    assert longitude == pytest.approx([-99.0, -99.0], abs=1e-12)
    assert latitude[0] == pytest.approx(0.0, abs=1e-12)
    assert 18.0 < latitude[1] < 18.2
    back = place.from_lonlat(longitude, latitude)
    assert np.allclose(back, [[500_000.0, 500_000.0], [0.0, 2_000_000.0]], atol=1e-6)


def test_passage_in_fewer_pixels(folder):
    """At full size the same; in fewer pixels, what is free there is free on one of those beneath."""
    found = open_map(folder)
    whole = found.window
    around = TileWindow(whole.col - 2, whole.row - 1, whole.cols + 4, whole.rows + 3)
    fine = found.passage(around)
    assert np.array_equal(found.passage_shown(around, fine.shape), fine)
    rows, cols = fine.shape[0] // 2, fine.shape[1] // 2
    coarse = found.passage_shown(around, (rows, cols))
    assert not (coarse & ~fine[: 2 * rows, : 2 * cols].reshape(rows, 2, cols, 2).any(axis=(1, 3))).any()


def open_below(folder):
    """Names of the files below a folder that this process has open."""
    opened = []
    for entry in Path("/proc/self/fd").iterdir():
        try:
            target = entry.readlink()
        except OSError:  # closed meanwhile, such as the listing itself
            continue
        if target.is_relative_to(folder):
            opened.append(target.name)
    return sorted(opened)


has_descriptors = pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="open files are not listed here")


@has_descriptors
def test_files_stay_open_for_as_long_as_wanted(folder):
    found = open_map(folder)
    alone = found.read(found.window)
    assert open_below(folder) == []
    with found.kept_open():
        for _ in range(3):
            assert same(found.read(found.window), alone)
        assert open_below(folder) == ["barred.tif", "roughness.tif"]
        with found.kept_open():
            found.passage(found.window)
        assert open_below(folder) == ["barred.tif", "passage.tif", "roughness.tif"]
    assert open_below(folder) == []


def test_threads_read_a_map_that_is_kept_open(folder):
    found = open_map(folder)
    whole = found.window
    rng = np.random.default_rng(3)
    corners = rng.integers(0, (whole.cols - 5, whole.rows - 5), (60, 2))
    windows = [TileWindow(whole.col + int(col), whole.row + int(row), 5, 5) for col, row in corners]
    wanted = [(found.read(window), found.passage(window)) for window in windows]

    def read(window):
        with found.kept_open():
            return found.read(window), found.passage(window)

    with ThreadPoolExecutor(4) as pool:
        read_by_threads = list(pool.map(read, windows))
    for (field, passage), (own, open_pixels) in zip(wanted, read_by_threads, strict=True):
        assert same(field, own)
        assert np.array_equal(passage, open_pixels)
