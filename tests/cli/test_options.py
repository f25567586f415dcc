"""Every option: what was typed counts, contradictions are refused; vehicles, calibrations and networks of users."""

import importlib.util
import json
import re
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import click
import pytest
from check_records import driven_stretches
from made_drives import POINTS, write_rellis
from small_surveys import run, write_survey

from bumpymap.api import map_survey
from bumpymap.cli import lab_commands, main
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


def command(name):
    found = main
    for word in name.split():
        found = found.get_command(click.Context(found), word)
    return found


COMMANDS = [
    " ".join(words)
    for first in main.list_commands(click.Context(main))
    for words in ([(first, part) for part in getattr(command(first), "commands", ())] or [(first,)])
]


def options(name):
    return [parameter for parameter in command(name).params if isinstance(parameter, click.Option)]


class Reached(Exception):  # noqa: N818 (no error)
    """The work would begin."""


@pytest.fixture
def reached(monkeypatch, tmp_path):
    """Give what each command hands to its work, which is not done."""
    got = {}

    def ends(name):
        def end(*values, **named):
            got[name] = (*values, *named.values())
            raise Reached

        return end

    # Modules that bind a patched name are imported before it is patched, or they would keep it.
    import bumpymap.readers
    import bumpymap.survey.batch.run
    import bumpymap.survey.engine
    import bumpymap.survey.pipeline
    from bumpymap.cli import lab_commands

    monkeypatch.setattr(bumpymap.survey.pipeline, "_prepare", ends("map"))
    monkeypatch.setattr("bumpymap.survey.run_batch", ends("batch"))
    monkeypatch.setattr("bumpymap.route.plan_routes", ends("route"))
    monkeypatch.setattr("bumpymap.change.find_changes", ends("diff"))
    monkeypatch.setattr("bumpymap.check.run_check", ends("check"))
    monkeypatch.setattr("bumpymap.layers.open_map", lambda _: SimpleNamespace(has_crs=False))
    monkeypatch.setattr("bumpymap.views.export_map", ends("export"))
    monkeypatch.setattr("bumpymap.scan.scan_frames", ends("scan"))
    monkeypatch.setattr(bumpymap.readers, "find_surveys", ends("info"))
    monkeypatch.setattr(lab_commands, "_calibrate", ends("calibrate"))
    monkeypatch.setattr("bumpymap.lab.require_dart", lambda: None)
    monkeypatch.setattr(lab_commands, "find_spec", lambda _: True)
    if importlib.util.find_spec("torch"):
        monkeypatch.setattr("bumpymap.lab.make_model", ends("train textures"))
        monkeypatch.setattr("bumpymap.lab.make_scan_model", ends("train scans"))
    return got


# The least words that a command works with, and what goes with some options.
WORDS = {
    "batch": ["surveys", "--out", "o"],
    "map": ["site.laz", "--out", "o"],
    "scan": ["drive", "--out", "o"],
    "info": ["site.laz"],
    "route": ["layers", "--from", "1,1", "--to", "2,2"],
    "calibrate": ["--vehicle", "warthog", "--out", "c.json"],
    "evaluate scans": ["frame.bin", "--out", "o"],
    "train textures": ["--out", "m.onnx"],
    "train scans": ["drive", "--out", "m.onnx"],
    "export": ["site_layers", "--to", "nav2", "--out", "o"],
    "diff": ["may_layers", "june_layers"],
    "check": ["--drive", "drive.csv"],
}
SLOPES = "climb", "descent", "side_slope"
# (command, option, value) -> where the value has to arrive.
MEANT = {
    ("calibrate", "seed", 0): lambda got: got[0].seed,
    ("train textures", "seed", 0): lambda got: got[0].seed,
    ("train scans", "seed", 0): lambda got: got[0].seed,
    ("scan", "radius_m", 0): lambda got: got[0].robot.radius_m,
    ("route", "risk", 0): lambda got: got[0].cost.risk,
    ("scan", "pictures", 0): lambda got: got[0].pictures,
    ("diff", "offset", 0): lambda got: got[0].offset,
    ("map", "max_unknown", 0): lambda got: got[0].max_unknown,
    ("batch", "max_unknown", 0): lambda got: got[0].given["max_unknown"],
    ("diff", "offset", -1): lambda got: got[0].offset,
    ("route", "snap", 0): lambda got: got[0].snap,
    **{("route", name, 0): lambda got, name=name: getattr(got[0].cost, name) for name in SLOPES},
    **{("export", name, 0): lambda got, name=name: getattr(got[2], name) for name in SLOPES},
}
NUMERIC = {"SIZE", "LIST", "N", "M", "HZ", "COST", "SHARE", "KM", "RAD_S"}


