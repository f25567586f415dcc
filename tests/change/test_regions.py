import numpy as np
from hypothesis import given, strategies as st
from scipy import ndimage

from bumpymap.change.compare import GroundChange, decide
from bumpymap.change.pipeline import connect


@given(st.integers(0, 10_000), st.floats(0.05, 0.8), st.integers(1, 6))
def test_small_changes_are_dropped_and_the_others_numbered(seed, share, least):
    rng = np.random.default_rng(seed)
    code = np.where(rng.random((9, 12)) < share, rng.integers(1, 5, (9, 12)), 0).astype(float)
    code[rng.random(code.shape) < 0.1] = np.nan
    kept, area, dropped = connect(code, least)
    labels, count = ndimage.label(np.nan_to_num(code) > 0)
    sizes = ndimage.sum_labels(np.ones(code.shape), labels, np.arange(1, count + 1))
    assert area.max() == sum(sizes >= least)
    assert dropped == sizes[sizes < least].sum()
    assert np.array_equal(area > 0, np.nan_to_num(kept) > 0)
    assert np.array_equal(np.isnan(kept), np.isnan(code))
    pairs = {(int(number), int(found)) for number, found in zip(area[area > 0], labels[area > 0], strict=True)}
    assert len(pairs) == area.max()


def ground(rng, shape=(20, 30)):
    height, form = rng.standard_normal((2, *shape))
    return GroundChange(0.01 * height, height, form)


def test_a_ride_that_jumps_over_ground_that_has_not_moved_is_no_change():
    rng = np.random.default_rng(1)
    found = ground(rng)
    ride = rng.standard_normal(found.z_height.shape)
    ride[:5] = 30.0
    assert not decide(found, ride, 0.05).code.any()
    found.z_height[:5] = 9.0
    code = decide(found, ride, 0.05).code
    assert (code[:5] == 2).all()
    assert (decide(found, np.where(ride == 30.0, -30.0, ride), 0.05).code[:5] == 3).all()
    assert (decide(found, np.where(ride == 30.0, np.nan, ride), 0.05).code[:5] == 4).all()
    assert (decide(found, np.where(ride == 30.0, 0.5, ride), 0.05).code[:5] == 1).all()
    assert not code[5:].any() or (code[5:] > 0).mean() < 0.02


def test_surveys_that_do_not_fit_each_other_are_widened():
    rng = np.random.default_rng(2)
    loose = ground(rng)
    loose = GroundChange(loose.d_height, 3.0 * loose.z_height, 2.0 + 2.0 * loose.z_shape)
    done = decide(loose, np.zeros(loose.z_height.shape), 0.05)
    assert 2.5 < done.widened["height"] < 3.5
    assert 1.7 < done.widened["shape"] < 2.3
    assert done.widened["c_r"] == 1.0
    assert not done.code.any()
