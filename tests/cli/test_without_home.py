"""A container's user: a number that no table of users knows, and no HOME."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.later

QUARRY = Path(__file__).resolve().parents[2] / "sample_data" / "quarry.laz"
NOBODY = """
import os, pwd, sys
def nobody(_):
    raise KeyError("uid not found")
pwd.getpwuid = pwd.getpwnam = nobody
for name in ("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "NUMBA_CACHE_DIR", "USER", "LOGNAME"):
    os.environ.pop(name, None)
from bumpymap.cli import main
main()
"""


def said(*words):
    """What a command prints; it must end well and say nothing else."""
    env = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    command = [sys.executable, "-c", NOBODY, *map(str, words)]
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    told = [line for line in done.stderr.splitlines() if not line.startswith("Warning: the numerical kernels are")]
    assert told == []
    return done.stdout


@pytest.fixture
def frame(tmp_path):
    rng = np.random.default_rng(1)
    place = rng.uniform(-18, 18, (60_000, 2))
    z = -1.5 + rng.normal(0, 0.01, len(place))
    np.column_stack([place, z, np.zeros(len(place))]).astype("<f4").tofile(tmp_path / "frame.bin")
    return tmp_path / "frame.bin"


def test_commands_need_no_home(tmp_path, frame):
    assert "1,250,148" in said("info", QUARRY)
    assert "Layers in" in said("map", QUARRY, "--out", tmp_path / "layers")
    assert "Output in" in said("scan", frame, "--out", tmp_path / "scanned")
