"""A calibration at another speed: what changes, what stays, and what it refuses."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from bumpymap.core import UsageError
from bumpymap.rating import (
    Calibration,
    MotionOperator,
    RideOperator,
    at_speed,
    motion_factors,
    motion_felt,
    move_over,
    roll_over,
)
from bumpymap.rating.ride.speed import map_rule, plain_factors, plain_speed_factor
from bumpymap.rating.steps import StepEffect, apply_steps
from bumpymap.rating.vehicle_profile import less_floor

WARTHOG = Calibration.shipped("warthog")
SPEEDS = (0.5, 1.0, 2.0)


@pytest.fixture(scope="module")
def heights():
    rng = np.random.default_rng(8)
    return (rng.normal(0, 1, (30, 15, 15)) * np.geomspace(0.003, 0.15, 30)[:, None, None]).astype(np.float32)


@cache
def rating_at(speed):
    calibration = at_speed(WARTHOG, speed)
    every = tuple(dict.fromkeys((*SPEEDS, calibration.map_speed)))
    return calibration, MotionOperator.of(WARTHOG.profile, 3.0, 15, every)


def factors_at(speed, heights):
    calibration, operator = rating_at(speed)
    own, factors = motion_factors(calibration, operator.speeds, move_over(heights, operator), pitch_of(heights))
    return own, factors[:, : 2 * len(SPEEDS)]


def pitch_of(heights):
    return roll_over(heights, RideOperator.of(WARTHOG.profile, 3.0, 15)).pitch_change


def test_its_own_speed_changes_nothing_and_another_has_another_id_and_the_same_drives():
    assert at_speed(WARTHOG, None) is at_speed(WARTHOG, 1.0) is WARTHOG
    assert WARTHOG.map_speed == 1.0
    fast = at_speed(WARTHOG, 2.0)
    assert fast.id != WARTHOG.id
    assert (fast.map_speed, fast.vehicle, fast.cost_rule) == (2.0, WARTHOG.vehicle, WARTHOG.cost_rule)
    assert Calibration.from_json(fast.to_json(), "file").id == fast.id


def test_speeds_out_of_range_say_what_to_do():
    for speed in (0.39, 2.51):
        with pytest.raises(UsageError, match=r"holds from 0\.4 to 2\.5 m/s"):
            at_speed(WARTHOG, speed)


def test_at_the_speed_of_the_map_the_factor_is_one_and_c_r_at_a_speed_does_not_depend_on_it(heights):
    (logs, one), (to_fast, other) = (factors_at(speed, heights) for speed in (1.0, 2.0))
    for factors, own in ((one, 1), (other, 2)):
        np.testing.assert_array_equal(factors[:, 2 * own], np.float32(1.0))
    assert (logs == 0).all()
    np.testing.assert_allclose(other * np.exp(to_fast)[:, None], one, rtol=1e-5)


def test_faster_shakes_more_and_tiles_without_a_heightmap_get_a_like_answer(heights):
    _, factors = factors_at(1.0, heights)
    plain = plain_factors(WARTHOG, SPEEDS, pitch_of(heights))
    for each in (factors, plain):
        assert (np.diff(each.reshape(len(heights), 3, 2)[:, :, 1], axis=1) > 0).all()
    # White noise is rougher at short waves than the ground that both were fitted to.
    assert np.median(np.abs(np.log(plain / factors))) < 0.5
    np.testing.assert_array_equal(plain[:, 2], np.float32(1.0))
    assert np.isnan(plain_factors(WARTHOG, SPEEDS, np.array([np.nan]))[0]).any()


@pytest.mark.parametrize("name", ["warthog", "car", "husky"])
@pytest.mark.parametrize("comfort", [{}, {"a_w_mps2": 0.8, "top_speed_mps": 9.0}, {"pitch_rate_radps": 0.15}])
def test_ground_is_driven_as_fast_as_the_limits_let_it(name, comfort):
    shipped = Calibration.shipped(name)
    calibration = replace(shipped, vehicle=shipped.vehicle | {"comfort": comfort})
    own, limits, rule = shipped.map_speed, {"pitch_rate_radps": 0.3} | comfort, map_rule(calibration)
    assert rule.top_mps == pytest.approx(min(comfort.get("top_speed_mps", own), 2.5 * own), rel=1e-5)
    speeds = []
    for c_r in np.hypot(np.geomspace(1e-3, 3.0, 60), shipped.floor):
        speed = float(1.0 / rule.slowness(c_r))
        known = max(speed, 0.4 * own)
        told = motion_felt(calibration, (known,), np.full((1, 2), np.nan, np.float32), np.array([c_r], np.float32))[0]
        used = np.hypot(less_floor(told[0], shipped.floor_at(known)) * speed, shipped.floor * own)
        used = max(used / limits["pitch_rate_radps"], told[1] * speed / known / limits.get("a_w_mps2", np.inf))
        assert used <= 1.01
        assert used >= 0.98 or speed == pytest.approx(rule.top_mps)
        speeds.append(speed)
    assert speeds[-1] < 0.4 * own < speeds[0] == pytest.approx(rule.top_mps)
    assert (np.diff(speeds) <= 1e-12).all()


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


def test_a_floor_is_a_rate_in_time():
    """Taken off before a ride is scaled to another speed, added after it; acceleration has none."""
    husky = Calibration.shipped("husky")
    own = husky.map_speed
    fast = at_speed(husky, 2 * own)
    assert fast.map_floor == pytest.approx(husky.floor / 2)
    factors = np.array([[2.0, 4.0]], np.float32)
    for calibration in (husky, fast):
        c_r = np.array([np.hypot(0.05, calibration.map_floor)], np.float32)
        (found,) = motion_felt(calibration, (2 * own,), factors, c_r)
        np.testing.assert_allclose(found, [np.hypot(2 * 0.05, husky.floor / 2), 4 * 0.05], rtol=1e-5)
    (level,) = motion_felt(husky, (2 * own,), factors, np.array([husky.floor], np.float32))
    np.testing.assert_allclose(level, [husky.floor / 2, 0.0], atol=1e-4)
