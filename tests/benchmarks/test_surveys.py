"""The synthetic surveys of the benchmarks."""

import json
import subprocess
import sys
from pathlib import Path

import laspy
import numpy as np
import pytest

from bumpymap.readers import open_survey

pytestmark = pytest.mark.slow
_SCRIPT = Path(__file__).with_name("surveys.py")


def _make(folder, *words):
    script = [sys.executable, str(_SCRIPT), "--data", str(folder), "--points", "300000", *words]
    return json.loads(subprocess.run(script, check=True, capture_output=True).stdout)


def _sorted(*files):
    return np.sort(np.concatenate([laspy.read(file).points.array for file in files]))


def test_one_file_files_that_adjoin_and_copc_contain_the_same_points(tmp_path):
    whole, parts, tree = (_make(tmp_path, *words) for words in ([], ["--cuts", "3"], ["--format", "copc"]))
    points = _sorted(whole["path"])
    files = sorted(Path(parts["path"]).iterdir())
    assert len(files) == 9
    assert np.array_equal(_sorted(*files), points)
    assert np.array_equal(_sorted(tree["path"]), points)
    assert whole["points"] == parts["points"] == tree["points"] == len(points) == 300_000
    assert whole["width_m"] == pytest.approx(parts["width_m"]) == tree["width_m"]
    with laspy.CopcReader.open(tree["path"]) as reader:
        assert np.array_equal(np.sort(reader.query().array), points)
        assert [len(reader.query(level=level)) > 0 for level in range(4)] == [True, True, True, False]
    assert open_survey(Path(tree["path"])).info.point_count == 300_000
