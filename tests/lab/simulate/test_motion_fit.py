"""The fit of drives at several speeds: it finds what was put in, repeats from the file, and can be resumed."""

import numpy as np
import pytest

from bumpymap.lab.simulate.motion_fit import (
    MotionEffort,
    MotionRecord,
    add_motion,
    fit_motion,
    motion_jobs,
    motion_journal,
)
from bumpymap.lab.simulate.plan import calibrated_settings
from bumpymap.lab.worlds.terrains import KINDS
from bumpymap.rating import Calibration, MotionModel
from bumpymap.rating.calibration import shipped_calibrations

WARTHOG = Calibration.shipped("warthog")
SETTINGS = calibrated_settings(WARTHOG)
EFFORT = MotionEffort(terrains=2, starts=1)
WITH_SPEEDS = [name for name in shipped_calibrations() if Calibration.shipped(name).motion is not None]


def invented(spread=0.0, seed=1):
    """Drives whose logarithms are plain functions of C_r and speed, with errors of a given spread."""
    rng = np.random.default_rng(seed)
    jobs = len(motion_jobs(EFFORT))
    c_r = np.geomspace(0.01, 0.4, jobs)[:, None]
    s = np.log(EFFORT.ratios)[None, :]
    logs = np.stack([np.log(c_r) - 0.1 * s, np.log(0.7 * c_r) + 0 * s, np.log(4 * c_r) + 1.3 * s], axis=-1)
    errors = rng.normal(0.0, spread, logs.shape)
    errors[:, EFFORT.ratios.index(1.0), 0] = 0.0
    return np.exp(logs + errors)


@pytest.mark.slow
def test_it_finds_what_was_put_in():
    model = fit_motion(SETTINGS, EFFORT, invented())
    c_r = np.array([0.03, 0.1, 0.3])
    told = np.exp(model.plain_log_factors(c_r, (0.5, 1.0, 1.5)))
    assert told[:, :, 0] == pytest.approx(np.broadcast_to([0.5**-0.1, 1.0, 1.5**-0.1], (3, 3)), rel=1e-3)
    assert told[:, :, 1] == pytest.approx(0.7, rel=1e-3)
    assert told[:, :, 2] == pytest.approx(np.broadcast_to([4 * 0.5**1.3, 4.0, 4 * 1.5**1.3], (3, 3)), rel=1e-3)


@pytest.mark.slow
def test_the_spread_is_that_of_the_errors_and_failed_terrains_are_left_out():
    means = invented(spread=0.1)
    means[3, 2] = np.nan
    model = fit_motion(SETTINGS, EFFORT, means)
    assert model.origin["used"] == len(means) - 1
    for fit in (model.c_r, model.c_roll, model.a_w):
        assert fit.plain_log_sd == pytest.approx(0.1, rel=0.3)


@pytest.mark.later
@pytest.mark.parametrize("name", WITH_SPEEDS)
def test_the_shipped_record_is_what_its_drives_give(name):
    shipped = Calibration.shipped(name)
    origin = shipped.motion["origin"]
    effort = MotionEffort(origin["terrains"] // len(KINDS), origin["starts"], tuple(origin["ratios"]))
    means = np.array(origin["driven"], np.float64)
    made = fit_motion(calibrated_settings(shipped), effort, means).to_record()
    for key in ("c_r", "c_roll", "a_w"):
        assert made[key]["plain"] == pytest.approx(shipped.motion[key]["plain"], rel=1e-4, abs=1e-5)
        assert made[key]["log_sd"] == pytest.approx(shipped.motion[key]["log_sd"], rel=0.01)
    assert made["origin"] == shipped.motion["origin"]


@pytest.mark.slow
def test_drives_are_added_and_resumed(tmp_path, monkeypatch):
    effort = MotionEffort(terrains=1, starts=1)
    asked = []

    def instead(_, __, job):
        asked.append(job.key)
        means = invented()[len(asked) % 34]
        return MotionRecord(*(((tuple(means[:, number].tolist()),)) for number in range(3)))

    monkeypatch.setattr("bumpymap.lab.simulate.motion_fit.run_motion", instead)
    monkeypatch.setattr("bumpymap.lab.simulate.motion_fit.require_dart", lambda: None)
    journal = motion_journal(tmp_path / "drives.jsonl", SETTINGS, effort)
    made = add_motion(WARTHOG, effort=effort, journal=journal)
    assert len(asked) == 17
    again = add_motion(WARTHOG, effort=effort, journal=motion_journal(tmp_path / "drives.jsonl", SETTINGS, effort))
    assert len(asked) == 17
    assert again.motion == made.motion
    assert MotionModel.from_record(made.motion, 1.0).speed_mps == 1.0
    assert Calibration.from_json(made.to_json(), "file").id == made.id
