"""What stands on made-up ground and is seen only from above is closed; level ground and what is under crowns is not."""

import itertools

import numpy as np
import pytest
from scenes import (
    BUILDING,
    FAR,
    OTHER,
    SCENES,
    Place,
    Scene,
    Solid,
    fence,
    judge,
    mapped_tiles,
    ring,
    seen_from_above,
    seen_pixels,
    survey_scene,
    wall,
)

from bumpymap.core import EMPTY, FREE, LONE, OBSTACLE, VehicleBody
from bumpymap.patches import settle_solids
from bumpytiles import Grid

BODY = VehicleBody(clearance_m=0.25, height_m=1.38, width_m=1.37, brush_stem_m=0.25)
BY_NAME = {scene.name: seen_from_above(scene) for scene in SCENES}


def pixel_centres(image, west, south):
    """Return the places of the middles of pixels."""
    rows, cols = (np.arange(size) for size in image.shape)
    return np.meshgrid(west + 0.2 * (cols + 0.5), south + 0.2 * (len(rows) - rows - 0.5))


SOLIDS = [
    (200, 0.95, ("wall 0.3 m",)),
    (50, 0.93, ("wall 0.6 m", "bales", "vans", "hut", "hut, unassigned", "hedge")),
    (50, 0.9, ("crates",)),
    (8, 0.85, ("bales", "hut")),
    (8, 0.8, ("crates", "hedge")),
    (8, 0.75, ("vans",)),
]
"""Density, least share that is closed, names."""


@pytest.mark.parametrize(("density", "least", "name"), [(*how, name) for *how, names in SOLIDS for name in names])
def test_a_solid_seen_only_from_above_is_closed(density, least, name):
    found = judge(BY_NAME[name], density, 0.03, BODY)
    assert found.closed >= least
    assert found.barred == 0


@pytest.mark.parametrize("density", [200, 4])
@pytest.mark.parametrize("name", ["open ground", "ditch", "ramp", "bank 0.4 m"])
@pytest.mark.parametrize("classified", [True, False])
def test_level_ground_is_free_at_any_density_and_noise(name, density, classified):
    for noise in (0.0, 0.03):
        found = judge(BY_NAME[name], density, noise, BODY, classified=classified)
        assert found.barred == 0
        assert name not in {"ditch", "ramp"} or found.relief == 0


@pytest.mark.parametrize("name", ["crowns over ground", "crowns, unassigned"])
def test_ground_under_crowns_is_free_where_it_is_seen(name):
    for density, most in ((200, 0), (50, 0), (20, 0.002), (8, 0.01)):
        assert judge(BY_NAME[name], density, 0.03, BODY).barred <= most


@pytest.mark.parametrize(
    "scene", [wall(0.3, OTHER), wall(0.3, OTHER, height=0.6), fence()], ids=lambda scene: scene.name
)
@pytest.mark.parametrize("classified", [True, False])
def test_more_points_see_no_less(scene, classified):
    scene = seen_from_above(scene)
    shares = [judge(scene, density, 0.0, BODY, classified=classified).closed for density in (8, 20, 50, 200)]
    assert np.all(np.diff(shares) > -0.03)


def test_in_a_survey_without_classes_narrow_things_are_told_from_relief():
    for name in ("wall 0.3 m", "crates", "vans", "hedge", "posts"):
        assert judge(BY_NAME[name], 200, 0.03, BODY, classified=False).closed > 0.95, name
    for name in ("crates", "bales"):
        assert judge(BY_NAME[name], 8, 0.03, BODY, classified=False, seeds=range(4)).closed > 0.8, name


def test_points_of_buildings_are_obstacles_however_high_and_thin():
    assert judge(wall(0.1, BUILDING, height=9.0), 200, 0.0, BODY).closed > 0.95
    assert judge(wall(0.05, OTHER, height=9.0), 200, 0.0, BODY).closed == 0  # as a wire is seen


