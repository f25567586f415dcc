import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from jitted_helpers import jitted

from bumpymap.core.config import FeatureSettings
from bumpymap.core.types import Reason
from bumpymap.patches.kernels.measure import measure_tiles, stray_bounds
from bumpytiles import Grid

STRAY_BOUNDS = jitted(stray_bounds)
EAST, NORTH = 500_001.0, 4_000_002.0  # south-west corner of a tile


def tile_points(seed=0, n=900, east=EAST, north=NORTH):
    rng = np.random.default_rng(seed)
    return east + rng.uniform(0, 3, n), north + rng.uniform(0, 3, n), rng


def only(values):
    assert len(values) == 1
    return values[0]


def test_statistics_of_every_tile_equal_numpys(measure_points):
    """For any number of points, so that whole lanes of the kernels and what is left of them are summed."""
    counts = [1, 2, 30, 63, 64, 65, 128, 777]
    col = np.repeat(np.arange(len(counts)), counts)
    x, y, rng = tile_points(1, n=len(col))
    z = 2500 + 0.3 * (x - EAST) + rng.normal(scale=0.02, size=len(x))
    stack = measure_points(x + 3 * col, y, z)
    assert stack.count.tolist() == counts
    for k, number in enumerate(counts):
        mine = z[col == k]
        assert stack.z_variance[k] == pytest.approx(np.var(mine), rel=1e-9, abs=1e-20)
        assert (stack.z_min[k], stack.z_max[k], stack.density[k]) == (mine.min(), mine.max(), number / 9)


def test_every_pixel_equals_brute_force_binning(measure_points):
    """North is up; the spread inside a pixel is about the plane of the tile."""
    x, y, rng = tile_points(2, n=400)
    z = 0.4 * (x - EAST) - 0.3 * (y - NORTH) + rng.uniform(-0.02, 0.02, 400)
    stack = measure_points(x, y, z)
    terms = np.stack([np.ones(400), x - EAST, y - NORTH], axis=1)
    away = z - terms @ np.linalg.lstsq(terms, z, rcond=None)[0]
    px, py = (np.floor(15 * axis / 3).astype(int) for axis in (x - EAST, y - NORTH))
    for r, c in np.ndindex(15, 15):
        mine = (px == c) & (py == 14 - r)
        assert stack.spread_count[0, r, c] == mine.sum()
        height, spread = (z[mine].mean(), away[mine].var()) if mine.any() else (np.nan, np.nan)
        assert stack.heights[0, r, c] == pytest.approx(height, rel=1e-6, abs=1e-6, nan_ok=True)
        assert stack.spread_variance[0, r, c] == pytest.approx(spread, rel=1e-3, abs=1e-9, nan_ok=True)
    assert stack.coverage[0] == np.count_nonzero(stack.spread_count[0]) / 225
    assert stack.z_range[0] == pytest.approx(np.nanmax(stack.heights[0]) - np.nanmin(stack.heights[0]), rel=1e-6)


