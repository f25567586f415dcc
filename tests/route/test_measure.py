"""What a way costs, against closed forms, shapely's lengths, and a measure in one piece."""

import math

import numpy as np
import pytest
import shapely
from tile_maps import TileMap

from bumpymap.core import Barred
from bumpymap.route import CostSettings, ground, measure
from bumpymap.route.ground import CostGround
from bumpymap.route.measure import measure_way

SIZE = 3.0


def random_map(rows=30, cols=40, seed=0):
    rng = np.random.default_rng(seed)
    return TileMap(rng.gamma(2.0, 0.1, (rows, cols)), p_fail=rng.random((rows, cols)) * 0.4)


def measured(site, corners, **settings):
    line = np.array([site.at(*corner) for corner in corners])
    return measure_way(CostGround(site, CostSettings(**settings), 10**6), line, line[[0, -1]])


def lengths_by_shapely(site, corners):
    """Length [m] of a line inside each tile, (rows, cols)."""
    rows, cols = site.c_r.shape
    row, col = np.mgrid[0:rows, 0:cols]
    line = shapely.LineString(np.array(corners)[:, ::-1])
    return shapely.length(shapely.intersection(line, shapely.box(col, row, col + 1, row + 1))) * SIZE


@pytest.mark.parametrize("seed", range(4))
def test_figures_are_sums_over_the_lengths_in_each_tile(seed):
    site = random_map(seed=seed)
    corners = np.random.default_rng(seed).uniform((1, 1), (29, 39), (5, 2))
    found = measured(site, corners).figures
    length = lengths_by_shapely(site, corners)
    hazard = -np.log1p(-site.p_fail.astype(float)) / 10.0
    assert found.length_m == pytest.approx(length.sum(), rel=1e-9)
    assert found.c_r_mean == pytest.approx((length * site.c_r).sum() / length.sum(), rel=1e-6)
    assert found.c_r_mean_low == pytest.approx(0.8 * found.c_r_mean, rel=1e-6)
    assert found.c_r_max == pytest.approx(site.c_r[length > 1e-9].max(), rel=1e-6)
    assert found.hazard == pytest.approx((length * hazard).sum(), rel=1e-6)
    assert found.p_arrives == pytest.approx(math.exp(-found.hazard))
    assert found.cost_m == pytest.approx((length * (1 + 5 * site.c_r + 300 * hazard)).sum(), rel=1e-6)
    assert found.seconds == pytest.approx(length.sum() / 2.0, rel=1e-9)
    assert found.straight_m == pytest.approx(math.dist(corners[0], corners[-1]) * SIZE, rel=1e-9)
    assert found.detour >= 1.0


def test_stretches_do_not_change_the_figures(monkeypatch):
    site = random_map(60, 300)
    corners = np.random.default_rng(1).uniform((1, 1), (59, 299), (6, 2))
    whole = measured(site, corners)
    site.windows.clear()
    for room in (measure, ground):
        monkeypatch.setattr(room, "_STRETCH_TILES", 7)
    parts = measured(site, corners)
    assert max(max(window.rows, window.cols) for window in site.windows) <= 11
    for name in parts.figures.__dataclass_fields__:
        assert getattr(parts.figures, name) == pytest.approx(getattr(whole.figures, name), rel=1e-9), name
    for name in parts.profile.__dataclass_fields__:
        np.testing.assert_allclose(getattr(parts.profile, name), getattr(whole.profile, name), rtol=1e-9, atol=1e-9)


def test_a_ramp_climbs_by_its_height_and_the_slope_has_the_sign_of_the_direction():
    slope = 0.05
    site = TileMap(np.full((10, 60), 0.1), height=lambda east, north: slope * (east - 160_000 * SIZE) + 0.0 * north)
    up = measured(site, [(5.5, 2.5), (5.5, 52.5)])
    down = measured(site, [(5.5, 52.5), (5.5, 2.5)])
    assert up.figures.climb_m == pytest.approx(150.0 * slope, abs=0.02)
    assert (up.figures.descent_m, down.figures.climb_m) == pytest.approx((0.0, 0.0), abs=1e-3)
    assert down.figures.descent_m == pytest.approx(up.figures.climb_m, abs=1e-3)
    angle = math.degrees(math.atan(slope))
    inner = slice(3, -3)
    np.testing.assert_allclose(up.profile.slope[inner], angle, atol=0.1)
    np.testing.assert_allclose(down.profile.slope[inner], -angle, atol=0.1)


def test_unknown_ground_has_a_length_and_no_ride():
    barred = np.zeros((4, 20), np.uint8)
    barred[:, 5:9] = Barred.UNKNOWN
    site = TileMap(np.full((4, 20), 0.2), barred)
    found = measured(site, [(1.5, 0.5), (1.5, 19.5)], unknown=10.0)
    figures = found.figures
    assert figures.unknown_m == pytest.approx(4 * SIZE)
    assert figures.c_r_mean == pytest.approx(0.2, rel=1e-6)
    assert figures.cost_m == pytest.approx(15 * SIZE * 2.0 + 4 * SIZE * 10.0, rel=1e-6)
    unknown = np.isnan(found.profile.c_r)
    np.testing.assert_allclose(found.profile.distance[unknown].min(), 4.5 * SIZE, atol=1.0)
    assert unknown.sum() == pytest.approx(4 * 3, abs=1)
