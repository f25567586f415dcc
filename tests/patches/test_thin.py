"""Measures of thinly surveyed tiles, against the same in plain numpy."""

import numpy as np
import pytest

from bumpymap.core.config import FeatureSettings
from bumpymap.patches import measure, measure_thin
from bumpytiles import Grid, TileBuckets

SETTINGS = FeatureSettings()
REACH = np.array([1.0, 2.0, 3.5, 5.5, 8.0]) * 0.2


def block_of(x, y, z, flag=None):
    buckets = TileBuckets(Grid(3.0, 15))
    buckets.add(x, y, z, np.zeros(len(x), np.bool_) if flag is None else flag)
    (points,) = buckets.blocks()
    return points


def thin_of(points, *, ground_only=False):
    """Pairs and filled heightmaps."""
    patches = measure(points, SETTINGS, ground_only=ground_only)
    return measure_thin(points, patches, SETTINGS, ground_only=ground_only)


def plain_pairs(x, y, z):
    """The measures of one tile without strays, by numpy."""
    plane = np.column_stack((x, y, np.ones(len(x))))
    slope, *_ = np.linalg.lstsq(plane, z, rcond=None)
    h = z - plane @ slope
    i, j = np.triu_indices(len(x), 1)
    group = np.searchsorted(REACH, np.hypot(x[i] - x[j], y[i] - y[j]), side="right")
    spread = np.sqrt((h**2).sum() / (len(x) - 3))
    squares = [((h[i] - h[j]) ** 2)[group == k].sum() for k in range(5)]
    return [spread, np.abs(h).mean() / spread, np.hypot(*slope[:2]), *squares, *np.bincount(group, minlength=6)[:5]]


def test_pairs_of_points_are_those_of_numpy():
    rng = np.random.default_rng(3)
    x, y = 600_000 + rng.uniform(0, 3, 40), 4_000_001.0 - 1 + rng.uniform(2, 5, 40)
    z = 900 + 0.2 * (x - 600_000) + rng.normal(0, 0.1, 40)
    points = block_of(x, y, z)
    found = thin_of(points)
    for tile in range(len(points.col)):
        own = slice(points.starts[tile], points.starts[tile + 1])
        if own.stop - own.start < 8:
            continue
        mine = plain_pairs(points.easting[own] - 600_000, points.northing[own] - 4_000_000, points.upward[own] - 900)
        np.testing.assert_allclose(found[0][tile, 2:], mine, rtol=1e-6)
        assert found[0][tile, 0] == own.stop - own.start


@pytest.mark.parametrize(
    ("width", "height", "seen"),
    [(3.0, 3.0, 1.0), (1.9, 3.0, 6 / 9), (0.9, 3.0, 0.0), (1.4, 1.4, 4 / 9)],
    ids=["all", "two thirds", "a third", "a corner"],
)
def test_share_that_is_seen_tells_a_hole(width, height, seen):
    rng = np.random.default_rng(4)
    x, y = 600_000 + rng.uniform(0, width, 60), 3_999_999 + rng.uniform(0, height, 60)
    points = block_of(x, y, rng.normal(0, 0.01, 60))
    assert thin_of(points)[0][0, 1] == pytest.approx(seen)


def test_heightmaps_of_thin_tiles_are_filled_and_dense_ones_left_out():
    rng = np.random.default_rng(5)
    x = np.concatenate((600_000 + rng.uniform(0, 3, 16), 600_003 + rng.uniform(0, 3, 2000)))
    y, z = 3_999_999 + rng.uniform(0, 3, len(x)), rng.normal(0, 0.05, len(x))
    thin = thin_of(block_of(x, y, z))
    assert np.isfinite(thin[1][0]).all()
    assert np.isnan(thin[1][1]).all()
    assert thin[0][1, 5:].sum() > 0  # its pairs still tell the noise


def test_stray_point_is_not_measured():
    rng = np.random.default_rng(6)
    x, y = 600_000 + rng.uniform(0, 3, 30), 3_999_999 + rng.uniform(0, 3, 30)
    z = rng.normal(0, 0.02, 30)
    plain = thin_of(block_of(x, y, z))[0][0]
    x, y, z = np.append(x, 600_001.5), np.append(y, 4_000_000.5), np.append(z, 25.0)
    stray = thin_of(block_of(x, y, z))[0][0]
    np.testing.assert_allclose(stray, plain, rtol=1e-6)


def test_points_that_are_no_ground_do_not_count():
    rng = np.random.default_rng(7)
    x, y = 600_000 + rng.uniform(0, 3, 60), 3_999_999 + rng.uniform(0, 3, 60)
    ground = np.arange(60) % 2 == 0
    z = np.where(ground, rng.normal(0, 0.02, 60), rng.uniform(1, 9, 60))
    mixed = thin_of(block_of(x, y, z, ground), ground_only=True)
    alone = thin_of(block_of(x[ground], y[ground], z[ground]))
    np.testing.assert_allclose(mixed[0][0, :2], alone[0][0, :2])
    np.testing.assert_allclose(mixed[0][0, 2:], alone[0][0, 2:], rtol=1e-9)


def test_points_on_a_line_span_no_plane():
    x = 600_000 + np.linspace(0.1, 2.9, 20)
    assert np.isnan(thin_of(block_of(x, np.full(20, 4_000_000.5), np.zeros(20)))[0]).all()


@pytest.mark.parametrize(("points", "seen"), [(500, 0.0), (40, 8 / 9)])
def test_a_pond_is_a_hole_where_points_are_many(points, seen):
    rng = np.random.default_rng(8)
    x, y = rng.uniform(0, 3, (2, 8 * points))
    dry = (np.abs(x - 1.5) > 1.2) | (np.abs(y - 1.5) > 1.2)  # ground at the rim of the tile only
    x, y = x[dry][:points], y[dry][:points]
    block = block_of(x, y, rng.normal(0, 0.01, points))
    assert measure(block, SETTINGS, ground_only=False).reason.tolist() == [3]
    assert thin_of(block)[0][0, 1] == pytest.approx(seen)
