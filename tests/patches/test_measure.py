"""Measures of tiles against numpy, scipy, scikit-learn and open3d: dense and thin ones, their planes, their pixels."""

import itertools
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import laspy
import numpy as np
import pytest
from cost_maps import block_of, joined_in_order
from hypothesis import given, settings, strategies as st
from scipy.stats import binned_statistic_2d
from sklearn.linear_model import RANSACRegressor

from bumpymap.core import POINT_GROUND, POINT_OTHER, SEEN, FeatureSettings, Reason, loops
from bumpymap.core.types import OBSTACLE, POINT_DECK, UNDECIDED, VehicleBody
from bumpymap.patches import decks_as_ground, find_objects, measure, measure_thin
from bumpymap.readers import ReadOptions, open_survey
from bumpytiles import Grid, TileBuckets, photo_of

EAST, NORTH = 500_001.0, 4_000_002.0  # south-west corner of a tile


def tile_points(seed, n=900):
    rng = np.random.default_rng(seed)
    return EAST + rng.uniform(0, 3, n), NORTH + rng.uniform(0, 3, n), rng


def only(values):
    assert len(values) == 1
    return values[0]


def test_statistics_of_every_tile_equal_numpys(measure_points):
    """For any number of points, so that whole lanes of the loops and what is left of them are summed."""
    counts = [1, 2, 30, 63, 64, 65, 128, 777]
    col = np.repeat(np.arange(len(counts)), counts)
    x, y, rng = tile_points(1, n=len(col))
    z = np.round(2500 + 0.3 * (x - EAST) + rng.normal(scale=0.02, size=len(x)), 8)  # all decimals that are read
    stack = measure_points(x + 3 * col, y, z)
    assert stack.count.tolist() == counts
    for k, number in enumerate(counts):
        mine = z[col == k]
        assert stack.z_variance[k] == pytest.approx(np.var(mine), rel=1e-9, abs=1e-20)
        assert (stack.z_min[k], stack.z_max[k], stack.density[k]) == (mine.min(), mine.max(), number / 9)


