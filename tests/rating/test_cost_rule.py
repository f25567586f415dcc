"""What is passable, and at what cost: closed forms, and every rating on real layers."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from click.testing import CliRunner
from hypothesis import given, strategies as st

from bumpymap.cli import main
from bumpymap.core.errors import BadInputError
from bumpymap.core.types import NO_CLASS, Barred, CostRule
from bumpymap.rating.calibration import Calibration, shipped_calibrations

QUARRY = Path(__file__).resolve().parents[2] / "sample_data" / "quarry.laz"
RULE = CostRule(ride_weight=5.0, fail_weight=300.0, drive_m=10.0, slope_limit_deg=30.0)


def columns(*, class_id=3, c_r=0.5, p_fail=0.1, slope=5.0):
    return {
        "class_id": np.array([class_id], np.uint8),
        "c_r": np.array([c_r], np.float32),
        "p_fail": np.array([p_fail], np.float32),
        "slope": np.array([slope]),
    }


@given(p_fail=st.floats(0, 0.49), drive_m=st.floats(1, 100))
def test_over_the_length_of_a_drive_as_many_arrive_as_the_calibration_says(p_fail, drive_m):
    (hazard,) = replace(RULE, drive_m=drive_m).hazard(np.array([p_fail]))
    assert np.exp(-hazard * drive_m) == pytest.approx(1 - p_fail)
    assert np.exp(-hazard * 3 * drive_m) == pytest.approx((1 - p_fail) ** 3)


def test_hazard_where_all_drives_fail_or_nobody_knows():
    np.testing.assert_array_equal(RULE.hazard(np.array([0.0, 1.0, np.nan], np.float32)), [0.0, np.inf, np.nan])


def test_cost_of_a_certain_failure_is_its_weight():
    # A hazard of 1/m is one expected failure in a metre: the metre itself, the ride, and fail_weight metres.
    assert RULE.cost(np.array([0.2]), np.array([1.0])) == pytest.approx([1 + 5 * 0.2 + 300])
    assert RULE.cost(np.array([0.2]), np.array([np.nan])) == pytest.approx([1 + 5 * 0.2])


@pytest.mark.parametrize(
    ("tile", "barred"),
    [
        ({}, Barred.NO),
        ({"p_fail": 0.49}, Barred.NO),
        ({"p_fail": 0.5}, Barred.FAILS),
        ({"p_fail": 1.0}, Barred.FAILS),
        ({"slope": 30.0}, Barred.NO),
        ({"slope": 30.1, "p_fail": 1.0}, Barred.SLOPE),
        ({"slope": np.nan}, Barred.SLOPE),
        ({"class_id": NO_CLASS}, Barred.UNKNOWN),
        ({"c_r": np.nan}, Barred.UNKNOWN),
        ({"p_fail": np.nan, "class_id": 2}, Barred.NO),
        ({"p_fail": np.nan, "class_id": 3}, Barred.FAILS),
    ],
)
def test_what_bars_a_tile(tile, barred):
    assert RULE.barred(columns(**tile)).tolist() == [barred]


@pytest.mark.parametrize("name", shipped_calibrations())
def test_shipped_calibrations_know_the_length_of_their_drives(name):
    calibration = Calibration.shipped(name)
    vehicle, rule = calibration.vehicle, calibration.cost_rule
    assert rule.drive_m == vehicle["speed_mps"] * calibration.settings["drive"]["measure_s"]
    assert (rule.ride_weight, rule.fail_weight) == (vehicle["ride_weight"], 300.0)


@pytest.mark.parametrize("change", [{"fail_weight": -1.0}, {"fail_weight": "much"}, {"speed_mps": 0.0}])
def test_a_calibration_whose_cost_makes_no_sense_is_refused(change):
    calibration = Calibration.shipped("warthog")
    with pytest.raises((ValueError, BadInputError, TypeError)):
        replace(calibration, vehicle=calibration.vehicle | change)


@pytest.mark.parametrize(
    "options", [[], ["--set", "rating=table"], ["--set", "compat=paper"]], ids=["ride", "table", "paper"]
)
def test_ground_of_the_sample_that_fails_has_no_cost(tmp_path, options):
    done = CliRunner().invoke(main, ["map", str(QUARRY), "--out", str(tmp_path), *options])
    assert done.exit_code == 0, done.output
    with rasterio.open(tmp_path / "cost.tif") as file:
        cost = file.read(1)
    with rasterio.open(tmp_path / "rasters/roughness.tif") as file:
        bands = dict(zip(file.descriptions, file.read(), strict=True))
    with rasterio.open(tmp_path / "rasters/class.tif") as file:
        class_id = file.read(1)
    never = (bands["p_fail"] >= 0.5) | (bands["slope"] > 30) | (class_id == NO_CLASS)
    assert (bands["p_fail"] >= 0.5).any()
    assert np.isnan(cost[never]).all()
    passable = bands["passable"] == 1
    assert not (never & passable).any()
    np.testing.assert_array_equal(np.isfinite(cost), passable)
    assert (cost[passable] >= 1).all()
