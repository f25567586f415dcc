"""Statistics of ratings by SciPy and scikit-learn, the paper's Table I, and drives over a survey held against it."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.stats import spearmanr
from sklearn.metrics import confusion_matrix

from bumpymap.lab.evaluate import agreement

SEEDS = st.integers(0, 2**31)
ROOT = Path(__file__).resolve().parents[2]


@given(SEEDS, st.integers(3, 60))
def test_rank_correlation_is_that_of_scipy_ties_and_all(seed, count):
    first, second = np.random.default_rng(seed).integers(0, 9, (2, count)).astype(float)
    if np.ptp(first) and np.ptp(second):
        assert agreement.spearman(first, second) == pytest.approx(spearmanr(first, second).statistic)
    else:
        assert np.isnan(agreement.spearman(first, second))


@given(SEEDS, st.integers(1, 60))
def test_confusion_matrix_is_that_of_scikit_learn(seed, count):
    truth, predicted = np.random.default_rng(seed).integers(0, 4, (2, count))
    table = agreement.confusion(truth, predicted, 4)
    assert np.array_equal(table, confusion_matrix(truth, predicted, labels=range(4)))


def verdict_of(c_r, class_id=None, p_fail=None):
    """What a rating may say."""
    c_r = np.asarray(c_r, float)
    none = np.zeros(len(c_r))
    class_id = np.asarray(none if class_id is None else class_id, np.uint8)
    p_fail = none if p_fail is None else np.asarray(p_fail, float)
    return agreement.Verdict(class_id, c_r, c_r / 1.2, c_r * 1.2, p_fail, none + 0.8)


def driven_of(c_r, failed):
    """Sixteen drives over each patch, with an error of 3 %."""
    return agreement.DriveStats(c_r, 0.03 * c_r, 16 - failed, failed)


def test_rows_hold_means_medians_and_shares_and_what_does_not_rise_is_named():
    class_id = [0, 0, 1, 1, 2, 3]
    variance, residual = np.array([1.0, 3.0, 4.0, 6.0, 7.0, 9.0]), np.array([0.1, 0.3, 0.4, np.nan, 0.7, 0.9])
    found = agreement.class_table(verdict_of([0.1, 0.2, 0.3, 0.4, 0.5, 0.6], class_id), variance, residual)
    first, second = found["rows"][:2]
    assert (first["tiles"], first["share"]) == (2, pytest.approx(1 / 3))
    assert (first["variance_mean"], first["residual_median"], first["c_r_median"]) == pytest.approx((2, 0.2, 0.15))
    assert second["residual_mean"] == 0.4
    assert all(found["rises"].values())
    other = agreement.class_table(verdict_of([0.1, 0.2, 0.3, 0.4, 0.5, 0.3], class_id), variance[::-1], residual)
    falls = {name for name, rises in other["rises"].items() if not rises}
    assert falls == {"variance_median", "variance_mean", "c_r_median"}


@pytest.mark.slow
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
