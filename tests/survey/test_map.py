"""The command line on files, good and bad: that change under a run, do not fit or have odd names; rasters, projects."""

import json
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pyarrow.parquet as pq
import pyogrio
import pytest
import rasterio
from click.testing import CliRunner
from made_drives import churned_field, write_bin
from made_quarry import tiles_of
from point_files import NORTH, WEST, ground, middles, write_raster
from pyproj import CRS, Transformer
from rasterio.transform import Affine
from small_surveys import band, files_in, killed_at, layers_of, run, write_las, write_survey

import bumpymap
from bumpymap import layers
from bumpymap.cli import main
from bumpymap.core import BadInputError, locked
from bumpymap.layers.products import EVERY_VIEW_NAME
from bumpymap.readers import PointStats, hash_survey, open_survey, scans as scan_files
from bumpymap.readers.las import LasSurvey
from bumpymap.scan import frames as scan_work
from bumpymap.scan.frames import FrameReader
from bumpymap.survey.engine.collector import ReadResult, ResultCollector
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
def complete(survey):
    out = survey.parent / "layers"
    run("map", survey, "--out", out, code=0)
    return out


def test_the_smooth_half_is_smoother_than_the_rubble(complete):
    with rasterio.open(complete / "rasters/roughness.tif") as raster:
        c_r = raster.read(raster.descriptions.index("c_r") + 1)
        assert c_r.shape == (10, 10)
        assert raster.bounds == (500_001, 4_000_002, 500_031, 4_000_032)
    class_id = band(complete / "rasters/class.tif")
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
def test_a_run_that_is_complete_is_done_already(complete, survey, extra):
    before = inodes(complete)
    again = run("map", survey, "--out", complete, *extra, code=0)
    assert "Already done" in again.output
    assert "60,000 points, 100 tiles" in again.output
    assert json.loads(run("map", survey, "--out", complete, *extra, "--json").stdout)["already_done"] is True
    assert inodes(complete) == before


def test_layers_that_a_gis_saved_its_styles_and_statistics_beside_are_still_a_complete_run(
    survey, tmp_path, monkeypatch
):
    """As QGIS leaves them; views that are deleted are not missed, and overwriting brings them back."""
    monkeypatch.setattr("bumpymap.views.write_map_views", write_map_views)
    out = tmp_path / "viewed"
    run("map", survey, "--out", out, code=0)
    made = files_in(out)
    for name in EVERY_VIEW_NAME:
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
    for name in EVERY_VIEW_NAME:
        (out / name).unlink(missing_ok=True)
    assert "Already done" in run("map", survey, "--out", out).output
    (out / "rasters/headings.tif").write_text("of an earlier version")
    run("map", survey, "--out", out, "--overwrite", code=0)
    assert not (out / "rasters/headings.tif").exists()
    for name in ("rasters/class.qml", "map.qgs"):
        assert (out / name).read_bytes() == made[name]
    assert not (out / "rasters/roughness.tif.aux.xml").exists()


def test_a_complete_run_of_something_else_says_what_differs(site, complete, survey, tmp_path):
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


