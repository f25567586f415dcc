"""The driver of ways: drives shake as the closed form says, and arrive round a wall where the map says."""

import sys
from pathlib import Path

import numpy as np
import pytest
from known_grounds import sine_c_r
from tile_maps import TileMap

from bumpymap.rating import Calibration, load_profile

sys.path.append(str(Path(__file__).parent))
import ways

WALL_COL = 5


def wall_map():
    """30 m by 18 m of waves of 3 m along the easting, with a wall across that leaves a gap in the north."""
    made = TileMap(np.full((6, 10), 0.02), p_fail=np.full((6, 10), 0.001))
    made.barred[2:, WALL_COL], made.p_fail[2:, WALL_COL] = 5, 0.9
    west, north = made.at(0, 0)

    def height(easting, northing):
        waves = 100.0 + 0.02 * np.sin(2.0 * np.pi * (easting - west) / 3.0) + 0.0 * northing
        inside = np.abs(easting - west - 3.0 * (WALL_COL + 0.5)) < 0.3
        return waves + 1.5 * (inside & (north - northing > 6.0))

    made.height, made.manifest = height, {"files": []}
    return made


@pytest.mark.slow
def test_a_way_over_waves_costs_what_the_closed_form_says():
    pytest.importorskip("dartpy")
    profile, east = load_profile("warthog"), (np.arange(200) + 0.5) * 0.2
    waves = ways.ReliefGround.from_heightmap(np.tile(0.02 * np.sin(2 * np.pi * east / 3), (30, 1)), 0.2)
    made = ways.drive_way(profile, waves, np.array([[3.0, 3.0], [33.0, 3.0]]))
    assert made.outcome == "completed"
    assert made.c_r == pytest.approx(sine_c_r(profile, 0.02, 3.0), rel=0.1)


@pytest.mark.slow
def test_ways_round_a_wall_are_driven_kept_and_counted(tmp_path, monkeypatch):
    pytest.importorskip("dartpy")
    trial = ways.WayTrial(wall_map(), Calibration.shipped("warthog"))
    pairs = list(trial.choose(2, 7, (12.0, 20.0)))
    driven = trial.drive(pairs, 1, 7, tmp_path)
    found = ways.figures_of(pairs, driven)
    assert (found["ways"], found["drives"], found["arrived"]) == (2, 2, 1.0)
    barred_m = [0.02 * (trial.tiles.barred[trial.tiles_under(straight.line)] > 0).sum() for _, straight in pairs]
    assert max(barred_m) > 2.5  # across the wall, not only along its edge
    ends = [driven[number, "straight", 0].outcome == "completed" for number in range(2)]
    assert not any(end for end, metres in zip(ends, barred_m, strict=True) if metres > 2.5)
    assert found["arrived on straight lines"] == np.mean(ends)
    assert found["P(arrives)"] == pytest.approx(1.0, abs=0.05)
    monkeypatch.setattr(ways, "drive_way", None)  # what was driven is not driven again
    assert trial.drive(pairs, 1, 7, tmp_path) == driven