def test_every_pixel_equals_the_bins_of_scipy(measure_points):
    """North is up; the spread inside a pixel is about the plane of the tile."""
    x, y, rng = tile_points(2, n=400)
    z = 0.4 * (x - EAST) - 0.3 * (y - NORTH) + rng.uniform(-0.002, 0.002, 400)
    stack = measure_points(x, y, z)
    terms = np.stack([np.ones(400), x - EAST, y - NORTH], axis=1)
    away = z - terms @ np.linalg.lstsq(terms, z, rcond=None)[0]
    edges = [NORTH + np.linspace(0, 3, 16), EAST + np.linspace(0, 3, 16)]
    count, height, spread = (
        binned_statistic_2d(y, x, values, how, edges).statistic[::-1]
        for values, how in ((z, "count"), (z, "mean"), (away, lambda mine: np.var(mine) if len(mine) else np.nan))
    )
    np.testing.assert_array_equal(stack.spread_count[0], count)
    np.testing.assert_allclose(stack.heights[0], height, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(stack.spread_variance[0], spread, rtol=1e-3, atol=1e-11)
    assert stack.coverage[0] == np.mean(count > 0)
    assert stack.z_range[0] == pytest.approx(np.nanmax(height) - np.nanmin(height), rel=1e-6)


def test_an_exactly_flat_tile_and_one_of_a_single_point(measure_points):
    x, y, _ = tile_points(3)
    stack = measure_points(x, y, np.full(900, 1234.567))
    assert only(stack.reason) == Reason.OK
    assert only(stack.z_variance) == 0.0
    assert only(stack.ransac_residual) == pytest.approx(0.0, abs=1e-12)
    assert only(stack.slope) == pytest.approx(0.0, abs=1e-6)
    assert only(stack.relief) == 0.0
    assert np.all(stack.relief_map == 0.0)
    stack = measure_points([EAST + 1], [NORTH + 1], [7.5])
    assert only(stack.reason) == Reason.TOO_FEW_POINTS
    assert (only(stack.z_min), only(stack.z_max), only(stack.z_variance)) == (7.5, 7.5, 0.0)
    assert np.isnan([only(stack.ransac_residual), only(stack.slope), only(stack.relief)]).all()
    assert np.all(np.isnan(stack.relief_map))
    assert only(stack.coverage) == 1 / 225


@pytest.mark.parametrize("strays", [[30.0], [-30.0], [1.0], [20.0, 21.0, 22.0, -5.0, -9.0]])
def test_stray_points_do_not_decide_the_relief(measure_points, strays):
    x, y, rng = tile_points(4)
    z = np.round(0.01 * rng.normal(size=900), 8)
    clean = measure_points(x, y, z)
    z[: len(strays)] += strays
    dirty = measure_points(x, y, z)
    assert only(dirty.reason) == Reason.OK
    assert only(dirty.spread_count).sum() == 900 - len(strays)
    assert only(dirty.relief) == pytest.approx(only(clean.relief), rel=0.2)
    # The statistics of the paper are those of all points.
    assert only(dirty.z_variance) == pytest.approx(np.var(z), rel=1e-9)
    assert only(dirty.z_max) - only(dirty.z_min) == pytest.approx(np.ptp(z), rel=1e-12)
    sparse = 0.01 * rng.normal(size=100) + 3.0 * (np.arange(100) < 2)
    assert only(measure_points(x[:100], y[:100], sparse).reason) == Reason.OUTLIER_RELIEF  # it rests on few points


def test_a_kerb_a_rock_and_a_tree_are_relief_not_strays_and_a_wall_is_a_steep_plane(measure_points):
    x, y, rng = tile_points(7)
    kerb = np.where(x > EAST + 1.5, 0.7, 0.0)
    rock = np.where(np.hypot(x - EAST - 1, y - NORTH - 1) < 0.3, 0.8, 0.0)
    tree = np.where(np.hypot(x - EAST - 2, y - NORTH - 2) < 0.8, rng.uniform(0, 6, 900), 0.0)
    for z in (kerb, rock, tree):
        stack = measure_points(x, y, z)
        assert only(stack.spread_count).sum() == 900
        assert only(stack.relief) > 0.3
    stack = measure_points(EAST + 1.0 + 0.002 * rng.normal(size=900), y, rng.uniform(0, 3, 900))
    assert only(stack.slope) == pytest.approx(90.0, abs=1.0)
    assert only(stack.ransac_residual) < 0.005


def test_relief_does_not_see_a_plane_and_fills_holes_from_their_neighbours_alone(measure_points):
    x, y, _ = tile_points(8, n=4000)
    bumps = 0.05 * np.sin(4 * (x - EAST)) * np.cos(3 * (y - NORTH))
    level = measure_points(x, y, bumps)
    tilted = measure_points(x, y, bumps + 0.2 * (x - EAST) - 0.1 * (y - NORTH) + 1000)
    # A pixel's mean moves a little with the plane where its points are off its centre.
    np.testing.assert_allclose(tilted.relief_map, level.relief_map, atol=0.012)
    assert only(tilted.relief) == pytest.approx(only(level.relief), abs=0.015)
    x, y = (axis.ravel() for axis in np.meshgrid(*2 * [(np.arange(15) + 0.5) * 0.2]))
    hole = np.hypot(x - 1.5, y - 1.5) < 0.7
    stack = measure_points(EAST + x[~hole], NORTH + y[~hole], 0.3 * x[~hole])
    assert only(stack.reason) == Reason.OK
    assert np.isnan(stack.heights).sum() == hole.sum()
    assert only(stack.relief) == pytest.approx(0.0, abs=1e-6)


def test_a_hole_too_deep_low_coverage_and_points_on_a_line_are_unknown(measure_points):
    x, y, _ = tile_points(9)
    half = x < EAST + 1.4
    stack = measure_points(x[half], y[half], np.zeros(half.sum()))
    assert only(stack.reason) == Reason.TOO_MANY_HOLES
    assert only(stack.coverage) > 0.25
    tolerant = FeatureSettings(max_hole=2.0)
    assert only(measure_points(x[half], y[half], np.zeros(half.sum()), settings=tolerant).reason) == Reason.OK
    # Plenty of points, all on a 4 x 4 lattice: 16 of 225 pixels.
    x, y = (np.repeat(axis.ravel(), 4) for axis in np.meshgrid(*2 * [(np.arange(4) + 0.5) * 0.75]))
    lattice = measure_points(EAST + x, NORTH + y, np.random.default_rng(0).normal(scale=0.01, size=64))
    x = EAST + np.linspace(0, 2.9, 200)
    line = measure_points(x, np.full(200, NORTH + 1.0), 0.1 * (x - EAST))
    assert only(lattice.reason) == only(line.reason) == Reason.TOO_MANY_HOLES
    assert np.isnan(only(line.ransac_residual))


def test_ground_only_measures_flagged_points_and_says_where_there_are_none(measure_points):
    x, y, rng = tile_points(10)
    ground = np.append(rng.random(900) < 0.6, [False])
    x, y, z = np.append(x, EAST + 4), np.append(y, NORTH), np.where(ground, 0.0, rng.uniform(2, 9, 901))
    stack = measure_points(x, y, z, ground, ground_only=True)
    assert stack.reason.tolist() == [Reason.OK, Reason.NO_GROUND]
    assert stack.count.tolist() == [np.count_nonzero(ground), 0]
    assert stack.relief[0] == 0.0
    assert np.isnan(stack.z_min[1])
    assert stack.coverage[1] == 0.0


@pytest.mark.parametrize(("angle", "sigma"), [(0.0, 0.005), (30.0, 0.03), (55.0, 0.005)])
def test_residual_and_slope_of_a_noisy_plane(measure_points, angle, sigma):
    """The plane ignores outliers, and the residual counts them."""
    x, y, rng = tile_points(11, n=3000)
    flat = np.cos(np.radians(angle))
    z = np.tan(np.radians(angle)) * (x - EAST) + sigma * rng.normal(size=3000) / flat
    lifted = rng.random(3000) < 0.2
    mean = sigma * np.sqrt(2 / np.pi)  # of |N(0, sigma)| across the plane
    for height in (0.0, 1.0):
        stack = measure_points(x, y, z + height * lifted)
        share = lifted.mean() * (height > 0)
        assert only(stack.ransac_residual) == pytest.approx(share * flat * height + (1 - share) * mean, rel=0.05)
        assert only(stack.slope) == pytest.approx(angle, abs=0.3)


@given(st.integers(0, 2**32 - 1), st.integers(0, 4), st.sampled_from([1e-3, 0.1, 1.0, 5.0]))
def test_strays_equal_those_of_the_definition(seed, most, spread):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2 * most + 2, 300))
    distance = rng.normal(scale=spread, size=n)
    lifted = rng.integers(0, n, rng.integers(0, 2 * most + 2))
    distance[lifted] += rng.uniform(-30, 30, len(lifted))
    low, high, strays = loops.stray_bounds(distance, 0.5, most)
    rank, fits = np.concatenate([[-np.inf], np.sort(distance), [np.inf]]), {(0, 0)}
    for above, below in itertools.product(range(most + 1), repeat=2):
        stay = rank[below + 1 : n - above + 1]
        need = max(0.5, np.ptp(stay))
        if rank[n - above + 1] - stay[-1] > need < stay[0] - rank[below]:
            fits.add((above, below))
    found = np.count_nonzero(distance > high), np.count_nonzero(distance < low)
    assert found in fits
    assert strays == sum(found) == max(map(sum, fits))