def moved(name):
    """Settings that have no option: option that it would be, key, value."""
    return [(option, *found) for option, found in getattr(command(name), "moved", {}).items()]


def numbers():
    """Yield command, setting, words that give a number, the name that a message has for it, and the number."""
    for name in COMMANDS:
        for option in options(name):
            known = option.type.name in {"integer", "float", "integer range", "float range"}
            if known or (option.metavar in NUMERIC and option.name not in {"products", "columns"}):
                # After an option that may stand alone, click takes a word with a dash for the next option.
                for value in ("0", "nan") if option._flag_needs_value else ("0", "-1", "nan"):
                    yield name, option.name, [f"{option.opts[0]}={value}"], option.opts[0], value
        for _, key, kind in moved(name):
            setting = key.split(".")[-1]
            if (
                kind in NUMERIC
                and setting not in {"products", "columns"}
                and (name, setting) != ("info", "max_unknown")
            ):
                for value in ("0", "-1", "nan"):
                    yield name, setting, ["--set", f"{key}={value}"], key, value


@pytest.mark.parametrize(("name", "setting", "given", "named", "value"), list(numbers()))
def test_no_number_is_ignored(name, setting, given, named, value, reached, tmp_path):
    """0 and -1 are refused with a message that names the option, or arrive as they are meant."""
    if name.startswith("train"):
        pytest.importorskip("torch")
    result = run(*name.split(), *WORDS[name], *given)
    if (name, setting, float(value)) in MEANT:
        assert isinstance(result.exception, Reached), result.output
        assert MEANT[name, setting, float(value)](reached[name]) == float(value)
        return
    assert result.exit_code == 2, (result.output, result.exception)
    _, _, message = result.stderr.rpartition("Error: ")
    assert named in re.findall(r"--[a-z-]+|[a-z][a-z_.]+", message), result.stderr
    assert not reached
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("content", "words", "expected"),
    [
        ('vehicle = "car"', ["--calibration", "c.json"], {"vehicle": "warthog", "calibration": "c.json"}),
        ('calibration = "c.json"', ["--vehicle", "car"], {"vehicle": "car", "calibration": "None"}),
        ('rating = "table"', ["--set", "compat=paper"], {"rating": "ride", "compat": "paper"}),
        ('compat = "paper"', ["--set", "rating=table"], {"rating": "table", "compat": "none"}),
        ("local = true", ["--crs", "EPSG:32614"], {"local": "False", "crs": "EPSG:32614"}),
        ("local = false", ["--crs", "EPSG:32614"], {"local": "False", "crs": "EPSG:32614"}),
    ],
)
def test_what_is_typed_wins_over_what_contradicts_it_in_a_file(content, words, expected, reached, tmp_path):
    (tmp_path / "a.toml").write_text(content)
    result = run("map", "a.laz", "--out", "o", "--config", "a.toml", *words)
    assert isinstance(result.exception, Reached), result.output
    assert {name: str(getattr(reached["map"][0], name)) for name in expected} == expected


def test_contradictions_of_a_file_are_refused(reached, tmp_path):
    (tmp_path / "a.toml").write_text('vehicle = "car"\ncalibration = "c.json"')
    result = run("map", "a.laz", "--out", "o", "--config", tmp_path / "a.toml")
    assert (result.exit_code, "calibration and vehicle contradict each other" in result.stderr) == (2, True)


