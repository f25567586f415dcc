"""A calibration moved to drives, from made-up stretches."""

import json
from dataclasses import replace

import numpy as np
import pytest
from driven_stretches import driven_stretches

from bumpymap.core import BadInputError
from bumpymap.rating import Calibration, RideModel, update_from_drives
from bumpymap.rating.drive_posterior import DrivePrior, collect_evidence, fit_move

CALIBRATION = Calibration.shipped("warthog")


def test_500_metres_bring_the_median_ratio_to_within_5_percent():
    for seed, shift in ((1, 0.35), (2, -0.35)):
        _, update = update_from_drives(CALIBRATION, driven_stretches(CALIBRATION, 50, shift=shift, seed=seed))
        assert update.ratio[0] == pytest.approx(np.exp(-shift), rel=0.08)
        assert update.ratio[1] == pytest.approx(1.0, abs=0.05)
        low, middle, high = update.factor
        assert low < middle < high
        assert middle == pytest.approx(np.exp(shift), rel=0.08)
        assert update.held_out_error[1] < 0.6 * update.held_out_error[0]
        assert (update.way_m, update.stretches, update.drives) == (500.0, 50, 1)
        assert update.new_m == pytest.approx(500.0)


def test_the_new_calibration_is_the_old_one_moved_by_the_posterior():
    stretches = driven_stretches(CALIBRATION, 60, tilt=0.1)
    new, update = update_from_drives(CALIBRATION, stretches)
    assert update_from_drives(CALIBRATION, stretches)[0].to_json() == new.to_json()
    shift, tilt = update.posterior.mean
    middle = np.log(CALIBRATION.class_limits[1])
    wanted = [middle + shift + (1 + tilt) * (np.log(c_r) - middle) for c_r in CALIBRATION.steps["tile"]["c_r"]]
    assert np.log(new.steps["tile"]["c_r"]) == pytest.approx(wanted)
    assert RideModel(new).calibration.vehicle == CALIBRATION.vehicle
    record = json.loads(json.dumps(new.settings["moved_to_drives"]))
    assert record["calibration_id"] == CALIBRATION.id
    assert record["way_m"] == 600.0
    assert record["posterior"]["mean"] == pytest.approx([shift, tilt])


def test_short_drives_are_refused_with_what_counts_and_what_is_asked():
    with pytest.raises(
        BadInputError, match=r"100 m of different ground on 10 stretches count\. It takes at least 200 m"
    ):
        update_from_drives(CALIBRATION, driven_stretches(CALIBRATION, 10))
    made = driven_stretches(CALIBRATION, 50)
    made.speed_mps[10:] = 3.0
    with pytest.raises(BadInputError, match=r"100 m of .* \(left out: 400 m not near the 1 m/s of the map\)"):
        update_from_drives(CALIBRATION, made)


def test_one_round_driven_ten_times_is_a_short_drive():
    one = driven_stretches(CALIBRATION, 10)
    laps = replace(one, **{name: np.tile(getattr(one, name), 10) for name in one.__slots__})
    with pytest.raises(BadInputError, match="100 m of different ground on 100 stretches"):
        update_from_drives(CALIBRATION, laps)


def test_few_metres_move_a_calibration_by_less_than_many():
    """A vehicle that pitches 40 % more, measured badly: the mean over ten drives of each length."""
    prior = DrivePrior(np.log(CALIBRATION.class_limits[1]), (0.2, 0.1), -np.inf)
    shifts = []
    for n in (3, 80):
        made = (driven_stretches(CALIBRATION, n, shift=0.35, sd=0.3, seed=seed) for seed in range(10))
        shifts.append(np.mean([fit_move(collect_evidence(each, 1.0, 0.0)[0], prior).mean[0] for each in made]))
    assert 0.0 < shifts[0] < 0.7 * 0.35
    assert shifts[1] == pytest.approx(0.35, abs=0.05)


def test_drives_that_agree_move_nothing():
    with pytest.raises(BadInputError, match=r"agree with the calibration .* room for a factor of 0\.9\d to 1\.0\d"):
        update_from_drives(CALIBRATION, driven_stretches(CALIBRATION, 60, shift=0.0))


def test_a_moved_calibration_is_not_moved_again():
    made = driven_stretches(CALIBRATION)
    new, _ = update_from_drives(CALIBRATION, made)
    with pytest.raises(BadInputError, match=f"against a map made with the calibration {CALIBRATION.id}"):
        update_from_drives(new, made)
