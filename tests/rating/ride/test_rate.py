"""Rating tiles by the shipped ride model."""

from dataclasses import replace

import numpy as np
import pytest

from bumpymap.core import NO_CLASS, FeatureSettings, interval_log_sd
from bumpymap.lab.simulate.ride_fit import survey_terrains
from bumpymap.lab.terrains import make_terrain
from bumpymap.patches.features import measure
from bumpymap.rating import DRIVE_LOG_SD, Calibration, RideModel, TextureModel, classify
from bumpymap.rating.ride.correction import Prediction
from bumpymap.rating.ride.rate import interval

CALIBRATION = Calibration.shipped("warthog")
MODEL = RideModel(CALIBRATION)


def patches_of(*kinds, slope=5.0, density=200.0, index=3):
    terrains = [make_terrain(kind, 9, index, slope_limit_deg=slope) for kind in kinds]
    (block,) = survey_terrains(terrains, density, 0.005, 1).blocks()
    return measure(block, FeatureSettings(), ground_only=False)


def rated(patches, model=MODEL):
    return model.rate(patches, classify(patches, TextureModel.shipped()))


def test_the_numbers_of_a_tile_agree_with_each_other():
    cost = rated(patches_of(*("flat", "low_noise", "tufts", "stones", "fractal_2", "steps", "high_noise")))
    assert np.all((cost.c_r_low < cost.c_r) & (cost.c_r < cost.c_r_high))
    assert np.all((cost.p_fail >= 0) & (cost.p_fail <= 1))
    assert np.all((cost.confidence >= 0) & (cost.confidence <= 1))
    by_c_r = np.searchsorted(CALIBRATION.class_limits, cost.c_r, side="right")
    assert np.array_equal(cost.class_id, np.where(cost.p_fail >= 0.5, 3, by_c_r))


def test_the_interval_holds_80_percent_of_single_drives_and_tells_how_far_off_their_mean_is():
    rng = np.random.default_rng(4)
    log_c_r, below, above = rng.uniform(-5, 0, 40_000), *rng.uniform(0.05, 0.4, (2, 40_000))
    c_r, low, high = interval(Prediction(log_c_r, below, above, np.zeros(40_000)), 0.0)
    error = rng.standard_normal(40_000)
    mean = log_c_r + error * np.where(error < 0, below, above)
    drive = np.exp(mean + DRIVE_LOG_SD * rng.standard_normal(40_000))
    assert np.mean((low < drive) & (drive < high)) == pytest.approx(0.8, abs=0.01)
    np.testing.assert_allclose(interval_log_sd(c_r, low, high, DRIVE_LOG_SD), [below, above], rtol=1e-6)


def test_a_tile_steeper_than_the_vehicle_can_climb_is_class_3():
    patches = patches_of("flat", "flat")
    steep = replace(patches, slope=np.array([5.0, CALIBRATION.vehicle["slope_limit_deg"] + 1]))
    cost = rated(steep)
    assert cost.class_id.tolist()[1] == 3
    assert cost.confidence[1] > 0.9
    assert (cost.p_fail < 0.5).all()  # that of the drives


def test_a_tile_that_cannot_be_judged_has_no_class():
    (block,) = survey_terrains([make_terrain("flat", 1, 1)], 1.0, 0.0, 1).blocks()
    cost = rated(measure(block, FeatureSettings(), ground_only=False))
    assert cost.class_id.tolist() == [NO_CLASS]
    assert np.isnan([cost.c_r[0], cost.c_r_low[0], cost.p_fail[0], cost.confidence[0]]).all()


def test_leaves_over_ground_are_not_taken_for_noise(measure_points):
    rng = np.random.default_rng(2)
    x, y = rng.uniform(0, 3, (2, 900))
    z = np.where(rng.random(900) < 0.5, 0.0, 5.0 + rng.normal(0, 0.3, 900))
    assert rated(measure_points(x, y, z)).class_id.tolist() == [3]