@pytest.mark.parametrize("density", [25, 50, 100, 400])
def test_a_bar_overhead_is_canopy_and_the_walls_beside_it_are_not(density):
    """Half of the pulses on the bar reach the ground; all points of both are higher than the vehicle."""
    walls = [Solid(sign * 6.0, 0, 8.0, 0.3, 2.0) for sign in (-1, 1)]
    bar = Solid(0, 0, 5.0, 0.3, 5.0, bottom=4.8, stops=0.5)
    scene = Scene("bar between walls", (*walls, bar), half=11.0)
    closed = []
    for seed in range(6):
        image, west, south = seen_pixels(survey_scene(scene, density, place=Place(20.0 * seed), seed=seed), BODY)
        x, y = Place(20.0 * seed).in_scene(*pixel_centres(image, west, south))
        beneath = (np.abs(x) < 1.4) & (np.abs(y) < 0.15)
        on_wall = (np.abs(np.abs(x) - 6.0) < 3.0) & (np.abs(y) < 0.1)
        closed.append([(image[part] == OBSTACLE).mean() for part in (beneath, on_wall)])
    bar_closed, wall_closed = np.mean(closed, axis=0)
    assert bar_closed < 0.1
    assert wall_closed > (0.9 if density >= 50 else 0.5)


@pytest.mark.parametrize("density", [200, 50, 20])
@pytest.mark.parametrize(
    "name", ["carport", "bridge 5 m above ground, unassigned", "footbridge 1 m above ground, unassigned"]
)
def test_what_a_roof_or_a_bridge_hides_is_closed(name, density):
    assert judge(BY_NAME[name], density, 0.03, BODY).closed > 0.9


def test_a_vehicle_gets_through_gaps_that_it_fits_through():
    for gap, share in ((0.0, 0.0), (1.0, 0.0), (3.0, 1.0)):
        assert judge(seen_from_above(ring(gap)), 50, 0.03, BODY, seeds=range(4)).joined == share


def test_a_fence_seen_here_and_there_is_one_line():
    image, west, south = seen_pixels(survey_scene(fence(mesh=0.1), 100, sides=True, seed=3), BODY)
    row, cols = len(image) - 1 - int(-south / 0.2), slice(int((-5.5 - west) / 0.2), int((5.5 - west) / 0.2))
    assert np.all((image[row - 1 : row + 2, cols] == OBSTACLE).any(axis=0))


def points_of_a_wall(every, first, last):
    """States of thinly seen ground with a point of a wall on every so many pixels, but for some in the middle."""
    states = np.full((75, 75), EMPTY, np.uint8)
    states[::2, ::2] = FREE
    states[37, 1::every] = LONE
    states[37, first : last + 1] = FREE
    return states


@pytest.mark.parametrize(
    ("every", "first", "last", "joins"), [(2, 34, 40, True), (1, 33, 41, False), (2, 30, 44, False)]
)
def test_a_line_of_few_points_has_wider_gaps_by_chance(every, first, last, joins):
    """Of 2.5 points per m, 1.6 m apart; in a line of twice as many 2 m are a gap, and 3 m are one in any."""
    settled = settle_solids(points_of_a_wall(every, first, last), Grid(), FAR)
    assert (settled[37, first : last + 1] == OBSTACLE).any() == joins


def test_a_pixel_is_the_same_wherever_a_block_is_cut_out():
    rng = np.random.default_rng(5)
    scenes = (BY_NAME["crowns, unassigned"], BY_NAME["vans"], BY_NAME["hut, unassigned"], fence())
    for scene, density in itertools.product(scenes, (8, 50)):
        raw = mapped_tiles(survey_scene(scene, density, seed=int(rng.integers(99)), sides=True), BODY)
        whole = settle_solids(raw, Grid(), FAR)
        for row, col in 15 * rng.integers(0, len(raw) // 15 - 2, (4, 2)):
            part = np.s_[row : row + 45, col : col + 45]
            cut = settle_solids(np.ascontiguousarray(raw[part]), Grid(), FAR)
            np.testing.assert_array_equal(cut[15:30, 15:30], whole[part][15:30, 15:30])