def test_a_run_in_a_folder_that_another_run_writes_to_touches_nothing(survey, complete, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(complete, out)
    work, staged = out / ".bumpymap-run", out / ".bumpymap-layers-0"
    for folder in (work, staged):
        folder.mkdir()
        (folder / "run_spec.json").write_text("{}")
    with locked(out):
        before = inodes(out)
        refused = run("map", survey, "--out", out, "--overwrite", code=3)
        assert f"another run is writing to {out}: pid {os.getpid()} on " in refused.output
        assert inodes(out) == before


def test_products_that_are_links_are_replaced_and_not_followed(survey, complete, tmp_path):
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
    assert layers_of(real) == layers_of(complete)
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
def test_a_killed_run_goes_on_and_ends_with_the_same_bits(survey, complete, tmp_path, limit_points, place):
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
    assert layers_of(left) == layers_of(complete)
    assert not (left / ".bumpymap-run").exists()


def write_site(path, lift=0.0, east=0.0):
    rng = np.random.default_rng(0)
    x, y = rng.uniform(500_001 + east, 500_016 + east, 20_000), rng.uniform(4_000_002, 4_000_017, 20_000)
    return write_las(path, x, y, 100 + lift + 0.01 * rng.standard_normal(20_000))


def again(path, write):
    """Write a file again, at a later moment."""
    before = path.stat().st_mtime_ns
    write(path)
    os.utime(path, ns=(0, before + 1_000_000_000))


@pytest.fixture
def changing(tmp_path):
    return write_site(tmp_path / "site.las")


@pytest.fixture
def lifted_when_read(changing, monkeypatch):
    """The survey is written again, 5 m higher, as soon as its first piece was read."""
    original, done = LasSurvey.fetch, []

    def fetch(self, chunk):
        fetched = original(self, chunk)
        if self.info.path == changing and not done:
            done.append(chunk)
            again(changing, lambda path: write_site(path, lift=5.0))
        return fetched

    monkeypatch.setattr(LasSurvey, "fetch", fetch)
    return changing


def refused(result, path, out):
    assert result.exit_code == 3, result.output
    assert result.output.count("Error: ") == 1
    assert f"{path} changed while" in result.output
    assert "Traceback" not in result.output
    assert not out.exists()


def test_map_refuses_a_survey_that_changes_while_it_is_read(lifted_when_read, tmp_path):
    out = tmp_path / "layers"
    refused(run("map", lifted_when_read, "--out", out), lifted_when_read, out)


def test_map_goes_on_without_it_where_it_may(lifted_when_read, tmp_path):
    other = write_site(tmp_path / "other.las", east=15.0)
    out = tmp_path / "layers"
    run("map", lifted_when_read, other, "--out", out, "--skip-bad", code=4)
    record = json.loads((out / "run.json").read_text(encoding="utf-8"))
    assert [entry["path"] for entry in record["inputs"]] == [str(other)]
    assert "changed while it was read" in record["skipped"][str(lifted_when_read)]


def test_the_checksum_is_that_of_the_file_that_was_read(changing, tmp_path, monkeypatch):
    """Also if another one is in its place when the layers are written."""
    state, checksum, original = changing.stat(), hash_survey(changing), layers.write_products

    def write_products(*arguments, **options):
        again(changing, lambda path: write_site(path, lift=5.0))
        return original(*arguments, **options)

    monkeypatch.setattr(layers, "write_products", write_products)
    run("map", changing, "--out", tmp_path / "layers", code=0)
    (record,) = json.loads((tmp_path / "layers" / "run.json").read_text(encoding="utf-8"))["inputs"]
    assert record["checksum"] == checksum != hash_survey(changing)
    assert (record["bytes"], record["mtime_ns"]) == (state.st_size, str(state.st_mtime_ns))


def write_frame(path, lift=0.0):
    return write_bin(path, churned_field(1, 30_000) + np.array([0.0, 0.0, lift]))


@pytest.mark.parametrize(
    ("owner", "moment", "name"),
    [(FrameReader, "read", "a.bin"), (scan_work, "report_frame", "a.bin"), (scan_files, "read_range", "a.label")],
)
def test_scan_refuses_a_frame_or_its_labels_that_change(tmp_path, monkeypatch, owner, moment, name):
    """While they are read, or between that and the checksum."""
    frame, changing, out = write_frame(tmp_path / "a.bin"), tmp_path / name, tmp_path / "out"
    np.zeros(30_000, "<u4").tofile(tmp_path / "a.label")
    other = write_frame(tmp_path / "other", lift=5.0) if name == "a.bin" else tmp_path / "a.bin"
    content, original = other.read_bytes()[: changing.stat().st_size], getattr(owner, moment)

    def change_before(*arguments):
        if moment != "read_range" or arguments[0] == changing:
            again(changing, lambda path: path.write_bytes(content))
        return original(*arguments)

    monkeypatch.setattr(owner, moment, change_before)
    refused(run("scan", frame, "--out", out), changing, out)


def test_ranges_that_workers_read_of_several_versions_are_no_file(changing):
    """Copies on two machines may differ in the time of their writing; what one machine reads must not."""
    reader = open_survey(changing)
    (chunk,) = reader.chunks()
    stats = reader.convert(chunk, reader.fetch(chunk)).stats
    one, two = ({"size": 7, "mtime_ns": text} for text in "12")

    def add(*seen):
        def refuse(_, error):
            raise error

        checkpoints = Mock(early=[], load_results=list)
        collector = ResultCollector([reader], [len(seen)], checkpoints, refuse)
        for number, place in enumerate(seen):
            own = stats if number == 0 else PointStats()
            collector.add(ReadResult(((0, number, number + 1),), {0: own}, seen={} if place is None else {0: place}))
        return collector

    assert add(("a", one), ("b", two), ("a", one), None).stats[0] == stats
    with pytest.raises(BadInputError, match=r"site\.las changed while it was read: workers on a saw several versions"):
        add(("a", one), ("b", two), ("a", two))


HERE = (480_717.0, 2_135_914.0)


def cloud(path, place=HERE, *, height=100.0, factor=1.0, more=(), count=2_000):
    """Level ground of 30 m x 30 m with a noise of 2 cm; ``more``: points at other places."""
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(0.0, 30.0, (count, 2)) + place, rng.normal(height, 0.02, count) * factor])
    x, y, z = np.concatenate([points, np.array(more).reshape(-1, 3)]).T
    return write_las(path, x, y, z, crs=None, offset=(x.min(), y.min(), 0.0), scales=(0.01,) * 3)


