"""Statistics against scikit-learn and SciPy."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.stats import spearmanr
from sklearn.isotonic import IsotonicRegression
from sklearn.metrics import confusion_matrix, roc_auc_score

from bumpymap.lab.evaluate.agreement import (
    class_shift,
    confusion,
    driven_class,
    fail_auc,
    monotone_fit,
    reliability,
    spearman,
)

SEEDS = st.integers(0, 2**32 - 1)


@given(SEEDS, st.integers(3, 60))
def test_rank_correlation_is_that_of_scipy_ties_and_all(seed, count):
    first, second = np.random.default_rng(seed).integers(0, 9, (2, count)).astype(float)
    if np.ptp(first) and np.ptp(second):
        assert spearman(first, second) == pytest.approx(spearmanr(first, second).statistic)
    else:
        assert np.isnan(spearman(first, second))


@given(SEEDS, st.integers(2, 60))
def test_monotone_fit_is_isotonic_regression_on_the_logarithm(seed, count):
    rng = np.random.default_rng(seed)
    predictor, c_r = rng.integers(0, 20, count).astype(float), np.exp(rng.normal(size=count))
    wanted = rng.uniform(-3, 23, 30)
    oracle = IsotonicRegression(out_of_bounds="clip").fit(predictor, np.log(c_r)).predict(wanted)
    np.testing.assert_allclose(monotone_fit(predictor, c_r, wanted), np.exp(oracle), rtol=1e-9)


@given(SEEDS, st.integers(2, 40))
def test_area_under_the_curve_is_that_of_every_single_drive(seed, count):
    rng = np.random.default_rng(seed)
    p_fail = np.round(rng.random(count), 1)
    failed, completed = rng.integers(0, 5, (2, count))
    failed[0], completed[1] = failed[0] + 1, completed[1] + 1
    labels = np.repeat(np.tile([1, 0], count), np.stack([failed, completed], axis=1).ravel())
    scores = np.repeat(np.repeat(p_fail, 2), np.stack([failed, completed], axis=1).ravel())
    assert fail_auc(p_fail, failed, completed) == pytest.approx(roc_auc_score(labels, scores))


def test_reliability_counts_patches():
    found = reliability(np.array([0.1, 0.15, 0.5, 1.0]), np.array([0.0, 0.25, 0.5, 1.0]))
    assert [one["patches"] for one in found] == [2, 0, 1, 0, 1]
    assert found[0]["predicted"] == pytest.approx(0.125)
    assert [found[i]["share_failed"] for i in (0, 2, 4)] == [0.125, 0.5, 1.0]
    assert np.isnan(found[1]["predicted"])


@given(SEEDS, st.integers(1, 60))
def test_confusion_matrix_is_that_of_scikit_learn(seed, count):
    driven, predicted = np.random.default_rng(seed).integers(0, 4, (2, count))
    table = confusion(driven, predicted, 4)
    assert np.array_equal(table, confusion_matrix(driven, predicted, labels=range(4)))
    away = np.abs(driven - predicted)
    shares = {"same": (away == 0).mean(), "one_off": (away == 1).mean(), "further": (away > 1).mean()}
    assert class_shift(table) == pytest.approx(shares)
    assert all(np.isnan(share) for share in class_shift(np.zeros((4, 4), np.int64)).values())


def test_where_half_of_the_drives_failed_the_class_is_the_last():
    c_r = np.array([0.05, 0.05, 0.2, np.nan, 0.1])
    share = np.array([0.0, 0.5, 0.49, 1.0, 0.0])
    assert driven_class(c_r, share, (0.1, 0.3, 0.5)).tolist() == [0, 3, 1, 3, 1]
