"""What counts as a change, tile by tile: figures by hand, the rule of the book, noise that is no change."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import ndimage, stats

from bumpymap.change.compare import (
    CommonError,
    GroundChange,
    coarsen,
    compare_heights,
    decide,
    hold_false_discoveries,
    ride_z,
)
from bumpymap.change.pipeline import connect

LAGS = [(0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0)]
CHANCES = st.lists(st.one_of(st.floats(0.0, 1.0), st.just(float("nan"))), min_size=0, max_size=40)


def by_hand(tile):
    """z_height and z_shape of one tile, one pixel after the other."""

    def cut(values):
        return np.clip(values / max(1.4826 * np.nanmedian(np.abs(values)), 1e-3), -1.5, 1.5)

    level = cut(tile)
    form = cut(tile - np.nanmedian(tile))
    form = form - np.nanmean(form)
    products = []
    for row, col in np.ndindex(form.shape):
        for down, right in LAGS:
            if row + down < len(tile) and 0 <= col + right < len(tile):
                products.append(form[row, col] * form[row + down, col + right])
    own = level[np.isfinite(level)]
    t, freedom = stats.ttest_1samp(own, 0.0).statistic, len(own) - 1
    height = -np.sign(t) * stats.norm.ppf(stats.t.cdf(-abs(t), freedom))
    return height, np.nansum(products) / np.sqrt(np.nansum(np.square(products)))


@given(st.integers(0, 10_000), st.floats(0.2, 1.0))
def test_figures_of_a_tile_are_those_made_by_hand(seed, seen):
    rng = np.random.default_rng(seed)
    tile = rng.normal(0.01, 0.05, (1, 15, 15))
    tile[rng.random(tile.shape) > seen] = np.nan
    found = compare_heights(tile)
    assert found.d_height[0] == pytest.approx(np.nanmean(tile))
    assert (found.z_height[0], found.z_shape[0]) == pytest.approx(by_hand(tile[0]))


def test_without_a_change_both_are_standard_normal_whatever_the_noise():
    """The size of the noise differs from pixel to pixel: a smooth path through a shrub."""
    rng = np.random.default_rng(0)
    size = np.where(np.arange(15) < 9, 0.01, 0.3)[None, :, None] * rng.uniform(0.5, 2.0, (4000, 1, 1))
    found = compare_heights(rng.standard_t(3, (4000, 15, 15)) * size)
    for z in (found.z_height, found.z_shape):
        assert z.mean() == pytest.approx(0.0, abs=0.5)
        assert z.std() == pytest.approx(1.0, abs=0.08)
        assert np.mean(z > 3.0) < 0.006
    assert found.z_height.mean() == pytest.approx(0.0, abs=0.06)


def test_cells_are_means_of_the_pixels_that_are_seen():
    heights = np.arange(16.0).reshape(1, 4, 4)
    heights[0, :2, :2] = heights[0, 3, 3] = np.nan
    np.testing.assert_array_equal(coarsen(heights, 2), [[[np.nan, 4.5], [10.5, np.mean([10.0, 11.0, 14.0])]]])
    np.testing.assert_array_equal(coarsen(heights, 1), heights)


def test_ride_costs_are_compared_by_their_logarithms():
    spread = 0.1
    half = 1.2815515655446004 * spread

    def bands(c_r):
        return tuple(np.array(c_r) * np.exp(by) for by in (0.0, -half, half))

    z = ride_z(bands([0.1, 0.1, 0.2, np.nan, 0.1]), bands([0.1, 0.2, 0.1, 0.1, 0.0]))
    expected = np.log(2.0) / (spread * np.sqrt(2.0))
    assert z == pytest.approx([0.0, expected, -expected, np.nan, np.nan], nan_ok=True)


@pytest.mark.parametrize("floor", [0.0, 0.05])
def test_what_both_maps_share_is_no_part_of_the_spread(floor):
    own, shared = 0.08, 0.1
    ground = np.array([0.05, 0.1])
    tail = 1.2815515655446004 * np.hypot(own, shared)

    def bands(factor):
        return tuple(np.hypot(factor * ground * np.exp(by), floor) for by in (0.0, -tail, tail))

    z = ride_z(bands(1.0), bands(1.02), CommonError(shared, floor))
    assert z == pytest.approx(np.full(2, np.log(1.02) / (own * np.sqrt(2.0))), rel=0.05)


def step_up(chances, share):
    """Benjamini and Hochberg by the book: sort, go down from the largest, stop at the first that is low enough."""
    known = sorted(chance for chance in chances if chance == chance)  # noqa: PLR0124 (NaN)
    for place in range(len(known), 0, -1):
        if known[place - 1] <= share * place / len(known):
            return [chance <= known[place - 1] for chance in chances]
    return [False] * len(chances)


@given(CHANCES, st.floats(0.01, 0.5))
def test_what_counts_as_found_is_the_rule_of_the_book(chances, share):
    assert hold_false_discoveries(np.array(chances, float), share).tolist() == step_up(chances, share)


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
    for jump, kind in ((30.0, 2), (-30.0, 3), (np.nan, 4), (0.5, 1)):
        code = decide(found, np.where(ride == 30.0, jump, ride), 0.05).code
        assert (code[:5] == kind).all()
        assert (code[5:] > 0).mean() < 0.02


def test_surveys_that_do_not_fit_each_other_are_widened():
    """A tenth of the tiles has changed, which widens the middle half of the heights to 1.15."""
    loose = ground(np.random.default_rng(2), (100, 200))
    loose.z_height[:10] = 500.0
    loose.z_height[-1] = np.nan
    loose = GroundChange(loose.d_height, 3.0 * loose.z_height, 2.0 + 2.0 * loose.z_shape)
    done = decide(loose, np.zeros(loose.z_height.shape), 0.05)
    assert done.widened == pytest.approx({"height": 3.0 * 1.15, "shape": 2.0, "c_r": 1.0}, rel=0.05)
    assert (done.code[:10] > 0).all()
    assert (done.code[10:-1] > 0).mean() < 0.01


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
