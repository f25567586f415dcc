"""File names that are no UTF-8: surveys, frames and --out, through whole runs of map, scan and info, in any locale."""

import json
import os
import subprocess
import sys
from pathlib import Path

import geopandas
import numpy as np
import pyarrow.parquet as pq
import pytest
import rasterio
from small_surveys import layers_of, run as run_here, write_survey

pytestmark = pytest.mark.slow

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


def run(code, *arguments):
    """The command in a process of its own, whose streams have the encoding of the locale; gives its two outputs."""
    words = [sys.executable, "-c", "from bumpymap.cli import main; main()", *map(str, arguments)]
    result = subprocess.run(words, env=os.environ | ENVIRONMENT, capture_output=True, timeout=300, check=False)
    told, warned = result.stdout.decode("utf-8", "replace"), result.stderr.decode("utf-8", "replace")
    assert result.returncode == code, warned
    assert "Traceback" not in warned
    assert "UnicodeEncodeError" not in warned
    return told, warned


def test_map_and_info(folder, tmp_path):
    good, bad, out = write_survey(folder / f"{NAME}.las"), folder / f"{NAME} bad.las", folder / f"{NAME} out"
    bad.write_bytes(b"LASF" + bytes(500))
    told, warned = run(3, "info", bad, good, "--json")
    assert "caf" in warned
    assert Path(json.loads(told)["files"][-1]["path"]) == good
    assert "caf" in run(4, "map", bad, good, "--skip-bad", "--out", out)[1]
    record = json.loads((out / "run.json").read_text(encoding="utf-8"))
    assert [Path(entry["path"]) for entry in record["inputs"]] == [good]
    assert [Path(path) for path in record["skipped"]] == [bad]
    assert run_here("map", good, "--out", tmp_path / "plain").exit_code == 0
    assert layers_of(out) == layers_of(tmp_path / "plain")


def test_scan(folder):
    """A name that looks like an escaped one is that of another frame."""
    frames, rng = [folder / f"{name}.bin" for name in (NAME, "caf%E9", "b")], np.random.default_rng(1)
    for frame in frames:
        xy = rng.uniform(-20, 20, (30_000, 2))
        np.column_stack([xy, 0.01 * rng.standard_normal(30_000), np.zeros(30_000)]).astype("<f4").tofile(frame)
    poses, out = folder / "poses.txt", folder / f"{NAME} out"
    poses.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 3)
    placed = ("--poses", poses, "--crs", "EPSG:32614")
    run(0, "scan", *frames, *placed, "--method", "filter", "--pictures", "--out", out)
    record = json.loads((out / "scan.json").read_text(encoding="utf-8"))
    by_path = {Path(frame["path"]): frame["name"] for frame in record["frames"]}
    assert set(by_path) == set(frames)
    names = set(by_path.values())
    assert len(names) == 3
    assert "caf%E9" in by_path[frames[0]]
    assert set(pq.read_table((out / "sectors.parquet").open("rb"))["frame"].to_pylist()) == names
    assert {path.name for path in (out / "frames").iterdir()} == {
        f"{name}.{ending}" for name in names for ending in ("json", "ply", "png")
    }
    assert rasterio.open((out / "map" / "rasters/class.tif").open("rb")).width > 0
    assert len(geopandas.read_parquet((out / "map" / "tiles.parquet").open("rb")))
