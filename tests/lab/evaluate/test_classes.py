"""Table I."""

import numpy as np
import pytest

from bumpymap.lab.evaluate.agreement import class_table

KLASS = [0, 0, 1, 1, 2, 3]
VARIANCE = np.array([1.0, 3.0, 4.0, 6.0, 7.0, 9.0])
RESIDUAL = np.array([0.1, 0.3, 0.4, np.nan, 0.7, 0.9])


def test_rows_hold_means_medians_and_shares(verdict_of):
    found = class_table(verdict_of([0.1, 0.2, 0.3, 0.4, 0.5, 0.6], KLASS), VARIANCE, RESIDUAL)
    first, second = found["rows"][:2]
    assert (first["tiles"], first["share"]) == (2, pytest.approx(1 / 3))
    assert (first["variance_mean"], first["residual_median"], first["c_r_median"]) == pytest.approx((2, 0.2, 0.15))
    assert second["residual_mean"] == 0.4
    assert all(found["rises"].values())


def test_what_does_not_rise_is_named(verdict_of):
    found = class_table(verdict_of([0.1, 0.2, 0.3, 0.4, 0.5, 0.3], KLASS), VARIANCE[::-1], RESIDUAL)
    assert found["rises"] == {
        "variance_median": False,
        "residual_median": True,
        "c_r_median": False,
        "variance_mean": False,
        "residual_mean": True,
    }


def test_a_class_without_tiles_breaks_no_rise(verdict_of):
    found = class_table(verdict_of([0.1, 0.2, 0.5], [0, 1, 3]), np.array([1.0, 2.0, 3.0]), np.array([0.1, 0.2, 0.3]))
    assert found["rows"][2]["tiles"] == 0
    assert np.isnan(found["rows"][2]["variance_mean"])
    assert all(found["rises"].values())
