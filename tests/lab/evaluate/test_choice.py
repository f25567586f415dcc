"""Which patches are driven, and random numbers that belong to a thing."""

import numpy as np
from hypothesis import given, strategies as st

from bumpymap.lab.evaluate.survey_trial import BINS, choose_patches, driven_ground, strata

SEEDS = st.integers(0, 2**31)


def ground(seed):
    rng = np.random.default_rng(seed)
    return np.exp(rng.normal(-1, 1, 2000)), rng.random(2000) ** 3, rng.random(2000)


@given(SEEDS)
def test_every_stratum_gives_as_many_patches_as_it_can_and_more_patches_keep_those_of_before(seed):
    c_r, p_fail, priority = ground(seed)
    stratum = strata(c_r, p_fail)
    few, chosen = (set(choose_patches(stratum, priority, total).tolist()) for total in (120, 300))
    assert len(chosen) == 300
    assert few < chosen
    there, taken = (np.bincount(part, minlength=BINS + 1) for part in (stratum, stratum[list(chosen)]))
    short = taken < taken.max() - 1
    assert np.array_equal(taken[short], there[short])


def test_ground_that_is_expected_to_fail_is_a_stratum_of_its_own():
    c_r, p_fail, _ = ground(5)
    stratum = strata(c_r, p_fail)
    assert np.array_equal(stratum == BINS, p_fail >= 0.5)
    within = [np.ptp(np.log(c_r[stratum == number])) for number in range(1, BINS - 1)]
    assert np.allclose(within, np.median(within), rtol=0.1)


def test_holes_are_filled_on_the_same_plane(measure_points):
    axis = (np.arange(30) + 0.5) * 0.1
    x, y = (part.ravel() for part in np.meshgrid(axis, axis))
    z = 1500 + 0.3 * x - 0.1 * y + 0.05 * np.sin(4 * x) * np.cos(3 * y)
    kept = np.hypot(x - 1.2, y - 1.8) > 0.4
    whole, holed = measure_points(x, y, z), measure_points(x[kept], y[kept], z[kept])
    assert np.isnan(holed.heights[0]).any()
    apart = driven_ground(holed)[0] - driven_ground(whole)[0]
    assert np.isfinite(apart).all()
    assert np.ptp(apart) < 0.12
