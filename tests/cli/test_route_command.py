"""`bumpymap route` as a user gives it, on layers of a made-up site."""

import json
from dataclasses import replace

import numpy as np
import pyogrio
import pytest
import rasterio
from click.testing import CliRunner
from route_maps import write_folder
from route_sites import ROWS, SOUTH, WEST, lonlat, place, site

from bumpymap.cli import main


@pytest.fixture(scope="module")
def layers(tmp_path_factory):
    return write_folder(tmp_path_factory.mktemp("route") / "layers", site())


@pytest.fixture(scope="module")
def others(tmp_path_factory):
    """The site for another vehicle."""
    vehicle = {"name": "small_rover", "width_m": 0.7, "height_m": 0.5, "clearance_m": 0.1, "speed_mps": 0.5}
    return write_folder(
        tmp_path_factory.mktemp("route") / "rover",
        site(seed=3),
        vehicle=vehicle,
        calibration={"id": "abc", "vehicle": "small_rover"},
    )


def run(*words):
    return CliRunner().invoke(main, ["route", *(str(word) for word in words)])


def record(*words):
    result = run(*words, "--json")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def test_the_way_goes_through_the_gap_and_all_files_are_there(layers, tmp_path):
    out = tmp_path / "way"
    result = run(layers, "--from", lonlat(20.5, 8.5), "--to", lonlat(20.5, 22.5), "--out", out)
    assert result.exit_code == 0, result.output
    assert {path.name for path in out.iterdir()} == {
        *("route.geojson", "route.gpx", "profile.csv", "route.png", "route.json")
    }
    assert "arrives" in result.stdout
    lines = pyogrio.read_dataframe(out / "route.geojson").to_crs("EPSG:32614")
    (line,) = lines.geometry[lines.geom_type == "LineString"]
    north = max(y for _, y in line.coords)
    assert north > (SOUTH + ROWS - 3) * 3.0
    properties = json.loads((out / "route.geojson").read_text())["features"][0]["properties"]
    assert properties["detour"] > 1.5
    assert properties["length_m"] == pytest.approx(line.length, abs=0.02)  # 7 decimals of a degree
    factor = 1 + 2.5 * 0.1 - 300 * np.log(0.99) / 10
    assert properties["cost_m"] == pytest.approx(properties["length_m"] * factor, rel=1e-5)


def test_without_a_place_to_write_only_the_summary_is_printed(layers, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = run(layers, "--from", place(20.5, 8.5), "--to", place(5.5, 8.5))
    assert result.exit_code == 0
    assert list(tmp_path.iterdir()) == []
    assert result.stdout.splitlines()[1].split()[:3] == ["route", "45", "1.00"]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--to", place(5.5, 5.5)], "give either the --from or a file of --points"),
        (["--from", "here", "--to", place(5.5, 5.5)], "'here' is not a point"),
        (["--from", place(5.5, 5.5), "--to", place(5.5, 6.5), "--unknown", "0.5"], "unknown is 0.5"),
        (["--from", place(5.5, 5.5), "--to", place(5.5, 6.5), "--risk", "1e300"], "risk is 1e+300"),
        (["--from", place(5.5, 5.5), "--to", place(5.5, 6.5), "--alternatives", "99"], "--alternatives is 99"),
        (["--from", place(5.5, 5.5)], "--out DIR"),
        (["--from", place(5.5, 5.5), "--to", place(5.5, 9.5), "--isochrones", "1"], "without a goal"),
        (
            ["--from", place(5.5, 5.5), "--isochrones", "1", "--set", "isocosts=50", "--out", "o"],
            "--set isocosts are outlines",
        ),
        (["--from", place(5.5, 5.5), "--to", place(5.5, 9.5), "--set", "memory=1MB"], "--set memory is '1MB'"),
        (
            ["--from", place(5.5, 5.5), "--isochrones", "0", "--out", "o"],
            "--isochrones is 0.0; it must be a",
        ),
    ],
)
def test_wrong_usage_is_exit_code_2(layers, words, says):
    result = run(layers, *words)
    assert result.exit_code == 2
    assert says in " ".join(result.output.split())


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--from", "1,1", "--to", place(5.5, 5.5)], "lies outside the map"),
        (["--from", place(10.5, 15.5), "--to", place(5.5, 5.5)], "not passable (too steep). The nearest point"),
        (["--from", place(20.5, 2.5), "--to", place(5.5, 5.5)], "unknown ground; --unknown COST"),
        (["--from", place(5.5, 5.5), "--to", place(5.5, 9.5), "--avoid", "none.geojson"], "none.geojson is missing"),
        (["--points", "none.csv"], "there is no file none.csv"),
    ],
)
def test_bad_input_is_exit_code_3_and_nothing_is_written(layers, words, says, tmp_path):
    out = tmp_path / "way"
    result = run(layers, *words, "--out", out)
    assert result.exit_code == 3
    assert says in " ".join(result.output.split())
    assert not out.exists()


