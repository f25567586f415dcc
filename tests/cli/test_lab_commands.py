"""Vehicles, calibrations and networks as a user makes them: `vehicle`, `calibrate`, `check --refit`, `train`."""

import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from driven_stretches import driven_stretches
from made_frames import POINTS, write_rellis
from small_surveys import run, write_survey

from bumpymap.api import map_survey
from bumpymap.cli import lab_commands
from bumpymap.cli.check_command import prepare_refit, refit_lines, write_refit
from bumpymap.core import BadInputError, OutputError, UsageError, install_command
from bumpymap.lab.settings import CalibrationSettings
from bumpymap.lab.simulate import calibrate as calibrate_module, refit
from bumpymap.lab.simulate.drive import PatchDrives
from bumpymap.lab.simulate.motion_fit import MotionRecord
from bumpymap.lab.terrains import KINDS
from bumpymap.rating import Calibration, Correction, Vehicle

pytestmark = pytest.mark.usefixtures("without_views")

WARTHOG = Calibration.shipped("warthog")


@pytest.fixture(autouse=True)
def _here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


# --- vehicle ---
def edited(path, *changes):
    """Replace texts of a file, each once."""
    text = Path(path).read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    Path(path).write_text(text, encoding="utf-8")


def test_the_list_names_what_ships():
    assert [line.split()[0] for line in run("vehicle", "list").stdout.splitlines()] == [
        *("car", "husky", "small_rover", "warthog")
    ]


def test_a_new_profile_passes_only_when_it_is_filled_in_and_what_was_estimated_is_shown():
    run("vehicle", "new", "mine", "--out", "mine.toml", code=0)
    refused = run("vehicle", "check", "mine.toml", code=3)
    first, *faults = refused.stderr.splitlines()
    assert "bumpymap vehicle new NAME" in first  # no page of docs, which are not installed
    assert len(faults) == 10
    assert "  wheelbase_m is not filled in: a number from 0.1 to 20 m" in faults
    Path("site").mkdir()
    Path("mine.toml").rename("site/mine.toml")  # beside a settings file that names it
    Path("site/run.toml").write_text('surveys = ["a.laz"]\nout = "o"\nvehicle = "mine.toml"\n')
    assert "site/mine.toml: 10 errors" in run("map", "--config", "site/run.toml", code=3).stderr
    values = ('"A robot"', "40", '"rigid"', "0.6", "0.5", "1", "20", "0.1", "0.15", "0.2")
    edited("site/mine.toml", *(('= "?"', f"= {value}") for value in values))
    shown = run("vehicle", "check", "site/mine.toml").stdout
    assert "estimated from mass, size and suspension" in shown
    assert "  rocker.stiffness_nm_per_rad = " in shown


def test_a_new_profile_like_another_says_so_and_passes(tmp_path):
    assert "change what differs" in run("vehicle", "new", "mine", "--like", "car", "--out", "a.toml").stdout
    assert "numbers are those of car" in Path("a.toml").read_text()
    made, car = Vehicle.load(tmp_path / "a.toml").to_dict(), Vehicle.load("car").to_dict()
    assert made == car | {"name": "mine", "description": "like car"}
    run("vehicle", "check", "a.toml", code=0)


def test_a_check_says_what_a_profile_means_and_which_calibration_it_has():
    said = run("vehicle", "check", "car").stdout
    assert "estimated" not in said
    for words in ("1,900 kg", "3.9 m long, 1.84 m wide", "3 m/s", "25 degrees", Calibration.shipped("car").id):
        assert words in said, words
    run("vehicle", "new", "mine", "--like", "car")
    edited("mine.toml", ("wheelbase_m = 2.7", "wheelbase_m = 2.8"))
    said = run("vehicle", "check", "mine.toml").stdout
    assert "mine.json does not exist. Make it: bumpymap calibrate --vehicle mine.toml --out mine.json" in said
    Path("mine.json").write_text(Calibration.shipped("car").to_json(), encoding="utf-8")
    assert (
        "mine.json was made for another vehicle: wheelbase_m is 2.8, was 2.7"
        in run("vehicle", "check", "mine.toml").stdout
    )
    edited("mine.toml", ("wheelbase_m = 2.8", "wheelbase_m = 2700"))
    edited("mine.json", ('"wheelbase_m": 2.7', '"wheelbase_m": 2700'))
    said = run("calibrate", "--vehicle", "mine.toml", "--out", "c.json", code=3)  # before it builds anything
    assert "wheelbase_m is 2700; it must be a number from 0.1 to 20 m; 2700 mm would be 2.7" in said.stderr
    Path("a.laz").touch()
    said = run("map", "a.laz", "--out", "o", "--calibration", "mine.json", code=3)
    assert "mine.json, vehicle: wheelbase_m is 2700; it must be a number" in said.stderr


