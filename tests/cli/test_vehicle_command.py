import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from bumpymap.cli import main
from bumpymap.rating.calibration import Calibration
from bumpymap.rating.vehicle_profile import load_profile

SHIPPED = Path(__file__).parents[2] / "bumpymap" / "rating" / "data"


@pytest.fixture(autouse=True)
def _here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def vehicle(*words):
    return CliRunner().invoke(main, ["vehicle", *words])


def test_the_list_names_what_ships():
    assert [line.split()[0] for line in vehicle("list").stdout.splitlines()] == [
        "car",
        "husky",
        "small_rover",
        "warthog",
    ]


def test_a_new_profile_passes_only_when_it_is_filled_in(tmp_path):
    assert vehicle("new", "mine").exit_code == 0
    refused = vehicle("check", "mine.toml")
    assert refused.exit_code == 3
    first, *faults = refused.stderr.splitlines()
    assert "bumpymap vehicle new NAME" in first  # no page of docs, which are not installed
    assert len(faults) == 10
    assert "  wheelbase_m is not filled in: between 0.1 and 20 metres" in faults
    assert "(between 0.1 and 20 metres)." in Path("mine.toml").read_text()


def test_the_check_shows_what_was_estimated():
    assert vehicle("new", "mine").exit_code == 0
    text = Path("mine.toml").read_text()
    for value in ('"A robot"', "40", '"rigid"', "0.6", "0.5", "1", "20", "0.1", "0.15", "0.2"):
        text = text.replace('= "?"', f"= {value}", 1)
    Path("mine.toml").write_text(text)
    shown = vehicle("check", "mine.toml").stdout
    assert "estimated from mass, size and suspension" in shown
    assert "  rocker.stiffness_nm_per_rad = " in shown
    assert "estimated" not in vehicle("check", "husky").stdout


def test_a_new_profile_like_another_says_so_and_passes(tmp_path):
    assert "change what differs" in vehicle("new", "mine", "--like", "car", "--out", "a.toml").stdout
    assert "numbers are those of car" in (tmp_path / "a.toml").read_text()
    made, car = load_profile(tmp_path / "a.toml").to_dict(), load_profile("car").to_dict()
    assert made == car | {"name": "mine", "description": "like car"}
    assert vehicle("check", "a.toml").exit_code == 0


def test_nothing_is_overwritten(tmp_path):
    (tmp_path / "mine.toml").write_text("old")
    (tmp_path / "link.toml").symlink_to(tmp_path / "elsewhere.toml")
    for words in (("mine",), ("mine", "--out", "link.toml")):
        result = vehicle("new", *words)
        assert (result.exit_code, "exists and is not overwritten" in result.stderr) == (3, True)
    assert (tmp_path / "mine.toml").read_text() == "old"
    assert not (tmp_path / "elsewhere.toml").exists()
    assert vehicle("new", "mine", "--out", "none/a.toml").exit_code == 3


def test_a_check_says_what_a_profile_means_and_which_calibration_it_has(tmp_path):
    said = vehicle("check", "car").stdout
    for words in ("1,900 kg", "3.9 m long, 1.84 m wide", "3 m/s", "25 degrees", Calibration.shipped("car").id):
        assert words in said, words
    vehicle("new", "mine", "--like", "car")
    path = tmp_path / "mine.toml"
    path.write_text(path.read_text().replace("wheelbase_m = 2.7", "wheelbase_m = 2.8"))
    said = vehicle("check", "mine.toml").stdout
    assert "mine.json does not exist. Make it: bumpymap calibrate --vehicle mine.toml --out mine.json" in said
    (tmp_path / "mine.json").write_text((SHIPPED / "calibrations" / "car.json").read_text())
    assert "mine.json was made for another vehicle: wheelbase_m is 2.8, was 2.7" in vehicle("check", "mine.toml").stdout


def test_a_vehicle_that_is_unknown_is_wrong_usage_in_every_command(tmp_path):
    survey = tmp_path / "a.laz"
    survey.touch()
    for words in (
        ["map", "a.laz", "--out", "o", "--vehicle", "tank"],
        ["scan", "a.bin", "--poses", "p.txt", "--out", "o", "--vehicle", "tank"],
        ["evaluate", "survey", "a.laz", "--out", "o", "--vehicle", "tank"],
        ["calibrate", "--out", "c.json", "--vehicle", "tank"],
        ["vehicle", "check", "tank"],
        ["vehicle", "new", "mine", "--like", "tank"],
    ):
        result = CliRunner().invoke(main, words)
        assert result.exit_code == 2, result.output
        assert "no vehicle 'tank'" in result.stderr, words
        assert "(car, husky, small_rover, warthog)" in result.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.laz"]


def test_a_profile_in_a_settings_file_is_beside_it(tmp_path):
    folder = tmp_path / "site"
    folder.mkdir()
    assert vehicle("new", "mine", "--out", "site/mine.toml").exit_code == 0
    (folder / "run.toml").write_text('surveys = ["a.laz"]\nout = "o"\nvehicle = "mine.toml"\n')
    result = CliRunner().invoke(main, ["map", "--config", "site/run.toml"])
    assert result.exit_code == 3
    assert "site/mine.toml: 10 errors" in result.stderr


def test_numbers_in_another_unit_stop_a_calibration_before_it_builds_anything(tmp_path):
    vehicle("new", "mine", "--like", "car")
    path = tmp_path / "mine.toml"
    path.write_text(path.read_text().replace("wheelbase_m = 2.7", "wheelbase_m = 2700"))
    result = CliRunner().invoke(main, ["calibrate", "--vehicle", "mine.toml", "--out", "c.json"])
    assert result.exit_code == 3
    assert "wheelbase_m is 2700; it must be between 0.1 and 20 metres; 2700 mm would be 2.7" in result.stderr
    calibration = json.loads((SHIPPED / "calibrations" / "car.json").read_text())
    calibration["vehicle"]["wheelbase_m"] = 2700
    (tmp_path / "c.json").write_text(json.dumps(calibration))
    (tmp_path / "a.laz").touch()
    result = CliRunner().invoke(main, ["map", "a.laz", "--out", "o", "--calibration", "c.json"])
    assert result.exit_code == 3
    assert "c.json, vehicle: wheelbase_m is 2700; it must be between" in result.stderr
