import json

import pytest
from click.testing import CliRunner
from cost_maps import make_field
from pyproj import Transformer
from route_maps import write_folder

from bumpymap.cli import main


@pytest.fixture(scope="module")
def layers(tmp_path_factory):
    """A map of 18 m x 18 m, on which some tiles are barred, some unknown."""
    return write_folder(tmp_path_factory.mktemp("export") / "site layers", make_field(6, 6, holes=0.0))


def export(*words):
    return CliRunner().invoke(main, ["export", *map(str, words)])


def test_the_summary_of_a_map_for_nav2(layers, tmp_path):
    done = export(layers, "--to", "nav2", "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    lines = done.stdout.splitlines()
    assert lines[0] == "18 m x 18 m, cells of 3 m, frame map"
    assert lines[1].startswith("origin of the frame: x,y 330009.000,2040009.000 in the survey's CRS, lon,lat -100.6")
    assert lines[2] == "6 passable, 25 barred, 5 unknown tiles"
    assert lines[3].startswith("cost per metre: 1 is value 0, ")
    assert "map.yaml, map.pgm" in done.stdout.replace("\n", "")
    quiet = export(layers, "--to", "nav2", "--out", tmp_path / "quiet", "--quiet")
    assert (quiet.exit_code, quiet.output) == (0, "")


@pytest.mark.parametrize("place", ["crs:330004.5,2040004.5", "330004.5,2040004.5", "lonlat:{0},{1}"])
def test_a_crop_around_a_point_in_either_system(layers, tmp_path, place):
    lonlat = Transformer.from_crs(32614, 4326, always_xy=True).transform(330004.5, 2040004.5)
    words = ("--around", place.format(*lonlat), "--radius", 2, "--datum", "crs:330000,2040000", "--resolution", "pixel")
    done = export(layers, "--to", "nav2", "--out", tmp_path / "out", *words, "--json")
    assert done.exit_code == 0, done.output
    record = json.loads(done.stdout)
    assert record["area"] == {"west": 0.0, "south": 0.0, "east": 9.0, "north": 9.0}
    assert record["resolution_m"] == pytest.approx(0.2)
    assert (tmp_path / "out" / "map.pgm").read_bytes().startswith(b"P5\n45 45\n255\n")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--to", "rviz"], "'rviz' is not one of"),
        (["--to", "graph", "--resolution", "pixel"], "--resolution has no effect with --to graph"),
        (["--to", "nav2", "--set", "every=9"], "--set every has no effect with --to nav2, only with graph"),
        (["--to", "plan", "--around", "1,2"], "--around has no effect with --to plan"),
        (["--to", "nav2", "--radius", "20"], "--radius has no effect without --around"),
        (["--to", "nav2", "--set", "comfort=0"], "comfort is 0; it must be a finite number greater than 0"),
        (["--to", "nav2", "--around", "here"], "'here' is not a point"),
        (["--to", "nav2", "--datum", ""], "'' is not a point"),
        ([], "Missing option '--to'"),
    ],
)
def test_wrong_usage(layers, tmp_path, words, said):
    done = export(layers, *words, "--out", tmp_path / "out")
    assert done.exit_code == 2
    assert said in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--to", "nav2", "--around", "crs:1,2"], "lies outside the map"),
        (["--to", "plan"], "pass the folder that it wrote with --route"),
        (["--to", "plan", "--route", "none.geojson"], "there is no none.geojson"),
    ],
)
def test_bad_input(layers, tmp_path, words, said):
    done = export(layers, *words, "--out", tmp_path / "out")
    assert done.exit_code == 3
    assert said in done.stderr
    assert not (tmp_path / "out").exists()


def test_folders_that_are_no_layers_or_hold_something(layers, tmp_path):
    assert "holds no complete run" in export(tmp_path, "--to", "nav2", "--out", tmp_path / "out").stderr
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "map.pgm").touch()
    done = export(layers, "--to", "nav2", "--out", tmp_path / "out")
    assert done.exit_code == 3
    assert "already holds map.pgm. Choose another --out, or pass --overwrite" in done.stderr
    assert export(layers, "--to", "nav2", "--out", tmp_path / "out", "--overwrite").exit_code == 0
    assert "holds the layers of a run" in export(layers, "--to", "nav2", "--out", layers).stderr
