from dataclasses import replace

import numpy as np
import pytest

from bumpymap.lab.settings import CalibrationSettings
from bumpymap.lab.simulate.refit import CrossingJob, add_steps, run_crossing, step_tile
from bumpymap.rating import Calibration, load_profile

SETTINGS = CalibrationSettings(load_profile("warthog"))


@pytest.mark.parametrize(("turn", "offset"), [(0, 0.0), (30, -0.2), (45, 0.1)])
def test_a_tile_has_both_levels_and_their_mean_between(turn, offset):
    tile = step_tile(turn, offset, 15)
    assert (tile.min(), tile.max()) == (0, 1)
    assert ((tile > 0) & (tile < 1)).mean() < 0.25
    if offset == 0:
        assert tile.mean() == pytest.approx(0.5, abs=0.005)
        np.testing.assert_allclose(tile + tile[::-1, ::-1], 1, atol=0.05)


@pytest.mark.slow
def test_a_low_kerb_is_crossed_and_a_high_wall_is_not():
    pytest.importorskip("dartpy")
    for up in (True, False):
        assert run_crossing(SETTINGS, CrossingJob(0.1, 0, up)).outcome == ("completed",)
    assert run_crossing(SETTINGS, CrossingJob(0.7, 1, up=True)).outcome == ("stuck",)


@pytest.mark.slow
def test_a_crossing_repeats_and_is_that_of_the_shipped_calibration():
    pytest.importorskip("dartpy")
    job = CrossingJob(0.4, 0, up=True)
    drives = run_crossing(SETTINGS, job)
    assert drives == run_crossing(SETTINGS, job)
    record = Calibration.shipped("warthog").steps["crossing"]
    assert drives.failed == record["fail_up"][record["height"].index(0.4)][0]


def test_tiles_are_rated_again_from_the_file(monkeypatch):
    """With the crossings at hand, the record of the shipped calibration can be made without driving."""
    shipped = Calibration.shipped("warthog")
    monkeypatch.setattr("bumpymap.lab.simulate.refit.drive_jobs", lambda *_, **__: {})
    monkeypatch.setattr("bumpymap.lab.simulate.refit._crossings", lambda *_: shipped.steps["crossing"])
    again = add_steps(replace(shipped, steps=None)).steps
    np.testing.assert_allclose(again["tile"]["c_r"], shipped.steps["tile"]["c_r"], rtol=1e-4)
    np.testing.assert_allclose(again["tile"]["p_fail"], shipped.steps["tile"]["p_fail"], rtol=1e-3)
