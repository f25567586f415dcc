"""Settings in messages: arguments for a Python caller, options on the command line."""

import ast
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import bumpymap
from bumpymap.change import DiffConfig
from bumpymap.check import CheckConfig
from bumpymap.cli import main
from bumpymap.cli._wording import as_options
from bumpymap.core.config import MapConfig
from bumpymap.layers import ExportSettings
from bumpymap.route import CostSettings, RouteConfig
from bumpymap.scan import ScanConfig
from bumpymap.survey import BatchConfig

ROOT = Path(__file__).resolve().parents[1]
QUARRY = ROOT / "sample_data" / "quarry.laz"
COMMANDS_ALONE = {
    *("cli", "lab", "survey/advice.py", "rating/vehicle"),
    "rating/calibration_lookup.py",  # its messages show commands to type
}
"""Code whose messages go to the command line: no call of the public API reaches it."""
A_COMMAND = re.compile(r"\b(bumpymap|pdal) [a-z]+ |\bmavlogdump\.py |--(filters|writers)\.|^reprojection$")

BAD = [
    ({"tile_size": -1}, "tile_size"),
    ({"tile_size": "large"}, "tile_size"),
    ({"tile_size": 5}, "tile_size=3"),
    ({"pixels": 2.5}, "pixels"),
    ({"pixels": 31}, "pixels=15"),
    ({"ground": "grass"}, "ground"),
    ({"ground": "csf", "csf": {"rigidness": 7}}, "rigidness"),
    ({"rating": "good"}, "rating"),
    ({"compat": "paper", "rating": "ride"}, "compat and rating"),
    ({"vehicle": "hovercraft"}, "hovercraft"),
    ({"vehicle": "warthog", "calibration": "a.json"}, "calibration and vehicle"),
    ({"calibration": "missing.json"}, "missing.json"),
    ({"model": "missing.onnx"}, "missing.onnx"),
    ({"crs": "EPSG:1"}, "crs='EPSG:1'"),
    ({"crs": "EPSG:4326"}, "CRS"),
    ({"crs": "EPSG:32632", "local": True}, "crs and local"),
    ({"z_unit": "yards"}, "z_unit"),
    ({"local": "yes"}, "local"),
    ({"resume": True, "overwrite": True}, "resume=True"),
    ({"threads": 0}, "threads"),
    ({"memory": "lots"}, "memory"),
    ({"workers": 0}, "workers"),
    ({"workers": 1, "scheduler": "tcp://a:1"}, "scheduler"),
    ({"scheduler": "tls://a:1"}, "tls_config="),
    ({"tls_config": "a.toml"}, "tls_config"),
    ({"features": {"min_points": 1}}, "min_points"),
    ({"features": {"max_holes": 1}}, "max_holes"),
    ({"features": 3}, "features"),
]


@pytest.mark.parametrize(("settings", "words"), BAD)
def test_a_python_caller_reads_arguments(settings, words, tmp_path):
    with pytest.raises(bumpymap.BumpymapError) as caught:
        bumpymap.map_survey(QUARRY, tmp_path / "out", **settings)
    told = " ".join([str(caught.value), *getattr(caught.value, "__notes__", [])])
    assert words in told
    assert "--" not in re.sub(r"(bumpymap|pdal) (train|calibrate|translate) [^;]*", "", told)


