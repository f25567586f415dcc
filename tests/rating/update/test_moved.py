"""The moved calibration predicts what was promised."""

import json
import math
from dataclasses import fields, replace

import numpy as np
import pytest

from bumpymap.rating import Calibration, Correction
from bumpymap.rating.calibration import shipped_calibrations
from bumpymap.rating.drive_update import LogMove, moved_calibration
from bumpymap.rating.ride.motion_operator import Rides
from bumpymap.rating.ride.thin import THIN_COLUMNS, ThinModel

NAMES = shipped_calibrations()


def move_of(calibration, shift=0.3, tilt=0.08, sd=(0.03, 0.04), widening=1.0):
    middle = math.log(calibration.class_limits[1])
    return LogMove(middle, shift, tilt, np.diag(np.square(sd)), widening)


def moved_by(calibration, **options):
    move = move_of(calibration, **options)
    return move, moved_calibration(calibration, move, {"way_m": 512.0})


def rides_of(log_g, rng):
    g = np.exp(log_g)
    n = len(g)
    same = Rides(**{field.name: 0.2 * g for field in fields(Rides)})
    return replace(
        same, pitch_change=g, pitch_change_rms=g * np.exp(rng.uniform(0, 0.6, n)), belly_reach=np.full(n, 0.5)
    )


@pytest.mark.parametrize("name", NAMES)
def test_predictions_inside_the_range_are_the_moved_ones(name):
    old = Calibration.shipped(name)
    move, new = moved_by(old)
    was, now = (Correction.from_record(each.ride) for each in (old, new))
    low, high = was.log_range
    rng = np.random.default_rng(1)
    log_g = rng.uniform(low, high, 200)
    rides, slope = rides_of(log_g, rng), rng.uniform(0, 25, 200)
    felt = np.where(np.arange(200) % 3 == 0, np.nan, np.exp(log_g) * rng.uniform(0, 0.5, 200))
    points = rng.uniform(0.5, 50, 200)
    before, after = (each.predict(rides, slope, felt, points) for each in (was, now))
    assert after.log_c_r == pytest.approx(move.log(before.log_c_r), abs=1e-7)
    assert np.array_equal(after.p_fail, before.p_fail)
    assert np.all(after.below > before.below)
    middle = np.abs(before.log_c_r - move.middle) < 0.5
    assert np.all(after.below[middle] < 1.5 * before.below[middle])


def test_ground_below_the_range_stays_proportional():
    old = Calibration.shipped("warthog")
    _, new = moved_by(old)
    now = Correction.from_record(new.ride)
    g = np.exp(np.array([now.log_range[0], now.log_range[0] - 1.0]))
    rides = replace(Rides(**{field.name: g for field in fields(Rides)}), belly_reach=np.zeros(2))
    found = now.predict(rides, np.zeros(2), np.zeros(2), np.full(2, 10.0))
    assert found.log_c_r[0] - found.log_c_r[1] == pytest.approx(1.0)


@pytest.mark.parametrize("name", NAMES)
def test_thin_tiles_steps_and_the_table_move_too(name):
    old = Calibration.shipped(name)
    move, new = moved_by(old)
    relief = np.exp(np.mean(ThinModel.from_record(old.thin).relief))
    columns = np.full((1, len(THIN_COLUMNS)), 0.3)
    columns[:, :3] = 30.0, 1.0, relief
    was, now = (ThinModel.from_record(each.thin).predict(columns, np.array([0.01])) for each in (old, new))
    assert now.log_c_r == pytest.approx(move.log(was.log_c_r))
    assert ThinModel.from_record(new.thin).prior[0] == pytest.approx(move.log(ThinModel.from_record(old.thin).prior[0]))
    assert np.array_equal(now.p_fail, was.p_fail)
    assert new.steps["tile"]["c_r"] == pytest.approx(np.exp(move.log(np.log(old.steps["tile"]["c_r"]))))
    assert new.steps["tile"]["p_fail"] == old.steps["tile"]["p_fail"]
    assert new.steps["crossing"] == old.steps["crossing"]
    known = [(a, b) for x, y in zip(old.c_r, new.c_r, strict=True) for a, b in zip(x, y, strict=True) if a is not None]
    assert [b for _, b in known] == pytest.approx([math.exp(move.log(math.log(a))) for a, _ in known])
    assert new.class_limits == old.class_limits


def test_classes_hold_the_terrains_that_moved_into_them():
    old = Calibration.shipped("warthog")
    _, new = moved_by(old, shift=0.4)
    edges = [0.0, *old.class_limits, math.inf]
    assert all(a <= mean <= b for a, mean, b in zip(edges, new.class_c_r, edges[1:], strict=False))


def test_intervals_widen_by_what_is_not_known_and_by_what_drives_scatter():
    old = Calibration.shipped("warthog")
    sd = math.exp(np.mean(old.ride["spread"]))
    for options, wanted in (
        ({"sd": (0.05, 0.0)}, math.hypot(sd, 0.05)),
        ({"sd": (0.0, 0.0), "widening": 1.5}, 1.5 * sd),
    ):
        _, new = moved_by(old, shift=0.3, tilt=0.0, **options)
        assert np.exp(np.mean(new.ride["spread"])) == pytest.approx(wanted, rel=0.02)


def test_the_file_reads_back_and_fits_the_vehicle():
    old = Calibration.shipped("warthog")
    _, new = moved_by(old)
    again = Calibration.from_json(new.to_json(), "moved.json")
    assert again.id == new.id != old.id
    assert again.settings["moved_to_drives"] == {"way_m": 512.0}
    assert json.loads(new.to_json())["vehicle"] == old.vehicle
    assert new.with_preferences(old.vehicle | {"ride_weight": 9.0}, "moved.json").vehicle["ride_weight"] == 9.0
