"""Pipes instead of files: nothing waits for what nobody writes."""

import os
import re
import signal
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest
from click.testing import CliRunner
from cost_maps import make_field
from route_maps import write_folder
from small_surveys import write_survey

from bumpymap.cli import main
from bumpytiles import Grid

pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")


class WaitedError(BaseException):
    """Nothing but the test may catch it."""


def wait(*_):
    raise WaitedError


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    """A survey, a frame and a map."""
    folder = tmp_path_factory.mktemp("given")
    write_survey(folder / "survey.las", points=100)
    np.zeros((50, 4), np.float32).tofile(folder / "frame.bin")
    write_folder(folder / "layers", make_field(12, 10, grid=Grid(3.0, 5), easy=True))
    return folder


@pytest.mark.parametrize(
    "line",
    [
        *(
            f"map survey.las --out out {option}"
            for option in ("--set model=p.onnx", "--config p.toml", "--vehicle p.toml")
        ),
        *(f"{command} --out out --calibration p.json" for command in ("map survey.las", "scan frame.bin")),
        *("batch p.csv --out out", "batch p.txt --out out", "batch . --out out --config p.toml"),
        *(f"scan frame.bin --out out {option}" for option in ("--set model=p.onnx", "--poses p.txt")),
        *(
            "scan p.mcap --out out",
            "scan p.db3 --out out",
        ),
        *(f"route layers --points p{suffix}" for suffix in (".csv", ".gpx", ".geojson")),
        *(f"route layers --from 1,1 --to 2,2 --avoid p{suffix}" for suffix in (".geojson", ".gpkg", ".shp")),
        *(f"check --drive p{suffix}" for suffix in (".csv", ".ulg", ".bag", ".mcap")),
        "check layers --drive survey.las --refit new.json --calibration p.json",
        *("export layers --to plan --out out --route p.geojson", "report layers --out out.html --route p.geojson"),
        *("report piped --out out.html", "info p.las", "calibrate --vehicle p.toml --out out.json"),
    ],
)
def test_a_pipe_is_refused_and_not_waited_for(given, tmp_path, monkeypatch, line):
    monkeypatch.chdir(copytree(given, tmp_path / "here"))
    Path("piped").mkdir()
    name = next((word for word in re.split("[ =]", line) if word.startswith("p.")), "piped/run.json")
    os.mkfifo(name)
    before = signal.signal(signal.SIGALRM, wait)
    signal.alarm(20)
    try:
        done = CliRunner().invoke(main, line.split())
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    assert done.exit_code in {2, 3}, done.output
    assert Path(name).name in done.output
