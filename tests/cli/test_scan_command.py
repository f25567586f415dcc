"""``bumpymap scan`` as a user meets it: options, exit codes, messages."""

import json
from pathlib import Path

import numpy as np
import ply_files
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from bumpymap.cli import main


def site(count=12_000, seed=0):
    rng = np.random.default_rng(seed)
    radius, azimuth = np.sqrt(rng.uniform(1.0, 144.0, count)), rng.uniform(-np.pi, np.pi, count)
    x, y = radius * np.cos(azimuth), radius * np.sin(azimuth)
    return np.column_stack([x, y, -1.0 + np.where(y < 0, 0.2, 0.002) * rng.standard_normal(count)])


def write_ply(path, points, **more):
    vertex = np.empty(
        len(points), [(axis, "<f4") for axis in "xyz"] + [(name, v.dtype.str) for name, v in more.items()]
    )
    for number, axis in enumerate("xyz"):
        vertex[axis] = np.reshape(points, (-1, 3))[:, number]
    for name, values in more.items():
        vertex[name] = values
    return ply_files.write_ply(path, vertex)


def write_bin(path, points):
    np.column_stack([points, np.ones(len(points))]).astype("<f4").tofile(path)
    return path


@pytest.fixture(name="scan")
def scan_fixture(tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")

    def run(*words, out=None):
        out = out or tmp_path / "out"
        arguments = [*map(str, words), *(["--out", str(out)] if "--out" not in words else [])]
        return CliRunner().invoke(main, ["scan", *arguments])

    return run


@pytest.fixture(name="frame")
def frame_fixture(tmp_path):
    return write_ply(tmp_path / "frame.ply", site())


def out_files(tmp_path):
    out = tmp_path / "out"
    return sorted(str(path.relative_to(out)) for path in out.rglob("*") if path.is_file()) if out.exists() else None


def test_one_scan(scan, frame, tmp_path):
    result = scan(frame, "--method", "filter")
    assert result.exit_code == 0, result.output
    rows = [line.split() for line in result.stdout.splitlines()]
    table = pq.read_table(tmp_path / "out" / "sectors.parquet").to_pydict()
    for class_id, name in enumerate(("smooth", "fair", "rough")):
        row = next(row for row in rows if row[:2] == [str(class_id), name])
        assert int(row[2]) == table["class"].count(class_id)
        points = sum(n for n, own in zip(table["points"], table["class"], strict=True) if own == class_id)
        assert int(row[-1].replace(",", "")) == points
    free = sum(own in (0, 1) and not held for own, held in zip(table["class"], table["obstacle"], strict=True))
    assert f"sectors: {free:,} free" in result.stdout
    assert f"{table['class'].count(None):,} not ground" in result.stdout
    assert f"Output in {tmp_path / 'out'}: frames, sectors.parquet, scan.json" in result.stdout
    assert out_files(tmp_path) == [
        "frames/frame.json",
        "frames/frame.ply",
        "scan.json",
        "sectors.parquet",
    ]


def test_pictures_of_all_frames_or_of_every_nth_as_far_as_wanted(scan, tmp_path):
    drive = tmp_path / "drive"
    drive.mkdir()
    for number in range(3):
        write_bin(drive / f"{number}.bin", site(seed=number))
    words = (drive, "--method", "filter", "--set", "products=table", "--overwrite", "--pictures")
    pictures = {}
    for more in ((), ("2",), ("1", "--set", "range_m=10")):
        assert scan(*words, *more).exit_code == 0
        pictures[more] = {path.name: path.read_bytes() for path in (tmp_path / "out" / "frames").iterdir()}
    everyone, second, near = pictures.values()
    assert list(map(sorted, pictures.values())) == [["0.png", "1.png", "2.png"], ["0.png", "2.png"], sorted(everyone)]
    assert all(everyone[name] == content for name, content in second.items())
    assert all(near[name] != content for name, content in everyone.items())


def test_a_frame_after_pictures_is_not_taken_for_a_number(scan, frame, tmp_path):
    done = scan("--pictures", frame)
    assert done.exit_code == 2
    assert "Name the frames first, or write --pictures 1" in done.stderr
    assert out_files(tmp_path) is None


def test_a_drive_for_machines(scan, tmp_path):
    drive = tmp_path / "drive"
    drive.mkdir()
    for number in (2, 10):
        write_bin(drive / f"{number}.bin", site(seed=number))
    poses = tmp_path / "poses.csv"
    poses.write_text("t,x,y,z,qx,qy,qz,qw\n0,0,0,1,0,0,0,1\n1,1,0,1,0,0,0,1\n")
    words = ("--method", "filter", "--set", "products=table, cloud")
    result = scan(drive, "--poses", poses, "--json", *words)
    assert result.exit_code == 0, result.output
    record = json.loads(result.stdout)
    assert record["frames"] == 2
    assert record["points"] == sum(record["points_by_class"].values())
    assert record["files"] == ["frames", "sectors.parquet", "gathered.laz", "scan.json"]
    assert Path(record["map"][0]) == tmp_path / "out" / "map" / "rasters" / "roughness.tif"
    names = {path.split("/")[0] for path in out_files(tmp_path)}
    assert names == {"frames", "gathered.laz", "map", "scan.json", "sectors.parquet"}
    assert [path for path in out_files(tmp_path) if path.startswith("frames")] == ["frames/10.ply", "frames/2.ply"]
    assert list(dict.fromkeys(pq.read_table(tmp_path / "out" / "sectors.parquet")["frame"].to_pylist())) == ["2", "10"]
    again = scan(drive, "--quiet")
    assert again.exit_code == 3
    assert "--overwrite" in again.stderr
    last = scan(drive, "--quiet", "--overwrite", *words)
    assert (last.exit_code, last.output) == (0, "")
    assert out_files(tmp_path) == ["frames/10.ply", "frames/2.ply", "scan.json", "sectors.parquet"]


def other_poses(folder):
    (folder / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 2)
    return [write_bin(folder / "a.bin", site()), "--poses", folder / "poses.txt"]


def not_a_model(folder):
    (folder / "a.onnx").write_text("no")
    return [write_ply(folder / "a.ply", site()), "--set", f"model={folder / 'a.onnx'}"]


def no_calibration(folder):
    (folder / "p.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    return [write_ply(folder / "a.ply", site()), "--poses", folder / "p.txt", "--calibration", folder / "c.json"]


def doubtful_columns(folder):
    np.random.default_rng(1).uniform(-9.0, 9.0, 60_000).astype("<f4").tofile(folder / "a.bin")
    return [folder / "a.bin"]


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (doubtful_columns, "Say which they are with --set columns"),
        (other_poses, "holds 2 poses, but there are 1 frames"),
        (not_a_model, "is not an ONNX model"),
        (no_calibration, "c.json"),
    ],
)
def test_bad_input_is_one_message_and_leaves_nothing(scan, tmp_path, make, words):
    folder = tmp_path / "in"
    folder.mkdir()
    result = scan(*make(folder))
    assert result.exit_code == 3, result.output
    assert result.stderr.startswith("Error: ")
    assert words in result.stderr
    assert "Traceback" not in result.output
    assert out_files(tmp_path) is None


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--set", "polar.sectors=24,a"], "value 2 of polar.sectors is 'a'; it must be a whole number"),
        (["--set", "polar.rings=1,2"], "--set polar.sectors and --set polar.rings must be for equally many"),
        (["--set", "products=cloud,map"], "value 2 of products is 'map'; it must be one of polygons, table, cloud"),
        (["--crs", "EPSG:32614"], "add --poses"),
        (["--fit"], "--fit is gone: train a network"),
    ],
)
def test_wrong_usage(scan, frame, tmp_path, options, words):
    result = scan(frame, *options)
    assert result.exit_code == 2, result.output
    assert words in result.stderr
    assert out_files(tmp_path) is None


def test_a_bad_frame_among_others(scan, frame, tmp_path):
    bad = tmp_path / "bad.ply"
    bad.write_bytes(b"ply\nnonsense")
    assert scan(frame, bad, "--set", "threads=1").exit_code == 3
    assert out_files(tmp_path) is None
    result = scan(frame, bad, "--skip-bad")
    assert result.exit_code == 4
    assert "skipped frames: 1;" in result.stdout
    assert str(bad) in result.stderr
    assert "frames/frame.ply" in out_files(tmp_path)
