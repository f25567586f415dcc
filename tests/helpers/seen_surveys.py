"""Surveys of level ground with posts or with a step, and the share of these that is found."""

import numpy as np
from scenes import GROUND, OTHER, ScenePoints, seen_pixels
from scipy.stats import binned_statistic_2d
from walls import PIXELS, TILE_SIZE, Wall

from bumpymap.core import OBSTACLE, VehicleBody, smallest_step
from bumpymap.rating import find_steps

BODY = VehicleBody(clearance_m=0.25, height_m=1.4, width_m=1.4, brush_stem_m=0.25)
APART, TILES, STEP_TILES = 4.0, 32, 12
"""Distance of the posts, m; tiles along a side of a survey of posts, and of one with a step."""


def share_of_posts(density, width, rng, *, in_relief, surveys=1):
    """Share of posts of 1 m, with a square top of some width, in which an obstacle is found; seen from above alone."""
    found, side, pixel = [], TILES * TILE_SIZE, TILE_SIZE / PIXELS
    for _ in range(surveys):
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