@pytest.mark.parametrize("part", ["half", "corner"])
def test_slope_beside_a_thing_is_that_of_the_ground(measure_points, part):
    x, y = np.add(np.random.default_rng(1).uniform(0, 18, (2, 26_000)), [[EAST], [NORTH]])
    on_it = (x % 3 > 1.6) & ((y % 3 > 1.0) | (part == "half"))
    stack = measure_points(x, y, np.round(0.2 * (x - EAST), 3) + 1.5 * on_it)
    np.testing.assert_allclose(stack.slope, np.degrees(np.arctan(0.2)), atol=0.1)


# ---- thin tiles ----

SETTINGS = FeatureSettings()
CLOSE = 0.2


def thin_of(points, *, ground_only=False):
    """Pairs and filled heightmaps."""
    patches = measure(points, SETTINGS, ground_only=ground_only)
    return measure_thin(points, patches, SETTINGS, ground_only=ground_only)


def test_pairs_of_points_are_those_of_numpy():
    rng = np.random.default_rng(3)
    x, y = rng.uniform(0, 3, 80), rng.uniform(0, 6, 80)
    points = block_of(600_000 + x, 3_999_999 + y, 900 + 0.2 * x + rng.normal(0, 0.1, 80))
    pairs, _ = thin_of(points)
    for tile, (first, end) in enumerate(itertools.pairwise(points.starts)):
        x, y, z = (axis[first:end] for axis in (points.easting - 600_000, points.northing - 4_000_000, points.upward))
        plane = np.column_stack((x, y, np.ones(len(x))))
        slope, *_ = np.linalg.lstsq(plane, z - 900, rcond=None)
        h = z - 900 - plane @ slope
        i, j = np.triu_indices(len(x), 1)
        close = np.hypot(x[i] - x[j], y[i] - y[j]) < CLOSE
        mine = [np.hypot(*slope[:2]), ((h[i] - h[j]) ** 2)[close].sum(), close.sum()]
        np.testing.assert_allclose(pairs[tile, 2:], mine, rtol=1e-6)
        assert pairs[tile, 0] == end - first > 20