# --- calibrate ---
@pytest.fixture
def fake_drives(monkeypatch):
    pytest.importorskip("dartpy")
    few = {"patches": 3, "starts": 2, "z_range": (0.02, 0.2, 2.0), "terrains": 1, "terrain_starts": 2}
    monkeypatch.setattr(CalibrationSettings, "quick", lambda self: replace(self, **few))

    def drive(settings, job):
        purpose, first, *rest = job.key
        if purpose == "library":
            c_r, failed = 0.02 * (1 + KINDS.index(first)), first == "kerb"
            return PatchDrives(("completed", "stuck" if failed else "completed"), (c_r, None if failed else c_r))
        if purpose == "crossing":
            return PatchDrives(("stuck",), (None,))
        if purpose == "motion":
            c_r = 0.02 * (1 + KINDS.index(first))
            return MotionRecord(*(((scale * c_r, scale * 1.1 * c_r, scale * 1.3 * c_r),) for scale in (1, 2)))
        c_r = 0.03 * (1 + first) * (1 + 5 * rest[0]) * (1 + 0.1 * rest[1])
        if rest[0] == 2:
            return PatchDrives(("completed", "rolled"), (c_r, None))
        return PatchDrives(("completed",) * 2, (c_r,) * 2)

    monkeypatch.setattr(calibrate_module, "run_job", drive)
    monkeypatch.setattr(refit, "fit_ride", lambda *_: (ride := Correction.from_record(WARTHOG.ride), [ride] * 2))
    monkeypatch.setattr(refit, "_LIBRARIES", 2)
    monkeypatch.setattr(refit, "fit_thin_surveys", lambda *_: WARTHOG.thin)


def test_a_calibration_is_written_and_summed_up_and_replaced_only_if_told(tmp_path, fake_drives):
    out = tmp_path / "new" / "warthog.json"
    words = ["calibrate", "--vehicle", "warthog", "--out", out, "--quick", "--jobs", 1, "--set", "seed=9"]
    result = run(*words, code=0)
    calibration = Calibration.load(out)
    assert calibration.settings["command"] == (
        "bumpymap calibrate --vehicle warthog --out warthog.json --tile-size 3 --quick --set seed=9 --set patches=3 "
        "--set starts=2 --set terrains=1 --set terrain_starts=2 --set pixels=15"
    )
    assert calibration.ride == WARTHOG.ride
    assert calibration.steps["seed"] == calibration.settings["seed"] == 9
    assert calibration.steps["crossing"]["fail_up"][0] == [1, 1, 1]
    assert calibration.motion["origin"]["used"] == calibration.motion["origin"]["terrains"] == 34
    assert re.search(r"warthog: \d+ drives, about .* with 1 process\.", result.output)
    assert "72 drives over textures, 12 failed" in result.output
    assert "34 drives over 17 terrains of the library, 1 failed" in result.output
    assert "class 3 very rough" in result.output
    assert "of the class limits: 0.0, 0.0, 0.0 %" in result.output  # both fits without a part are the same
    assert "--quick makes a quarter" in result.output
    assert calibration.id in result.output
    assert [path.name for path in out.parent.iterdir()] == ["warthog.json"]
    out.write_text("mine")
    refused = run(*words, code=3)
    assert re.search(r"exists.*--overwrite", refused.output, re.DOTALL)
    assert out.read_text() == "mine"
    run(*words, "--overwrite", code=0)
    assert json.loads(out.read_text())["format"] == "bumpymap-calibration"


@pytest.mark.parametrize("package", ["dartpy", "sklearn"])
def test_missing_libraries_are_named_with_their_extra(tmp_path, monkeypatch, package):
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.setattr(lab_commands, "find_spec", lambda _: None)
    for words, said in (
        (["calibrate", "--vehicle", "warthog"], install_command("sim")),
        (["train", "scans", tmp_path], install_command("learn")),
    ):
        assert said in run(*words, "--out", "c", code=2).stderr
    assert list(tmp_path.iterdir()) == []


