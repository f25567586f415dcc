"""Slopes of tiles are those that weights which stand still give."""

import numpy as np
import pytest

TILES = 6
REACH = 0.1
EAST, NORTH = 500_001, 4_000_002


def rough_ground():
    """Points of 6 x 6 tiles: waves, terraces, and more and more plants northwards; none on the border of a tile."""
    rng = np.random.default_rng(1)
    x, y = (np.floor(rng.uniform(0, 3 * TILES, (2, 80 * (3 * TILES) ** 2)) * 1e3) + 0.5) / 1e3
    z = 0.1 * x + np.where(np.sin(0.7 * x + 0.3 * y) > 0.4, 0.6, 0.0) + 0.02 * rng.normal(size=len(x))
    for wave in (12.0, 5.0, 2.0, 0.8):
        a, b = rng.uniform(0, 6, 2)
        z += 0.06 * wave**0.8 * np.sin(6.3 * x / wave + a) * np.sin(6.3 * y / wave + b)
    plants = rng.random(len(x)) < 0.9 * y / (3 * TILES)
    return x + EAST, y + NORTH, np.round(z + plants * rng.exponential(0.4, len(x)) + 2277, 3)


GROUND = rough_ground()


@pytest.fixture(scope="module", name="measured")
def measured_fixture(measure_points):
    return measure_points(*GROUND)


def by_tile(stack, x, y, z):
    """Points of each tile, from its middle."""
    place = np.lexsort((np.floor(x / 3), -np.floor(y / 3)))
    ends = np.cumsum(stack.count)[:-1]
    middle = 3 * (np.stack([stack.col, stack.row], axis=1) + 0.5)
    for tile, (west, south) in zip(np.split(place, ends), middle, strict=True):
        yield np.stack([x[tile] - west, y[tile] - south, z[tile] - z[tile].mean()], axis=1)


def robust_slopes(points):
    """By plain steps from the least-squares planes of all points and of each quarter, until they stand still."""
    terms = np.column_stack([points[:, :2], np.ones(len(points))])
    east, north = points[:, 0] > 0, points[:, 1] > 0
    for start in (np.ones(len(points)), east & north, east & ~north, ~east & north, ~east & ~north):
        weight, plane = start.astype(float), np.zeros(3)
        for _ in range(3000):
            last, weighted = plane, terms.T * weight
            plane = np.linalg.solve(weighted @ terms, weighted @ points[:, 2])
            distance = (points[:, 2] - terms @ plane) / np.hypot(np.hypot(*plane[:2]), 1.0)
            weight = (1.0 + (distance / REACH) ** 2) ** -2.0
            if abs(plane - last).max() < 1e-8:
                break
        yield np.degrees(np.arctan(np.hypot(*plane[:2])))


def test_slope_is_that_of_least_squares_reweighted_until_they_stand_still(measured):
    """From the start that explains most; where several planes would do, a step may lead to another than plain ones."""
    slopes = np.array([list(robust_slopes(points)) for points in by_tile(measured, *GROUND)])
    away = np.abs(slopes - measured.slope[:, None]).min(axis=1)
    assert np.median(away) < 2e-3
    assert np.mean(away < 0.1) > 0.95


@pytest.mark.parametrize("part", ["half", "corner"])
def test_slope_beside_a_thing_is_that_of_the_ground(measure_points, part):
    x, y, _ = GROUND
    on_it = (x % 3 > 1.6) & ((y % 3 > 1.0) | (part == "half"))
    stack = measure_points(x, y, np.round(0.2 * (x - EAST), 3) + 1.5 * on_it)
    np.testing.assert_allclose(stack.slope, np.degrees(np.arctan(0.2)), atol=0.1)
