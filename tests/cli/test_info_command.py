import json
import re

import laspy
import numpy as np
import pytest
from click.testing import CliRunner
from small_surveys import write_las

from bumpymap.cli import main


def write(path, points, crs=None, classes=None):
    columns = {} if classes is None else {"classification": classes}
    return write_las(path, *points.T, crs=crs, **columns)


def dense(side=6.0, step=0.2):
    x, y = np.meshgrid(np.arange(step / 2, side, step), np.arange(step / 2, side, step))
    # 500001 and 4000002 are multiples of 3: tiles are full.
    return np.column_stack([500001 + x.ravel(), 4000002 + y.ravel(), np.full(x.size, 10.0)])


@pytest.fixture
def info(monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")

    def run(*words):
        return CliRunner().invoke(main, ["info", *map(str, words)])

    return run


def test_the_classes_and_what_they_are_taken_for(info, tmp_path):
    classes = np.full(900, 2, np.uint8)
    classes[:90], classes[90:180], classes[180:270], classes[270:279] = 6, 4, 66, 7
    path = write(tmp_path / "a.laz", dense(), "EPSG:32614", classes)
    found = json.loads(info(path, "--json").stdout)["files"][0]["classes"]
    assert found == {"2": 621, "4": 90, "6": 90, "66": 90}  # noise is left out
    rows = {line[:18].strip(): line[18:].strip() for line in info(path).output.splitlines()}
    assert rows["class 2"] == "ground: 69.7% of the points, in 100% of the tiles; ground"
    assert re.fullmatch(r"building: 10.1% of the points, in .*; obstacle", rows["class 6"])
    assert re.fullmatch(r"10.1% of the points, in .* above the ground \(median\); by height", rows["class 66"])


def test_a_good_survey(info, tmp_path):
    path = write(tmp_path / "a.laz", dense(), "EPSG:32614", np.full(900, 2, np.uint8))
    result = info(path)
    assert result.exit_code == 0, result.output
    for words in (
        "LAZ 1.4, point format 6",
        "900",
        "WGS 84 / UTM zone 14N (EPSG:32614)",
        "metre",
        "500,001.10 to 500,006.90",
        "5.8 m x 5.8 m",
        "25.0 pts/m2: 225 points per 3 m tile (median of 4 tiles)",
        "100% of the points are ground",
        f"ready, about 0% of the tiles will be unknown: bumpymap map {path} --out DIR",
    ):
        assert words in result.output, words


def test_what_is_missing_is_said(info, tmp_path):
    path = write(tmp_path / "a.las", dense()[::300])
    result = info(path)
    assert result.exit_code == 0
    assert "no CRS: pass --crs EPSG:CODE, or --local" in result.output
    assert "about 100% of the tiles will be unknown, mostly because of too few points" in result.output
    assert "ready" not in result.output


def test_a_given_crs_and_unit(info, tmp_path):
    path = write(tmp_path / "a.las", dense())
    result = info(path, "--crs", "EPSG:2992", "--set", "z_unit=m", "--json")
    (record,) = json.loads(result.stdout)["files"]
    assert record["epsg"] == 2992
    assert (record["metres_per_unit"], record["metres_per_unit_z"]) == (0.3048, 1.0)
    assert record["bounds_crs_units"][0] == pytest.approx(500001.1)
    assert record["bounds_m"][0] == pytest.approx(500001.1 * 0.3048)


def test_json_holds_the_facts(info, tmp_path):
    classes = np.full(900, 1, np.uint8)
    classes[:3] = 7
    path = write(tmp_path / "a.laz", dense(), "EPSG:32614", classes)
    result = info(path, "--json")
    (record,) = json.loads(result.stdout)["files"]
    assert record["points_promised"] == 900
    assert record["points"] == 897
    assert record["dropped"] == {"withheld": 0, "noise": 3, "not_a_number": 0}
    assert record["tiles"] == 4
    assert record["unknown_tiles_about"] == {}
    assert record["needs"] == [f"ready, about 0% of the tiles will be unknown: bumpymap map {path} --out DIR"]


def test_quick_reads_no_points(info, tmp_path, monkeypatch):
    path = write(tmp_path / "a.laz", dense(), "EPSG:32614")
    monkeypatch.setattr(laspy.LasReader, "read_points", None)
    result = info(path, "--quick")
    assert result.exit_code == 0, result.output
    assert "900 according to the header" in result.output
    assert "26.8 pts/m2 in the header's extent" in result.output  # 900 / 5.8**2


def test_one_bad_file_among_good_ones(info, tmp_path):
    good = write(tmp_path / "a.laz", dense(), "EPSG:32614")
    bad = tmp_path / "b.laz"
    bad.write_bytes(good.read_bytes()[:-50])
    result = info(tmp_path)
    assert result.exit_code == 3
    assert f"ready, about 0% of the tiles will be unknown: bumpymap map {good}" in result.output
    assert f"error: {bad}" in result.output
    assert info("memory://none.laz").output.count("cannot") == 1  # and not "cannot be read: cannot read"
    record = json.loads(info(tmp_path, "--json").stdout)["files"][1]
    assert record["path"] == str(bad)
    assert "truncated" in record["error"]


def test_the_command_has_the_options_that_were_given(info, tmp_path):
    path = write(tmp_path / "a b.las", dense())
    said = info(path, "--crs", "EPSG:32614", "--set", "z_unit=m", "--ground", "all", "--quick").output
    assert f"ready: bumpymap map '{path}' --crs EPSG:32614 --z-unit m --ground all --out DIR" in said


def test_several_files_are_told_together(info, tmp_path):
    write(tmp_path / "a.laz", dense()[::2], "EPSG:32614", np.full(450, 1, np.uint8))
    write(tmp_path / "b.laz", dense()[1::2], "EPSG:32614", np.full(450, 1, np.uint8))
    said = info(tmp_path, "--crs", "EPSG:32614").output
    assert "together: about 0% of the tiles will be unknown" in said
    assert f"one map: bumpymap map {tmp_path} --crs EPSG:32614 --out DIR" in said


@pytest.mark.parametrize("quick", [[], ["--quick"]])
def test_a_site_larger_than_one_map_is_told_before_and_refused_by_map(info, tmp_path, quick):
    south, north = tmp_path / "site" / "south.las", tmp_path / "site" / "north.las"
    write(south, dense(), "EPSG:32614")
    write(north, dense() + np.array([0.0, 400_000.0, 0.0]), "EPSG:32614")
    report = " ".join(info(tmp_path / "site", *quick).output.split())
    assert "too large: the survey spans 0.0 km x 400.0 km" in report
    assert "separate runs, whose rasters lie on one grid, or give larger tiles with --tile-size" in report
    found = json.loads(info(tmp_path / "site", *quick, "--json").stdout)
    assert found["too_large"].startswith("the survey spans")
    assert json.loads(info(south, *quick, "--json").stdout)["too_large"] == ""
    made = CliRunner().invoke(main, ["map", str(tmp_path / "site"), "--out", str(tmp_path / "out")])
    assert made.exit_code == 3
    said = " ".join(made.output.split())
    assert "the survey spans 0.0 km x 400.0 km" in said
    assert f"The files read are: {north}, {south}" in said