# --- check --refit: which calibration is moved, where it is written, what is said ---
@pytest.fixture(scope="module")
def layers(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    map_survey(write_survey(folder / "site.laz"), folder / "layers")
    return folder / "layers"


def test_the_calibration_of_the_map_is_moved_and_written(layers, tmp_path):
    out = tmp_path / "new" / "my_robot.json"
    found = prepare_refit(layers, None, out, overwrite=False)
    update = write_refit(found, out, driven_stretches(WARTHOG, 50, shift=0.3), 1.0, overwrite=False)
    assert Calibration.load(out).settings["moved_to_drives"]["calibration_id"] == WARTHOG.id
    assert [path.name for path in out.parent.iterdir() if not path.name.startswith(".")] == ["my_robot.json"]
    said = "\n".join(refit_lines(update, out))
    assert "500 m of driving on 50 stretches, 500 m of it on different ground: this vehicle pitches 3" in said
    assert f"--calibration {out}" in said
    assert json.dumps(update.to_record())


def test_a_map_of_larger_tiles_has_its_own_calibration(tmp_path):
    map_survey(write_survey(tmp_path / "site.laz"), tmp_path / "layers", tile_size=5)
    own, out = Calibration.shipped("warthog", 5.0), tmp_path / "moved.json"
    assert prepare_refit(tmp_path / "layers", None, out, overwrite=False).id == own.id


def test_drives_that_are_refused_write_nothing(tmp_path):
    out = tmp_path / "my_robot.json"
    with pytest.raises(BadInputError, match="too short"):
        write_refit(WARTHOG, out, driven_stretches(WARTHOG, 5), 1.0, overwrite=False)
    assert not out.exists()


@pytest.mark.parametrize("content", ["time,gyro_y\n", "{}", '{"format": "bumpymap-run"}', "", None])
def test_a_calibration_that_exists_is_replaced_only_if_asked_and_other_files_never(layers, tmp_path, content):
    out, link = tmp_path / "my_robot.json", tmp_path / "link.json"
    out.write_text(Calibration.shipped("car").to_json() if content is None else content, encoding="utf-8")
    link.symlink_to(tmp_path / "elsewhere.json")
    for path, overwrite, said in (
        (out, False, "exists; give `overwrite=True`"),
        (link, False, "exists"),
        (tmp_path, True, "is a folder"),
        *([] if content is None else [(out, True, "is no calibration, and was not touched")]),
    ):
        with pytest.raises(OutputError, match=said):
            prepare_refit(layers, None, path, overwrite=overwrite)
    if content is None:
        write_refit(WARTHOG, out, driven_stretches(WARTHOG, 50), 1.0, overwrite=True)
        assert Calibration.load(out).vehicle["name"] == "warthog"


def test_a_map_is_needed_and_its_own_calibration_at_its_own_speed(layers, tmp_path):
    other, own, out = tmp_path / "rover.json", tmp_path / "mine.json", tmp_path / "a.json"
    other.write_text(Calibration.shipped("small_rover").to_json(), encoding="utf-8")
    own.write_text(WARTHOG.to_json(), encoding="utf-8")
    survey = write_survey(tmp_path / "site.laz")
    map_survey(survey, tmp_path / "own", calibration=own)
    map_survey(survey, tmp_path / "fast", speed=1.5)
    moved = own.rename(tmp_path / "moved.json")
    for folder, given, kind, said in (
        (None, None, UsageError, "give the folder of the map"),
        (layers, other, BadInputError, f"made with the calibration {WARTHOG.id} of warthog"),
        (tmp_path / "own", None, UsageError, r"is not found .* Give its file with `calibration`"),
        (tmp_path / "fast", None, BadInputError, r"made for 1\.5 m/s.*drives at 1 m/s"),
    ):
        with pytest.raises(kind, match=said):
            prepare_refit(folder, given, out, overwrite=False)
    assert prepare_refit(tmp_path / "own", moved, out, overwrite=False).id == WARTHOG.id


# --- train ---


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    return write_rellis(tmp_path_factory.mktemp("data") / "Rellis-3D")


def train(frames, *words, **how):
    pytest.importorskip("torch", reason="torch comes with the extra 'learn'")
    pytest.importorskip("onnx", reason="onnx comes with the extra 'learn'")
    return run("train", "scans", frames, "--set", "epochs=2", "--set", "sectors_per_class=32", *words, **how)


@pytest.mark.slow
def test_a_network_from_a_folder_classes_scans(frames, tmp_path):
    out = tmp_path / "own.onnx"
    result = train(frames, "--out", out, "--set", "seed=5", code=0)
    assert [line.split(":")[0] for line in result.stderr.splitlines()] == ["epoch 1/2", "epoch 2/2"]
    assert [path.name for path in tmp_path.iterdir()] == ["own.onnx"]
    assert len(re.findall(r"([\d.]+) %", result.stdout)) == 2
    run("scan", frames / "00000" / POINTS / "000002.bin", "--out", "o", "--set", f"model={out}", code=0)
    assert f"bumpymap scan FRAME --out DIR --set model={out}" in result.stdout
    train(frames, "--out", "again.onnx", "--set", "seed=5", code=0)
    assert Path("again.onnx").read_bytes() == out.read_bytes()


@pytest.mark.slow
def test_ctrl_c_says_how_to_go_on(frames):
    pytest.importorskip("torch")
    from bumpymap.lab.train import scan_net

    draw, drawn = scan_net.draw_epoch, []

    def stop_at_the_second(*arguments):
        drawn.append(arguments)
        if len(drawn) == 2:
            raise KeyboardInterrupt
        return draw(*arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scan_net, "draw_epoch", stop_at_the_second)
        ended = train(frames, "--out", "m.onnx", code=130)
    assert ended.stderr.endswith("Give the same command again to continue after the last complete epoch.\n")
    again = train(frames, "--out", "m.onnx", code=0)
    assert [line.split(":")[0] for line in again.stderr.splitlines()] == ["epoch 2/2"]
