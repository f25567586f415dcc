import numpy as np
import pytest
from walls import PIXELS, TILE_SIZE, Wall, crossed, mosaic

from bumpymap.rating import find_steps

NORTH, EAST, SOUTH, WEST = range(4)
RNG = np.random.default_rng(7)
PLACES = [(*RNG.uniform(4.5, 7.5, 2), RNG.uniform(0, 360)) for _ in range(25)]


def highest(steps):
    return np.fmax(steps.inner, steps.edge_step)


@pytest.mark.parametrize("height", [0.05, 0.3, -0.4, 2.0])
def test_a_wall_at_any_place_and_angle_is_measured_in_full(height):
    for place in PLACES:
        wall = Wall(height, *place)
        tiles = crossed(wall, 4)
        assert tiles.any()
        found = highest(find_steps(mosaic(wall, 4), PIXELS))
        np.testing.assert_allclose(found[tiles], abs(height), rtol=0.05)


@pytest.mark.parametrize("shift", [-0.1, -0.04, 0.0, 0.04, 0.1])
def test_a_wall_on_or_next_to_a_border_belongs_to_both_tiles(shift):
    """The second of four columns ends at 6 m; a wall up to half a pixel beside it is a step between both tiles."""
    steps = find_steps(mosaic(Wall(0.5, 6 + shift, 0, 0), 4), PIXELS)
    np.testing.assert_allclose(steps.border[:, 0, EAST], 0.5, rtol=1e-5)
    np.testing.assert_allclose(steps.border[:, 1, WEST], 0.5, rtol=1e-5)
    assert (steps.border[..., [NORTH, SOUTH]] < 1e-6).all()
    np.testing.assert_allclose(steps.unseen, 0.5, rtol=1e-5)


@pytest.mark.parametrize("offset", [0.9, 1.5, 2.1])
def test_a_wall_well_inside_a_tile_is_left_to_its_rating(offset):
    steps = find_steps(mosaic(Wall(0.5, 3 + offset, 0, 0), 4), PIXELS)
    np.testing.assert_allclose(steps.inner[:, 0], 0.5, rtol=1e-5)
    assert (steps.unseen < 1e-6).all()


def test_what_stands_on_the_ground_makes_no_step_and_hides_none_beside_it():
    """A thin wall in one tile, and a bank 3 m beside it in the next."""
    heights = mosaic(Wall(0.4, 7.5, 0, 0), 4)
    standing = np.zeros(heights.shape, bool)
    standing[:, PIXELS + 5 : PIXELS + 7] = True
    walled = np.where(standing, heights + 2.0, heights)
    bare, seen, left = (
        find_steps(*given) for given in ((heights, PIXELS), (walled, PIXELS), (walled, PIXELS, 3.0, standing))
    )
    assert (highest(seen)[:, 0] > 1.5).all()
    assert (np.nan_to_num(highest(left)) <= highest(bare)).all()
    assert (np.nan_to_num(highest(left))[:, 0] < 0.01).all()
    np.testing.assert_array_equal(left.inner[:, 1], bare.inner[:, 1])
    assert (left.inner[:, 1] > 0.3).all()


def test_a_wall_on_a_slope_is_measured_in_full():
    steps = find_steps(mosaic(Wall(0.3, 6.05, 6, 12, (0.3, -0.2)), 4), PIXELS)
    np.testing.assert_allclose(steps.border[:, 0, EAST], 0.3, rtol=0.05)


@pytest.mark.parametrize("noise", [0.005, 0.03])
def test_noise_has_no_steps(noise):
    rng = np.random.default_rng(3)
    found = highest(find_steps(rng.normal(0, noise, (16 * PIXELS, 16 * PIXELS)), PIXELS))
    assert (found > 0).mean() < 0.02
    assert (found > 3 * noise).mean() < 0.005


@pytest.mark.parametrize("noise", [0.005, 0.01, 0.02])
def test_a_kerb_stands_out_from_noise(noise):
    """Eight times as high as the noise of a pixel is enough."""
    rng = np.random.default_rng(4)
    heights = mosaic(Wall(8 * noise, 6.02, 6, 3), 4)
    found = find_steps(heights + rng.normal(0, noise, heights.shape), PIXELS)
    np.testing.assert_allclose(found.border[:, 0, EAST], 8 * noise, rtol=0.25)