def test_points_on_the_four_edges_of_a_tile(measure_points):
    x = [EAST, EAST, EAST + 3, EAST]
    y = [NORTH, NORTH + 1.5, NORTH, NORTH + 3]
    stack = measure_points(x, y, [1.0, 2.0, 3.0, 4.0])
    found = {(int(c), int(r)): int(n) for c, r, n in zip(stack.col, stack.row, stack.count, strict=True)}
    col, row = int(EAST // 3), int(NORTH // 3)
    assert found == {(col, row): 2, (col + 1, row): 1, (col, row + 1): 1}
    own = np.flatnonzero((stack.col == col) & (stack.row == row))[0]
    assert stack.spread_count[own, 14, 0] == 1
    assert stack.spread_count[own, 7, 0] == 1


def test_coordinates_of_four_million_metres_keep_millimetres(measure_points):
    # One point a pixel, one millimetre inside its west and south edge; another millimetre would be the next pixel.
    offset = np.arange(15) * 0.2 + 0.001
    x, y = (a.ravel() for a in np.meshgrid(3_999_999.0 + offset, 3_999_999.0 + offset))
    stack = measure_points(x, y, np.zeros(225))
    assert np.all(only(stack.spread_count) == 1)
    west = measure_points(x - 0.002, y, np.zeros(225))
    assert len(west.col) == 2


def test_an_exactly_flat_tile(measure_points):
    x, y, _ = tile_points(3)
    stack = measure_points(x, y, np.full(900, 1234.567))
    assert only(stack.reason) == Reason.OK
    assert only(stack.z_variance) == 0.0
    assert only(stack.ransac_residual) == pytest.approx(0.0, abs=1e-12)
    assert only(stack.slope) == pytest.approx(0.0, abs=1e-6)
    assert only(stack.relief) == 0.0
    assert np.all(stack.relief_map == 0.0)


def test_a_one_point_tile_is_unknown_but_measured(measure_points):
    stack = measure_points([EAST + 1], [NORTH + 1], [7.5])
    assert only(stack.reason) == Reason.TOO_FEW_POINTS
    assert (only(stack.z_min), only(stack.z_max), only(stack.z_variance)) == (7.5, 7.5, 0.0)
    assert np.isnan(only(stack.ransac_residual))
    assert np.isnan(only(stack.slope))
    assert np.isnan(only(stack.relief))
    assert np.all(np.isnan(stack.relief_map))
    assert only(stack.coverage) == 1 / 225


@pytest.mark.parametrize("strays", [[30.0], [-30.0], [1.0], [20.0, 21.0, 22.0, -5.0, -9.0]])
def test_stray_points_do_not_decide_the_relief(measure_points, strays):
    x, y, rng = tile_points(4)
    z = 0.01 * rng.normal(size=900)
    clean = measure_points(x, y, z)
    z[: len(strays)] += strays
    dirty = measure_points(x, y, z)
    assert only(dirty.reason) == Reason.OK
    assert only(dirty.spread_count).sum() == 900 - len(strays)
    assert only(dirty.relief) == pytest.approx(only(clean.relief), rel=0.2)
    # The statistics of the paper are those of all points.
    assert only(dirty.z_variance) == pytest.approx(np.var(z), rel=1e-9)
    assert only(dirty.z_max) - only(dirty.z_min) == pytest.approx(np.ptp(z), rel=1e-12)


def test_relief_that_rests_on_few_points_of_a_sparse_tile_is_unknown(measure_points):
    x, y, rng = tile_points(6, n=100)
    z = 0.01 * rng.normal(size=100)
    z[[1, 2]] += 3.0
    assert only(measure_points(x, y, z).reason) == Reason.OUTLIER_RELIEF


def test_a_kerb_a_rock_and_a_tree_are_relief_not_strays(measure_points):
    x, y, rng = tile_points(7)
    kerb = np.where(x > EAST + 1.5, 0.7, 0.0)
    rock = np.where(np.hypot(x - EAST - 1, y - NORTH - 1) < 0.3, 0.8, 0.0)
    tree = np.where(np.hypot(x - EAST - 2, y - NORTH - 2) < 0.8, rng.uniform(0, 6, 900), 0.0)
    for z in (kerb, rock, tree):
        stack = measure_points(x, y, z)
        assert only(stack.spread_count).sum() == 900
        assert only(stack.relief) > 0.3


def test_relief_does_not_see_a_plane(measure_points):
    x, y, _ = tile_points(8, n=4000)
    bumps = 0.05 * np.sin(4 * (x - EAST)) * np.cos(3 * (y - NORTH))
    level = measure_points(x, y, bumps)
    tilted = measure_points(x, y, bumps + 0.2 * (x - EAST) - 0.1 * (y - NORTH) + 1000)
    # A pixel's mean moves a little with the plane where its points are off its centre.
    np.testing.assert_allclose(tilted.relief_map, level.relief_map, atol=0.012)
    assert only(tilted.relief) == pytest.approx(only(level.relief), abs=0.015)


def test_holes_are_filled_from_their_neighbours_alone(measure_points):
    offset = (np.arange(15) + 0.5) * 0.2
    x, y = (a.ravel() for a in np.meshgrid(EAST + offset, NORTH + offset))
    z = 0.3 * (x - EAST)
    hole = (np.hypot(x - EAST - 1.5, y - NORTH - 1.5) < 0.7) & (x > 0)
    stack = measure_points(x[~hole], y[~hole], z[~hole])
    assert only(stack.reason) == Reason.OK
    assert np.isnan(stack.heights).sum() == hole.sum()
    assert only(stack.relief) == pytest.approx(0.0, abs=1e-6)


def test_a_hole_too_deep_is_unknown(measure_points):
    x, y, _ = tile_points(9)
    half = x < EAST + 1.4
    stack = measure_points(x[half], y[half], np.zeros(half.sum()))
    assert only(stack.reason) == Reason.TOO_MANY_HOLES
    assert only(stack.coverage) > 0.25
    tolerant = FeatureSettings(max_hole=2.0)
    assert only(measure_points(x[half], y[half], np.zeros(half.sum()), settings=tolerant).reason) == Reason.OK


def test_low_coverage_is_unknown(measure_points):
    # Plenty of points, all on a 4 x 4 lattice: 16 of 225 pixels.
    offset = np.repeat((np.arange(4) + 0.5) * 0.75, 16)
    x, y = EAST + offset, NORTH + np.tile(np.repeat((np.arange(4) + 0.5) * 0.75, 4), 4)
    z = np.random.default_rng(0).normal(scale=0.01, size=len(x))
    stack = measure_points(x, y, z)
    assert only(stack.count) == 64
    assert only(stack.reason) == Reason.TOO_MANY_HOLES


def test_ground_only_measures_flagged_points_and_says_where_there_are_none(measure_points):
    x, y, rng = tile_points(10)
    canopy = rng.random(900) < 0.4
    z = np.where(canopy, rng.uniform(2, 9, 900), 0.0)
    stack = measure_points(
        np.append(x, EAST + 4), np.append(y, NORTH), np.append(z, 5.0), np.append(~canopy, [False]), ground_only=True
    )
    assert stack.reason.tolist() == [Reason.OK, Reason.NO_GROUND]
    assert stack.count.tolist() == [np.count_nonzero(~canopy), 0]
    assert stack.relief[0] == 0.0
    assert np.isnan(stack.z_min[1])
    assert stack.coverage[1] == 0.0


@pytest.mark.parametrize(("angle", "sigma"), [(0.0, 0.005), (30.0, 0.03), (55.0, 0.005)])
def test_residual_and_slope_of_a_noisy_plane(measure_points, angle, sigma):
    x, y, rng = tile_points(11, n=3000)
    tilt = np.tan(np.radians(angle))
    z = tilt * (x - EAST) + sigma * rng.normal(size=3000) / np.cos(np.radians(angle))
    stack = measure_points(x, y, z)
    # Mean of |N(0, sigma)| across the plane.
    assert only(stack.ransac_residual) == pytest.approx(sigma * np.sqrt(2 / np.pi), rel=0.05)
    assert only(stack.slope) == pytest.approx(angle, abs=0.3)


def test_the_plane_ignores_outliers_and_the_residual_counts_them(measure_points):
    x, y, rng = tile_points(12, n=2000)
    z = 0.1 * (x - EAST) + 0.01 * rng.normal(size=2000)
    lifted = rng.random(2000) < 0.2
    z[lifted] += 1.0
    stack = measure_points(x, y, z)
    assert only(stack.slope) == pytest.approx(np.degrees(np.arctan(0.1)), abs=0.2)
    share = lifted.mean()
    expected = share * np.cos(np.arctan(0.1)) * 1.0 + (1 - share) * 0.01 * np.sqrt(2 / np.pi)
    assert only(stack.ransac_residual) == pytest.approx(expected, rel=0.03)


def test_points_on_a_line_span_no_plane(measure_points):
    x = EAST + np.linspace(0, 2.9, 200)
    stack = measure_points(x, np.full(200, NORTH + 1.0), 0.1 * (x - EAST))
    assert np.isnan(only(stack.ransac_residual))
    assert only(stack.reason) == Reason.TOO_MANY_HOLES


def test_a_wall_is_a_steep_plane(measure_points):
    rng = np.random.default_rng(13)
    y, z = NORTH + rng.uniform(0, 3, 800), rng.uniform(0, 3, 800)
    stack = measure_points(np.full(800, EAST + 1.0) + 0.002 * rng.normal(size=800), y, z)
    assert only(stack.slope) == pytest.approx(90.0, abs=1.0)
    assert only(stack.ransac_residual) < 0.005


def test_other_tile_sizes_and_pixels(measure_points):
    x, y, rng = tile_points(14, n=4000)
    stack = measure_points(x, y, rng.normal(size=4000), grid=Grid(1.5, 30))
    assert len(stack.col) == 4
    assert stack.heights.shape == (4, 30, 30)
    assert np.all(stack.density == stack.count / 2.25)


@settings(max_examples=100)
@given(st.integers(0, 2**32 - 1), st.integers(0, 4), st.sampled_from([1e-3, 0.1, 1.0, 5.0]))
def test_strays_equal_those_of_the_definition(seed, most, spread):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2 * most + 2, 300))
    distance = rng.normal(scale=spread, size=n)
    lifted = rng.integers(0, n, rng.integers(0, 2 * most + 2))
    distance[lifted] += rng.uniform(-30, 30, len(lifted))
    low, high, strays = STRAY_BOUNDS(distance, 0.5, most, np.empty((2, most + 1)))
    kept = (distance >= low) & (distance <= high)
    rank = np.sort(distance)
    fits = {(0, 0)}
    for above in range(most + 1):
        for below in range(most + 1):
            stay = rank[below : n - above]
            need = max(0.5, np.ptp(stay))
            clear_above = above == 0 or rank[n - above] - stay[-1] > need
            clear_below = below == 0 or stay[0] - rank[below - 1] > need
            if clear_above and clear_below:
                fits.add((above, below))
    assert strays == np.count_nonzero(~kept) == max(map(sum, fits))
    assert (np.count_nonzero(distance > high), np.count_nonzero(distance < low)) in fits