def told(files, tmp_path):
    """Return what info and map say of files in UTM zone 14, and the exit code of map."""
    words = (*files, "--crs", "EPSG:32614")
    facts = json.loads(run("info", *words, "--quick", "--json").stdout)
    return facts["doubts"], run("map", *words, "--out", tmp_path / "out")


@pytest.mark.parametrize(
    ("second", "says", "code"),
    [
        ({"place": (HERE[0] + 30.0, HERE[1]), "height": 130.0}, "of another datum", 0),
        ({"place": (HERE[0] + 30.0, HERE[1]), "factor": 1 / 0.3048}, "in feet", 0),
        ({"place": (0.0, 0.0)}, "at the origin (0, 0): leave it out?", 3),
        ({"place": (HERE[0] + 400_000.0, HERE[1])}, "lies 400 km from all other files: leave it out?", 3),
        ({"more": [(0.0, 0.0, 0.0)] * 9}, "some lie at the origin (0, 0)", 3),
        ({"more": [(HERE[0], 5e6, 100.0)]}, "there may be stray coordinates", 3),
    ],
    ids=["datum", "feet", "origin", "far", "points at the origin", "stray"],
)
def test_a_file_that_does_not_fit_is_named_with_the_evidence(tmp_path, second, says, code):
    files = cloud(tmp_path / "a.las"), cloud(tmp_path / "b.las", **second)
    doubts, mapped = told(files, tmp_path)
    assert any(says in doubt and "b.las" in doubt for doubt in doubts), doubts
    assert (mapped.exit_code, says in mapped.stderr) == (code, True)


def test_files_that_fit_are_not_doubted(tmp_path):
    beside = cloud(tmp_path / "b.las", (HERE[0] + 30.0, HERE[1]), height=104.0)
    below = cloud(tmp_path / "c.las", (HERE[0] + 90.0, HERE[1]), height=180.0)  # not beside them
    doubts, mapped = told([cloud(tmp_path / "a.las"), beside, below], tmp_path)
    assert (doubts, mapped.exit_code, "heights" in mapped.stderr) == ([], 0, False)


