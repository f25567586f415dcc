"""A calibration at another speed: what changes, what stays, and what it refuses."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from bumpymap.core import BadInputError, UsageError
from bumpymap.rating import Calibration, MotionModel, RideOperator, at_speed, motion_felt, require_speeds, roll_over
from bumpymap.rating.ride.speed import SpeedRating, plain_factors, plain_speed_factor
from bumpymap.rating.steps import StepEffect, apply_steps

WARTHOG = Calibration.shipped("warthog")
SPEEDS = (0.5, 1.0, 2.0)


def relief(count=30):
    rng = np.random.default_rng(8)
    return (rng.normal(0, 1, (count, 15, 15)) * np.geomspace(0.003, 0.15, count)[:, None, None]).astype(np.float32)


@cache
def rating_at(speed):
    return SpeedRating.of(at_speed(WARTHOG, speed), SPEEDS)


def pitch_of(heights):
    return roll_over(heights, RideOperator.of(WARTHOG.vehicle, 3.0, 15)).pitch_change


def test_its_own_speed_changes_nothing():
    assert at_speed(WARTHOG, None) is WARTHOG
    assert at_speed(WARTHOG, 1.0) is WARTHOG
    assert WARTHOG.map_speed == 1.0


def test_another_speed_has_another_id_and_the_same_drives():
    fast = at_speed(WARTHOG, 2.0)
    assert fast.id != WARTHOG.id
    assert fast.map_speed == 2.0
    assert fast.vehicle == WARTHOG.vehicle
    assert fast.cost_rule == WARTHOG.cost_rule
    again = Calibration.from_json(fast.to_json(), "file")
    assert again.id == fast.id


@pytest.mark.parametrize("speed", [0.39, 2.51])
def test_speeds_out_of_range_are_refused_with_the_range(speed):
    with pytest.raises(UsageError, match=re.escape("holds from 0.4 to 2.5 m/s")):
        at_speed(WARTHOG, speed)


def test_a_calibration_without_other_speeds_says_how_to_make_one():
    with pytest.raises(UsageError, match=r"`speeds`.*without other speeds than 1 m/s.*bumpymap calibrate"):
        require_speeds(replace(WARTHOG, motion=None), SPEEDS, "speeds")


def test_at_the_speed_of_the_map_the_factor_is_one_to_the_bit():
    heights = relief()
    for calibration in (WARTHOG, at_speed(WARTHOG, 2.0)):
        _, factors = rating_at(calibration.map_speed).factors(heights, pitch_of(heights))
        own = SPEEDS.index(calibration.map_speed)
        np.testing.assert_array_equal(factors[:, 3 * own], np.float32(1.0))


def test_c_r_at_a_speed_does_not_depend_on_the_speed_of_the_map():
    heights = relief()
    logs, one = rating_at(1.0).factors(heights, pitch_of(heights))
    assert (logs == 0).all()
    to_fast, other = rating_at(2.0).factors(heights, pitch_of(heights))
    np.testing.assert_allclose(other * np.exp(to_fast)[:, None], one, rtol=1e-5)


def test_faster_shakes_more():
    heights = relief()
    _, factors = rating_at(1.0).factors(heights, pitch_of(heights))
    felt = factors.reshape(len(heights), 3, 3)[:, :, 2]
    assert (np.diff(felt, axis=1) > 0).all()
    plain = plain_factors(WARTHOG, SPEEDS, np.geomspace(0.01, 0.5, 20)).reshape(20, 3, 3)
    assert (np.diff(plain[:, :, 2], axis=1) > 0).all()


def test_tiles_without_a_heightmap_get_a_like_answer():
    heights = relief()
    _, factors = rating_at(1.0).factors(heights, pitch_of(heights))
    plain = plain_factors(WARTHOG, SPEEDS, pitch_of(heights))
    # White noise is rougher at short waves than the ground that both were fitted to.
    assert np.median(np.abs(np.log(plain / factors))) < 0.5
    np.testing.assert_array_equal(plain[:, 3], np.float32(1.0))
    assert np.isnan(plain_factors(WARTHOG, SPEEDS, np.array([np.nan]))[0]).any()


def test_steps_follow_the_speed_of_the_map():
    columns = {
        "class_id": np.zeros(3, np.uint8),
        "coverage": np.ones(3),
        **{name: np.full(3, 0.01, np.float32) for name in ("c_r", "c_r_low", "c_r_high", "p_fail", "confidence")},
    }
    step = np.array([0.1, 0.2, 0.0])
    slow, fast = (apply_steps(columns, step, each) for each in (WARTHOG, at_speed(WARTHOG, 2.0)))
    effect = StepEffect.of(WARTHOG)
    told = effect.read(effect.c_r, step[:2])
    ratio = np.exp(plain_speed_factor(at_speed(WARTHOG, 2.0), np.log(told)))
    assert slow["c_r"][:2] == pytest.approx(told, rel=1e-5)
    assert fast["c_r"][:2] == pytest.approx(told * ratio, rel=0.03)  # curves are straight between known heights
    np.testing.assert_array_equal(slow["p_fail"], fast["p_fail"])


def test_the_record_is_read_as_it_was_written():
    model = MotionModel.from_record(WARTHOG.motion, 1.0)
    assert model.to_record() == WARTHOG.motion


@pytest.mark.parametrize("change", [{"c_r": {}}, {"range": [1.0]}, {"a_w": {"terms": [1.0], "plain": [1.0]}}])
def test_a_damaged_record_is_told(change):
    with pytest.raises(BadInputError, match="record of speeds"):
        MotionModel.from_record({**WARTHOG.motion, **change}, 1.0)


def test_a_floor_is_a_rate_in_time():
    """Taken off before a ride is scaled to another speed, added after it; roll and acceleration have none."""
    husky = Calibration.shipped("husky")
    own = husky.map_speed
    fast = at_speed(husky, 2 * own)
    assert fast.map_floor == pytest.approx(husky.floor / 2)
    factors = np.array([[2.0, 3.0, 4.0]], np.float32)
    driven = 0.05
    c_r = np.array([np.hypot(driven, husky.floor)], np.float32)
    (found,) = motion_felt(husky, (2 * own,), factors, c_r)
    np.testing.assert_allclose(found, [np.hypot(2 * driven, husky.floor / 2), 3 * driven, 4 * driven], rtol=1e-5)
    (level,) = motion_felt(husky, (2 * own,), factors, np.array([husky.floor], np.float32))
    np.testing.assert_allclose(level, [husky.floor / 2, 0.0, 0.0], atol=1e-4)
