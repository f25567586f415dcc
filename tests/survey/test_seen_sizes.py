"""Objects and steps that a survey shows, held against made-up surveys; and what is said of those that it does not."""

import numpy as np
import pytest
from scenes import GROUND, OTHER, ScenePoints, seen_pixels
from scipy.stats import binned_statistic_2d
from walls import PIXELS, TILE_SIZE, Wall

from bumpymap.core import OBSTACLE, SeenSizes, VehicleBody, chance_text, density_for, smallest_object, smallest_step
from bumpymap.rating import find_steps

BODY = VehicleBody(clearance_m=0.25, height_m=1.4, width_m=1.4, brush_stem_m=0.25)
APART, TILES, STEP_TILES = 4.0, 32, 12
"""Distance of the posts, m; tiles along a side of a survey of posts, and of one with a step."""


def share_of_posts(density, width, rng, *, in_relief):
    """Share of posts of 1 m, with a square top of some width, in which an obstacle is found; seen from above alone."""
    found, side, pixel = [], TILES * TILE_SIZE, TILE_SIZE / PIXELS
    posts = int(side / APART)
    x, y = rng.uniform(0, side, (2, rng.poisson(density * side**2)))
    middle = (np.indices((posts, posts)).reshape(2, -1).T + 0.5) * APART + rng.uniform(-1, 1, (posts**2, 2))
    own = middle[(x // APART).astype(int) * posts + (y // APART).astype(int)]
    on = (np.abs(x - own[:, 0]) < width / 2) & (np.abs(y - own[:, 1]) < width / 2)
    z = 0.1 * x + rng.normal(0, 0.02, len(x)) + on
    classes = np.where(on | in_relief, OTHER, GROUND)
    closed = seen_pixels(ScenePoints(x, y, z, classes), BODY)[0] == OBSTACLE
    low, high = (middle - width / 2 - 0.25) / pixel, (middle + width / 2 + 0.25) / pixel
    top = (TILES + 1) * PIXELS - 1
    for (west, south), (east, north) in zip(low.astype(int), high.astype(int), strict=True):
        found.append(closed[top - north : top - south + 1, PIXELS + west : PIXELS + east + 1].any())
    return np.mean(found)


def steps_of(wall, density, noise, rng, closing=np.inf):
    """Steps of a survey of two levels."""
    side = STEP_TILES * TILE_SIZE
    x, y = rng.uniform(0, side, (2, int(density * side**2)))
    z = wall.ground(x, y) + rng.normal(0, noise, len(x))
    heights = binned_statistic_2d(side - y, x, z, "mean", STEP_TILES * PIXELS, [(0, side)] * 2).statistic
    return find_steps(heights, PIXELS, closing=closing)


def level_step(density, noise, rng, closing=np.inf):
    """Lowest step that level ground says would have been found, m."""
    limit = steps_of(Wall(0.0, 0, 0, 0), density, noise, rng).limit
    return float(np.median(smallest_step(limit, density, closing)))


def share_of_steps(height, density, noise, rng, *, closing=np.inf, surveys=4):
    """Share of the tiles on a step, at any place and angle, that find at least half of it, or are closed by it."""
    found, axis = [], (np.arange(1, STEP_TILES - 1) + 0.5) * TILE_SIZE
    for _ in range(surveys):
        wall = Wall(height, *rng.uniform(16.5, 19.5, 2), rng.uniform(0, 360))
        steps = steps_of(wall, density, noise, rng, closing)
        near = np.abs(wall.distance(*np.meshgrid(axis, axis[::-1]))) < 1.0
        tiles = steps.closed.reshape(STEP_TILES, PIXELS, STEP_TILES, PIXELS)
        closed = tiles.any(axis=(1, 3))[1:-1, 1:-1]
        found.extend((closed | (np.fmax(steps.inner, steps.edge_step) > 0.5 * height))[near])
    return np.mean(found)


PIXEL_M, SIDE, TILE_M = 0.2, 15, 3.0


@pytest.mark.parametrize(("density", "width"), [(4, 1.09), (10, 0.69), (35, 0.385), (100, 0.22)])
def test_the_narrowest_object_follows_from_the_density(density, width):
    found = SeenSizes.forecast(density, PIXEL_M, in_relief=False)
    assert found.object_m == pytest.approx(width, abs=0.01)
    assert SeenSizes.forecast(density, PIXEL_M, in_relief=True).object_m >= found.object_m
    assert 0.95 * density < density_for(width, PIXEL_M, in_relief=False) < 1.4 * density


@pytest.mark.parametrize("in_relief", [False, True])
@pytest.mark.parametrize("density", [10, 35, 100])
def test_a_post_of_that_width_is_found_in_95_percent_and_a_narrower_one_is_not(density, in_relief):
    width, rng = SeenSizes.forecast(density, PIXEL_M, in_relief=in_relief).object_m, np.random.default_rng(density)
    of_chance = 0.01  # of 576 posts
    assert share_of_posts(density, width, rng, in_relief=in_relief) > 0.95 - of_chance
    assert share_of_posts(density, 0.6 * width, rng, in_relief=in_relief) < 0.8


@pytest.mark.parametrize(
    ("density", "noise", "closing"), [(20, 0.01, np.inf), (100, 0.03, np.inf), (400, 0.01, 0.28), (10, 0.03, 0.28)]
)
def test_a_step_of_that_height_is_found_and_a_lower_one_is_not(density, noise, closing):
    rng = np.random.default_rng(density)
    height = level_step(density, noise, rng, closing)
    assert share_of_steps(height, density, noise, rng, closing=closing, surveys=8) > 0.9
    assert share_of_steps(0.4 * height, density, noise, rng, closing=closing, surveys=8) < 0.6


def tiles_of(points, tiles=300):
    """The narrowest object of tiles, and that of even ones with as many points; ``points`` makes those of a tile."""
    held, count = np.zeros((tiles, SIDE, SIDE), bool), np.zeros(tiles, np.int64)
    for tile in range(tiles):
        x, y = points()
        held[tile, (y / PIXEL_M).astype(int), (x / PIXEL_M).astype(int)] = True
        count[tile] = len(x)
    own = smallest_object(held, count, TILE_M, in_relief=False)
    even = [SeenSizes.forecast(each / TILE_M**2, PIXEL_M, in_relief=False).object_m for each in count]
    return own, np.minimum(even, TILE_M)


@pytest.mark.parametrize("density", [2, 10, 35, 400])
def test_points_at_random_are_even(density):
    rng = np.random.default_rng(1)
    own, even = tiles_of(lambda: rng.uniform(0, TILE_M, (2, 1 + rng.poisson(density * 9))))
    assert np.mean(own > 1.001 * even) < 0.02
    np.testing.assert_array_less(0.999 * even, own)


@pytest.mark.parametrize("apart", [0.5, 0.9, 1.5])
@pytest.mark.parametrize("turned", [False, True])
def test_lines_with_gaps_show(apart, turned):
    rng = np.random.default_rng(2)

    def lines():
        y = np.repeat(np.arange(rng.uniform(0, apart), TILE_M, apart), 100)
        place = rng.uniform(0, TILE_M, len(y)), y
        return place[::-1] if turned else place

    own, even = tiles_of(lines)
    assert np.median(own) > 0.95 * apart
    assert np.median(own) > 2 * np.median(even)


def test_the_sparser_part_of_a_tile_counts():
    rng = np.random.default_rng(3)

    def halves():
        dense, sparse = rng.poisson(100 * 4.5), rng.poisson(10 * 4.5)
        x = np.concatenate([rng.uniform(0, 1.5, dense), rng.uniform(1.5, TILE_M, sparse)])
        return x, rng.uniform(0, TILE_M, len(x))

    own, even = tiles_of(halves)
    assert np.median(even) < 0.35
    assert np.median(own) == pytest.approx(0.69, abs=0.12)
    assert tiles_of(lambda: np.array([[0.1], [0.1]]))[0].max() == TILE_M


@pytest.mark.parametrize(
    ("chance", "text"), [(1.0, "over 99.9%"), (0.9999, "over 99.9%"), (0.998, "99.8%"), (0.0, "0.0%")]
)
def test_no_chance_to_arrive_is_certain(chance, text):
    assert chance_text(chance) == text
    assert not chance_text(chance, 0).startswith("100")
