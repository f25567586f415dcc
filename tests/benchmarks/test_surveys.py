"""The synthetic surveys of the benchmarks."""

import json
import subprocess
import sys
from pathlib import Path

import laspy
import numpy as np
import pytest

pytestmark = pytest.mark.slow
_SCRIPT = Path(__file__).with_name("surveys.py")


def _make(folder, *words):
    script = [sys.executable, str(_SCRIPT), "--data", str(folder), "--points", "300000", *words]
    return json.loads(subprocess.run(script, check=True, capture_output=True).stdout)


def _sorted(*files):
    return np.sort(np.concatenate([laspy.read(file).points.array for file in files]))


def test_one_file_and_files_that_adjoin_contain_the_same_points(tmp_path):
    whole, parts = (_make(tmp_path, *words) for words in ([], ["--cuts", "3"]))
    points = _sorted(whole["path"])
    files = sorted(Path(parts["path"]).iterdir())
    assert len(files) == 9
    assert np.array_equal(_sorted(*files), points)
    assert whole["points"] == parts["points"] == len(points) == 300_000
    assert whole["width_m"] == pytest.approx(parts["width_m"])