def test_where_there_is_no_way_the_message_says_between_which_points_and_what_to_do(tmp_path):
    made = site()
    closed = replace(made, patches=replace(made.patches, slope=np.where(made.patches.col == WEST + 15, 60.0, 2.0)))
    folder = write_folder(tmp_path / "closed", closed)
    result = run(folder, "--from", place(5.5, 5.5), "--to", place(5.5, 25.5))
    assert result.exit_code == 3
    text = " ".join(result.output.split())
    assert f"no way from the start {place(5.5, 5.5)} to the goal {place(5.5, 25.5)}" in text
    assert "--unknown COST" in text


def test_what_can_be_reached_is_a_raster_and_outlines(layers, tmp_path):
    out = tmp_path / "reach"
    result = run(layers, "--from", place(20.5, 8.5), "--out", out, "--isochrones", "0.5,1")
    assert result.exit_code == 0, result.output
    assert "can be reached from the start" in result.stdout
    with rasterio.open(out / "reach.tif") as file:
        assert file.descriptions == ("cost", "minutes")
        assert file.crs.to_epsg() == 32614
        (cost,) = file.sample([tuple(float(part) for part in place(20.5, 18.5).split(","))])
    assert not cost[0] <= 60.0 * 1.6  # only around the wall
    assert len(pyogrio.read_dataframe(out / "isochrones.geojson")) == 2


def test_a_reach_over_part_of_the_map_says_so(layers, tmp_path):
    words = [layers, "--from", place(20.5, 8.5), "--out", tmp_path / "reach", "--overwrite"]
    part = run(*words, "--set", "isocosts=15")
    assert part.stdout.startswith("Within 15 m of the start to each side, ")
    found = record(*words, "--set", "isocosts=15")["reach"]
    assert f"{found['tiles']:,} tiles ({found['area_ha']:.2f} ha) can be reached, {found['share']:.1%}" in part.stdout
    assert found["limit_m"] == 15.0
    assert found["tiles"] < 150
    whole = record(*words)["reach"]
    assert whole["limit_m"] is None
    assert whole["tiles"] > 600
    assert record(layers, "--from", place(20.5, 8.5), "--to", place(5.5, 8.5))["reach"] is None


def test_an_earlier_run_is_replaced_only_if_told(layers, tmp_path):
    words = [layers, "--from", place(20.5, 8.5), "--to", place(5.5, 8.5), "--out", tmp_path / "way"]
    assert run(*words).exit_code == 0
    again = run(*words)
    assert again.exit_code == 3
    assert "--overwrite" in again.output
    for wrong, said in (
        ([tmp_path / "none", *words[1:]], "there is no folder"),
        ([layers, "--from", "1,2", *words[3:]], "lies outside the map"),
        ([*words, "--avoid", tmp_path / "none.geojson"], "none.geojson"),
    ):
        assert said in run(*wrong).output  # told before that the folder is occupied
    before = {path.name: path.read_bytes() for path in (tmp_path / "way").iterdir()}
    assert run(*words, "--overwrite").exit_code == 0
    after = {path.name: path.read_bytes() for path in (tmp_path / "way").iterdir()}
    assert {name for name in before if before[name] != after[name]} <= {"route.json"}
