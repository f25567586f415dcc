"""A calibration moved to drives: what counts of them, the posterior, and what the moved one predicts."""

import json
import math
from dataclasses import fields, replace

import numpy as np
import pytest
from driven_stretches import driven_stretches

from bumpymap.core import BadInputError
from bumpymap.rating import Calibration, Correction, RideModel, update_from_drives
from bumpymap.rating.calibration import shipped_calibrations
from bumpymap.rating.drive_update import (
    DriveEvidence,
    DrivePrior,
    LogMove,
    collect_evidence,
    fit_move,
    moved_calibration,
    respond,
)
from bumpymap.rating.ride.operator import Rides
from bumpymap.rating.ride.thin import THIN_COLUMNS, Strength, ThinModel

CALIBRATION = Calibration.shipped("warthog")


def test_500_metres_bring_the_median_ratio_to_within_5_percent():
    for seed, shift in ((1, 0.35), (2, -0.35)):
        _, update = update_from_drives(CALIBRATION, driven_stretches(CALIBRATION, 50, shift=shift, seed=seed))
        assert update.ratio[0] == pytest.approx(np.exp(-shift), rel=0.08)
        assert update.ratio[1] == pytest.approx(1.0, abs=0.05)
        low, middle, high = update.factor
        assert low < middle < high
        assert middle == pytest.approx(np.exp(shift), rel=0.08)
        assert update.held_out_error[1] < 0.6 * update.held_out_error[0]
        assert (update.way_m, update.stretches, update.drives) == (500.0, 50, 1)
        assert update.new_m == pytest.approx(500.0)


def test_the_new_calibration_is_the_old_one_moved_by_the_posterior():
    stretches = driven_stretches(CALIBRATION, 60, tilt=0.1)
    new, update = update_from_drives(CALIBRATION, stretches)
    assert update_from_drives(CALIBRATION, stretches)[0].to_json() == new.to_json()
    shift, tilt = update.posterior.mean
    middle = np.log(CALIBRATION.class_limits[1])
    wanted = [middle + shift + (1 + tilt) * (np.log(c_r) - middle) for c_r in CALIBRATION.steps["tile"]["c_r"]]
    assert np.log(new.steps["tile"]["c_r"]) == pytest.approx(wanted)
    assert RideModel(new).calibration.vehicle == CALIBRATION.vehicle
    record = json.loads(json.dumps(new.settings["moved_to_drives"]))
    assert record["calibration_id"] == CALIBRATION.id
    assert record["way_m"] == 600.0
    assert record["posterior"]["mean"] == pytest.approx([shift, tilt])


def test_drives_that_are_short_or_agree_or_moved_it_already_move_nothing():
    moved, _ = update_from_drives(CALIBRATION, driven_stretches(CALIBRATION))
    ten, fifty = driven_stretches(CALIBRATION, 10), driven_stretches(CALIBRATION, 50)
    fifty.speed_mps[10:] = 3.0
    laps = replace(ten, **{name: np.tile(getattr(ten, name), 10) for name in ten.__slots__})
    for calibration, made, words in (
        (CALIBRATION, ten, r"100 m of different ground on 10 stretches count\. It takes at least 200 m"),
        (CALIBRATION, fifty, r"100 m of .* \(left out: 400 m not near the 1 m/s of the map\)"),
        (CALIBRATION, laps, "100 m of different ground on 100 stretches"),
        (CALIBRATION, driven_stretches(CALIBRATION, 60, shift=0.0), r"agree .* room for a factor of 0\.9\d to 1\.0\d"),
        (moved, driven_stretches(CALIBRATION), f"against a map made with the calibration {CALIBRATION.id}"),
    ):
        with pytest.raises(BadInputError, match=words):
            update_from_drives(calibration, made)


def test_variances_are_those_of_the_logarithm_and_the_floor_is_taken_off_in_power():
    made = driven_stretches(CALIBRATION, 50, shift=0.0, sd=1e-9, map_sd=0.2)
    made.measured[:] = made.c_r
    made.measured_sd[:], made.place_sd[:] = 0.03 * made.c_r, 0.04 * made.c_r
    evidence, _ = collect_evidence(made, 1.0, 0.0)
    assert np.sqrt(evidence.own_variance) == pytest.approx(0.05)
    assert evidence.map_sd == pytest.approx(0.2, rel=1e-4)
    before = np.log(made.c_r)
    made.c_r[:] = np.hypot(made.c_r, 0.03)
    assert collect_evidence(made, 1.0, 0.03)[0].log_c_r == pytest.approx(before)


MIDDLE = np.log(0.25)
PRIOR = DrivePrior(MIDDLE, (0.2, 0.1), -np.inf)


def evidence_of(rng, n=45, numbers=(0.2, 0.05), *, prior=PRIOR, scale=1.0, line_sd=0.1):
    """Stretches in squares of three; what the map is off by is ``scale`` times what it says."""
    square = np.arange(n) // 3
    log_c_r = MIDDLE - 0.3 + rng.normal(0, 0.7, n)
    map_sd, sd = np.full(n, 0.1), np.full(n, 0.05)
    off = scale * map_sd * rng.normal(size=n)[square] + np.hypot(sd, line_sd) * rng.normal(size=n)
    measured = respond(np.array(numbers), log_c_r, prior)[0] + off
    whole = np.zeros(n, np.int64)
    return DriveEvidence(log_c_r, measured, sd**2, map_sd, square, whole, whole, np.full(n, 10.0), np.full(n, 10.0))


