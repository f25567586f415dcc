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
from small_surveys import write_survey

from bumpymap.layers.products import NAMED_RASTERS, PRODUCT_NAMES, VIEW_NAMES

pytestmark = pytest.mark.slow

NAMES = tuple(f"{name}.aux.xml" for name in NAMED_RASTERS)
NAME = os.fsdecode(b"caf\xe9")
ENVIRONMENTS = {
    "C": {"LANG": "C", "LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"},
    "ascii": {"PYTHONIOENCODING": "ascii"},
}
LOCALES = ["C", pytest.param("ascii", marks=pytest.mark.later)]


@pytest.fixture
def folder(tmp_path):
    """A folder whose own name is no UTF-8 either."""
    path = tmp_path / NAME
    try:
        path.mkdir()
    except OSError:
        pytest.skip("this file system takes UTF-8 names alone")
    return path


def run(*arguments, env=None):
    """The command in a process of its own: its streams have the encoding of the locale."""
    return subprocess.run(
        [sys.executable, "-c", "from bumpymap.cli import main; main()", *map(str, arguments)],
        env=os.environ | (env or {}),
        capture_output=True,
        timeout=300,
        check=False,
    )


def ended(result, code):
    said = (result.stdout + result.stderr).decode("utf-8", "replace")
    assert result.returncode == code, said
    assert "Traceback" not in said
    assert "UnicodeEncodeError" not in said
    return said


def write_frame(path):
    rng = np.random.default_rng(1)
    xy = rng.uniform(-20, 20, (30_000, 2))
    np.column_stack([xy, 0.01 * rng.standard_normal(30_000), np.zeros(30_000)]).astype("<f4").tofile(path)
    return path


@pytest.mark.parametrize("locale", LOCALES)
def test_map(folder, tmp_path, locale):
    survey, out = write_survey(folder / f"{NAME}.las"), folder / f"{NAME} out"
    result = run("map", survey, "--out", out, env=ENVIRONMENTS[locale])
    ended(result, 0)
    (entry,) = json.loads((out / "run.json").read_text(encoding="utf-8"))["inputs"]
    assert Path(entry["path"]) == survey
    assert os.fsencode(entry["path"]) == os.fsencode(survey)
    plain = tmp_path / "plain"
    ended(run("map", survey, "--out", plain), 0)
    assert sorted(path.name for path in out.iterdir()) == sorted([*PRODUCT_NAMES, *VIEW_NAMES, *NAMES])
    for name in (*PRODUCT_NAMES, *NAMES):
        assert name == "run.json" or (out / name).read_bytes() == (plain / name).read_bytes()


@pytest.mark.parametrize("locale", LOCALES)
def test_messages_name_the_file(folder, locale):
    bad = folder / f"{NAME}.las"
    bad.write_bytes(b"LASF" + bytes(500))
    for command in (["info", bad], ["map", bad, "--out", folder / "out"]):
        assert "caf" in ended(run(*command, env=ENVIRONMENTS[locale]), 3)
    good = write_survey(folder / f"{NAME} good.las")
    assert "bumpymap map" in ended(run("info", good, env=ENVIRONMENTS[locale]), 0)
    result = run("info", good, "--json", env=ENVIRONMENTS[locale])
    ended(result, 0)
    assert Path(json.loads(result.stdout)["files"][0]["path"]) == good
    ended(run("map", bad, good, "--out", folder / "out", "--skip-bad", env=ENVIRONMENTS[locale]), 4)
    skipped = json.loads((folder / "out" / "run.json").read_text(encoding="utf-8"))["skipped"]
    assert [Path(path) for path in skipped] == [bad]


@pytest.mark.parametrize("locale", LOCALES)
def test_scan(folder, locale):
    frames = [write_frame(folder / f"{NAME}.bin"), write_frame(folder / "b.bin")]
    poses, out = folder / "poses.txt", folder / f"{NAME} out"
    poses.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 2)
    arguments = [*frames, "--poses", poses, "--crs", "EPSG:32614", "--method", "filter", "--pictures", "--out", out]
    ended(run("scan", *arguments, env=ENVIRONMENTS[locale]), 0)
    record = json.loads((out / "scan.json").read_text(encoding="utf-8"))
    by_path = {Path(frame["path"]): frame["name"] for frame in record["frames"]}
    assert by_path == {frames[0]: "caf%E9", frames[1]: "b"}
    assert set(pq.read_table((out / "sectors.parquet").open("rb"))["frame"].to_pylist()) == {"caf%E9", "b"}
    assert {path.name for path in (out / "frames").iterdir()} == {
        f"{name}.{ending}" for name in ("caf%E9", "b") for ending in ("json", "ply", "png")
    }
    assert json.loads((out / "frames" / "caf%E9.json").read_text(encoding="utf-8"))
    assert rasterio.open((out / "map" / "class.tif").open("rb")).width > 0
    assert len(geopandas.read_parquet((out / "map" / "tiles.parquet").open("rb")))


def test_a_name_that_looks_like_an_escaped_one_is_another_frame(folder):
    write_frame(folder / f"{NAME}.bin")
    write_frame(folder / "caf%E9.bin")
    ended(run("scan", folder, "--method", "filter", "--set", "products=table", "--out", folder / "out"), 0)
    record = json.loads((folder / "out" / "scan.json").read_text(encoding="utf-8"))
    assert len({frame["name"] for frame in record["frames"]}) == 2