def test_heightmaps_of_thin_tiles_are_filled_and_dense_ones_left_out():
    rng = np.random.default_rng(5)
    x = np.concatenate((600_000 + rng.uniform(0, 3, 16), 600_003 + rng.uniform(0, 3, 2000)))
    y, z = 3_999_999 + rng.uniform(0, 3, len(x)), rng.normal(0, 0.05, len(x))
    pairs, (relief, count, variance) = thin_of(block_of(x, y, z))
    assert np.isfinite(relief[0]).all()
    assert np.isnan(relief[1]).all()
    assert count.sum(axis=(1, 2)).tolist() == [16, 0]
    assert (variance[count == 1] == 0.0).all()
    assert pairs[1, 3:].sum() > 0  # its pairs still tell the noise


def test_neither_stray_points_nor_those_that_are_no_ground_are_measured():
    rng = np.random.default_rng(6)
    x, y = 600_000 + rng.uniform(0, 3, 60), 3_999_999 + rng.uniform(0, 3, 60)
    ground = np.arange(60) % 2 == 0
    z = np.where(ground, rng.normal(0, 0.02, 60), rng.uniform(1, 9, 60))
    alone = thin_of(block_of(x[ground], y[ground], z[ground]))[0]
    np.testing.assert_allclose(thin_of(block_of(x, y, z, ground), ground_only=True)[0], alone, rtol=1e-9)
    stray = block_of(np.append(x[ground], 600_001.5), np.append(y[ground], 4_000_000.5), np.append(z[ground], 25.0))
    np.testing.assert_allclose(thin_of(stray)[0], alone, rtol=1e-6)
    line = block_of(600_000 + np.linspace(0.1, 2.9, 20), np.full(20, 4_000_000.5), np.zeros(20))
    assert np.isnan(thin_of(line)[0]).all()  # points on a line span no plane


@pytest.mark.parametrize(
    ("width", "height", "rim", "count", "seen"),
    [
        (3.0, 3.0, 0.0, 60, 1.0),
        (1.9, 3.0, 0.0, 60, 6 / 9),
        (0.9, 3.0, 0.0, 60, 0.0),
        (1.4, 1.4, 0.0, 40, 4 / 9),
        (3.0, 3.0, 1.2, 500, 0.0),  # a pond is a hole where points are many
        (3.0, 3.0, 1.2, 40, 8 / 9),
    ],
)
def test_share_that_is_seen_tells_a_hole(width, height, rim, count, seen):
    rng = np.random.default_rng(4)
    x, y = rng.uniform(0, [[width], [height]], (2, 8 * count))
    dry = np.flatnonzero(np.maximum(abs(x - 1.5), abs(y - 1.5)) > rim)[:count]
    block = block_of(600_000 + x[dry], 3_999_999 + y[dry], rng.normal(0, 0.01, count))
    assert thin_of(block)[0][0, 1] == pytest.approx(seen)


# ---- ransac_residual against two other implementations, on the sample survey and on a real one ----


def by_sklearn(points):
    fit = RANSACRegressor(residual_threshold=0.1, random_state=0, max_trials=1000).fit(points[:, :2], points[:, 2])
    return np.array([*fit.estimator_.coef_, -1.0, fit.estimator_.intercept_])


