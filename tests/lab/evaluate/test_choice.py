"""Which patches are driven, and random numbers that belong to a thing."""

import numpy as np
from hypothesis import given, strategies as st

from bumpymap.lab.evaluate.survey_trial import BINS, choose_patches, strata, uniform_by_key

SEEDS = st.integers(0, 2**31)


def ground(seed, count=2000):
    rng = np.random.default_rng(seed)
    return np.exp(rng.normal(-1, 1, count)), rng.random(count) ** 3, rng.random(count)


@given(SEEDS)
def test_every_stratum_gives_as_many_patches_as_it_can(seed):
    c_r, p_fail, priority = ground(seed)
    stratum = strata(c_r, p_fail)
    chosen = choose_patches(stratum, priority, 300)
    assert len(set(chosen.tolist())) == 300
    there, taken = (np.bincount(part, minlength=BINS + 1) for part in (stratum, stratum[chosen]))
    short = taken < taken.max() - 1
    assert np.array_equal(taken[short], there[short])


@given(SEEDS)
def test_more_patches_keep_those_of_before(seed):
    c_r, p_fail, priority = ground(seed, 500)
    stratum = strata(c_r, p_fail)
    few, many = choose_patches(stratum, priority, 50), choose_patches(stratum, priority, 120)
    assert set(few.tolist()) < set(many.tolist())


def test_ground_that_is_expected_to_fail_is_a_stratum_of_its_own():
    c_r, p_fail, _ = ground(5)
    stratum = strata(c_r, p_fail)
    assert np.array_equal(stratum == BINS, p_fail >= 0.5)
    within = [np.ptp(np.log(c_r[stratum == number])) for number in range(1, BINS - 1)]
    assert np.allclose(within, np.median(within), rtol=0.1)


def test_a_thing_keeps_its_number_whatever_stands_beside_it():
    col, row = np.arange(-50, 50), np.arange(100) % 7
    whole = uniform_by_key(3, col, row)
    assert np.array_equal(uniform_by_key(3, col[40:60], row[40:60]), whole[40:60])
    assert not np.array_equal(uniform_by_key(4, col, row), whole)
    assert not np.array_equal(uniform_by_key(3, row, col), whole)
