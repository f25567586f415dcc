"""A scan run from Python: what it writes, its threads, what it leaves when it ends early, and the map of a drive."""

import hashlib
import json
import os
import re
import shutil
import threading
from dataclasses import replace
from functools import partial

import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest
import rasterio
from made_drives import write_bin
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from small_surveys import SIDES

from bumpymap.core import BadInputError, OutputError, PolarSettings, Robot, SilentProgress, UsageError
from bumpymap.layers import part_path
from bumpymap.layers.products import EVERY_VIEW_NAME, PRODUCT_NAMES
from bumpymap.readers import read_scan
from bumpymap.scan.classifier import choose_method
from bumpymap.scan.config import ScanConfig
from bumpymap.scan.pipeline import scan_frames as scan_alone
from bumpymap.survey import map_surveys

pytestmark = pytest.mark.slow
scan_frames = partial(scan_alone, mapper=map_surveys)

POSES = [
    (Rotation.from_euler("zyx", (0.4, 0.02, -0.03)), np.array([1003.0, 2001.0, 51.5])),
    (Rotation.from_euler("zyx", (2.6, -0.04, 0.01)), np.array([1007.5, 2004.0, 51.5])),
    (Rotation.from_euler("zyx", (1.1, 0.01, 0.03)), np.array([1005.0, 2002.0, 51.5])),
]


