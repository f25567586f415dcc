"""Maps read window by window, and folders that are refused."""

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from shutil import rmtree

import numpy as np
import pytest
from route_maps import copy_folder, list_anew, write_folder

from bumpymap.core import NO_TILE, BadInputError
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


def test_coarse_relief_holds_means(folder):
    found = open_map(folder)
    whole = found.window
    blocks = found.heights(whole).reshape(whole.rows, 4, whole.cols, 4)
    known = np.isfinite(blocks).sum(axis=(1, 3))
    means = np.nansum(blocks, axis=(1, 3)) / np.where(known, known, np.nan)
    coarse = found.relief(whole, (whole.rows, whole.cols))
    full = known == 16  # an overview of an overview weighs pixels beside holes differently
    np.testing.assert_allclose(coarse[full], means[full], atol=1e-3)
    np.testing.assert_array_equal(np.isnan(coarse), known == 0)
    assert np.abs(coarse - means)[known > 0].max() < 0.5


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


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="open files are not listed here")
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
    corners = np.random.default_rng(3).integers(0, (whole.cols - 5, whole.rows - 5), (60, 2)).tolist()
    windows = [TileWindow(whole.col + col, whole.row + row, 5, 5) for col, row in corners]
    wanted = [(found.read(window), found.passage(window)) for window in windows]

    def read(window):
        with found.kept_open():
            return found.read(window), found.passage(window)

    with ThreadPoolExecutor(4) as pool:
        for (field, passage), (own, open_pixels) in zip(wanted, pool.map(read, windows), strict=True):
            assert same(field, own)
            assert np.array_equal(passage, open_pixels)


@pytest.fixture(scope="module")
def small(make_field, tmp_path_factory):
    return write_folder(tmp_path_factory.mktemp("route") / "small", make_field(20, 16, grid=SMALL))


def first_version(folder):
    """It had all files at the top."""
    for path in (folder / "rasters").iterdir():
        path.rename(folder / path.name)


def in_sheets(folder):
    (folder / "run.json").write_text(json.dumps({"format": "bumpymap-sheets", "sheets": []}))


@pytest.mark.parametrize(
    ("change", "entries", "words"),
    [
        (lambda folder: (folder / "run.json").unlink(), {}, "no complete run"),
        (rmtree, {}, "there is no folder"),
        *((lambda _: None, {key: {"a": 1}}, r"run\.json is damaged") for key in ("grid", "files", "crs")),
        (in_sheets, {}, r"layers holds a map of another version.*Map the survey again"),
        (first_version, {"version": 1}, r"layers holds a map of another version.*other places.*again"),
    ],
)
def test_what_is_no_complete_run_of_this_version_is_refused(small, tmp_path, change, entries, words):
    folder = copy_folder(small, tmp_path / "layers", **entries)
    change(folder)
    with pytest.raises(BadInputError, match=words):
        open_map(folder)


@pytest.mark.parametrize("name", ["cost.tif", "rasters/heightmap.tif"])
def test_missing_cut_off_and_damaged_files_are_refused(small, tmp_path, name):
    folder = copy_folder(small, tmp_path / "layers")
    path = folder / name
    content = path.read_bytes()
    damages = {"cut off": content[: len(content) * 2 // 3], "damaged": content[:-400] + bytes(400)}
    if name == "rasters/heightmap.tif":  # compared by size only
        del damages["damaged"]
    for words, damaged in damages.items():
        path.write_bytes(damaged)
        with pytest.raises(BadInputError, match=f"{name} is {words}"):
            open_map(folder)
    path.unlink()
    with pytest.raises(BadInputError, match=f"{name} is missing"):
        open_map(folder)


def test_rasters_of_another_place_are_refused(small, tmp_path, make_field):
    """A raster that was copied from another run; its size and checksum are entered, so only its place is wrong."""
    folder = copy_folder(small, tmp_path / "layers")
    other = write_folder(tmp_path / "other", make_field(20, 17, grid=SMALL))
    (folder / "cost.tif").write_bytes((other / "cost.tif").read_bytes())
    list_anew(folder)
    with pytest.raises(BadInputError, match=r"cost\.tif spans other tiles"):
        open_map(folder)
    list_anew(folder, grid=json.loads((folder / "run.json").read_text())["grid"] | {"tile_size_m": 2.5})
    with pytest.raises(BadInputError, match="does not lie on the grid"):
        open_map(folder)
