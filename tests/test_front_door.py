"""`import bumpymap` as a notebook uses it: what is there, what it costs, what the calls give and say."""

import copy
import doctest
import importlib
import math
import re
import shutil
import subprocess
import sys
from pathlib import Path

import geopandas
import numpy as np
import pytest
import rasterio
import xarray as xr
from made_drives import write_drive
from small_surveys import write_survey

import bumpymap
from bumpymap.core import BANDS, install_command
from bumpymap.views import check_headline

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("without_views")]

ROOT = Path(__file__).resolve().parents[1]
QUARRY = ROOT / "sample_data" / "quarry.laz"
PART = ROOT / "sample_data" / "quarry_part.ply"
OPEN_FILES = Path("/proc/self/fd")


@pytest.fixture(scope="module")
def layers(tmp_path_factory):
    return bumpymap.map_survey(str(QUARRY), tmp_path_factory.mktemp("layers") / "site_layers")


@pytest.mark.parametrize("name", bumpymap.__all__)
def test_every_public_name_is_there_and_says_what_it_is(name):
    assert name in dir(bumpymap)
    value = getattr(bumpymap, name)
    assert isinstance(value, str) or value.__doc__


def test_the_dataset_holds_every_band_as_rasterio_reads_it(layers):
    dataset = layers.dataset()
    assert list(dataset.data_vars) == [*(band.name for band in BANDS), "class", "reason", "cost", "speed", "barred"]
    with rasterio.open(layers.folder / "rasters/roughness.tif") as file:
        assert dataset.rio.crs == file.crs
        assert dataset.rio.transform() == file.transform
        for number, band in enumerate(BANDS, 1):
            variable = dataset[band.name]
            np.testing.assert_array_equal(variable.values, file.read(number))
            assert variable.attrs["long_name"] == band.description
            assert variable.attrs["units"] == (band.unit or "1")
    for name, place in (
        ("class", "rasters/class.tif"),
        ("reason", "rasters/reason.tif"),
        ("cost", "cost.tif"),
        ("speed", "rasters/speed.tif"),
    ):
        with rasterio.open(layers.folder / place) as file:
            np.testing.assert_array_equal(dataset[name].values, file.read(1))
    np.testing.assert_array_equal(np.isfinite(dataset["cost"].values), dataset["barred"].values == 0)
    assert dataset["class"].dtype == np.uint8
    assert dataset["class"].rio.nodata == 255
    assert dataset["reason"].rio.nodata == 255
    np.testing.assert_array_equal(dataset["reason"].values == 0, dataset["class"].values != 255)
    assert dataset["class"].attrs["flag_meanings"] == "smooth fair rough very_rough"


def test_objects_tiles_and_regions_are_those_of_the_files(layers):
    objects, tiles = layers.obstacles(), layers.tiles()
    regions = geopandas.read_file(layers.folder / "cost.fgb")
    with rasterio.open(layers.folder / "rasters/obstacle.tif") as file:
        np.testing.assert_array_equal(objects.values, file.read(1))
        assert objects.rio.transform() == file.transform == layers.heights().rio.transform()
    assert objects.attrs["flag_meanings"] == "free obstacle canopy unknown step"
    assert isinstance(tiles, geopandas.GeoDataFrame)
    assert len(tiles) == layers.manifest["counts"]["tiles"]
    assert tiles.crs == regions.crs == "EPSG:32632"
    assert regions.area.sum() == pytest.approx(tiles.area.sum())


def test_values_are_read_when_they_are_used(layers):
    dataset = layers.dataset()
    unread = "1428 values with dtype=float32"  # xarray says so of what is not in memory
    assert unread in repr(dataset["c_r"])
    assert np.isfinite(dataset["slope"].values).any()
    assert unread in repr(dataset["c_r"])
    assert unread not in repr(dataset["slope"])
    assert "values with dtype" in repr(layers.heights())


def test_the_dataset_is_kept_in_a_netcdf_file(layers, tmp_path):
    dataset = layers.dataset()
    dataset.to_netcdf(tmp_path / "layers.nc", engine="scipy")  # which every installation has
    layers.obstacles().to_netcdf(tmp_path / "obstacles.nc", engine="scipy")
    back = xr.open_dataset(tmp_path / "layers.nc", engine="scipy", decode_coords="all", mask_and_scale=False)
    assert back.rio.crs == "EPSG:32632"
    for name in dataset:
        np.testing.assert_array_equal(back[name].values, dataset[name].values)
    about = {"survey": "quarry", "vehicle": "warthog", "calibration": layers.manifest["calibration"]["id"]}
    assert back.attrs.items() >= about.items()
    assert layers.obstacles().attrs.items() >= about.items()


def test_a_folder_of_a_drive_names_its_map(tmp_path):
    (tmp_path / "scan.json").write_text("{}", encoding="utf-8")
    with pytest.raises(bumpymap.BadInputError, match="map of this drive is in"):
        bumpymap.open(tmp_path)


