"""Fits of the ride model: what made-up drives follow is found, and what cannot be fitted is refused."""

from dataclasses import replace

import numpy as np
import pytest

from bumpymap.core import NORMAL_80, BumpymapError
from bumpymap.lab.simulate.ride_fit import DrivenPatches, fit_correction
from bumpymap.rating import Rides

pytestmark = pytest.mark.slow
COUNT = 400


def made_up(seed=1, spread=0.1, count=COUNT):
    """Drives that follow the model: ln C_r = 0.2 + 1.1 ln g with a spread; the rougher the ground, the more fail."""
    rng = np.random.default_rng(seed)
    g = np.exp(rng.uniform(np.log(0.005), np.log(1.5), count))
    uneven, twist = np.exp(0.25 + 0.1 * rng.random(count)), rng.uniform(0.5, 2, count)
    rides = Rides(g, g * uneven, g / 3, g / 4 * twist, np.minimum(g, 0.8), g / 2, g / 9)
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
    points = np.exp(rng.uniform(-0.5, 4, count))
    return np.stack([excess, points, 0.3 * excess * rng.standard_normal(count) - 0.1 * excess])


@pytest.fixture(scope="module", name="correction")
def correction_fixture():
    return fit_correction(made_up(), no_noise())


def predicted(correction, driven):
    none = np.zeros(len(driven.c_r))
    return correction.predict(driven.rides, driven.slope_deg, none, none + 4.0)


def test_a_fit_finds_what_the_drives_follow(correction):
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
    inside = (away > -NORMAL_80 * found.below) & (away < NORMAL_80 * found.above)
    assert 0.72 < inside[good].mean() < 0.88


def test_the_chance_to_fail_is_in_step_with_the_drives(correction):
    unseen = made_up(2)
    p_fail = predicted(correction, unseen).p_fail
    share = unseen.failed / 8
    for low, high in ((0, 0.1), (0.3, 0.7), (0.9, 1.01)):
        chosen = (p_fail >= low) & (p_fail < high)
        assert share[chosen].mean() == pytest.approx(p_fail[chosen].mean(), abs=0.08)


def test_a_vehicle_that_always_arrives_never_fails():
    driven = made_up()
    safe = replace(driven, completed=np.full(COUNT, 8), failed=np.zeros(COUNT, np.int64))
    assert predicted(fit_correction(safe, no_noise()), made_up(2)).p_fail.max() < 1e-3


def test_a_vehicle_that_completes_nothing_is_refused():
    driven = made_up()
    stuck = replace(driven, completed=np.zeros(COUNT, int), failed=np.full(COUNT, 8))
    with pytest.raises(BumpymapError, match="wrong number in its profile"):
        fit_correction(stuck, no_noise())
