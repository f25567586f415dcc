import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import stats

from bumpymap.change.compare import CommonError, coarsen, compare_heights, ride_z

LAGS = [(0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0)]


def noise(tiles, seed=0):
    """Differences whose size differs from pixel to pixel: a smooth path through a shrub."""
    rng = np.random.default_rng(seed)
    size = np.where(np.arange(15) < 9, 0.01, 0.3)[None, :, None] * rng.uniform(0.5, 2.0, (tiles, 1, 1))
    return rng.standard_t(3, (tiles, 15, 15)) * size


def by_hand(tile):
    """z_height and z_shape of one tile, one pixel after the other."""

    def cut(values):
        known = [abs(value) for value in values.ravel() if np.isfinite(value)]
        return np.clip(values / max(1.4826 * np.median(known), 1e-3), -1.5, 1.5)

    level = cut(tile)
    form = cut(tile - np.nanmedian(tile))
    form = form - np.nanmean(form)
    products = []
    for row in range(len(tile)):
        for col in range(len(tile)):
            for down, right in LAGS:
                there = row + down, col + right
                if there[0] < len(tile) and 0 <= there[1] < len(tile):
                    products.append(form[row, col] * form[there])
    own = level[np.isfinite(level)]
    products = np.array([product for product in products if np.isfinite(product)])
    t = own.mean() / (own.std(ddof=1) / np.sqrt(len(own)))
    height = -np.sign(t) * stats.norm.ppf(stats.t.cdf(-abs(t), len(own) - 1))
    return height, products.sum() / np.sqrt((products**2).sum())


@given(st.integers(0, 10_000), st.floats(0.2, 1.0))
def test_figures_of_a_tile_are_those_made_by_hand(seed, seen):
    rng = np.random.default_rng(seed)
    tile = rng.normal(0.01, 0.05, (1, 15, 15))
    tile[rng.random(tile.shape) > seen] = np.nan
    found = compare_heights(tile)
    height, shape = by_hand(tile[0])
    assert found.d_height[0] == pytest.approx(np.nanmean(tile))
    assert found.z_height[0] == pytest.approx(height)
    assert found.z_shape[0] == pytest.approx(shape)


def test_without_a_change_both_are_standard_normal_whatever_the_noise():
    found = compare_heights(noise(4_000))
    for z in (found.z_height, found.z_shape):
        assert z.mean() == pytest.approx(0.0, abs=0.5)
        assert z.std() == pytest.approx(1.0, abs=0.08)
        assert np.mean(z > 3.0) < 0.006
    assert found.z_height.mean() == pytest.approx(0.0, abs=0.06)


def test_cells_are_means_of_the_pixels_that_are_seen():
    heights = np.random.default_rng(1).normal(size=(3, 6, 6))
    heights[0, :2, :2] = heights[1, 0, 0] = np.nan
    cells = coarsen(heights, 2)
    for tile in range(3):
        for row in range(3):
            for col in range(3):
                part = heights[tile, 2 * row : 2 * row + 2, 2 * col : 2 * col + 2]
                expected = np.nanmean(part) if np.isfinite(part).any() else np.nan
                assert cells[tile, row, col] == pytest.approx(expected, nan_ok=True)
    assert np.array_equal(coarsen(heights, 1), heights, equal_nan=True)


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

    before, after = bands(1.0), bands(1.02)
    z = ride_z(before, after, CommonError(shared, floor))
    assert z == pytest.approx(np.full(2, np.log(1.02) / (own * np.sqrt(2.0))), rel=0.05)
    assert (z > 1.5 * ride_z(before, after)).all()
