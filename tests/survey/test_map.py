"""The main job as a user meets it: the command line on files, good and bad."""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pyogrio
import pytest
import rasterio
from made_quarry import tiles_of
from pyproj import CRS
from small_surveys import band, files_in, killed_at, layers_of, run, write_las

from bumpymap.core.run_folder import locked
from bumpymap.layers.products import VIEW_NAMES
from bumpymap.views import write_map_views

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("without_views")]

QUARRY = Path(__file__).resolve().parents[2] / "sample_data" / "quarry.laz"


@pytest.fixture(scope="module")
def site():
    """Points of a 30 m x 30 m site: the west half smooth, the east half rubble."""
    rng = np.random.default_rng(0)
    n = 60_000
    x, y = rng.uniform(0.01, 29.99, n), rng.uniform(0.01, 29.99, n)
    bumps = 0.25 * np.sin(9 * x) * np.sin(8 * y)
    z = 100 + 0.02 * x + np.where(x > 15, bumps, 0.0) + 0.004 * rng.normal(size=n)
    return np.round(x, 3) + 500_001, np.round(y, 3) + 4_000_002, np.round(z, 3)


@pytest.fixture(scope="module")
def survey(site, tmp_path_factory):
    return write_las(tmp_path_factory.mktemp("survey") / "site.laz", *site)


@pytest.fixture(scope="module")
def layers(survey):
    out = survey.parent / "layers"
    run("map", survey, "--out", out, code=0)
    return out


def test_the_smooth_half_is_smoother_than_the_rubble(layers):
    with rasterio.open(layers / "rasters/roughness.tif") as raster:
        c_r = raster.read(raster.descriptions.index("c_r") + 1)
        assert c_r.shape == (10, 10)
        assert raster.bounds == (500_001, 4_000_002, 500_031, 4_000_032)
    class_id = band(layers / "rasters/class.tif")
    assert np.median(c_r[:, 6:]) > 5 * np.median(c_r[:, :4])
    assert class_id[:, 6:].min() > class_id[:, :4].max()


def test_a_survey_in_feet_gives_the_tiles_of_the_same_survey_in_metres(site, tmp_path):
    x, y, z = site
    in_feet = (1_600_000, 13_000_000, 0)
    metres = write_las(tmp_path / "m.laz", x, y, z, crs="EPSG:2956")
    feet_crs = CRS.from_user_input("EPSG:2225")  # US survey feet
    us_foot = 1200 / 3937
    feet = write_las(tmp_path / "ft.laz", x / us_foot, y / us_foot, z / us_foot, crs=feet_crs, offset=in_feet)
    mixed = write_las(tmp_path / "mixed.laz", x / us_foot, y / us_foot, z, crs=feet_crs, offset=in_feet)
    bare = write_las(tmp_path / "bare.laz", x / us_foot, y / us_foot, z / us_foot, crs=None, offset=in_feet)
    given = ("--local", "--xy-unit", "us-ft")
    for file, extra in ((metres, ()), (feet, ()), (mixed, ("--z-unit", "m")), (bare, given)):
        result = run("map", file, "--out", tmp_path / file.stem, *extra, code=0)
        assert "metres are assumed" not in result.output
    assert "metres are assumed" in run("map", bare, "--out", tmp_path / "assumed", "--local").output
    medians = {}
    for name in ("m", "ft", "mixed", "bare"):
        with rasterio.open(tmp_path / name / "rasters/roughness.tif") as raster:
            # A point within a millimetre of a tile's or pixel's edge may change sides: compare in the median of many.
            values = raster.read()
            medians[name] = np.nanmedian(values[np.isfinite(values).sum(axis=(1, 2)) > 20], axis=(1, 2))
            unit = us_foot if name != "m" else 1.0
            assert raster.transform.a == pytest.approx(3 / unit)
            assert raster.transform.c * unit == pytest.approx(500_001, abs=1e-4)
        np.testing.assert_allclose(medians[name], medians["m"], rtol=0.02, atol=0.01)


def inodes(folder):
    return {path.name: (path.stat().st_ino, path.stat().st_mtime_ns) for path in folder.rglob("*")}