@pytest.mark.parametrize("prepare", ["complete", "other", "file", "no_crs", "no_ground", "tiles"])
def test_what_inputs_and_folders_cause_is_told_in_arguments(prepare, tmp_path):
    out, survey, settings = tmp_path / "out", QUARRY, {}
    if prepare == "complete":
        bumpymap.map_survey(survey, out)
        settings = {"ground": "all"}
    elif prepare == "other":
        out.mkdir()
        (out / "class.tif").touch()
    elif prepare == "file":
        out.touch()
    elif prepare == "no_crs":
        survey = _ply(tmp_path / "site.ply")
    else:
        survey, settings = _ply(tmp_path / "site.ply"), {"local": True, "ground": "class"}
        settings |= {"memory": "nothing"} if prepare == "tiles" else {}
    with pytest.raises(bumpymap.BumpymapError) as caught:
        bumpymap.map_survey(survey, out, **settings)
    said = {
        "complete": "overwrite=True",
        "other": "overwrite=True",
        "no_crs": "local=True",
        "no_ground": "ground='all'",
    }
    assert said.get(prepare, "") in str(caught.value)
    assert "--" not in str(caught.value)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"method": "sharp"}, "method"),
        ({"method": "learned", "stripes": "a.json"}, "stripes"),
        ({"compat": "paper", "stripes": "a.json"}, "compat='paper'"),
        ({"model": "missing.onnx"}, "missing.onnx"),
        ({"robot": {"radius": 1}}, "radius"),
        ({"polar": {"rings": "many"}}, "rings"),
    ],
)
def test_a_caller_of_the_classifier_reads_arguments(settings, words):
    with pytest.raises(bumpymap.BumpymapError) as caught:
        bumpymap.ScanClassifier(**settings)
    assert words in str(caught.value)
    assert "--" not in str(caught.value).partition("bumpymap train")[0]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--crs", "EPSG:1"], "--crs EPSG:1 is not a coordinate reference system"),
        (["--resume", "--overwrite"], "--resume continues an interrupted run, --overwrite starts again"),
        (["--tile-size", "5"], "Use --tile-size 3, --pixels 15"),
        (["--scheduler", "tls://a:1"], "give --tls-config FILE"),
        (["--crs", "EPSG:32632", "--local"], "--crs and --local contradict"),
    ],
)
@pytest.mark.parametrize("style", [[], ["--log-json"]])
def test_the_command_line_reads_options(words, said, style, tmp_path):
    done = CliRunner().invoke(main, ["map", str(QUARRY), "--out", str(tmp_path / "out"), *words, *style])
    assert done.exit_code == 2
    assert said in done.output
    assert "`" not in done.output


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("Choose another `out`, or `overwrite=True`", "Choose another --out, or --overwrite"),
        ("pass `crs='EPSG:32614'`", "pass --crs EPSG:32614"),
        ("`crs='my crs'` is none", "--crs 'my crs' is none"),
        ("Use `tile_size=5`", "Use --tile-size 5"),
        ("a file named a`b.laz and `C:\\x`", "a file named a`b.laz and `C:\\x`"),
        ("", ""),
    ],
)
def test_settings_are_spelled_as_options(text, shown):
    assert as_options(text) == shown


def _is_for_commands(file):
    return any(file.is_relative_to(ROOT / "bumpymap" / place) for place in COMMANDS_ALONE)


@pytest.mark.slow
def test_no_message_that_a_python_caller_can_see_names_an_option():
    found = []
    for file in sorted((ROOT / "bumpymap").rglob("*.py")):
        if _is_for_commands(file):
            continue
        tree = ast.parse(file.read_text(encoding="utf-8"))
        documented = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        for node in ast.walk(tree):
            if isinstance(node, ast.JoinedStr):
                text = "".join(part.value if isinstance(part, ast.Constant) else "{}" for part in node.values)
                documented |= {id(part) for part in node.values}
            elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in documented:
                text = node.value
            else:
                continue
            if re.search(r"--[a-z]", A_COMMAND.split(text)[0]):
                found.append(f"{file.name}:{node.lineno}: {text}")
    assert found == []


def test_every_setting_in_backquotes_is_one():
    known = set(MapConfig.__dataclass_fields__) | {"fit", "check"}
    known |= set(BatchConfig.__dataclass_fields__)
    known |= set(RouteConfig.__dataclass_fields__) | set(CostSettings.__dataclass_fields__)
    known |= set(ScanConfig.__dataclass_fields__)
    known |= set(ExportSettings.__dataclass_fields__)
    known |= set(DiffConfig.__dataclass_fields__) | set(CheckConfig.__dataclass_fields__)
    for file in sorted((ROOT / "bumpymap").rglob("*.py")):
        if _is_for_commands(file):
            continue
        tree = ast.parse(file.read_text(encoding="utf-8"))
        documented = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in documented:
                named = re.findall(r"`([a-z_]+)(?:=[^`]*)?`", node.value)
                assert set(named) <= known, f"{file.name}:{node.lineno}"


def _ply(path):
    points = np.random.default_rng(0).uniform(0, 30, (5000, 3)) * (1, 1, 0.01)
    lines = "\n".join(" ".join(f"{value:.3f}" for value in point) for point in points)
    header = "ply\nformat ascii 1.0\nelement vertex 5000\nproperty double x\nproperty double y\nproperty double z\n"
    path.write_text(f"{header}end_header\n{lines}\n", encoding="ascii")
    return path
