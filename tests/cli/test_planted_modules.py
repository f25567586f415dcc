"""Modules in the current folder, or beside the surveys, are files of strangers: no command runs one."""

import shutil
import subprocess
import sys
import tomllib
from itertools import chain
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from small_surveys import write_survey

from bumpymap.cli import main

pytestmark = pytest.mark.later

ROOT = Path(__file__).resolve().parents[2]
PLANTED = "open({marker!r}, 'a').write(__file__ + '\\n')\nraise ImportError('planted')\n"
COMMANDS = {
    "map": "map surveys/a.laz --out new",
    "map with a filter in a child": "map surveys/a.laz --out new --ground csf",
    "batch": "batch surveys --out new --jobs 2",
    "demo": "demo --out new",
    "info": "info surveys/a.laz",
    "route": "route layers --from 500005,4000006 --to 500011,4000012 --out way --set cost.robust=true",
    "diff": "diff layers layers --out new",
    "report": "report layers --overwrite",
    "export": "export layers --to nav2 --out new",
    "check": "check layers --drive surveys/drive.csv --out new",
    "scan": "scan surveys/frame.bin --out new",
    "vehicle": "vehicle list",
    "compile": "compile",
    "settings": "settings map",
    "calibrate": "calibrate --out layers",
    "evaluate": "evaluate scans surveys/frame.bin --out new",
    "train": "train scans surveys --out n.onnx",
}
FAIL = {"calibrate": 2, "check": 3, "evaluate": 3, "scan": 3, "train": 3}
"""Commands that have no fit input here, and end once they have imported what they need."""
PROGRAM = """
import operator
import bumpymap
from bumpymap.lab.simulate.jobs import run_in_processes
if __name__ == "__main__":
    assert list(run_in_processes(operator.neg, [1, 2], 2)) == [-1, -2]
    bumpymap.map_survey("surveys/a.laz", "new", overwrite=True)
"""


@pytest.fixture(scope="module", name="place")
def place_fixture(tmp_path_factory):
    """A current folder and one of surveys, in which every module that a command may want is planted."""
    place = tmp_path_factory.mktemp("planted") / "here"
    for name in "ab":
        write_survey(place / "surveys" / f"{name}.laz", points=5000, side=12.0)
    (place / "surveys" / "drive.csv").write_text("time\n")
    (place / "surveys" / "frame.bin").write_bytes(b"")
    (place.parent / "bin").mkdir()
    shutil.copy(ROOT / "bin" / "bumpymap", place.parent / "bin")
    (place.parent / "bin" / "program").write_text(PROGRAM)
    assert ended(place, [str(place.parent / "bin" / "bumpymap"), "map", "surveys/a.laz", "--out", "layers"]) == 0
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    needed = chain(project["dependencies"], *project["optional-dependencies"].values())
    names = {Requirement(line).name.replace("-", "_") for line in needed} | {"PIL", "CSF", "skimage", "sklearn", "dask"}
    plant(place, {*sys.stdlib_module_names, *names, "bumpymap", "bumpytiles", "sitecustomize", "usercustomize"})
    return place


def plant(place, names):
    for folder in (place, place / "surveys"):
        for name in names:
            code = f"open({str(place.parent / 'ran')!r}, 'a').write(__file__ + '\\n')\nraise ImportError('planted')\n"
            (folder / f"{name}.py").write_text(code, encoding="utf-8")


def ended(place, arguments):
    command = [sys.executable, *arguments]
    done = subprocess.run(command, cwd=place, capture_output=True, text=True, timeout=300, check=False)
    assert not (place.parent / "ran").exists(), (place.parent / "ran").read_text()
    assert "Traceback" not in done.stderr, done.stderr
    return done.returncode


def test_all_commands_are_tried():
    assert set(main.list_commands(None)) == {words.split()[0] for words in COMMANDS.values()}


@pytest.mark.parametrize("command", COMMANDS)
def test_no_command_runs_a_module_of_the_current_folder(place, command):
    shutil.rmtree(place / "new", ignore_errors=True)
    assert ended(place, [str(place.parent / "bin" / "bumpymap"), *COMMANDS[command].split()]) == FAIL.get(command, 0)


def test_no_process_of_a_program_runs_one(place):
    assert ended(place, [str(place.parent / "bin" / "program")]) == 0


def test_python_m_runs_none_once_it_has_found_the_package(tmp_path):
    write_survey(tmp_path / "here" / "surveys" / "a.laz", points=5000, side=12.0)
    plant(tmp_path / "here", ["numpy", "click", "json", "multiprocessing", "bumpytiles", "rasterio", "distributed"])
    assert ended(tmp_path / "here", ["-m", "bumpymap", *COMMANDS["map with a filter in a child"].split()]) == 0