@pytest.mark.parametrize("extra", [(), ("--skip-bad", "--threads", 1, "--memory", "300MB")])
def test_a_run_that_is_complete_is_done_already(layers, survey, extra):
    before = inodes(layers)
    again = run("map", survey, "--out", layers, *extra, code=0)
    assert "Already done" in again.output
    assert "60,000 points, 100 tiles" in again.output
    assert json.loads(run("map", survey, "--out", layers, *extra, "--json").stdout)["already_done"] is True
    assert inodes(layers) == before


def test_layers_that_a_gis_saved_its_styles_and_statistics_beside_are_still_a_complete_run(
    survey, tmp_path, monkeypatch
):
    """As QGIS leaves them; views that are deleted are not missed, and overwriting brings them back."""
    monkeypatch.setattr("bumpymap.views.write_map_views", write_map_views)
    out = tmp_path / "viewed"
    run("map", survey, "--out", out, code=0)
    made = files_in(out)
    for name in VIEW_NAMES:
        if (out / name).suffix in {".qml", ".qgs"}:
            (out / name).write_text("<qgis/>", encoding="utf-8")
    (out / "map.qgs~").write_text("<qgis/>", encoding="utf-8")
    for raster in out.rglob("*.tif"):
        side = raster.with_name(f"{raster.name}.aux.xml")
        if not side.exists():
            side.write_text("<PAMDataset/>", encoding="utf-8")
    before = files_in(out)
    assert "Already done" in run("map", survey, "--out", out).output
    assert files_in(out) == before
    for name in VIEW_NAMES:
        (out / name).unlink(missing_ok=True)
    assert "Already done" in run("map", survey, "--out", out).output
    run("map", survey, "--out", out, "--overwrite", code=0)
    for name in ("rasters/class.qml", "map.qgs"):
        assert (out / name).read_bytes() == made[name]
    assert not (out / "rasters/roughness.tif.aux.xml").exists()


def test_a_complete_run_of_something_else_says_what_differs(site, layers, survey, tmp_path):
    """An input that was touched or copied is the same; its bytes decide."""
    out = tmp_path / "out"
    moved = tmp_path / "site.laz"
    shutil.copy(survey, moved)
    run("map", moved, "--out", out, code=0)
    os.utime(moved)
    assert "Already done" in run("map", moved, "--out", out).output
    content = bytearray(moved.read_bytes())
    content[40] ^= 1  # of the project id: as long as it was, and of no matter to the map
    moved.write_bytes(content)
    more = write_las(tmp_path / "more.laz", *site)
    before = files_in(out)
    for given, words in (
        ((moved,), [f"{moved} has changed since", "--overwrite"]),
        ((more,), [f"{moved} was an input, but is not given now", f"{more} is given now, but was not an input"]),
        ((survey, "--vehicle", "car", "--crs", "EPSG:32614"), ["vehicle was warthog, is car", "crs was not given, is"]),
    ):
        refused = run("map", *given, "--tile-size", 3.0, "--out", out, code=3)
        assert [word for word in words if word not in refused.output] == []
        assert [word for word in ("calibration", "tile_size", "{") if word in refused.output] == []
    assert files_in(out) == before
    shutil.copy(survey, moved)
    (out / "tiles.parquet").write_bytes(b"mine")
    assert "tiles.parquet has changed since" in run("map", moved, "--out", out).output
    (out / "tiles.parquet").unlink()
    assert "tiles.parquet is missing" in run("map", moved, "--out", out).output
    (out / "run.json").write_text('{"files": [{}]}')
    assert "run.json that cannot be read" in run("map", moved, "--out", out).output