def world(count=50_000, seed=0):
    """Points of the ground around all poses: waves, with rubble in the north."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(995.0, 1016.0, count), rng.uniform(1992.0, 2013.0, count)
    bumps = np.where(y > 2006.0, 0.3 * np.sin(9.0 * x) * np.sin(8.0 * y), 0.0) + 0.003 * rng.standard_normal(count)
    return np.column_stack([x, y, 50.0 + 0.1 * np.sin(x / 3.0) + bumps])


def write_poses(path, poses=POSES):
    rows = [np.column_stack([turn.as_matrix(), place]).ravel() for turn, place in poses]
    np.savetxt(path, rows, fmt="%.12g")
    return path


@pytest.fixture(name="drive", scope="module")
def drive_fixture(tmp_path_factory):
    """Three frames of one ground, and their poses."""
    folder = tmp_path_factory.mktemp("drive")
    for number, (turn, place) in enumerate(POSES):
        seen = turn.inv().apply(world() - place)
        write_bin(folder / "frames" / f"{number}.bin", seen)
    write_poses(folder / "poses.txt")
    return folder


@pytest.fixture(name="mapped", scope="module")
def mapped_fixture(drive, tmp_path_factory):
    out = tmp_path_factory.mktemp("mapped") / "out"
    config = ScanConfig(
        (drive / "frames",), out, poses=drive / "poses.txt", crs="EPSG:32614", method="filter", pictures=1, threads=1
    )
    return out, scan_frames(config), config


def files(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def checksums(folder):
    return {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in files(folder)}


def products(folder):
    """Checksums of all files but those that say how long it took, and where it lies."""
    return {name: held for name, held in checksums(folder).items() if name not in {"scan.json", "map/run.json"}}


def test_a_run_writes_every_product_and_nothing_else(mapped):
    out, result, _ = mapped
    frames = [f"frames/{number}.{ending}" for number in range(3) for ending in ("ply", "png")]
    layers = [*PRODUCT_NAMES, *EVERY_VIEW_NAME, *SIDES]
    whole = [*frames, "gathered.laz", "scan.json", "sectors.parquet", *(f"map/{name}" for name in layers)]
    assert files(out) == sorted(whole)
    assert result.files == ("frames", "sectors.parquet", "gathered.laz", "scan.json")


def test_the_manifest_is_enough_to_repeat_the_run(drive, mapped):
    out, _, config = mapped
    record = json.loads((out / "scan.json").read_text(encoding="utf-8"))
    assert record["settings"]["polar"]["rings"] == list(config.polar.rings)
    assert (record["settings"]["robot"]["radius_m"], record["method"]["name"]) == (0.5, "filter")
    assert "numpy" in record["versions"]
    assert [file["path"] for file in record["files"]] == ["sectors.parquet", "gathered.laz"]
    for file in record["files"]:
        assert file["sha256"] == hashlib.sha256((out / file["path"]).read_bytes()).hexdigest()
    table = pq.read_table(out / "sectors.parquet", columns=["frame", "points"]).to_pylist()
    for number, frame in enumerate(record["frames"]):
        path = drive / "frames" / f"{number}.bin"
        assert (frame["name"], frame["path"], frame["bytes"]) == (str(number), str(path), path.stat().st_size)
        assert frame["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
        assert frame["points"] + frame["dropped"]["on_robot"] == 50_000
        assert sum(frame["points_by_class"].values()) == frame["points"]
        rows = [row for row in table if row["frame"] == str(number)]
        assert sum(frame["sectors"].values()) == len(rows) > 0
        turn, place = POSES[number]
        assert np.allclose(frame["pose"], np.vstack([np.column_stack([turn.as_matrix(), place]), [0, 0, 0, 1]]))
    assert set(record["seconds"]) == {"prepare", "scan"}


def test_one_ground_seen_from_all_poses_lands_in_one_place(mapped):
    out, result, _ = mapped
    las = laspy.read(out / "gathered.laz")
    ground = las.classification == 2
    # Every gathered point is one of the ground's own, wherever it was seen from; its height may be corrected.
    assert cKDTree(world()).query(las.xyz)[0].max() < 0.01
    assert cKDTree(world()[:, :2]).query(las.xyz[:, :2])[0].max() < 0.00075
    assert result.merged["poses"]["misfits"] == []
    tiles = pq.read_table(out / "map" / "tiles.parquet", columns=["col", "row", "count"]).to_pydict()
    expected = {tuple(place) for place in np.floor(las.xyz[ground, :2] / 3.0).astype(int).tolist()}
    assert set(zip(tiles["col"], tiles["row"], strict=True)) >= expected
    assert sum(tiles["count"]) == result.drive.summary.points
    assert result.drive.ground_only


def test_the_map_of_a_drive_has_the_ground_at_its_height_and_the_crs_of_the_poses(mapped):
    with rasterio.open(mapped[0] / "map" / "rasters/heightmap.tif") as file:
        assert file.crs.to_epsg() == 32614
        heights = file.read(1)
        rows, columns = np.nonzero(np.isfinite(heights))
        x, y = (np.asarray(axis) for axis in rasterio.transform.xy(file.transform, rows, columns))
    smooth = y < 2005.5
    off = heights[rows, columns][smooth] - (50.0 + 0.1 * np.sin(x[smooth] / 3.0))
    assert smooth.sum() > 3000
    assert np.abs(off).max() < 0.03
    tiles = pq.read_table(mapped[0] / "map" / "tiles.parquet", columns=["row", "c_r"]).to_pandas().dropna()
    north = 3.0 * tiles["row"]
    assert tiles["c_r"][north > 2006.0].mean() > 4.0 * tiles["c_r"][north < 2001.0].mean()


class _Ends(SilentProgress):
    """Ends the run after a number of frames."""

    def __init__(self, after):
        self.left = after

    def advance(self, steps):
        self.left -= steps
        if self.left <= 0:
            raise KeyboardInterrupt


@pytest.fixture
def done_frames(monkeypatch):
    """Names of the frames that are read."""
    read = []
    reading = "bumpymap.scan.frames.read_scan"
    monkeypatch.setattr(reading, lambda path, *rest: read.append(path.stem) or read_scan(path, *rest))
    return read


def test_poses_that_change_during_the_run_are_not_recorded_as_those_that_were_used(drive, tmp_path):
    poses = write_poses(tmp_path / "poses.txt")
    config = ScanConfig((drive / "frames",), tmp_path / "out", poses=poses, method="filter", products=("table",))

    class _Changes(_Ends):
        def advance(self, steps):
            write_poses(poses, [(turn, place + 1.0) for turn, place in POSES])

    with pytest.raises(BadInputError, match=r"poses\.txt.*changed"):
        scan_frames(config, _Changes(0))
    assert not (config.out / "scan.json").exists()


@pytest.mark.parametrize(("after", "older"), [(1, False), (2, True)])
def test_an_interrupted_run_goes_on_and_an_older_one_is_as_it_was(drive, mapped, tmp_path, done_frames, after, older):
    out = tmp_path / "out"
    config = replace(mapped[2], out=out)
    if older:
        scan_frames(ScanConfig((drive / "frames" / "0.bin",), out, method="filter"))
    before = checksums(out) if older else {}
    with pytest.raises(KeyboardInterrupt) as end:
        scan_frames(replace(config, overwrite=older), _Ends(after))
    assert end.value.__notes__ == ["Run the same again to continue from the finished frames."]
    assert {name: sum_ for name, sum_ in checksums(out).items() if not name.startswith(".")} == before
    assert (out / ".bumpymap-run").is_dir()
    with pytest.raises(UsageError, match="products was table, cloud, is table"):
        scan_frames(replace(config, products=("table",)))
    done_frames.clear()
    result = scan_frames(config)
    assert not set(done_frames) & set(["0", "1", "2"][:after])  # others may have been finished ahead
    assert [frame["name"] for frame in result.frames] == ["0", "1", "2"]
    assert products(out) == products(mapped[0])


def inodes(folder):
    return {str(path): (path.stat().st_ino, path.stat().st_mtime_ns) for path in folder.rglob("*") if path.is_file()}


def test_a_run_that_is_complete_is_done_already(drive, mapped, done_frames):
    out, first, config = mapped
    before = inodes(out)
    for extra in ({}, {"skip_bad": True}):
        again = scan_frames(replace(config, **extra))
        assert again.already_done
        assert (again.files, again.method, again.skipped) == (first.files, first.method, first.skipped)
        assert again.frames == first.frames
        assert repr(again.drive.summary) == repr(first.drive.summary)
    assert done_frames == []
    assert inodes(out) == before


def test_a_complete_run_of_something_else_says_what_differs(drive, tmp_path):
    shutil.copytree(drive, tmp_path / "drive")
    frames = tmp_path / "drive" / "frames"
    config = ScanConfig((frames,), tmp_path / "out", method="filter")
    labels = np.full((frames / "0.bin").stat().st_size // 16, 40, "<u4")
    labels.tofile(frames / "0.label")
    scan_frames(config)
    before = checksums(tmp_path / "out")
    os.utime(frames / "0.bin")
    assert scan_frames(config).already_done
    for other, words in (
        (replace(config, robot=Robot(1.0)), "robot.radius_m was 0.5, is 1.0"),
        (replace(config, frames=(frames / "0.bin",)), "1.bin was an input, but is not given now"),
        (replace(config, poses=drive / "poses.txt"), "poses.txt is given now, but was not an input"),
    ):
        with pytest.raises(
            OutputError, match=f"(?s)already holds a complete run.*{re.escape(words)}.*`overwrite=True`"
        ):
            scan_frames(other)
    np.full_like(labels, 48).tofile(frames / "0.label")
    with pytest.raises(OutputError, match=r"\.label has changed since"):
        scan_frames(config)
    labels.tofile(frames / "0.label")
    write_bin(frames / "0.bin", world()[::-1] - POSES[0][1])
    with pytest.raises(OutputError, match=r"0\.bin has changed since"):
        scan_frames(config)
    assert checksums(tmp_path / "out") == before


def test_a_failure_of_the_map_leaves_the_frames_and_the_next_run_maps(
    drive, mapped, tmp_path, monkeypatch, done_frames
):
    out = tmp_path / "out"
    config = replace(mapped[2], out=out)

    def full(*_, **__):
        raise OutputError("No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("bumpymap.layers.folder.write_raster", full)
        with pytest.raises(OutputError, match="No space left") as failed:
            scan_frames(config)
    assert failed.value.__notes__ == [
        "The products of the frames are complete; the map of the drive is missing. Run the same again to make it."
    ]
    done_frames.clear()
    result = scan_frames(config)
    assert done_frames == []
    assert not result.already_done
    assert products(out) == products(mapped[0])


def test_products_that_are_links_are_replaced_and_not_followed(drive, mapped, tmp_path):
    out, mine = tmp_path / "out", tmp_path / "mine"
    (mine / "frames").mkdir(parents=True)
    for name in ("frames/0.ply", "run.json", "class.tif"):
        (mine / name).write_text("mine")
    before = inodes(mine)
    out.mkdir()
    for name, target in (("frames", "frames"), ("map", "."), ("gathered.laz", "class.tif"), ("scan.json", "none")):
        (out / name).symlink_to(mine / target)
    config = replace(mapped[2], out=out)
    with pytest.raises(OutputError, match=r"scan\.json that cannot be read"):
        scan_frames(replace(config, poses=None, crs=None))
    scan_frames(replace(config, overwrite=True))
    assert inodes(mine) == before
    assert not [path for path in out.rglob("*") if path.is_symlink()]
    assert products(out) == products(mapped[0])


def test_bad_frames_are_skipped_with_a_word_and_the_poses_of_the_others_stay_theirs(drive, tmp_path, caplog):
    for number in (0, 1):
        (tmp_path / f"{2 * number}.bin").write_bytes((drive / "frames" / f"{number}.bin").read_bytes())
    (tmp_path / "1.bin").write_bytes(b"123")
    write_poses(tmp_path / "poses.txt", [POSES[0], POSES[0], POSES[1]])
    config = ScanConfig((tmp_path,), tmp_path / "out", poses=tmp_path / "poses.txt", method="filter", products=())
    with pytest.raises(BadInputError, match=r"1\.bin has 3 bytes") as failed:
        scan_frames(config)
    assert failed.value.__notes__ == [
        "`skip_bad=True` goes on without such frames.",
        "Run the same again to continue from the finished frames.",
    ]
    result = scan_frames(replace(config, skip_bad=True))
    assert list(result.skipped) == [str(tmp_path / "1.bin")]
    assert "skipped" in caplog.text
    assert [frame["name"] for frame in result.frames] == ["0", "2"]
    np.testing.assert_array_equal(np.array(result.frames[1]["pose"])[:3, 3], POSES[1][1])
    record = json.loads((tmp_path / "out" / "scan.json").read_text(encoding="utf-8"))
    assert list(record["skipped"]) == [str(tmp_path / "1.bin")]
    assert files(tmp_path / "out")[0] == "gathered.laz"


def test_an_empty_frame_is_skipped_and_a_map_of_many_scans_is_sent_to_map(drive, tmp_path, caplog):
    scans = tmp_path / "scans"
    write_bin(scans / "0.bin", world() - POSES[0][1])
    (scans / "1.bin").write_bytes(b"")
    config = ScanConfig((scans,), tmp_path / "out", method="filter", products=("table",))
    assert list(scan_frames(config).skipped) == [str(scans / "1.bin")]
    assert "1.bin is empty" in caplog.text
    assert "bumpymap map" not in caplog.text
    even = np.random.default_rng(3).uniform(-50.0, 50.0, (30_000, 3)) * [1.0, 1.0, 0.001] - [0.0, 0.0, 1.0]
    cloud = write_bin(tmp_path / "slam cloud.bin", even)
    scan_frames(replace(config, frames=(cloud,), out=tmp_path / "far"))
    assert f"bumpymap map '{cloud}' --local" in caplog.text


def test_nothing_but_bad_frames_is_a_failure_that_names_some(tmp_path):
    for number in range(7):
        (tmp_path / f"{number}.bin").write_bytes(b"123")
    config = ScanConfig((tmp_path,), tmp_path / "out", skip_bad=True, method="filter")
    with pytest.raises(BadInputError, match=r"(?s)none of the frames could be read.*4\.bin.*2 more"):
        scan_frames(config)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("points", "why"),
    [
        (np.zeros((50, 3)), r"it holds no points: 50 returns at \(0, 0, 0\)"),
        (np.tile([np.nan, 6.0, -1.0], (400, 1)), "400 not finite"),
        (np.array([[0.7, 0.0, -1.0]] * 60), "0 of 60 points lie 1 to 100 m"),
        (np.column_stack([np.full(200, 6.0), np.linspace(-0.5, 0.5, 200), np.linspace(-1, 3, 200)]), "z axis point up"),
    ],
)
def test_a_scan_without_ground_gives_empty_products_and_says_why(tmp_path, caplog, points, why):
    write_bin(tmp_path / "a.bin", points)
    write_poses(tmp_path / "poses.txt", POSES[:1])
    config = ScanConfig((tmp_path / "a.bin",), tmp_path / "out", poses=tmp_path / "poses.txt", method="filter")
    result = scan_frames(config)
    assert re.search(why, caplog.text)
    assert "no map was made" in caplog.text
    assert result.drive is None
    named = result.frames[0]["sectors"], result.frames[0]["points_by_class"]
    assert not any(sum([*each.values()][:3]) for each in named)
    assert files(tmp_path / "out" / "frames") == ["a.ply"]
    table = pq.read_table(tmp_path / "out" / "sectors.parquet")
    assert table["class"].null_count == table.num_rows
    assert not (tmp_path / "out" / "map").exists()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"products": ("picture",)}, "Pictures of frames are drawn with `pictures`"),
        ({"method": "filter", "model": "a.onnx"}, "give one of them"),
        ({"poses": "poses.txt", "odometry": "/odom"}, "give one of them"),
        ({"poses": "poses.txt", "topic": "/a,/b"}, "those of one sensor"),
    ],
)
def test_settings_that_do_not_go_together(tmp_path, settings, words):
    with pytest.raises(UsageError, match=words):
        ScanConfig((tmp_path,), tmp_path, **settings)


@pytest.mark.parametrize("crs", ["EPSG:4326", "EPSG:2264"])
def test_a_crs_that_is_not_in_metres_is_refused_before_the_work(drive, tmp_path, crs):
    config = ScanConfig((drive / "frames",), tmp_path / "out", poses=drive / "poses.txt", crs=crs, method="filter")
    with pytest.raises(UsageError, match=r"`crs[`=]"):
        scan_frames(config)
    assert not (tmp_path / "out").exists()


def test_a_frame_that_lies_too_far_away_is_skipped_whole(drive, tmp_path):
    far = [POSES[0], (POSES[1][0], POSES[1][1] + 3e6), POSES[2]]
    poses = write_poses(tmp_path / "poses.txt", far)
    config = ScanConfig(
        (drive / "frames",), tmp_path / "out", poses=poses, method="filter", products=("cloud", "table")
    )
    with pytest.raises(BadInputError, match="1 lies more than 2,000 km"):
        scan_frames(config)
    result = scan_frames(replace(config, skip_bad=True))
    assert list(result.skipped) == [str(drive / "frames" / "1.bin")]
    assert {path.name for path in (tmp_path / "out" / "frames").iterdir()} == {"0.ply", "2.ply"}
    assert set(pq.read_table(tmp_path / "out" / "sectors.parquet")["frame"].to_pylist()) == {"0", "2"}
    record = json.loads((tmp_path / "out" / "scan.json").read_text(encoding="utf-8"))
    assert record["gathered"]["seen"] == sum(frame["points"] for frame in result.frames)


def test_heightmaps_of_another_size_are_refused_by_both_methods(tmp_path):
    config = ScanConfig((tmp_path / "a.bin",), tmp_path / "out")
    assert choose_method(replace(config, polar=PolarSettings(rings=(2, 2, 2, 2, 2)))).name == "learned"
    other = replace(config, polar=PolarSettings(pixels=9))
    with pytest.raises(UsageError, match="were fitted on heightmaps of 15"):
        choose_method(other)
    with pytest.raises(UsageError, match="was trained on heightmaps of 15"):
        choose_method(replace(other, method="learned"))


def test_any_number_of_threads_gives_the_same_bytes(mapped, tmp_path, monkeypatch):
    """Frame 0 waits until frame 2 has been read."""
    out, one, config = mapped
    read = threading.Event()

    def reading(path, *rest):
        if path.stem == "0":
            assert read.wait(20.0)
        scan = read_scan(path, *rest)
        if path.stem == "2":
            read.set()
        return scan

    monkeypatch.setattr("bumpymap.scan.frames.read_scan", reading)
    three = scan_frames(replace(config, out=tmp_path / "out", threads=3))
    assert products(tmp_path / "out") == products(out)
    untimed = [[frame | {"seconds": 0.0} for frame in run.frames] for run in (one, three)]
    assert untimed[0] == untimed[1]


def test_what_a_power_cut_has_left_half_written_is_made_again(mapped, tmp_path):
    config = replace(mapped[2], out=tmp_path / "out")
    before = set(threading.enumerate())
    with pytest.raises(KeyboardInterrupt):
        scan_frames(config, _Ends(2))
    assert not set(threading.enumerate()) - before
    run = config.out / ".bumpymap-run"
    for cut in (part_path(run, 0), run / "products" / "frames" / "1.ply"):
        cut.write_bytes(cut.read_bytes()[: cut.stat().st_size // 2])
    (run / "products" / "frames" / "0.ply").unlink()
    scan_frames(config)
    assert products(tmp_path / "out") == products(mapped[0])