NAME = os.fsdecode(b"caf\xe9")
ENVIRONMENT = {"LANG": "C", "LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}


@pytest.fixture
def folder(tmp_path):
    """A folder whose own name is no UTF-8 either."""
    path = tmp_path / NAME
    try:
        path.mkdir()
    except OSError:
        pytest.skip("this file system takes UTF-8 names alone")
    return path


def run_in_c_locale(code, *arguments):
    """The command in a process of its own, whose streams have the encoding of the locale; gives its two outputs."""
    if not bumpymap.__file__.isascii() or not sys.prefix.isascii():
        pytest.skip("in this locale Python reads no .pth file, and pyproj no data, under a path that is not ASCII")
    words = [sys.executable, "-c", "from bumpymap.cli import main; main()", *map(str, arguments)]
    result = subprocess.run(words, env=os.environ | ENVIRONMENT, capture_output=True, timeout=300, check=False)
    told, warned = result.stdout.decode("utf-8", "replace"), result.stderr.decode("utf-8", "replace")
    assert result.returncode == code, warned
    assert "Traceback" not in warned
    return told, warned


def test_map_and_info(folder, tmp_path):
    good, bad, out = write_survey(folder / f"{NAME}.las"), folder / f"{NAME} bad.las", folder / f"{NAME} out"
    bad.write_bytes(b"LASF" + bytes(500))
    told, warned = run_in_c_locale(3, "info", bad, good, "--json")
    assert "caf" in warned
    assert Path(json.loads(told)["files"][-1]["path"]) == good
    assert "caf" in run_in_c_locale(4, "map", bad, good, "--skip-bad", "--out", out)[1]
    record = json.loads((out / "run.json").read_text(encoding="utf-8"))
    assert [Path(entry["path"]) for entry in record["inputs"]] == [good]
    assert [Path(path) for path in record["skipped"]] == [bad]
    run("map", good, "--out", tmp_path / "plain", code=0)
    mine, plain = (layers_of(folder) | {"item.json": b"lists views"} for folder in (out, tmp_path / "plain"))
    assert mine == plain


def test_scan(folder):
    """A name that looks like an escaped one is that of another frame."""
    frames = [write_frame(folder / f"{name}.bin") for name in (NAME, "caf%E9", "b")]
    poses, out = folder / "poses.txt", folder / f"{NAME} out"
    poses.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 3)
    placed = ("--poses", poses, "--crs", "EPSG:32614")
    run_in_c_locale(0, "scan", *frames, *placed, "--method", "filter", "--pictures", "--out", out)
    record = json.loads((out / "scan.json").read_text(encoding="utf-8"))
    by_path = {Path(frame["path"]): frame["name"] for frame in record["frames"]}
    assert set(by_path) == set(frames)
    names = set(by_path.values())
    assert len(names) == 3
    assert set(pq.read_table((out / "sectors.parquet").open("rb"))["frame"].to_pylist()) == names
    assert {path.name for path in (out / "frames").iterdir()} == {
        f"{name}.{ending}" for name in names for ending in ("ply", "png")
    }
    assert rasterio.open((out / "map" / "rasters/class.tif").open("rb")).width > 0


# ---- what drone software writes ----


HEIGHTS = ground().astype(np.float32)
MIDDLE = WEST + 14.0


def map_to(out, *arguments):
    return run("map", *arguments, "--out", out, "--threads", 1, code=0).output


def cloud_of_heights(path):
    x, y = (side.ravel() for side in middles(HEIGHTS.shape))
    return write_las(path, x, y, HEIGHTS.astype(np.float64).round(2).ravel(), scales=(0.001, 0.001, 0.01))


def test_a_dsm_is_mapped_as_its_pixels_would_be_as_points(tmp_path):
    half = len(HEIGHTS) // 2
    write_raster(tmp_path / "dsm" / "north.tif", HEIGHTS[:half], compress="deflate")
    south = Affine(0.2, 0, WEST, 0, -0.2, NORTH - 0.2 * half)
    write_raster(
        tmp_path / "dsm" / "south.tif", HEIGHTS[half:], transform=south, tiled=True, blockxsize=16, blockysize=16
    )
    map_to(tmp_path / "by_points", cloud_of_heights(tmp_path / "site.laz"))
    map_to(tmp_path / "by_dsm", tmp_path / "dsm")
    found, wanted = (pq.read_table(tmp_path / out / "tiles.parquet").to_pylist() for out in ("by_dsm", "by_points"))
    assert str(found) == str(wanted)  # NaN too
    record = json.loads((tmp_path / "by_dsm" / "run.json").read_text())
    assert "GeoTIFF (DSM), float32, pixels of 0.2 m" in record["inputs"][0]["format"]
    assert any("a DSM has one height for each pixel" in warning for warning in record["warnings"])
    assert record["inputs"][0]["dropped"]["not_a_number"] == 0