@pytest.mark.parametrize(("options", "low"), [({"line_sd": 0.25}, 0.7), ({"scale": 1.5, "n": 60}, 0.65)])
def test_the_stated_uncertainty_holds(options, low):
    """The 80 % interval of both numbers, over drives whose numbers are drawn from the prior."""
    inside = []
    for seed in range(16):
        rng = np.random.default_rng([seed, 5])
        numbers = rng.normal(0.0, PRIOR.sd)
        found = fit_move(evidence_of(rng, numbers=numbers, **options), PRIOR)
        inside.append(np.abs(found.mean - numbers) < 1.2816 * np.sqrt(np.diag(found.covariance)))
    assert low < np.mean(inside) < 0.92


def test_wild_stretches_hardly_move_anything():
    evidence = evidence_of(np.random.default_rng(4), 60, scale=0.5)
    calm = fit_move(evidence, PRIOR)
    evidence.log_measured[::15] += 2.0
    wild = fit_move(evidence, PRIOR)
    assert abs(wild.mean[0] - calm.mean[0]) < 0.05
    assert wild.covariance[0, 0] > calm.covariance[0, 0]


def test_ground_driven_again_says_little_more():
    """Five passes over the same squares, each with its own measurement, where the map's error rules."""
    once = evidence_of(np.random.default_rng(5), 30, line_sd=0.0)
    once.own_variance[:] = 0.02**2
    rows = np.tile(np.arange(30), 5)
    again = once.chosen(rows)
    apart = DriveEvidence(**{n: getattr(again, n) for n in again.__slots__} | {"square": np.arange(150) // 3})
    sd = [np.sqrt(fit_move(each, PRIOR).covariance[0, 0]) for each in (once, again, apart)]
    assert sd[1] > 0.8 * sd[0]
    assert sd[2] < 0.6 * sd[0]


def test_a_floor_is_found():
    prior = DrivePrior(MIDDLE, (0.2, 0.1, 1.0), np.log(0.02))
    numbers = np.array([0.2, 0.05, np.log(0.06)])
    rng = np.random.default_rng(7)
    evidence = evidence_of(rng, 200, prior=prior, numbers=numbers, scale=0.5)
    evidence.log_c_r[:] -= 1.0
    evidence.log_measured[:] = respond(numbers, evidence.log_c_r, prior)[0] + 0.05 * rng.normal(size=200)
    assert fit_move(evidence, prior).mean[2] == pytest.approx(np.log(0.06), abs=0.1)


def moved_by(calibration, shift=0.3, tilt=0.08, sd=(0.03, 0.04), widening=1.0):
    move = LogMove(math.log(calibration.class_limits[1]), shift, tilt, np.diag(np.square(sd)), widening)
    return move, moved_calibration(calibration, move, {"way_m": 512.0})


def rides_of(log_g, rng):
    g = np.exp(log_g)
    n = len(g)
    same = Rides(**{field.name: 0.2 * g for field in fields(Rides)})
    return replace(
        same, pitch_change=g, pitch_change_rms=g * np.exp(rng.uniform(0, 0.6, n)), belly_reach=np.full(n, 0.5)
    )


@pytest.mark.parametrize("name", shipped_calibrations())
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


@pytest.mark.parametrize("name", shipped_calibrations())
def test_thin_tiles_steps_and_the_table_move_too(name):
    old = Calibration.shipped(name)
    move, new = moved_by(old)
    ground = np.mean(ThinModel.from_record(old.thin).relief)
    columns = np.full((1, len(THIN_COLUMNS)), 0.3)
    columns[:, :2] = 30.0, 1.0
    strength = Strength(*np.array([[ground], [0.1], [-4.5]]))
    was, now = (ThinModel.from_record(each.thin).predict(columns, strength) for each in (old, new))
    assert now.log_c_r == pytest.approx(move.log(was.log_c_r))
    assert np.array_equal(now.p_fail, was.p_fail)
    assert new.steps["tile"]["c_r"] == pytest.approx(np.exp(move.log(np.log(old.steps["tile"]["c_r"]))))
    assert new.steps["tile"]["p_fail"] == old.steps["tile"]["p_fail"]
    assert new.steps["crossing"] == old.steps["crossing"]
    known = [(a, b) for x, y in zip(old.c_r, new.c_r, strict=True) for a, b in zip(x, y, strict=True) if a is not None]
    assert [b for _, b in known] == pytest.approx([math.exp(move.log(math.log(a))) for a, _ in known])
    assert new.class_limits == old.class_limits
    edges = [0.0, *old.class_limits, math.inf]
    assert all(a <= mean <= b for a, mean, b in zip(edges, new.class_c_r, edges[1:], strict=False))


def test_intervals_widen_by_what_is_not_known_and_by_what_drives_scatter():
    sd = math.exp(np.mean(CALIBRATION.ride["spread"]))
    for wanted, options in (
        (math.hypot(sd, 0.05), {"sd": (0.05, 0.0)}),
        (1.5 * sd, {"sd": (0.0, 0.0), "widening": 1.5}),
    ):
        _, new = moved_by(CALIBRATION, tilt=0.0, **options)
        assert np.exp(np.mean(new.ride["spread"])) == pytest.approx(wanted, rel=0.02)


def test_the_file_reads_back_and_fits_the_vehicle():
    _, new = moved_by(CALIBRATION)
    again = Calibration.from_json(new.to_json(), "moved.json")
    assert again.id == new.id != CALIBRATION.id
    assert again.settings["moved_to_drives"] == {"way_m": 512.0}
    assert again.vehicle == CALIBRATION.vehicle
    mine = replace(CALIBRATION.profile, ride_weight=9.0)
    assert new.with_preferences(mine, "moved.json").vehicle["ride_weight"] == 9.0
