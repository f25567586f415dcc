"""How far a map is off: closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from check_records import made_up_check, stretches_at
from hypothesis import given, strategies as st

from bumpymap.check.pipeline import agreement_of
from bumpymap.layers.check_vectors import NOT_COMPARED, OFF_KINDS, MapOffset

ONE = np.array([[330_000.0, 2_040_000.0]])


def offset_of(factor, **changes):
    return MapOffset.of(replace(stretches_at(ONE, [0.1], np.array([factor])), **changes))


@pytest.mark.parametrize(
    ("factor", "kind"),
    [
        (2.01, "map over 2 times too low"),
        (1.99, "map 1.5 to 2 times too low"),
        (1.49, "map 1.2 to 1.5 times too low"),
        (1.19, "map within a factor of 1.2"),
        (1.0, "map within a factor of 1.2"),
        (1 / 1.21, "map 1.2 to 1.5 times too high"),
        (1 / 1.51, "map 1.5 to 2 times too high"),
        (1 / 2.01, "map over 2 times too high"),
    ],
)
def test_the_kind_is_named_from_the_map(factor, kind):
    offset = offset_of(factor)
    assert offset.ratio == pytest.approx(1 / factor)
    assert OFF_KINDS[int(offset.kind[0])] == kind


@given(st.floats(1.01, 20.0), st.floats(1.01, 5.0))
def test_without_errors_of_measurement_the_interval_decides(factor, side):
    exact = {"measured_sd": np.zeros(1), "place_sd": np.zeros(1)}
    above = offset_of(factor, c_r_low=np.array([0.01]), c_r_high=np.array([0.1 * side]), **exact)
    assert above.beyond == pytest.approx((factor - 1) / (side - 1))
    below = offset_of(1 / factor, c_r_low=np.array([0.1 / side]), c_r_high=np.array([9.0]), **exact)
    assert below.beyond == pytest.approx((1 - 1 / factor) / (1 - 1 / side))


def test_errors_add_in_power():
    """80 % half widths, rad/m: 0.03 of the map, 0.04 of the measurement: a difference of 0.05 is just explained."""
    widths = {
        "c_r_high": np.array([0.13]),
        "measured_sd": np.array([0.04]) / 1.2815515655446004,
        "place_sd": np.zeros(1),
    }
    assert offset_of(1.5, **widths).beyond == pytest.approx(1.0)
    widths["place_sd"] = widths["measured_sd"]
    assert offset_of(1.5, **widths).beyond == pytest.approx(0.05 / np.sqrt(0.0041))


def test_the_share_that_errors_explain_is_that_of_the_agreement():
    stretches = made_up_check(200, noise=0.5, unknown=[3, 7]).stretches
    offset = MapOffset.of(stretches)
    explained = ~offset.is_off[np.isfinite(offset.ratio)]
    assert 0.0 < explained.mean() == agreement_of(stretches).inside < 1.0


@pytest.mark.parametrize("changes", [{"c_r": np.array([np.nan])}, {"measured": np.zeros(1)}])
def test_what_is_not_known_or_under_the_floor_is_not_compared(changes):
    offset = offset_of(1.0, **changes)
    assert offset.kind.tolist() == [NOT_COMPARED]
    assert np.isnan(offset.ratio).all()
    assert np.isnan(offset.beyond).all()
    assert not offset.is_off.any()


def test_an_interval_that_is_not_known_leaves_the_errors_of_measurement():
    unknown = {"c_r_low": np.array([np.nan]), "c_r_high": np.array([np.nan])}
    assert offset_of(1.03, **unknown).is_off.tolist() == [False]
    assert offset_of(1.3, **unknown).is_off.tolist() == [True]