def test_a_dtm_is_measured_from_ground_and_bars_nothing_by_an_obstacle(tmp_path):
    layers = bumpymap.map_survey(write_raster(tmp_path / "dtm.tif", HEIGHTS), tmp_path / "out", dtm=True, threads=1)
    assert layers.manifest["ground_only"]
    assert layers.manifest["settings"]["dtm"]


def colours(easting, northing):
    """Red in the west, blue in the east, with a green that grows to the north, (3, ...), 8 bits."""
    green = np.clip((northing - NORTH + 30.0) * 8.0, 0, 255)
    return np.stack([200 * (easting < MIDDLE), green, 200 * (easting >= MIDDLE)]).astype(np.uint8)


def ortho(path, crs="EPSG:32614", alpha=False, scale=1, dtype="uint8"):
    """Pixels of about 5 cm over the site and 3 m around it."""
    step = 0.05 if crs == "EPSG:32614" else 4.5e-7
    west, north = Transformer.from_crs("EPSG:32614", crs, always_xy=True).transform(WEST - 3, NORTH + 3)
    row, col = np.mgrid[:760, :760] + 0.5
    x, y = west + col * step, north - row * step
    bands = colours(*Transformer.from_crs(crs, "EPSG:32614", always_xy=True).transform(x, y)).astype(dtype) * scale
    if alpha:
        bands = np.concatenate([bands, (255 * (row > 300))[None].astype(dtype)])
    how = {"photometric": "RGB", **({"alpha": "YES"} if alpha else {})}
    return write_raster(path, bands, crs=crs, transform=Affine(step, 0, west, 0, -step, north), **how)


def photo_of(out):
    """Colours (3, n) and whether they are known (n,), with those wanted, of pixels of photo.tif off the border."""
    with rasterio.open(out / "rasters" / "photo.tif") as file:
        (step, _, west, _, down, north), sides = file.transform[:6], (file.width, file.height)
        x, y = np.meshgrid(
            *(
                start + by * (np.arange(n) + 0.5)
                for start, by, n in zip((west, north), (step, down), sides, strict=True)
            )
        )
        inside = (np.abs(x - MIDDLE) > 1) & (x > WEST + 3) & (x < WEST + 25) & (y < NORTH - 3) & (y > NORTH - 25)
        return file.read((1, 2, 3))[:, inside], file.dataset_mask()[inside], colours(x[inside], y[inside]), y[inside]


@pytest.mark.parametrize(
    "how", [{}, {"crs": "EPSG:4326"}, {"dtype": "uint16", "scale": 256}, {"dtype": "uint16", "scale": 16}], ids=str
)
def test_an_orthophoto_of_any_crs_and_depth_is_the_photo_of_a_cloud_without_colours(tmp_path, how):
    map_to(tmp_path / "out", cloud_of_heights(tmp_path / "site.laz"), "--photo", ortho(tmp_path / "ortho.tif", **how))
    found, known, wanted, _ = photo_of(tmp_path / "out")
    assert known.all()
    assert np.abs(found.astype(int) - wanted).max() < 25  # JPEG


def test_what_an_orthophoto_leaves_out_is_not_known(tmp_path):
    map_to(
        tmp_path / "out", cloud_of_heights(tmp_path / "site.laz"), "--photo", ortho(tmp_path / "ortho.tif", alpha=True)
    )
    _, known, _, northing = photo_of(tmp_path / "out")
    edge = NORTH + 3 - 15.0
    assert not known[northing > edge + 1].any()
    assert known[northing < edge - 1].all()


