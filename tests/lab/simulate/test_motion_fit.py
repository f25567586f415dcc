"""The fit of drives at several speeds: it finds what was put in, and repeats from the file."""

from dataclasses import replace

import numpy as np
import pytest

from bumpymap.lab.simulate.motion_fit import SPEED_RATIOS, fit_means, motion_jobs
from bumpymap.lab.simulate.plan import calibrated_settings
from bumpymap.rating import Calibration
from bumpymap.rating.calibration import shipped_calibrations

WARTHOG = Calibration.shipped("warthog")
SETTINGS = replace(calibrated_settings(WARTHOG), terrains=8, terrain_starts=4)
WITH_SPEEDS = [name for name in shipped_calibrations() if Calibration.shipped(name).motion is not None]


@pytest.mark.slow
@pytest.mark.parametrize(("spread", "tolerance"), [(0.0, 1e-3), (0.1, 0.1)])
def test_it_finds_what_was_put_in_and_its_spread_and_leaves_failed_terrains_out(spread, tolerance):
    # Logarithms are plain functions of C_r and speed, with errors of that spread.
    c_r = np.geomspace(0.01, 0.4, len(motion_jobs(SETTINGS)))[:, None]
    s = np.log(SPEED_RATIOS)[None, :]
    logs = np.stack([np.log(c_r) - 0.1 * s, np.log(0.7 * c_r) + 0 * s, np.log(4 * c_r) + 1.3 * s], axis=-1)
    errors = np.random.default_rng(1).normal(0.0, spread, logs.shape)
    errors[:, SPEED_RATIOS.index(1.0), 0] = 0.0
    means = np.exp(logs + errors)
    means[3, 2] = np.nan
    model = fit_means(SETTINGS, means, 2)
    told = np.exp(model.plain_log_factors(np.array([0.03, 0.1, 0.3]), (0.5, 1.0, 1.5)))
    for speed, ratio in enumerate((0.5, 1.0, 1.5)):
        assert told[:, speed] == pytest.approx(np.tile([ratio**-0.1, 0.7, 4 * ratio**1.3], (3, 1)), rel=tolerance)
    assert model.origin["used"] == len(means) - 1
    for fit in (model.c_r, model.c_roll, model.a_w):
        assert fit.plain_log_sd == pytest.approx(spread, rel=0.3, abs=1e-3)


@pytest.mark.later
@pytest.mark.parametrize("name", WITH_SPEEDS)
def test_the_shipped_record_is_what_its_drives_give(name):
    shipped = Calibration.shipped(name)
    origin = shipped.motion["origin"]
    made = fit_means(calibrated_settings(shipped), np.array(origin["driven"], np.float64), origin["starts"]).to_record()
    for key in ("c_r", "c_roll", "a_w"):
        assert made[key]["plain"] == pytest.approx(shipped.motion[key]["plain"], rel=1e-4, abs=1e-5)
        assert made[key]["log_sd"] == pytest.approx(shipped.motion[key]["log_sd"], rel=0.01)
    assert made["origin"] == shipped.motion["origin"]
