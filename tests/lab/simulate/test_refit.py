"""Models fitted again from what a calibration holds, without driving; crossings of walls."""

import copy
from dataclasses import replace

import numpy as np
import pytest

from bumpymap.core import UsageError
from bumpymap.lab.settings import CalibrationSettings
from bumpymap.lab.simulate.jobs import DriveJob
from bumpymap.lab.simulate.refit import refit, run_crossing, step_tile
from bumpymap.rating import Calibration, load_profile

SETTINGS = CalibrationSettings(load_profile("warthog"))
WARTHOG = Calibration.shipped("warthog")


def test_a_calibration_that_was_moved_to_real_drives_is_refused():
    moved = replace(WARTHOG, settings=WARTHOG.settings | {"moved_to_drives": {"calibration_id": WARTHOG.id}})
    with pytest.raises(UsageError, match=f"moved to real drives.*Fit the calibration {WARTHOG.id}.*check --refit"):
        refit(moved)


def test_a_calibration_without_the_library_is_refused():
    settings = copy.deepcopy(WARTHOG.settings)
    del settings["library"]
    with pytest.raises(UsageError, match="holds no drives over the terrain library"):
        refit(replace(WARTHOG, settings=settings))


@pytest.mark.parametrize(("turn", "offset"), [(0, 0.0), (30, -0.2), (45, 0.1)])
def test_a_tile_has_both_levels_and_their_mean_between(turn, offset):
    tile = step_tile(turn, offset, 15)
    assert (tile.min(), tile.max()) == (0, 1)
    assert ((tile > 0) & (tile < 1)).mean() < 0.25
    if offset == 0:
        assert tile.mean() == pytest.approx(0.5, abs=0.005)
        np.testing.assert_allclose(tile + tile[::-1, ::-1], 1, atol=0.05)


@pytest.mark.slow
def test_a_low_kerb_is_crossed_and_a_high_wall_is_not_and_a_crossing_is_that_of_the_shipped_calibration():
    pytest.importorskip("dartpy")
    for up in (1, 0):
        assert run_crossing(SETTINGS, DriveJob(("crossing", "0.1", 0, up), 1)).outcome == ("completed",)
    assert run_crossing(SETTINGS, DriveJob(("crossing", "0.7", 1, 1), 1)).outcome == ("stuck",)
    record = WARTHOG.steps["crossing"]
    failed = run_crossing(SETTINGS, DriveJob(("crossing", "0.4", 0, 1), 1)).failed
    assert failed == record["fail_up"][record["height"].index(0.4)][0]
