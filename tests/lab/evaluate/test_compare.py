"""Predictions beside drives, and Table I, on made-up numbers."""

import numpy as np
import pytest

from bumpymap.lab.evaluate.agreement import DriveStats, class_table, compare
from bumpymap.lab.simulate.drive import PatchDrives

LIMITS = (0.1, 0.3, 0.5)


def driven_of(c_r, failed):
    """Sixteen drives over each patch, with an error of 3 %."""
    return DriveStats(c_r, 0.03 * c_r, 16 - failed, failed)


def test_drives_are_summed_up():
    patches = [
        PatchDrives(("completed", "stuck", "completed"), (0.1, None, 0.3)),
        PatchDrives(("rolled", "stuck"), (None, None)),
        PatchDrives(("completed",), (0.2,)),
    ]
    found = DriveStats.of(patches)
    np.testing.assert_allclose(found.c_r, [0.2, np.nan, 0.2])
    np.testing.assert_allclose(found.error, [0.1, np.nan, np.nan])
    assert (found.completed.tolist(), found.failed.tolist()) == ([2, 0, 1], [1, 2, 0])
    assert found.comparable.tolist() == [False, False, True]


def test_a_perfect_prediction_is_perfect(verdict_of):
    c_r = np.geomspace(0.02, 0.9, 40)
    verdict = verdict_of(c_r, np.searchsorted(LIMITS, c_r, side="right"))
    found = compare(
        {"ride": verdict}, {"height": c_r**2}, driven_of(c_r, np.zeros(40, int)), np.zeros(40, bool), LIMITS
    )
    own, plain = found.agreement["ride"], found.agreement["height"]
    assert own.spearman == pytest.approx(1) == plain.spearman
    assert (own.median_error, own.steps["same"], own.coverage["held"]) == (pytest.approx(0), 1, 1)
    assert 0 < plain.median_error < 0.1
    assert plain.fail is None
    assert (found.left_out, found.label_error, found.label_error_over) == (0, pytest.approx(0.03), 0)


def test_survivors_are_not_compared_but_their_failures_count(verdict_of):
    c_r = np.array([0.1, 0.2, 0.3, 0.4])
    driven = driven_of(np.array([0.1, 0.2, 0.3, 99.0]), np.array([0, 0, 4, 5]))
    verdict = verdict_of(c_r, [1, 1, 2, 2], p_fail=[0.1, 0.1, 0.9, 0.9])
    found = compare({"ride": verdict}, {"height": c_r}, driven, np.array([False, False, True, False]), LIMITS)
    assert (found.patches, found.left_out, found.beyond_limit, found.failed) == (4, 1, 1, 9)
    own = found.agreement["ride"]
    assert own.median_error == pytest.approx(0)
    assert sum(map(sum, own.confusion)) == 3  # the class of the one beyond the slope limit is a rule
    # Every patch counts alike: shares 9/16 of failures against 2 of safe ground and 23/16 of the same ground.
    assert own.fail["auc"] == pytest.approx((2 + 23 / 16 / 2) / (2 + 23 / 16))
    assert own.fail["auc_below_limit"] == pytest.approx((2 + 11 / 16 / 2) / (2 + 11 / 16))
    # Shares of 0, 0, 4/16 and 5/16: of 9/16 * 55/16 pairs, 2 * 9/16 are safe, the others of four and five compare.
    assert found.auc_most == pytest.approx((2 * 9 + 5 * 12 / 16 + (4 * 12 + 5 * 11) / 32) / (9 * 55 / 16))


def test_ground_that_nothing_crosses_leaves_only_failures_to_compare(verdict_of):
    driven = DriveStats(*np.full((2, 3), np.nan), np.zeros(3, np.int64), np.full(3, 4))
    found = compare({"ride": verdict_of([0.1, 0.2, 0.3])}, {"height": np.ones(3)}, driven, np.zeros(3, bool), LIMITS)
    assert found.left_out == 3
    assert np.isnan(found.agreement["ride"].median_error)
    assert found.agreement["ride"].confusion[3] == [3, 0, 0, 0]
    assert "height" not in found.agreement


KLASS = [0, 0, 1, 1, 2, 3]
VARIANCE = np.array([1.0, 3.0, 4.0, 6.0, 7.0, 9.0])
RESIDUAL = np.array([0.1, 0.3, 0.4, np.nan, 0.7, 0.9])


def test_rows_hold_means_medians_and_shares_and_what_does_not_rise_is_named(verdict_of):
    found = class_table(verdict_of([0.1, 0.2, 0.3, 0.4, 0.5, 0.6], KLASS), VARIANCE, RESIDUAL)
    first, second = found["rows"][:2]
    assert (first["tiles"], first["share"]) == (2, pytest.approx(1 / 3))
    assert (first["variance_mean"], first["residual_median"], first["c_r_median"]) == pytest.approx((2, 0.2, 0.15))
    assert second["residual_mean"] == 0.4
    assert all(found["rises"].values())
    other = class_table(verdict_of([0.1, 0.2, 0.3, 0.4, 0.5, 0.3], KLASS), VARIANCE[::-1], RESIDUAL)
    assert {name for name, rises in other["rises"].items() if not rises} == {
        "variance_median",
        "variance_mean",
        "c_r_median",
    }