def test_without_the_extra_the_message_says_how_to_install_it(layers, monkeypatch):
    real = importlib.import_module

    def refuse(name, package=None):
        if name in {"xarray", "rioxarray", "geopandas"}:
            raise ModuleNotFoundError(f"No module named '{name}'")
        return real(name, package)

    monkeypatch.setattr("bumpymap.layers._imports.import_module", refuse)
    for call in (layers.dataset, layers.heights, layers.tiles):
        with pytest.raises(bumpymap.UsageError, match=re.escape(install_command("notebook"))):
            call()


def test_without_out_the_files_go_with_the_object():
    layers = bumpymap.map_survey(QUARRY, ground="all")
    folder, dataset, heights = layers.folder, layers.dataset(), layers.heights()
    assert "in memory" in repr(layers)
    assert folder.is_dir()
    with pytest.raises(bumpymap.UsageError, match="out='DIR'"):
        copy.copy(layers)  # as pickle does it
    del layers
    assert not folder.exists()
    assert np.isfinite(dataset["c_r"]).sum() > 1000
    assert np.isfinite(heights).sum() > 1000


def lines_of(script, *arguments, **how):
    """Run a script in a process of its own; gives what it prints."""
    command = [sys.executable, "-c", script, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, **how)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


IN_A_FORK = """
import multiprocessing, sys
from pathlib import Path

import bumpymap

part, out = map(Path, sys.argv[1:])


def made(out):
    global kept
    kept = bumpymap.map_survey(part, out, local=True)
    return kept.folder, {file["path"]: file["sha256"] for file in kept.manifest["files"]}


_, before = made(out)
with multiprocessing.get_context("fork").Pool(1) as pool:
    folder, after = pool.apply_async(made, (None,)).get(timeout=100)
    pool.close()
    pool.join()
assert after == before
assert not folder.exists()
"""


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere multiprocessing does not fork by itself")
def test_a_process_that_is_forked_after_a_map_makes_the_same_map_and_leaves_nothing(tmp_path):
    """As `multiprocessing` makes its workers: GDAL would wait for ever for threads that have stayed in the parent."""
    lines_of(IN_A_FORK, PART, tmp_path / "parent")


LOOP_OVER_MAPS = """
import gc, sys, tracemalloc
from pathlib import Path

import numpy as np

import bumpymap

part, folder = map(Path, sys.argv[1:])


def two_more(number):
    for out in (None, folder / str(number)):
        layers = bumpymap.map_survey(part, out)
        assert np.isfinite(layers.dataset()["c_r"].values).any()
        assert np.isfinite(layers.heights().values).any()
        layers.tiles()


gc.disable()
for number in range(2):
    two_more(number)
    files = len(list(Path("/proc/self/fd").iterdir()))
    gc.collect()  # files may not wait for this, small objects may
    print(files, tracemalloc.get_traced_memory()[0])
    tracemalloc.start()  # not before, since it makes imports slow
"""


@pytest.mark.later
@pytest.mark.skipif(not OPEN_FILES.is_dir(), reason="open files are counted in /proc, which is Linux's")
def test_a_loop_over_maps_leaves_no_file_open_and_no_memory(tmp_path):
    survey = write_survey(tmp_path / "small.las", points=5_000, side=12.0)
    (files, memory), (more_files, more_memory) = (
        map(int, line.split()) for line in lines_of(LOOP_OVER_MAPS, survey, tmp_path)
    )
    assert more_files == files
    assert more_memory - memory < 200_000


MAPS_IN_THREADS = """
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import bumpymap

folder, number = Path(sys.argv[1]), int(sys.argv[2])
surveys = sorted(folder.glob("*.laz"))


def made(survey, out):
    listed = bumpymap.map_survey(survey, folder / out).manifest["files"]
    return {file["path"]: file["sha256"] for file in listed}


def again(survey):
    return [made(survey, f"{survey.stem} {count}") for count in range(number)]


alone = [made(survey, f"{survey.stem} alone") for survey in surveys]
with ThreadPoolExecutor(len(surveys)) as pool:
    assert list(pool.map(again, surveys)) == [number * [files] for files in alone]
"""


@pytest.mark.parametrize(("surveys", "number"), [(3, 1), pytest.param(8, 20, marks=pytest.mark.later)])
def test_threads_map_surveys_with_the_same_bytes_as_one_after_the_other(tmp_path, surveys, number):
    for seed in range(surveys):
        write_survey(tmp_path / f"{seed}.laz", points=5_000, side=12.0, seed=seed)
    lines_of(MAPS_IN_THREADS, tmp_path, number, timeout=300 + 30 * number)


def test_values_of_layers_that_were_replaced_are_not_mixed_with_the_earlier_ones(tmp_path):
    dataset = bumpymap.map_survey(PART, tmp_path / "out", local=True).dataset()
    assert np.isfinite(dataset["slope"].values).any()
    bumpymap.map_survey(PART, tmp_path / "out", local=True, overwrite=True, features={"min_points": 2000})
    with pytest.raises(bumpymap.BadInputError, match="open the layers again"):
        _ = dataset["c_r"].values


