"""A whole evaluation of routes over a made-up map, with short ways; choice of pairs; what is recorded."""

import json
import math
from dataclasses import replace
from functools import partial
from itertools import pairwise

import _route_trial as route_trial
import numpy as np
import pytest
import route_drives
from _route_trial import (
    RoutePlanner,
    RouteTrialSettings,
    evaluate_routes,
    ride_without_correction,
)
from driven_ways import ReliefGround, WayDrive
from known_grounds import sine_c_r

from bumpymap.core.errors import BadInputError, OutputError
from bumpymap.core.interrupts import SilentProgress
from bumpymap.lab.evaluate.survey_trial import TrialOptions
from bumpymap.rating import RideModel
from bumpymap.rating.vehicle_profile import load_profile

SETTINGS = RouteTrialSettings(total_pairs=2, repeats=1, least_m=12.0, most_m=20.0)


def options(out, *, overwrite=False):
    return TrialOptions(out, 1, overwrite, SilentProgress())


def round_the_wall(start, goal):
    """Through the gap in the north of the made-up map."""
    return np.array([start, [0.9, 4.5], [0.9, 6.5], goal])


def test_a_map_without_ways_is_refused(made_up, warthog, tmp_path):
    with pytest.raises(BadInputError, match="no two passable tiles 12 to 20 m apart"):
        evaluate_routes(made_up, warthog, lambda *_: None, SETTINGS, options(tmp_path))
    with pytest.raises(BadInputError, match="the layers were made with the calibration"):
        evaluate_routes(made_up, replace(warthog, settings={}), round_the_wall, SETTINGS, options(tmp_path))


def test_obstacles_are_walls_over_exactly_their_pixels():
    ground = ReliefGround.from_heightmap(np.array([[1.0, np.nan, 1.0]]), 0.2, np.array([[0, 2, 1]], np.uint8))
    at = np.array([0.3, 0.4, 0.41, 0.5, 0.59])
    assert ground.height(at, np.full(5, 0.1)).tolist() == [1.0, 1.0, 2.0, 2.0, 2.0]


def test_ride_of_measured_heights_without_noise_is_that_of_waves(made_up, warthog):
    known = np.zeros((6, 10), bool)
    known[1, 1:4] = True
    made_up.amplitude = 0.03
    c_r = ride_without_correction(RideModel(warthog), made_up.heights(made_up.window), known)
    assert np.isnan(c_r[~known]).all()
    # The model averages over all headings: waves along the easting are met at every angle.
    along = sine_c_r(load_profile("warthog"), 0.03, 3.0)
    assert c_r[known] == pytest.approx(np.full(3, 0.6 * along), rel=0.5)
    made_up.amplitude = 0.0
    assert (ride_without_correction(RideModel(warthog), made_up.heights(made_up.window), known)[known] < 0.002).all()


def test_the_planner_keeps_clear_of_barred_tiles(made_up):
    planner = RoutePlanner.of(made_up)
    margin = (1.37 / 2 + 0.1) / 3
    line = planner(np.array([4.5, 2.5]), np.array([4.5, 8.5]))
    share = np.linspace(0, 1, 200)[:, None]
    dense = np.concatenate([a + share * (b - a) for a, b in pairwise(line)])
    beside = np.maximum(np.maximum(5 - dense[:, 1], dense[:, 1] - 6), 0)
    assert np.hypot(beside, np.maximum(2 - dense[:, 0], 0)).min() >= margin - 1e-6
    assert planner(np.array([4.5, 2.5]), np.array([4.5, 5.5])) is None  # in the wall


def fake_drives(monkeypatch):
    """Drives that cost nothing; returns the keys of those that were made."""
    made = []

    def run(_driven, job):
        made.append(job.key)
        return WayDrive("completed", 10.0, 0.5 + job.offset, 10.0, tiles=[(1, 1, 10.0, 0.5)])

    monkeypatch.setattr(route_trial, "run_way", run)
    return made


def test_the_floor_of_a_vehicle_is_left_out_as_its_drives_have_none(made_up, warthog, tmp_path, monkeypatch):
    fake_drives(monkeypatch)
    bare = evaluate_routes(made_up, warthog, round_the_wall, SETTINGS, options(tmp_path))
    raised = replace(warthog, vehicle=warthog.vehicle | {"floor": {"c_r_radpm": 0.05}})
    felt = replace(made_up, calibration=raised, c_r=math.hypot(made_up.c_r, 0.05))
    with_it = evaluate_routes(felt, raised, round_the_wall, SETTINGS, options(tmp_path, overwrite=True))
    assert [way.predicted.c_r for way in with_it.ways] == pytest.approx([way.predicted.c_r for way in bare.ways], 1e-3)


def test_drives_are_recorded_and_not_made_again(made_up, warthog, tmp_path, monkeypatch):
    made = fake_drives(monkeypatch)
    first = evaluate_routes(made_up, warthog, round_the_wall, SETTINGS, options(tmp_path))
    assert [key[1:] for key in made] == [("best", 0), ("straight", 0)] * 2
    journal = tmp_path / "ways-warthog.jsonl"
    kept = journal.read_text().splitlines()
    journal.write_text("\n".join(kept[:-1]) + "\n" + kept[-1][:20])  # cut off in the last line
    again = evaluate_routes(made_up, warthog, round_the_wall, SETTINGS, options(tmp_path))
    assert made[4:] == made[3:4]
    assert again == first
    other = replace(SETTINGS, offset_m=0.05)
    with pytest.raises(OutputError, match="other settings"):
        evaluate_routes(made_up, warthog, round_the_wall, other, options(tmp_path))
    evaluate_routes(made_up, warthog, round_the_wall, other, options(tmp_path, overwrite=True))


def test_the_driver_prints_and_writes_all_figures(made_up, tmp_path, monkeypatch, capsys):
    pytest.importorskip("dartpy")
    fake_drives(monkeypatch)
    monkeypatch.setattr(route_drives, "open_map", lambda _folders: made_up)
    monkeypatch.setattr(route_drives, "RouteTrialSettings", partial(RouteTrialSettings, least_m=12.0, most_m=20.0))
    words = ["layers", "--out", str(tmp_path), "--pairs", "2", "--repeats", "1", "--jobs", "1"]
    monkeypatch.setattr("sys.argv", ["route_drives.py", *words])
    route_drives.main()
    assert "## Best way against straight line" in capsys.readouterr().out
    record = json.loads((tmp_path / "routes.json").read_text())
    assert len(record["ways"]) == record["settings"]["total_pairs"] * 2 == 4


@pytest.mark.slow
def test_ways_round_a_wall_are_driven_and_reported(made_up, warthog, tmp_path):
    pytest.importorskip("dartpy")
    findings = evaluate_routes(made_up, warthog, RoutePlanner.of(made_up), SETTINGS, options(tmp_path))
    assert all(way.arrived == 1 for way in findings.of("best"))
    blocked = [way for way in findings.of("straight") if way.predicted.barred_m > 2.5]  # not only at its edge
    assert blocked
    assert all(way.arrived == 0 for way in blocked)
    assert findings.order.by_arrival_right == findings.order.by_arrival >= len(blocked)
    assert findings.arrivals["best"].held
