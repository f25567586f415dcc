"""What counts of the stretches of drives."""

from dataclasses import fields, replace

import numpy as np
import pytest
from driven_stretches import driven_stretches

from bumpymap.core import DrivenStretches
from bumpymap.rating import Calibration
from bumpymap.rating.drive_posterior import collect_evidence

CALIBRATION = Calibration.shipped("warthog")


def joined(*parts):
    return DrivenStretches(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(DrivenStretches)))


def test_what_does_not_count_is_named_with_its_length():
    made = driven_stretches(CALIBRATION, 50)
    made.c_r[:3] = np.nan
    made.measured[3] = np.nan
    made.speed_mps[4:6] = 2.0
    made.measured_sd[6] = made.c_r[6]
    evidence, lost = collect_evidence(made, 1.0, 0.0)
    assert len(evidence.way_m) == 43
    assert (lost.off_map, lost.other_speed, lost.below_sensor) == (40.0, 20.0, 10.0)


def test_variances_are_those_of_the_logarithm():
    made = replace(driven_stretches(CALIBRATION, 50, shift=0.0, sd=1e-9, map_sd=0.2))
    made.measured[:] = made.c_r
    made.measured_sd[:], made.place_sd[:] = 0.03 * made.c_r, 0.04 * made.c_r
    evidence, _ = collect_evidence(made, 1.0, 0.0)
    assert np.sqrt(evidence.own_variance) == pytest.approx(0.05)
    assert evidence.map_sd == pytest.approx(0.2, rel=1e-4)


def test_the_floor_of_the_profile_is_taken_off_in_power():
    made = driven_stretches(CALIBRATION, 20)
    before = np.log(made.c_r)
    made.c_r[:] = np.hypot(made.c_r, 0.03)
    evidence, _ = collect_evidence(made, 1.0, 0.03)
    assert evidence.log_c_r == pytest.approx(before)


@pytest.mark.parametrize("laps", [1, 2, 3])
def test_ground_that_was_driven_again_counts_once(laps):
    made = driven_stretches(CALIBRATION, 40)
    parts = [replace(made, drive=np.full(40, lap), easting=made.easting + 3.7 * lap) for lap in range(laps)]
    evidence, _ = collect_evidence(joined(*parts), 1.0, 0.0)
    assert evidence.way_m.sum() == 400.0 * laps
    assert evidence.new_m.sum() == pytest.approx(400.0, rel=0.03)


def test_squares_hold_the_stretches_of_30_metres():
    evidence, _ = collect_evidence(driven_stretches(CALIBRATION, 50), 1.0, 0.0)
    assert np.bincount(evidence.square).max() == 3
    some = evidence.chosen(evidence.log_c_r > np.median(evidence.log_c_r))
    assert np.array_equal(np.unique(some.square), np.arange(some.square.max() + 1))