def test_another_orthophoto_is_another_map_and_the_same_one_is_done(tmp_path):
    site, photo = cloud_of_heights(tmp_path / "site.laz"), ortho(tmp_path / "ortho.tif")
    map_to(tmp_path / "out", site, "--photo", photo)
    assert "Already done" in map_to(tmp_path / "out", site, "--photo", photo)
    ortho(photo, alpha=True)
    outcome = run("map", site, "--photo", photo, "--out", tmp_path / "out")
    assert (outcome.exit_code, "photo was" in outcome.output) == (3, True)


PHOTOS = {
    "grey": (lambda p: write_raster(p, np.zeros((8, 8), np.uint8)), "1 band of uint8"),
    "floats": (lambda p: write_raster(p, np.zeros((3, 8, 8), np.float32)), "3 bands of float32"),
    "nowhere": (lambda p: write_raster(p, np.zeros((3, 8, 8), np.uint8), transform=Affine.identity()), "where it lies"),
    "elsewhere": (
        lambda p: write_raster(p, np.zeros((3, 8, 8), np.uint8), transform=Affine(1, 0, WEST + 900, 0, -1, NORTH)),
        "lies beside the survey",
    ),
    "no raster": (lambda p: p.write_bytes(b"II*\0" + bytes(99)) and p, "cannot read"),
    "missing": (lambda p: p, "cannot read"),
}


@pytest.mark.parametrize("name", PHOTOS)
def test_what_is_no_orthophoto_of_the_site_is_refused_before_the_points_are_read(tmp_path, name):
    write, why = PHOTOS[name]
    outcome = run(
        "map", cloud_of_heights(tmp_path / "a.laz"), "--photo", write(tmp_path / "o.tif"), "--out", tmp_path / "out"
    )
    assert (outcome.exit_code, why in outcome.output, (tmp_path / "out").exists()) == (3, True, False), outcome.output


def test_a_project_of_odm_is_mapped_as_it_is_with_its_orthophoto(tmp_path):
    odm = tmp_path / "site"
    cloud_of_heights(odm / "odm_georeferencing" / "odm_georeferenced_model.laz")
    ortho(odm / "odm_orthophoto" / "odm_orthophoto.tif")
    write_raster(odm / "odm_dem" / "dsm.tif", HEIGHTS + 1.0)
    said = " ".join(map_to(tmp_path / "out", odm).split())
    assert "odm_georeferencing/odm_georeferenced_model.laz and odm_orthophoto/odm_orthophoto.tif" in said
    assert photo_of(tmp_path / "out")[1].all()
    assert "orthophoto: " in run("info", odm).output
    assert json.loads(CliRunner().invoke(main, ["info", str(odm), "--json"]).stdout)["photo"]


def test_rasters_beside_a_cloud_are_named_and_not_mapped(tmp_path):
    cloud_of_heights(tmp_path / "site" / "cloud.laz")
    dsm = write_raster(tmp_path / "site" / "dsm.tif", HEIGHTS + 1.0)
    photo = ortho(tmp_path / "site" / "ortho.tif")
    said = " ".join(map_to(tmp_path / "out", tmp_path / "site", "--photo", photo).split())
    assert f"not mapped, since the folder holds point clouds: {dsm}. Give a DSM by its own path" in said
    assert "not mapped" not in map_to(tmp_path / "alone", tmp_path / "site" / "cloud.laz")


@pytest.mark.realdata
def test_the_two_commands_from_a_pcd_to_nav2_on_a_real_cloud(tmp_path, shared_data):
    page = (Path(__file__).parents[2] / "docs" / "pages" / "slam-to-nav2.md").read_text()
    cloud_of_robot = shared_data / "scans" / "patchwork_128ch" / "000000.pcd"
    for line in page.split("```")[1].strip().splitlines():
        words = [str(tmp_path / word) if word.startswith("slam_") else word for word in shlex.split(line)[1:]]
        run(*(str(cloud_of_robot) if word == "slam.pcd" else word for word in words), code=0)
    datum = json.loads((tmp_path / "slam_nav2" / "datum.json").read_text())
    assert (datum["datum"]["x"], datum["datum"]["y"]) == (0.0, 0.0)
    assert "map.pgm" in (tmp_path / "slam_nav2" / "map.yaml").read_text()
