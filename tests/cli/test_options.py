"""Every option of every command: what was typed counts, contradictions are refused, one style of help."""

import importlib.util
import json
import re
from types import SimpleNamespace

import click
import pytest
from small_surveys import run

from bumpymap.cli import main


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
def test_no_number_is_ignored(name, setting, given, named, value, reached, tmp_path, monkeypatch):
    """0 and -1 are refused with a message that names the option, or arrive as they are meant."""
    monkeypatch.chdir(tmp_path)
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
def test_what_is_typed_wins_over_what_contradicts_it_in_a_file(
    content, words, expected, reached, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
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
def test_the_stored_command_repeats_the_run(words, reached, tmp_path, monkeypatch):
    pytest.importorskip("dartpy")
    monkeypatch.chdir(tmp_path)
    assert isinstance(run("calibrate", "--vehicle", "warthog", "--out", "c.json", *words).exception, Reached)
    settings, again = reached["calibrate"][0], reached["calibrate"][4]
    if "patches=2" in words:
        assert settings.patches == 2
    assert isinstance(run(*again.split()[1:]).exception, Reached)
    assert reached["calibrate"][0] == settings
    assert reached["calibrate"][4] == again


LONG = [name for name in COMMANDS if name != "settings" and not name.startswith("vehicle")]


@pytest.mark.parametrize("name", [name for name in LONG if name not in {"batch", "demo", "report", "info", "view"}])
def test_a_settings_file_names_every_setting_and_its_default(name, tmp_path, monkeypatch, reached):
    """Its lines without the # give what the command does without the file."""
    monkeypatch.chdir(tmp_path)
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