def test_two_blocks_find_the_same_bits_for_the_border_that_they_share():
    rng = np.random.default_rng(5)
    world = mosaic(Wall(0.2, 14.9, 9, 7), 10) + rng.normal(0, 0.01, (150, 150)).astype(np.float32)
    world[rng.random(world.shape) < 0.4] = np.nan
    whole = find_steps(world, PIXELS)
    west, east = find_steps(world[:, : 6 * PIXELS], PIXELS), find_steps(world[:, 4 * PIXELS :], PIXELS)
    np.testing.assert_array_equal(west.border[:, -1, EAST], east.border[:, 0, WEST])
    for part, columns in ((west, slice(0, 4)), (east, slice(4, 8))):
        np.testing.assert_array_equal(part.border, whole.border[:, columns])
        np.testing.assert_array_equal(part.inner, whole.inner[:, columns])
        np.testing.assert_array_equal(part.rim, whole.rim[:, columns])
    np.testing.assert_array_equal(whole.border[:, :-1, EAST], whole.border[:, 1:, WEST])
    np.testing.assert_array_equal(whole.border[:-1, :, SOUTH], whole.border[1:, :, NORTH])


def surveyed(ground, density, noise, seed):
    """Return 8 x 8 tiles of ground, a function of x and y, from points at random places; NaN in empty pixels."""
    rng = np.random.default_rng(seed)
    n = 8 * PIXELS
    x, y = rng.uniform(0, 8 * TILE_SIZE, (2, int(density * (8 * TILE_SIZE) ** 2)))
    at = (n - 1 - (y / TILE_SIZE * PIXELS).astype(int)) * n + (x / TILE_SIZE * PIXELS).astype(int)
    with np.errstate(invalid="ignore"):
        mean = np.bincount(at, ground(x, y) + rng.normal(0, noise, len(x)), n * n) / np.bincount(at, minlength=n * n)
    return mean.reshape(n, n)


def near(wall):
    """Tiles of the inner 6 x 6 whose middle is within 1 m of a wall."""
    axis = (np.arange(1, 7) + 0.5) * TILE_SIZE
    return np.abs(wall.distance(*np.meshgrid(axis, axis[::-1]))) < 1


def share_with_step(rise, width, density):
    """Share of the tiles across a ridge or ditch in level ground where most of its height is a step."""
    share = []
    for number, place in enumerate(PLACES[:12]):
        wall = Wall(rise, 6 + place[0], 6 + place[1], place[2])
        heights = surveyed(lambda x, y, w=wall: rise * (np.abs(w.distance(x, y)) < width / 2), density, 0.01, number)
        share.extend(highest(find_steps(heights, PIXELS))[near(wall)] > 0.7 * abs(rise))
    return np.mean(share)


@pytest.mark.parametrize("density", [200, 20, 6])
@pytest.mark.parametrize(("width", "expected"), [(0.3, 0.0), (0.5, 0.0), (1.5, 1.0)])
def test_a_ditch_is_a_step_where_a_wheel_drops_into_it(density, width, expected):
    """A wheel of 0.6 m rolls over one of 0.5 m, however deep."""
    assert share_with_step(-1.0, width, density) == pytest.approx(expected, abs=0.1)


@pytest.mark.parametrize("density", [100, 20, 10])
@pytest.mark.parametrize(("width", "least"), [(0.2, 0.4), (0.3, 0.9), (0.5, 0.9), (0.8, 0.65)])
def test_a_ridge_is_a_step_however_narrow(density, width, least):
    """A wheel rolls over a narrow ditch, not over a narrow wall; in pixels of 0.2 m, one of 0.3 m stands in full."""
    assert share_with_step(0.5, width, density) > least


@pytest.mark.parametrize("density", [200, 20, 4])
@pytest.mark.parametrize("length", [1, 6, 99])
def test_a_ramp_has_no_step(density, length):
    """Of 28 degrees, from one level to another: a vehicle climbs it, and few points must not make a wall of it."""
    found = []
    for number, place in enumerate(PLACES[:6]):
        wall = Wall(0.0, 6 + place[0], 6 + place[1], place[2])
        heights = surveyed(lambda x, y, w=wall: 0.53 * np.clip(w.distance(x, y), 0, length), density, 0.02, number)
        found.append(highest(find_steps(heights, PIXELS)))
    assert np.mean(np.nan_to_num(found) > 0.35) < 0.02


def test_few_points_make_no_steps_of_rough_ground():
    """Lumps of half a metre: a copy with a tenth of the points has hardly a step more than the dense survey."""
    rng = np.random.default_rng(8)
    waves = rng.uniform(-4, 4, (2, 60)), rng.uniform(0, 2 * np.pi, 60)

    def lumps(x, y):
        return 0.07 * np.cos(x[:, None] * waves[0][0] + y[:, None] * waves[0][1] + waves[1]).sum(axis=1)

    dense, thin = (highest(find_steps(surveyed(lumps, density, 0.01, 1), PIXELS)) > 0.35 for density in (100, 10))
    assert thin[~dense].mean() < 0.1


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
