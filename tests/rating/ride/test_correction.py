"""The correction of the geometry: beyond what was driven, under noise, written and read, refused when damaged."""

import json
from dataclasses import fields, replace

import numpy as np
import pytest

from bumpymap.core import BadInputError
from bumpymap.rating import Calibration, Correction, MotionModel, Rides, ThinModel, shipped_calibrations, subtract_noise

SHIPPED = Calibration.shipped("warthog")
RECORD = SHIPPED.ride
CORRECTION = Correction.from_record(RECORD)


def rides_of(*values):
    """Rides whose values are all the same on each patch, but for the belly, which touches nothing."""
    same = Rides(*(np.array(values) for _ in fields(Rides)))
    return replace(same, belly_reach=np.zeros(len(values)))


def predicted(rides, excess=0.0, correction=CORRECTION):
    felt = rides.pitch_change * np.sqrt(np.expm1(2 * excess))
    return correction.predict(rides, np.full(len(felt), 5.0), felt, np.full(len(felt), 4.0))


ROUGH = rides_of(*np.geomspace(0.005, 1.5, 50))


def test_below_what_was_driven_c_r_is_proportional():
    found = predicted(rides_of(1e-3, 1e-4))
    assert np.exp(CORRECTION.log_range[0]) > 1e-3
    assert np.diff(found.log_c_r) == pytest.approx(np.log(0.1))


@pytest.mark.parametrize("vehicle", shipped_calibrations())
def test_c_r_of_ground_that_reaches_higher_than_any_that_was_crossed_is_not_made_up(vehicle):
    """In the driven terrains that were crossed the belly reach is 1.4 to 2.3 at most; a square beyond is a guess."""
    correction = Correction.from_record(Calibration.shipped(vehicle).ride)
    c_r = [
        predicted(replace(ROUGH, belly_reach=np.full(50, reach)), correction=correction).log_c_r
        for reach in (0.0, 1.5, 2.0, 5.0)
    ]
    np.testing.assert_array_equal(c_r[1], c_r[2])
    np.testing.assert_array_equal(c_r[1], c_r[3])
    assert np.all(c_r[0] <= c_r[1])
    assert np.all(c_r[1] < c_r[0] + np.log(2.5))


def test_ground_is_not_called_smoother_than_its_noise_lets_one_tell():
    rides = rides_of(1e-5, 1e-3, 0.2)
    found = CORRECTION.predict(rides, np.zeros(3), np.full(3, 0.1), np.full(3, 4.0))
    assert found.log_c_r[0] == found.log_c_r[1] < found.log_c_r[2]
    g, excess = subtract_noise(rides.pitch_change, np.full(3, 0.1))
    assert g == pytest.approx([0.01, 0.01, 0.2])
    assert np.exp(2 * excess) == pytest.approx([101, 101, 1.25])


def test_noise_widens_the_interval():
    quiet, loud, unknown = (predicted(ROUGH, excess) for excess in (0.0, 1.5, np.nan))
    assert np.all(loud.below > quiet.below)
    assert np.all(unknown.below > quiet.below)


MODELS = {"the ride model": (Correction, RECORD), "thin surveys": (ThinModel, SHIPPED.thin)}
MODELS |= {"record of speeds": (MotionModel, SHIPPED.motion)}
DAMAGE = {
    "the ride model": [
        *({name: None} for name in ("c_r", "excess")),
        *({"c_r": "text"}, {"noise_low": [[1.0]]}, {"fail": [0.1] * 9}, {"c_r": [0.1] * 7}),
        *({"model_error": wrong} for wrong in (-0.1, float("nan"), float("inf"), "wide")),
    ],
    "thin surveys": [{"c_r": [1.0]}, {"fail": None}, {"sides": [1.0]}],
    "record of speeds": [{"c_r": {}}, {"range": [1.0]}, {"a_w": {"terms": [1.0], "plain": [1.0]}}],
}


@pytest.mark.parametrize("name", MODELS)
def test_a_record_is_read_back_and_a_damaged_one_is_refused_with_what_to_do(name):
    model, record = MODELS[name]
    assert model.from_record(json.loads(json.dumps(model.from_record(record).to_record()))) == model.from_record(record)
    for change in DAMAGE[name]:
        with pytest.raises(BadInputError, match=f"{name}.* is damaged: .*bumpymap calibrate"):
            model.from_record(record | change)
    with pytest.raises(BadInputError, match="9 coefficients of fail, not 10"):
        Correction.from_record(RECORD | {"fail": [0.1] * 9})


def test_what_another_simulation_adds_widens_every_interval():
    own, world = (
        predicted(ROUGH, 0.3, Correction.from_record(RECORD | {"model_error": error})) for error in (0.0, 0.2)
    )
    np.testing.assert_allclose(world.below, np.hypot(own.below, 0.2))
    np.testing.assert_allclose(world.above, np.hypot(own.above, 0.2))
    np.testing.assert_array_equal(world.log_c_r, own.log_c_r)
