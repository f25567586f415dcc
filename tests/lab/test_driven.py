"""Classes against labels by scikit-learn, and drives over a survey held against its map."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from sklearn.metrics import accuracy_score, confusion_matrix, recall_score

from bumpymap.lab.label_sets import accuracy_of

ROOT = Path(__file__).resolve().parents[2]


@given(st.integers(0, 2**31), st.integers(1, 60))
def test_scores_are_those_of_scikit_learn(seed, count):
    truth, answer = np.random.default_rng(seed).integers(0, 4, (2, count))
    found = accuracy_of(truth, answer, 4)
    assert found.confusion == confusion_matrix(truth, answer, labels=range(4)).tolist()
    assert found.right == pytest.approx(accuracy_score(truth, answer))
    occurs = np.unique(truth)
    recall = recall_score(truth, answer, labels=occurs, average=None)
    assert np.array(found.recall)[occurs] == pytest.approx(recall)
    assert np.isnan(found.recall).sum() == 4 - len(occurs)
    assert found.even == pytest.approx(recall.mean())


@pytest.mark.later
def test_patches_of_a_survey_are_driven_and_compared(tmp_path):
    pytest.importorskip("dartpy")
    out, survey = tmp_path / "report.json", ROOT / "sample_data" / "quarry_part.ply"
    words = [ROOT / "tests" / "tools" / "driven.py", survey, "--patches", 4, "--drives", 2, "--out", out]
    said = subprocess.run([sys.executable, *map(str, words)], capture_output=True, text=True, check=True).stdout
    assert "| `ride` |" in said
    assert "4 patches, " in said
    patches = json.loads(out.read_text())["patches"]
    assert len(patches["driven"]["c_r"]) == len(patches["verdicts"]["ride"]["c_r"]) == 4
    assert min(patches["driven"]["c_r"]) > 0
