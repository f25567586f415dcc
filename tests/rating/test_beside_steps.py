"""The ground that a step leaves of a tile: the bridge over a ditch, the rest beside a drop."""

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from bumpymap.core import loops
from bumpymap.rating import THIN_COLUMNS, Calibration, rate_beside_steps

PIXELS = 15
SHIPPED = Calibration.shipped("warthog")
ROWS, COLS = np.indices((PIXELS, PIXELS))
NOTHING = np.zeros((1, PIXELS, PIXELS), bool)
WORST = np.array([0.9], np.float32), np.array([1.0], np.float32)


def rated(heights, line, noise=0.0):
    rng = np.random.default_rng(3)
    thin = np.full((1, len(THIN_COLUMNS)), np.nan, np.float32)
    own = {"points": 225.0, "squares": 2.0 * noise**2 * 500, "pairs": 500.0}
    thin[0, [THIN_COLUMNS.index(name) for name in own]] = list(own.values())
    noisy = (heights + rng.normal(0, noise, heights.shape))[None].astype(np.float32)
    return rate_beside_steps(noisy, line[None], NOTHING, WORST, thin, SHIPPED)


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("slope", [0.0, 0.2])
def test_beside_a_drop_the_ground_is_as_good_as_it_is(noise, slope):
    heights = np.where(COLS < 3, -1.2, 0.0) + slope * 0.2 * ROWS
    closed, c_r, p_fail = rated(heights, COLS == 2, noise)
    assert not closed.any()
    assert p_fail[0] < 0.1
    assert c_r[0] < (0.03 if noise == 0.0 else 0.1)


def test_what_is_too_steep_or_fails_stays_closed():
    steep = rated(np.where(COLS < 3, -1.2, 0.0) + 0.2 * np.tan(np.radians(40)) * ROWS, COLS == 2)
    blocks = np.where(COLS < 3, -1.2, 0.5 * ((ROWS // 3 + COLS // 3) % 2))
    failing = rated(blocks, COLS == 2)
    for closed, c_r, p_fail in (steep, failing):
        assert closed[0, :, 6:].all()
        assert np.isnan([c_r[0], p_fail[0]]).all()


def test_the_larger_of_two_rests_is_open_and_the_ditch_is_not_asked_for():
    """A ditch of 1 m, of whose floor 0.2 m lie apart from its sides: nothing can stand there."""
    heights = np.where((COLS > 3) & (COLS < 9), -1.0, 0.0)
    closed, _, p_fail = rated(heights, (COLS == 3) | (COLS == 9))
    assert closed[0, :, 6].all()
    assert not closed[0, :, 14].any()
    assert p_fail[0] < 0.1


def test_the_nearest_mark_is_that_of_a_distance_transform():
    marks = np.random.default_rng(5).random((40, PIXELS, PIXELS)) < np.linspace(0.01, 0.5, 40)[:, None, None]
    marks = np.concatenate([marks[marks.any(axis=(1, 2))], NOTHING])
    place, square = (np.empty(marks.shape, np.int32) for _ in range(2))
    loops.find_nearest(marks, place, square)
    for tile, own, far in zip(marks[:-1], place, square, strict=False):
        distance, (row, col) = distance_transform_edt(~tile, return_indices=True)
        np.testing.assert_array_equal(own, PIXELS * row + col)
        np.testing.assert_allclose(np.sqrt(far), distance)
    assert (place[-1] == -1).all()
