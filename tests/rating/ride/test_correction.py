"""The correction: recovered from made-up drives, written and read, refused when damaged."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from bumpymap.core.errors import BadInputError, BumpymapError
from bumpymap.rating import Correction, DrivenPatches, NoisyPatches, fit_correction
from bumpymap.rating.ride.correction import NORMAL_TAIL, student_factor, subtract_noise
from bumpymap.rating.ride.motion_operator import Rides

pytestmark = pytest.mark.slow
COUNT = 400


def made_up(seed=1, spread=0.1, count=COUNT):
    """Drives that follow the model: ln C_r = 0.2 + 1.1 ln g with a spread; the rougher the ground, the more fail."""
    rng = np.random.default_rng(seed)
    g = np.exp(rng.uniform(np.log(0.005), np.log(1.5), count))
    uneven, twist = np.exp(0.25 + 0.1 * rng.random(count)), rng.uniform(0.5, 2, count)
    rides = Rides(g, g * uneven, g / 3, g / 3, g / 4 * twist, np.minimum(g, 0.8), g / 2, g / 9)
    truth = np.exp(0.2 + 1.1 * np.log(g) + spread * rng.standard_normal(count))
    chance = 1 / (1 + np.exp(-6 * (np.log(g) + 0.2)))
    failed = rng.binomial(8, chance)
    error = 0.05 * truth
    return DrivenPatches(
        rides, rng.uniform(0, 20, count), truth + error * rng.standard_normal(count), error, 8 - failed, failed
    )


def no_noise(count=500):
    rng = np.random.default_rng(3)
    excess = rng.exponential(0.5, count)
    return NoisyPatches(
        excess, np.exp(rng.uniform(-0.5, 4, count)), 0.3 * excess * rng.standard_normal(count) - 0.1 * excess
    )


@cache
def fitted():
    """The fit to those drives."""
    return fit_correction(made_up(), no_noise())


def predicted(correction, driven, excess=0.0):
    felt = driven.rides.pitch_change * np.sqrt(np.expm1(2 * excess))
    return correction.predict(driven.rides, driven.slope_deg, felt, np.full(len(felt), 4.0))


def test_a_fit_finds_what_the_drives_follow():
    correction = fitted()
    unseen = made_up(2)
    found = predicted(correction, unseen)
    good = unseen.failed <= 2
    error = found.log_c_r[good] - (0.2 + 1.1 * np.log(unseen.rides.pitch_change[good]))
    assert np.abs(error).max() < 0.12
    assert np.median(np.abs(error)) < 0.03
    assert correction.origin["spearman"] > 0.98


def test_intervals_hold_their_share():
    correction = replace(fit_correction(made_up(spread=0.15), no_noise()), model_error=0.0)
    unseen = made_up(2, spread=0.15)
    found = predicted(correction, unseen)
    good = unseen.failed <= 2
    away = np.log(unseen.c_r) - found.log_c_r
    inside = (away > -NORMAL_TAIL * found.below) & (away < NORMAL_TAIL * found.above)
    assert 0.72 < inside[good].mean() < 0.88


def test_the_chance_to_fail_is_in_step_with_the_drives():
    correction = fitted()
    unseen = made_up(2)
    p_fail = predicted(correction, unseen).p_fail
    share = unseen.failed / 8
    for low, high in ((0, 0.1), (0.3, 0.7), (0.9, 1.01)):
        chosen = (p_fail >= low) & (p_fail < high)
        assert share[chosen].mean() == pytest.approx(p_fail[chosen].mean(), abs=0.08)


def test_below_what_was_driven_c_r_is_proportional():
    correction = fitted()
    rides = replace(Rides(*(np.array([1e-3, 1e-4]) for _ in range(8))), belly_reach=np.zeros(2))
    found = correction.predict(rides, np.zeros(2), np.zeros(2), np.full(2, 4.0))
    assert np.diff(found.log_c_r) == pytest.approx(np.log(0.1))


def test_ground_is_not_called_smoother_than_its_noise_lets_one_tell():
    correction = fitted()
    rides = replace(Rides(*(np.array([1e-5, 1e-3, 0.2]) for _ in range(8))), belly_reach=np.zeros(3))
    found = correction.predict(rides, np.zeros(3), np.full(3, 0.1), np.full(3, 4.0))
    assert found.log_c_r[0] == found.log_c_r[1] < found.log_c_r[2]
    g, excess = subtract_noise(rides.pitch_change, np.full(3, 0.1))
    assert g == pytest.approx([0.01, 0.01, 0.2])
    assert np.exp(2 * excess) == pytest.approx([101, 101, 1.25])


def test_noise_widens_the_interval():
    correction, driven = fitted(), made_up(2)
    quiet, loud, unknown = (predicted(correction, driven, excess) for excess in (0.0, 1.5, np.nan))
    assert np.all(loud.below > quiet.below)
    assert np.all(unknown.below > quiet.below)


def test_a_record_is_read_back():
    correction = fitted()
    assert Correction.from_record(json.loads(json.dumps(correction.to_record()))) == correction


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"c_r": None}, "damaged"),
        ({"c_r": "text"}, "damaged"),
        ({"noise_low": [[1.0]]}, "damaged"),
        ({"excess": None}, "damaged"),
        ({"fail": [0.1] * 9}, "9 coefficients of p_fail, not 10"),
        ({"c_r": [0.1] * 7}, "7 coefficients of C_r, not 9"),
        *(({"model_error": wrong}, "damaged") for wrong in (-0.1, float("nan"), float("inf"), "wide")),
    ],
)
def test_a_damaged_record_is_refused(change, message):
    with pytest.raises(BadInputError, match=message):
        Correction.from_record(fitted().to_record() | change)


def test_what_another_simulation_adds_widens_every_interval():
    record, driven = fitted().to_record(), made_up(2)
    own, world = (predicted(Correction.from_record(record | {"model_error": e}), driven, 0.3) for e in (0.0, 0.2))
    np.testing.assert_allclose(world.below, np.hypot(own.below, 0.2))
    np.testing.assert_allclose(world.above, np.hypot(own.above, 0.2))
    np.testing.assert_array_equal(world.log_c_r, own.log_c_r)


def test_a_vehicle_that_completes_nothing_is_refused():
    driven = made_up()
    stuck = replace(driven, completed=np.zeros(COUNT, int), failed=np.full(COUNT, 8))
    with pytest.raises(BumpymapError, match="wrong number in its profile"):
        fit_correction(stuck, no_noise())


def test_few_drives_doubt_their_mean_more():
    scipy_stats = pytest.importorskip("scipy.stats")
    drives = np.array([5, 8, 30])
    wanted = scipy_stats.t.ppf(0.9, drives - 1) / scipy_stats.norm.ppf(0.9)
    assert student_factor(drives) == pytest.approx(wanted, rel=0.03)