def test_a_run_in_memory_that_ends_early_leaves_nothing_and_does_not_speak_of_going_on(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with pytest.raises(bumpymap.BadInputError):
        bumpymap.map_survey(tmp_path / "missing.laz")
    assert list(tmp_path.iterdir()) == []

    def end_early(config):
        error = bumpymap.OutputError("the disk is full")
        error.add_note("Run the same again to continue from the finished tiles.")
        error.add_note("Look at it.")
        raise error

    monkeypatch.setattr("bumpymap.survey.map_surveys", end_early)
    for out, notes in ((None, ["Look at it."]), (tmp_path, ["Run the same again", "Look at it."])):
        with pytest.raises(bumpymap.OutputError) as caught:
            bumpymap.map_survey(QUARRY, out)
        assert len(caught.value.__notes__) == len(notes)
        assert all(map(str.startswith, caught.value.__notes__, notes))


# --- scans ---
def ring_of_ground(seed=0, points=60_000):
    rng = np.random.default_rng(seed)
    angle, distance = rng.uniform(0, 2 * math.pi, points), rng.uniform(1, 40, points)
    z = -1.5 + np.where(angle < math.pi, 0.0, rng.normal(0, 0.15, points))
    return np.column_stack([distance * np.cos(angle), distance * np.sin(angle), z]).astype(np.float32)


@pytest.mark.parametrize("method", ["filter", "learned"])
def test_a_scan_has_classes_by_point_and_by_sector(method):
    points = ring_of_ground()
    result = bumpymap.classify_scan(points, method=method)
    assert isinstance(result, bumpymap.ScanResult)
    assert result.method == method
    assert result.point_class.shape == result.point_sector.shape == result.point_confidence.shape == (len(points),)
    inside = result.point_sector >= 0
    own = np.append(result.sector_class, 255)[result.point_sector]
    assert (result.point_class == own)[own < 255].mean() > 0.9
    assert (result.point_class[np.hypot(points[:, 0], points[:, 1]) < 0.999] == 255).all()
    bounds = result.sector_bounds
    distance = np.hypot(points[:, 0], points[:, 1])[inside]
    place = result.point_sector[inside]
    assert (distance >= bounds.near[place] - 1e-3).all()
    assert (distance < bounds.far[place] + 1e-3).all()
    np.testing.assert_array_equal(np.bincount(place, minlength=len(result.sector_class)), result.sector_points)
    assert set(np.unique(result.sector_class)) <= set(result.class_names)
    assert f"{len(points):,} points" in repr(result)


def test_returns_that_are_no_points_keep_their_rows():
    points = ring_of_ground()
    odd = points.copy()
    odd[::7] = 0.0
    odd[3::11, 2] = np.nan
    odd[5::13, 0] = np.inf
    kept = np.isfinite(odd).all(axis=1) & (odd != 0.0).any(axis=1)
    result, alone = bumpymap.classify_scan(odd), bumpymap.classify_scan(odd[kept])
    np.testing.assert_array_equal(result.point_class[kept], alone.point_class)
    np.testing.assert_array_equal(result.point_sector[kept], alone.point_sector)
    assert (result.point_class[~kept] == 255).all()
    assert (result.point_sector[~kept] == -1).all()


# --- drives ---
def test_the_sample_drive_is_judged_as_readme_says(layers):
    drive = ",".join(str(ROOT / f"sample_data/quarry_drive_{part}.csv") for part in ("imu", "gnss"))
    by_line, by_tiles = check_headline(bumpymap.check_drives(layers, drive))
    said = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    for part, verdict, text in (
        (
            by_line,
            "holds in rank and level",
            "the map holds in rank and level by the driven line ({} low in the median)",
        ),
        (by_tiles, "ranks the ground rightly, but its level is off", "reads {} low by its tiles"),
    ):
        assert verdict in part
        (low,) = re.findall(r"reads (\d+ %) low in the median", part)
        assert text.format(low) in said


def test_a_check_takes_layers_and_one_drive_or_several(layers, tmp_path):
    drive = write_drive(tmp_path / "drive.csv")
    again = shutil.copy(drive, tmp_path / "again.csv")
    several = bumpymap.check_drives(layers, [str(drive), again])
    assert len(several.drives) == 2
    first, second = np.split(several.stretches.measured, 2)
    np.testing.assert_array_equal(first, second)
    alone = bumpymap.check_drives(None, drive, tmp_path / "alone", band_hz=5, window_m=20)
    assert alone.ground is None
    assert alone.drives[0].band_hz == 5
    assert (tmp_path / "alone" / "check.json").exists()


# --- examples ---
@pytest.mark.parametrize(
    "module",
    [
        "bumpymap.survey.batch.run",
        "bumpymap.change.pipeline",
        "bumpymap.check.pipeline",
        "bumpymap.api",
        "bumpymap.scan.classifier",
    ],
)
@pytest.mark.usefixtures("batches_here")
def test_the_examples_of_the_docstrings_run(module, layers, tmp_path, monkeypatch):
    shutil.copytree(layers.folder, tmp_path / "site_layers")
    (tmp_path / "sample_data").symlink_to(ROOT / "sample_data")
    write_drive(tmp_path / "drive.csv")
    monkeypatch.chdir(tmp_path)
    done = doctest.testmod(importlib.import_module(module))
    assert done.attempted >= 3
    assert done.failed == 0