def test_tiles_are_measured_alike_in_any_company(measure_points):
    x, y, rng = tile_points(20, n=6000)
    x = x + 3 * rng.integers(0, 6, 6000)
    z = rng.normal(scale=0.2, size=6000)
    whole = measure_points(x, y, z)
    for k, col in enumerate(whole.col):
        mine = np.floor(x / 3) == col
        alone = measure_points(x[mine], y[mine], z[mine])
        for name in ("z_variance", "ransac_residual", "slope", "z_range", "relief", "heights", "relief_map"):
            np.testing.assert_array_equal(getattr(alone, name)[0], getattr(whole, name)[k])


def test_compiled_kernels_and_plain_python_agree(measure_points, monkeypatch):
    x, y, rng = tile_points(21, n=120)
    z = 0.2 * (x - EAST) + 0.05 * rng.normal(size=120)
    z[5] += 9.0
    compiled = measure_points(x, y, z)
    monkeypatch.setattr("bumpymap.patches.features.measure_tiles", measure_tiles.plain)
    with np.errstate(all="ignore"):
        plain = measure_points(x, y, z)
    for name in ("z_variance", "ransac_residual", "slope", "z_range", "relief", "heights", "relief_map"):
        np.testing.assert_allclose(getattr(plain, name), getattr(compiled, name), rtol=1e-6, atol=1e-9)
    np.testing.assert_array_equal(plain.spread_count, compiled.spread_count)