def by_open3d(points):
    import open3d

    open3d.utility.random.seed(0)
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    return cloud.segment_plane(0.1, 3, 1000, probability=1.0)[0]


@pytest.mark.parametrize("oracle", [by_sklearn, pytest.param(by_open3d, marks=pytest.mark.open3d)])
@pytest.mark.parametrize("survey", ["quarry.laz", pytest.param("godie_espacio.laz", marks=pytest.mark.realdata)])
def test_residuals_of_whole_surveys_agree_in_the_median(survey, oracle, measure_points, request):
    """Of some dense tiles from the middle."""
    place = Path(__file__).resolve().parents[2] / "sample_data"
    if survey != "quarry.laz":
        place = request.getfixturevalue("shared_data") / "surveys"
    points = laspy.read(place / survey).xyz
    x, y, z = points[np.all(abs(points - np.median(points, axis=0))[:, :2] < 36, axis=1)].T
    stack, ratio = measure_points(x, y, z), []
    for k in np.random.default_rng(0).choice(np.flatnonzero(stack.count > 200), 30, replace=False):
        west, south = 3 * stack.col[k], 3 * stack.row[k]
        mine = (np.floor(x / 3) * 3 == west) & (np.floor(y / 3) * 3 == south)
        points = np.column_stack((x[mine] - west, y[mine] - south, z[mine] - z[mine].mean()))
        plane = oracle(points)
        ratio.append(stack.ransac_residual[k] / np.mean(abs(points @ plane[:3] + plane[3]) / np.linalg.norm(plane[:3])))
    assert np.median(ratio) == pytest.approx(1.0, abs=0.05)
    assert np.median(np.abs(np.array(ratio) - 1.0)) < 0.05


# ---- points of files whose grid has borders of pixels on it, against exact integers: pixels are half-open ----


UNITS = {"m": Fraction(1), "ft": Fraction(381, 1250), "us-ft": Fraction(1200, 3937)}
SCALES, OFFSETS = ("0.001", "0.01", "0.0001"), ("0", "500000", "313700.5", "-1234.56")
GRIDS = {"3": Grid(), "1.5": Grid(1.5, 30), "1.1": Grid(1.1, 11)}
DENSE = 3000


def write(path, numbers, scale, offsets, heights, **columns):
    """A LAS file of the integers of x and y, (2, n)."""
    header = laspy.LasHeader(version="1.4", point_format=7)
    header.scales, header.offsets = [float(scale)] * 2 + [0.001], [float(offset) for offset in (*offsets, 0)]
    las = laspy.LasData(header)
    las.X, las.Y = numbers
    las.z = heights
    for name, values in columns.items():
        las[name] = values
    las.write(path)
    return path


