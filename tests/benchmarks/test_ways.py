"""The driver of ways: the plain search finds what routes find, and drives round a wall arrive where the map says."""

import sys
from pathlib import Path

import numpy as np
import pytest
from known_grounds import sine_c_r
from tile_maps import TileMap

from bumpymap.rating import Calibration, RideModel
from bumpymap.rating.vehicle_profile import load_profile

sys.path.append(str(Path(__file__).parent))
import ways
from route_maps import write_folder
from route_sites import site

WALL_COL = 5


def wall_map(amplitude=0.02):
    """30 m by 18 m of waves of 3 m along the easting, with a wall across that leaves a gap in the north."""
    made = TileMap(np.full((6, 10), 0.02), p_fail=np.full((6, 10), 0.001))
    made.barred[2:, WALL_COL], made.p_fail[2:, WALL_COL] = 5, 0.9
    west, north = made.at(0, 0)

    def height(easting, northing):
        waves = 100.0 + amplitude * np.sin(2.0 * np.pi * (easting - west) / 3.0) + 0.0 * northing
        inside = np.abs(easting - west - 3.0 * (WALL_COL + 0.5)) < 0.3
        return waves + 1.5 * (inside & (north - northing > 6.0))

    made.height, made.manifest = height, {}
    return made


def test_ride_of_measured_heights_without_noise_is_that_of_waves():
    known = np.zeros((6, 10), bool)
    known[1, 1:4] = True
    model = RideModel(Calibration.shipped("warthog"))
    waves, level = (wall_map(amplitude) for amplitude in (0.03, 0.0))
    c_r = ways.ride_without_correction(model, waves.heights(waves.window), known)
    assert np.isnan(c_r[~known]).all()
    # The model averages over all headings: waves along the easting are met at every angle.
    assert c_r[known] == pytest.approx(np.full(3, 0.6 * sine_c_r(load_profile("warthog"), 0.03, 3.0)), rel=0.5)
    assert (ways.ride_without_correction(model, level.heights(level.window), known)[known] < 0.002).all()


def test_wilson_is_the_set_of_shares_that_the_score_test_does_not_reject():
    for successes, trials in ((0, 20), (3, 20), (20, 20), (7.5, 10)):
        seen, shares = successes / trials, np.linspace(0.0005, 0.9995, 1000)
        kept = np.abs(seen - shares) <= 1.959964 * np.sqrt(shares * (1 - shares) / trials)
        assert (shares[kept].min(), shares[kept].max()) == pytest.approx(ways.wilson(successes, trials), abs=2e-3)


@pytest.mark.slow
def test_routes_are_there_where_the_plain_search_finds_one_and_cost_no_more(tmp_path, capsys):
    folder = write_folder(tmp_path / "map", site())
    found = ways.compare_searches(folder, 6, 1, joined=False)
    assert (found["missing"], found["extra"], found["touches"]) == (0, 0, 0)
    assert found["ratios"]
    assert max(found["ratios"]) < 1.05
    assert "times the cost of the search" in capsys.readouterr().out


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
