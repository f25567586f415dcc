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


def test_a_shuffled_survey_holds_the_same_points(tmp_path):
    facts = [_make(tmp_path, "--order", order) for order in ("sorted", "shuffled")]
    first, second = (laspy.read(fact["path"]).points.array for fact in facts)
    assert not np.array_equal(first, second)
    assert np.array_equal(np.sort(first), np.sort(second))
    assert facts[0]["points"] == facts[1]["points"] == len(first) == 300_000
    assert facts[0]["width_m"] == facts[1]["width_m"]