def exact(numbers, scale, offset, unit, side, pixels):
    """Number of the pixel of each integer along an axis, counted from the origin."""
    factor, shift = (UNITS[unit] * Fraction(number) * pixels / Fraction(side) for number in (scale, offset))
    below = factor.denominator * shift.denominator
    up, start = int(factor * below), int(shift * below)
    return np.array([(number * up + start) // below for number in numbers.tolist()])


def numbers_around(rng, place, scale, offset, unit, count=DENSE):
    """Integers of coordinates within 6 m around a place [m], at least half of them on the 5 cm nearest to a border."""
    step = float(Fraction(scale) * UNITS[unit])
    wanted = place + rng.uniform(0, 6, count)
    wanted[::2] = np.round(wanted[::2] / 0.1) * 0.1
    return np.round((wanted - float(Fraction(offset) * UNITS[unit])) / step).astype(np.int64)


def blocks_of(path, unit, grid):
    reader = open_survey(path, ReadOptions(xy_unit=None if unit == "m" else unit, z_unit="m", colour=True))
    buckets = TileBuckets(grid)
    for chunk in reader.chunks():
        buckets.add_chunk(reader.convert(chunk, reader.fetch(chunk)).grouped(grid))
    return list(buckets.blocks())


def maps_of(stack):
    """Number of points and mean height of every pixel that has points, by row (from the south) and column."""
    t, north, col = np.nonzero(stack.spread_count)
    px = stack.grid.pixels
    keys = np.stack([stack.row[t] * px + px - 1 - north, stack.col[t] * px + col], axis=1).tolist()
    held = zip(stack.spread_count[t, north, col], stack.heights[t, north, col], strict=True)
    return dict(zip(map(tuple, keys), held, strict=True))


@settings(max_examples=15)
@given(
    st.integers(0, 1 << 30),
    st.sampled_from(SCALES),
    st.tuples(st.sampled_from(OFFSETS), st.sampled_from(OFFSETS)),
    st.sampled_from(list(UNITS)),
    st.tuples(*2 * [st.integers(-7_000_000, 7_000_000)]),
    st.sampled_from(list(GRIDS)),
)
def test_every_pixel_holds_the_points_that_exact_arithmetic_gives_it(
    tmp_path_factory, seed, scale, offsets, unit, place, side
):
    """Whatever scale, offset and unit a file has, whatever the sign of its coordinates."""
    rng, grid = np.random.default_rng(seed), GRIDS[side]
    reach = 0.9 * 2**31 * float(Fraction(scale) * UNITS[unit])
    middle = [float(Fraction(offset) * UNITS[unit]) for offset in offsets]
    place = [min(max(at, own - reach), own + reach) for at, own in zip(place, middle, strict=True)]
    numbers = [numbers_around(rng, at, scale, offset, unit) for at, offset in zip(place, offsets, strict=True)]
    # No two points at one place: of twins, one counts.
    numbers = np.unique(np.array(numbers), axis=1)
    heights = rng.integers(0, 100, numbers.shape[1]) / 1000
    path = write(tmp_path_factory.mktemp("pixels") / "a.las", numbers, scale, offsets, heights)
    stack = joined_in_order(measure(b, FeatureSettings(), ground_only=False) for b in blocks_of(path, unit, grid))
    col, row = (
        exact(axis, scale, offset, unit, side, grid.pixels) for axis, offset in zip(numbers, offsets, strict=True)
    )
    places, at, count = np.unique(np.stack([row, col]), axis=1, return_inverse=True, return_counts=True)
    found = sorted(maps_of(stack).items())
    assert [key for key, _ in found] == list(map(tuple, places.T.tolist()))
    assert [own for _, (own, _) in found] == count.tolist()
    np.testing.assert_allclose([own for _, (_, own) in found], np.bincount(at.ravel(), heights) / count, atol=1e-6)


def test_objects_decks_and_photos_have_the_pixels_of_the_heights(tmp_path):
    """On a grid of centimetres far from the origin, where 15 * (x - west) / 3 falls to either side of a border."""
    rng, corner = np.random.default_rng(4), (413_700, 5_403_200)
    numbers = np.unique(rng.integers(0, 60, (2, 4000)) * 5, axis=1)
    kind = rng.choice([POINT_GROUND, POINT_OTHER], numbers.shape[1], p=[0.9, 0.1]).astype(np.uint8)
    z, white = 1.0 * (kind == POINT_OTHER), np.where(kind == POINT_OTHER, 255, 0)
    path = write(tmp_path / "a.las", numbers, "0.01", corner, z, red=white << 8, green=white << 8, blue=white << 8)
    body = VehicleBody(clearance_m=0.25, height_m=1.4, width_m=1.4, brush_stem_m=0.25)
    raised = 0
    for block in blocks_of(path, "m", Grid()):
        of_tile = np.repeat(np.arange(len(block.col)), np.diff(block.starts))
        x, y = (np.round(axis * 100).astype(np.int64) // 20 for axis in (block.easting, block.northing))
        place = of_tile, 14 - y % 15, x % 15
        is_raised = block.upward > 0.5
        expected = np.zeros((len(block.col), 15, 15), bool)
        expected[tuple(axis[is_raised] for axis in place)] = True
        assert np.array_equal(photo_of(block).any(axis=-1), expected)
        marked = replace(block, flag=np.where(is_raised, POINT_OTHER, POINT_GROUND).astype(np.uint8))
        states = find_objects(marked, measure(marked, FeatureSettings(), ground_only=True), body).objects % SEEN
        assert np.array_equal((states == OBSTACLE) | (states == UNDECIDED), expected)
        decks = decks_as_ground(replace(block, flag=np.where(is_raised, POINT_DECK, POINT_GROUND).astype(np.uint8)))
        assert np.array_equal(decks.flag == POINT_OTHER, expected[place] & ~is_raised)
        raised += expected.sum()
    assert raised > 100