@pytest.mark.parametrize(
    "words",
    [
        [],
        ["--quick", "--set", "patches=2"],
        ["--set", "patches=8", "--quick"],
        ["--set=seed=0", "--tile-size=3.123456789", "--set=pixels=21", "--set=terrains=3", "--set=starts=1"],
    ],
)
def test_the_stored_command_repeats_the_run(words, reached, tmp_path):
    pytest.importorskip("dartpy")
    assert isinstance(run("calibrate", "--vehicle", "warthog", "--out", "c.json", *words).exception, Reached)
    settings, again = reached["calibrate"][0], reached["calibrate"][4]
    if "patches=2" in words:
        assert settings.patches == 2
    assert isinstance(run(*again.split()[1:]).exception, Reached)
    assert reached["calibrate"][0] == settings
    assert reached["calibrate"][4] == again


LONG = [name for name in COMMANDS if name != "settings" and not name.startswith("vehicle")]


@pytest.mark.parametrize("name", [name for name in LONG if name not in {"batch", "demo", "report", "info", "view"}])
def test_a_settings_file_names_every_setting_and_its_default(name, tmp_path, reached):
    """Its lines without the # give what the command does without the file."""
    text = run("settings", *name.split()).stdout
    keys = {key.split(".")[-1] for _, key, _ in moved(name)}
    assert keys <= set(re.findall(r"^#([a-z_]+) =", text, re.MULTILINE))
    (tmp_path / "a.toml").write_text(re.sub(r"^#(?=[a-z_]+ = |\[)", "", text, flags=re.MULTILINE))
    if name.startswith("train"):
        pytest.importorskip("torch")
    plain = run(*name.split(), *WORDS[name])
    first = reached.get(name)
    stated = run(*name.split(), *WORDS[name], "--config", tmp_path / "a.toml")
    assert (plain.exit_code, plain.stderr) == (stated.exit_code, stated.stderr)
    alike = [re.sub(r" at 0x[0-9a-f]+|memory='?\d+\w*", "", repr(got)) for got in (reached.get(name), first)]
    assert alike[0] == alike[1]


@pytest.mark.parametrize("name", ["map", "scan", "train textures"])
def test_the_schema_of_a_settings_file_has_its_keys_tables_and_bounds(name):
    validator = pytest.importorskip("jsonschema").Draft7Validator
    schema = json.loads(run("settings", *name.split(), "--schema").stdout)
    validator.check_schema(schema)
    lines = re.findall(r"^#([a-z_]+) =|^#\[([a-z_]+)\]", run("settings", *name.split()).stdout, re.MULTILINE)
    inner = [each.get("properties", {}) for each in schema["properties"].values()]
    assert {*schema["properties"]}.union(*inner) == {key or table for key, table in lines}
    if name == "map":
        check = validator(schema)
        assert check.is_valid({"tile_size": 5.0, "ground": "csf", "csf": {"rigidness": 2}, "ground_classes": [2, 8]})
        for wrong in (
            {"tile_size": 0},
            {"ground": "none"},
            {"csf": {"rigidness": 4}},
            {"ground_classes": ["x"]},
            {"no": 1},
        ):
            assert not check.is_valid(wrong), wrong


def test_a_set_value_keeps_the_rest_of_a_table(reached, tmp_path):
    (tmp_path / "a.toml").write_text("[csf]\nrigidness = 2\ncloth_resolution = 1.5\n[features]\nmin_points = 12")
    words = ["--config", tmp_path / "a.toml", "--set", "csf.rigidness=1", "--set", "ground_classes=2,8"]
    run("map", "a.laz", "--out", "o", *words)
    config = reached["map"][0]
    assert (config.csf.rigidness, config.csf.cloth_resolution, config.features.min_points) == (1, 1.5, 12)
    assert config.ground_classes == (2, 8)
    run("map", "a.laz", "--out", "o", "--set", "max_unknown = 40%", "--set", "ground_classes=2")
    assert (reached["map"][0].max_unknown, reached["map"][0].ground_classes) == (0.4, (2,))
    run("route", *WORDS["route"], "--via", "3,3", "--via", "4,4")
    assert reached["route"][0].via == ("3,3", "4,4")


@pytest.mark.parametrize("name", LONG)
def test_what_refuses_a_moved_option_names_a_command_that_prints_its_settings(name):
    for option, key, value in moved(name)[:1]:
        done = run(*name.split(), option, *WORDS[name])
        assert f"write --set {key}={value}, or put it" in done.stderr
        assert f"bumpymap settings {name} prints one" in done.stderr
        assert key.split(".")[-1] in run("settings", *name.split()).stdout


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