def test_a_run_in_a_folder_that_another_run_writes_to_touches_nothing(survey, layers, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(layers, out)
    work, staged = out / ".bumpymap-run", out / ".bumpymap-layers-0"
    for folder in (work, staged):
        folder.mkdir()
        (folder / "run_spec.json").write_text("{}")
    with locked(out):
        before = inodes(out)
        refused = run("map", survey, "--out", out, "--overwrite", code=3)
        assert f"another run is writing to {out}: pid {os.getpid()} on " in refused.output
        assert inodes(out) == before


def test_products_that_are_links_are_replaced_and_not_followed(survey, layers, tmp_path):
    out, mine = tmp_path / "out", tmp_path / "mine"
    (mine / "folder").mkdir(parents=True)
    (mine / "raster.tif").write_text("mine")
    (mine / "folder" / "a").write_text("mine")
    before = inodes(mine)
    real = tmp_path / "real"
    real.mkdir()
    out.symlink_to(real)  # the user's own choice
    (real / "rasters").mkdir()
    (out / "rasters/roughness.tif").symlink_to(mine / "raster.tif")
    (out / "rasters/class.tif").symlink_to(mine / "none.tif")
    (out / "cost.fgb").symlink_to(mine / "folder")
    (out / ".bumpymap-layers-0").symlink_to(mine / "folder")
    (out / "rasters/class.tif.aux.xml").symlink_to(mine / "raster.tif")
    refused = run("map", survey, "--out", out, code=3)
    assert "already holds rasters/roughness.tif, rasters/class.tif, cost.fgb " in refused.output
    run("map", survey, "--out", out, "--overwrite", code=0)
    assert inodes(mine) == before
    assert layers_of(real) == layers_of(layers)
    assert not [path for path in real.rglob("*") if path.is_symlink()]


def test_without_a_crs_the_user_is_told_what_to_pass(site, tmp_path):
    file = write_las(tmp_path / "nowhere.laz", *site, crs=None)
    refused = run("map", file, "--out", tmp_path / "layers", code=3)
    assert "--crs" in refused.output
    assert "--local" in refused.output
    assert list((tmp_path / "layers").glob("*")) == []
    run("map", file, "--out", tmp_path / "local", "--local", code=0)
    with rasterio.open(tmp_path / "local" / "rasters/class.tif") as raster:
        assert raster.crs is None
    run("map", file, "--out", tmp_path / "given", "--crs", "EPSG:32614", code=0)
    assert pyogrio.read_info(tmp_path / "given" / "cost.fgb")["crs"] == "EPSG:32614"


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """What the demo makes of the sample survey."""
    out = tmp_path_factory.mktemp("demo")
    run("demo", "--out", out, code=0)
    return out


def test_the_demo_maps_the_sample_survey_and_runs_twice(demo):
    result = run("demo", "--out", demo, code=0)
    assert str(demo / "layers" / "map.qgs") in result.output
    assert (demo / "survey" / "quarry.laz").read_bytes() == QUARRY.read_bytes()
    refused = run("demo", "--out", QUARRY)
    assert (refused.exit_code, "cannot write the survey" in refused.output) == (3, True)
    assert str(demo / "layers" / "report.html") in result.output
    with rasterio.open(demo / "layers" / "rasters/class.tif") as raster:
        assert raster.crs.to_epsg() == 32632
        counts = np.bincount(raster.read(1).ravel(), minlength=256)
    assert counts[:4].min() > 50


@pytest.mark.later
def test_zones_of_the_sample_survey_are_rated_as_a_driver_would(demo):
    with rasterio.open(demo / "layers" / "rasters/roughness.tif") as raster:
        c_r, west, north = raster.read(1), raster.bounds.left, raster.bounds.top

    def median(symbol):
        col, row = tiles_of(symbol)
        return np.nanmedian(c_r[np.round(north / 3).astype(int) - 1 - row, col - np.round(west / 3).astype(int)])

    pad, road, washboard, ruts, rubble, bank = map(median, "PRWUXB")
    assert pad < road < washboard < ruts < rubble < bank
    assert road < 0.107 < ruts  # smooth; fair or worse
    assert rubble > 0.273  # rough or worse


@pytest.mark.parametrize(
    "place", ["survey.engine.run.decide_ground", "layers.write_products", "core.run_folder._remove"]
)
def test_a_killed_run_goes_on_and_ends_with_the_same_bits(survey, layers, tmp_path, limit_points, place):
    """When the points are read, when the tiles are measured, and when the layers are in place."""
    left = tmp_path / "left"
    limit_points(chunk=5_000, waiting=20_000, block=8_000)
    killed_at(place, left, survey)
    if place != "core.run_folder._remove":
        assert list(left.glob(".bumpymap-run/*"))
        other = run("map", survey, "--out", left, "--ground", "all", code=2)
        assert "\n  ground was auto, is all\n" in other.output
        assert "--overwrite to discard it" in other.output
    run("map", survey, "--out", left, code=0)
    assert layers_of(left) == layers_of(layers)
    assert not (left / ".bumpymap-run").exists()
