"""Where walls, ridges, ditches and ramps are steps of the ground, and what a step does to the rating of tiles."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage
from scipy.stats import binned_statistic_2d
from walls import PIXELS, TILE_SIZE, Wall, crossed, mosaic

from bumpymap.core import BadInputError, loops
from bumpymap.rating import Calibration, apply_steps, closing_height, crossing_fails, edge_usable, find_steps
from bumpymap.rating.steps import STEP_COLUMNS

NORTH, EAST, SOUTH, WEST = range(4)
RNG = np.random.default_rng(7)
PLACES = [(*RNG.uniform(4.5, 7.5, 2), RNG.uniform(0, 360)) for _ in range(25)]
SHIPPED = Calibration.shipped("warthog")


def highest(steps):
    return np.fmax(steps.inner, steps.edge_step)


@pytest.mark.parametrize("height", [0.05, -0.4, 2.0])
def test_a_wall_at_any_place_and_angle_is_measured_in_full(height):
    for place in PLACES:
        wall = Wall(height, *place)
        tiles = crossed(wall, 4)
        assert tiles.any()
        found = highest(find_steps(mosaic(wall, 4), PIXELS))
        np.testing.assert_allclose(found[tiles], abs(height), rtol=0.05)


@pytest.mark.parametrize("shift", [-0.1, 0.0, 0.04])
def test_a_wall_on_or_next_to_a_border_belongs_to_both_tiles(shift):
    """The second of four columns ends at 6 m; a wall up to half a pixel beside it is a step between both tiles."""
    steps = find_steps(mosaic(Wall(0.5, 6 + shift, 0, 0), 4), PIXELS)
    np.testing.assert_allclose(steps.border[:, 0, EAST], 0.5, rtol=1e-5)
    np.testing.assert_allclose(steps.border[:, 1, WEST], 0.5, rtol=1e-5)
    assert (steps.border[..., [NORTH, SOUTH]] < 1e-6).all()
    np.testing.assert_allclose(steps.unseen, 0.5, rtol=1e-5)
    sloping = find_steps(mosaic(Wall(0.3, 6 + shift, 6, 12, (0.3, -0.2)), 4), PIXELS)
    np.testing.assert_allclose(sloping.border[:, 0, EAST], 0.3, rtol=0.05)


@pytest.mark.parametrize("offset", [0.9, 1.5, 2.1])
def test_a_wall_well_inside_a_tile_is_left_to_its_rating(offset):
    steps = find_steps(mosaic(Wall(0.5, 3 + offset, 0, 0), 4), PIXELS)
    np.testing.assert_allclose(steps.inner[:, 0], 0.5, rtol=1e-5)
    assert (steps.unseen < 1e-6).all()


def test_without_a_neighbour_the_step_is_unknown():
    heights = mosaic(Wall(0.3, 4.5, 6, 0), 3)
    heights[:, 2 * PIXELS :] = np.nan
    steps = find_steps(heights, PIXELS)
    assert np.isnan(steps.border[0, 0, EAST])
    assert np.isfinite(steps.border[0, 0, [NORTH, SOUTH, WEST]]).all()
    assert steps.inner[0, 0] == pytest.approx(0.3, rel=1e-5)
    empty = find_steps(np.full_like(heights, np.nan), PIXELS)
    assert np.isnan(empty.border).all()
    assert np.isnan(empty.unseen).all()


def test_what_stands_on_the_ground_makes_no_step_and_hides_none_beside_it():
    """A thin wall in one tile, and a bank 3 m beside it in the next."""
    heights = mosaic(Wall(0.4, 7.5, 0, 0), 4)
    standing = np.zeros(heights.shape, bool)
    standing[:, PIXELS + 5 : PIXELS + 7] = True
    walled = np.where(standing, heights + 2.0, heights)
    bare, seen, left = (
        find_steps(*given) for given in ((heights, PIXELS), (walled, PIXELS), (walled, PIXELS, 3.0, np.inf, standing))
    )
    assert (highest(seen)[:, 0] > 1.5).all()
    assert (np.nan_to_num(highest(left)) <= highest(bare)).all()
    assert (np.nan_to_num(highest(left))[:, 0] < 0.01).all()
    np.testing.assert_array_equal(left.inner[:, 1], bare.inner[:, 1])
    assert (left.inner[:, 1] > 0.3).all()


@pytest.mark.parametrize("noise", [0.005, 0.03])
def test_noise_has_no_steps_and_a_kerb_stands_out_from_it(noise):
    """Eight times as high as the noise of a pixel is enough."""
    rng = np.random.default_rng(3)
    found = highest(find_steps(rng.normal(0, noise, (16 * PIXELS, 16 * PIXELS)), PIXELS))
    assert (found > 0).mean() < 0.02
    assert (found > 3 * noise).mean() < 0.005
    heights = mosaic(Wall(8 * noise, 6.02, 6, 3), 4)
    kerb = find_steps(heights + rng.normal(0, noise, heights.shape), PIXELS)
    np.testing.assert_allclose(kerb.border[:, 0, EAST], 8 * noise, rtol=0.25)


@pytest.mark.parametrize(("density", "noise"), [(10, 0.003), (10, 0.05), (25, 0.05), (100, 0.02)])
def test_the_line_of_a_step_is_closed_whole_and_nothing_else(density, noise):
    """A step of 0.5 m at three headings; a kerb, a ramp of 20 degrees and a ditch of 0.3 m are no lines."""
    closing, found = closing_height(SHIPPED), []
    for turn in (0, 18, 63):
        wall = Wall(0.5, 12.1, 12.3, turn)
        steps = find_steps(points_of(wall.ground, density, noise, turn), PIXELS, 3.0, closing)
        x, y = np.meshgrid(MIDDLES, MIDDLES[::-1])
        away = np.abs(wall.distance(x, y))
        assert not steps.closed[away > 0.8].any()
        along = (x - 12.1) * -np.sin(np.radians(turn)) + (y - 12.3) * np.cos(np.radians(turn))
        parts = np.floor(along / 0.8)[steps.closed]
        found += [part in parts for part in range(-8, 8)]
        for ground in (
            Wall(0.15, 12.1, 12.3, turn).ground,
            lambda x, y, wall=wall: np.clip(wall.distance(x, y) * np.tan(np.radians(20)), 0, 1),
            lambda x, y, wall=wall: np.where(np.abs(wall.distance(x, y)) < 0.15, -1.0, 0.0),
        ):
            closed = find_steps(points_of(ground, density, noise, turn), PIXELS, 3.0, closing).closed
            assert closed.mean() < 1e-3
    assert np.mean(found) > 0.93


MIDDLES = (np.arange(8 * PIXELS) + 0.5) * TILE_SIZE / PIXELS


def points_of(ground, density, noise, seed):
    """Return 8 x 8 tiles of ground, a function of x and y, from points at random places; NaN in empty pixels."""
    rng = np.random.default_rng(seed)
    n = 8 * PIXELS
    x, y = rng.uniform(0, 8 * TILE_SIZE, (2, int(density * (8 * TILE_SIZE) ** 2)))
    z = ground(x, y) + rng.normal(0, noise, len(x))
    return binned_statistic_2d(8 * TILE_SIZE - y, x, z, "mean", n, [(0, 8 * TILE_SIZE)] * 2).statistic


def near(wall):
    """Tiles of the inner 6 x 6 whose middle is within 1 m of a wall."""
    axis = (np.arange(1, 7) + 0.5) * TILE_SIZE
    return np.abs(wall.distance(*np.meshgrid(axis, axis[::-1]))) < 1


def share_with_step(rise, width, density):
    """Share of the tiles across a ridge or ditch in level ground where most of its height is a step."""
    share = []
    for number, place in enumerate(PLACES[:12]):
        wall = Wall(rise, 6 + place[0], 6 + place[1], place[2])
        heights = points_of(lambda x, y, w=wall: rise * (np.abs(w.distance(x, y)) < width / 2), density, 0.01, number)
        share.extend(highest(find_steps(heights, PIXELS))[near(wall)] > 0.7 * abs(rise))
    return np.mean(share)


@pytest.mark.parametrize("density", [100, 20, 10])
@pytest.mark.parametrize(("width", "least"), [(0.2, 0.4), (0.3, 0.9), (0.5, 0.9), (0.8, 0.65)])
def test_a_ridge_is_a_step_however_narrow(density, width, least):
    """A wheel rolls over a narrow ditch, not over a narrow wall; in pixels of 0.2 m, one of 0.3 m stands in full."""
    assert share_with_step(0.5, width, density) > least


def test_few_points_make_no_steps_of_rough_ground():
    """Lumps of half a metre: a copy with a tenth of the points has hardly a step more than the dense survey."""
    rng = np.random.default_rng(8)
    waves = rng.uniform(-4, 4, (2, 60)), rng.uniform(0, 2 * np.pi, 60)

    def lumps(x, y):
        return 0.07 * np.cos(x[:, None] * waves[0][0] + y[:, None] * waves[0][1] + waves[1]).sum(axis=1)

    dense, thin = (highest(find_steps(points_of(lumps, density, 0.01, 1), PIXELS)) > 0.35 for density in (100, 10))
    assert thin[~dense].mean() < 0.1


def smooth(n):
    """Columns of n smooth tiles."""
    values = {"class_id": 0, "c_r": 0.02, "c_r_low": 0.01, "c_r_high": 0.03, "p_fail": 0.001, "confidence": 0.9}
    columns = {name: np.full(n, value, np.float32) for name, value in values.items()}
    return columns | {"class_id": np.zeros(n, np.uint8), "coverage": np.ones(n)}


def test_higher_steps_are_never_better():
    step = np.linspace(0, 3, 400)
    felt = apply_steps(smooth(400), step, SHIPPED)
    for name in ("class_id", "c_r", "c_r_low", "c_r_high", "p_fail"):
        assert (np.diff(felt[name].astype(float)) >= 0).all(), name
    assert felt["class_id"][0] == 0
    assert felt["class_id"][-1] == 3
    assert felt["p_fail"][-1] > 0.9
    assert (felt["c_r_low"] <= felt["c_r"]).all()
    assert (felt["c_r"] <= felt["c_r_high"]).all()
    assert ((felt["confidence"] > 0) & (felt["confidence"] <= 1)).all()
    fails = crossing_fails(step, SHIPPED)
    assert (np.diff(fails) >= 0).all()
    assert fails[0] == 0
    assert fails[-1] == 1


def test_tiles_without_a_step_unknown_ones_and_those_that_are_rougher_keep_their_bits():
    columns = smooth(5)
    columns["class_id"][2:] = 3, 3, 255
    for name in STEP_COLUMNS[1:]:
        columns[name][2:] = 0.99 if name in {"p_fail", "confidence"} else 5.0
        columns[name][4] = np.nan
    felt = apply_steps(columns, np.array([0, np.nan, 0.2, 0.1, 1.0]), SHIPPED)
    for name in STEP_COLUMNS:
        np.testing.assert_array_equal(felt[name], columns[name])
        assert felt[name].dtype == columns[name].dtype


def test_a_border_is_usable_if_it_is_known_and_low():
    border = np.array([[0.0, 0.05, 2.0, np.nan]])
    np.testing.assert_array_equal(edge_usable(border, SHIPPED), [[True, True, False, False]])
    assert np.isnan(crossing_fails(border, SHIPPED)[0, 3])


@pytest.mark.parametrize("damage", [{"tile": {}}, {"crossing": {"height": [1, 0.5]}}, {"tile": 3}])
def test_a_damaged_record_is_named(damage):
    broken = replace(SHIPPED, steps={**SHIPPED.steps, **damage})
    with pytest.raises(BadInputError, match="record of steps"):
        edge_usable(np.zeros(1), broken)


def test_pixels_that_close_are_those_of_filters_over_the_mosaic():
    tiles, pixels = 4, 10
    shape, seen = (tiles * pixels, tiles * pixels), RNG.random((tiles * pixels, tiles * pixels)) < 0.7
    heights = np.where(seen, RNG.normal(0, 0.2, shape), np.nan).astype(np.float32)
    is_thin, least = RNG.random((tiles, tiles)) < 0.5, RNG.uniform(0.3, 0.9, (tiles, tiles))
    of_tiles = np.ones((pixels, pixels))
    low, closed = np.empty(shape, bool), np.empty(shape, bool)
    loops.find_low(heights, pixels, least, low)
    highest = ndimage.maximum_filter(np.where(seen, heights, -np.inf), 3, mode="nearest")
    np.testing.assert_array_equal(low, highest - heights >= np.kron(least, of_tiles))

    across, along = RNG.choice(3, (2, *shape), p=(0.95, 0.03, 0.02)).astype(np.uint8)
    jumps = RNG.random(shape) < 0.01
    loops.close_steps(across, np.ascontiguousarray(along.T), pixels, is_thin, jumps, low, closed)
    sure = np.kron(is_thin, of_tiles) > 0
    steps = np.maximum(across, along) > sure
    beside = ndimage.correlate((steps | jumps | low).astype(int), np.ones((5, 5), int), mode="constant")
    assert (steps & sure & (beside == 1)).any()
    np.testing.assert_array_equal(closed, jumps | (steps & (~sure | (beside > 1))))
