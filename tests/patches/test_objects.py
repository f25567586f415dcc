"""Obstacles, canopy and the ground under vegetation: made-up points and solids whose truth is plain, in any order."""

import importlib.util
import itertools
from dataclasses import replace

import numpy as np
import pytest
import small_surveys
from cost_maps import block_of
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
from small_surveys import alike_surveys, band, layers_of, write_las

from bumpymap.core import SEEN, CsfSettings, FeatureSettings, UsageError, install_command
from bumpymap.core.types import CANOPY, FREE, OBSTACLE, UNDECIDED, UNSEEN, Barred, VehicleBody
from bumpymap.patches import close_filter, cloth, find_objects, mark_ground, measure, require_filter, settle_solids
from bumpymap.patches.features import find_in_relief, find_standing, leave_out_standing, take_off_standing
from bumpymap.survey import Budget
from bumpytiles import Grid

BODY = VehicleBody(clearance_m=0.25, height_m=1.4, width_m=1.4, brush_stem_m=0.25)
SETTINGS = FeatureSettings()
EAST, NORTH = 500_001.0, 4_000_002.0  # south-west corner of a tile


@pytest.fixture
def rng():
    return np.random.default_rng(1)


def meadow(rng, density=50, tiles=1, slope=0.1):
    """Easting, northing, upward and ground flag of open ground, metres from the corner of a tile."""
    n = rng.poisson(density * 9 * tiles)
    x, y = rng.uniform(0, 3 * tiles, n), rng.uniform(0, 3, n)
    return np.column_stack([x, y, slope * x + 0.02 * rng.normal(size=n), np.ones(n)])


def things(x, y, height, slope=0.1):
    """Points over the ground, rows like those of ``meadow``."""
    x, y, height = np.broadcast_arrays(*(np.asarray(axis, float) for axis in (x, y, height)))
    return np.column_stack([axis.ravel() for axis in (x, y, slope * x + height, np.zeros(x.shape))])


def found(*points, body=BODY):
    x, y, z, ground = np.concatenate(points).T
    block = block_of(EAST + x, NORTH + y, z, ground == 1)
    stack = find_objects(block, measure(block, SETTINGS, ground_only=True), body)
    col, row = block.col - block.col.min() + 1, block.row.max() - block.row + 1
    mosaic = np.full((3, 15, col.max() + 2, 15), UNSEEN, np.uint8)
    mosaic[row, :, col] = stack.objects
    settled = settle_solids(mosaic.reshape(45, -1), Grid(), SETTINGS.max_hole)
    states = settled.reshape(mosaic.shape)[row, :, col]
    return replace(stack, objects=states, obstacle=np.mean(states == OBSTACLE, axis=(1, 2)))


def pixel(x, y):
    return 14 - int(y / 0.2), int(x / 0.2)


@pytest.mark.parametrize(
    ("height", "state"), [(0.0, FREE), (0.15, FREE), (0.35, OBSTACLE), (1.3, OBSTACLE), (1.5, CANOPY), (9.0, CANOPY)]
)
def test_the_height_above_ground_decides(rng, height, state):
    stack = found(meadow(rng), things([1.5, 1.52, 1.51], [1.1, 1.1, 1.12], height))
    assert stack.objects[0][pixel(1.5, 1.1)] == state
    assert np.count_nonzero(stack.objects[0] != FREE) == (state != FREE)
    assert stack.obstacle[0] == pytest.approx((state == OBSTACLE) / 225)
    assert stack.canopy[0] == pytest.approx((state == CANOPY) / 225)
    assert stack.obstacle_height[0] == pytest.approx(height * (state == OBSTACLE), abs=0.06)
    assert stack.clearance[0] == pytest.approx(height if state == CANOPY else np.nan, abs=0.06, nan_ok=True)


@pytest.mark.parametrize(
    ("density", "height", "returns", "free"),
    [(50, 0.8, 1, True), (50, 5.0, 1, True), (1000, 0.8, 6, True), (100, 0.8, 6, False)],
)
def test_a_bird_is_no_obstacle_and_no_canopy(rng, density, height, returns, free):
    """In a dense survey, it may return more than once."""
    bird = things([1.5, 1.55, 1.6, 1.5, 1.55, 1.6][:returns], 1.1, height)
    assert np.all(found(meadow(rng, density), bird).objects == FREE) == free


def test_a_crown_is_canopy_and_under_it_one_return_is_an_obstacle(rng):
    crown = things(*rng.uniform(0, 3, (2, 600)), rng.uniform(3, 8, 600))
    stack = found(meadow(rng), crown, things(1.5, 1.5, 0.9))
    assert np.argwhere(stack.objects[0] == OBSTACLE).tolist() == [list(pixel(1.5, 1.5))]
    assert stack.canopy[0] > 0.8
    assert stack.clearance[0] > 2.9


def test_plants_that_are_brushed_aside_are_no_obstacle_and_a_wire_is_one(rng):
    ground, grass = meadow(rng), things(*rng.uniform(0, 3, (2, 300)), rng.uniform(0, 0.4, 300))
    assert found(ground, grass).obstacle[0] > 0.2
    assert found(ground, grass, body=VehicleBody(0.25, 1.4, 1.4, brush_stem_m=0.5)).obstacle[0] == 0
    assert found(ground, things(np.arange(0.1, 3, 0.2), 1.5, 0.8)).obstacle[0] >= 13 / 225


def test_ground_is_continued_under_a_boulder_and_down_a_slope(rng):
    ground = meadow(rng, slope=0.5)
    raised = np.hypot(*(ground[:, :2] - 1.5).T) < 0.7
    stack = found(ground + raised[:, None] * [0, 0, 0.6, -1])  # and none of the ground
    assert stack.obstacle[0] == pytest.approx(np.pi * 0.7**2 / 9, rel=0.2)
    assert stack.obstacle_height[0] == pytest.approx(0.6, abs=0.12)


def test_what_is_far_from_all_points_is_unseen_and_without_ground_the_rest_is_an_obstacle(rng):
    stack = found(things(rng.uniform(0, 1.5, 300), rng.uniform(0, 3, 300), 7.0))
    assert np.all(stack.objects[0][:, 8:] == UNSEEN)
    assert np.mean(stack.objects[0][:, :7] == OBSTACLE) > 0.8
    assert np.isnan(stack.canopy[0])
    ground = meadow(rng)
    half = found(ground[ground[:, 0] < 1.0]).objects[0]
    assert np.all(half[:, 11:] == UNSEEN)
    assert np.all(half[:, :9] == FREE)
    assert np.all(found(meadow(rng, density=4)).objects == FREE)  # thin surveys have gaps


def test_too_few_points_at_a_border_are_left_to_the_neighbour(rng):
    stack = found(meadow(rng, tiles=2), things([2.95, 3.05], 1.5, 0.8))
    assert [np.argwhere(tile == UNDECIDED).tolist() for tile in stack.objects] == [[[7, 14]], [[7, 0]]]
    assert np.all(stack.obstacle == 0)


# ---- low things in the ground of a block: what stands out of it, and relief that does not ----

Y, X = (np.mgrid[:60, :60] + 0.5) * 0.2  # 12 m


def marks_of(heights, body=BODY):
    noise = 0.02 * np.random.default_rng(0).normal(size=heights.shape)
    return find_standing((heights + noise).astype(np.float32), body, Grid())


def boulder(x, y, radius, height):
    return height * np.sqrt(np.maximum(0, 1 - ((X - x) ** 2 + (Y - y) ** 2) / radius**2))


@pytest.mark.parametrize(("slope", "radius", "height"), [(0.0, 0.4, 0.35), (0.5, 0.4, 0.35), (0.5, 0.75, 0.5)])
def test_a_boulder_stands_anywhere_on_a_slope(slope, radius, height):
    for x, y in ((6.0, 6.0), (3.3, 6.0), (3.2, 3.2), (4.57, 5.93)):
        stone = boulder(x, y, radius, height)
        marks = marks_of(slope * X + stone)
        assert np.mean(marks[stone > 0.25]) > 0.9
        assert not np.any(marks[stone == 0])


@pytest.mark.parametrize("slope", [0.0, 0.3])
def test_paths_along_a_slope_and_roofs_are_wide_however_steep_the_ground_beside_them(slope):
    terrace = np.where(X < 5.0, 0.8 * X, np.where(X < 6.8, 4.0, 4.0 + 0.8 * (X - 6.8)))
    roof = np.where((abs(X - 6) < 2.5) & (abs(Y - 6) < 2.5), 3.0, 0.0)
    for relief in (terrace + slope * Y, roof + slope * X):
        marks = find_standing(relief.astype(np.float32), BODY, Grid(), width=2.6, least=0.25)
        assert marks.mean() < 0.015  # a disc does not reach into the corners of a roof


def thinned(heights, density, seed):
    """Leave the pixels that a survey of so many points per m2 fills."""
    empty = np.random.default_rng(seed).random(heights.shape) < np.exp(-density * 0.2**2)
    return np.where(empty, np.nan, heights)


@pytest.mark.parametrize("density", [np.inf, 20, 6])
def test_relief_does_not_stand(density):
    waves = 0.2 * np.sin(2 * np.pi * X / 2.0)  # 0.4 m high, 2 m long
    bank = np.where(X > 6.0, 0.5, 0.0)
    ditch = np.where(np.abs(X - 6.0) < 0.7, -0.5, 0.0)
    swell = 0.3 * np.exp(-((X - 6) ** 2 + (Y - 6) ** 2) / 2 / 0.6**2)
    hills = 2.0 * np.sin(2 * np.pi * X / 24.0) * np.cos(2 * np.pi * Y / 20.0)
    dense_alone = (waves, hills) if density == np.inf else ()
    for relief in (bank, ditch, swell, 1.0 * X, *dense_alone):
        assert not any(np.any(marks_of(thinned(relief, density, seed))) for seed in range(20))


def test_missing_heights_are_neither_things_nor_foot_and_a_higher_belly_passes(rng):
    heights = boulder(6.0, 6.0, 0.6, 0.45)
    holes = rng.random(heights.shape) < 0.4
    marks = marks_of(np.where(holes, np.nan, heights))
    assert not np.any(marks[holes])
    assert np.all(marks[(heights > 0.25) & ~holes])
    assert not np.any(marks_of(np.full_like(heights, np.nan)))
    assert not np.any(marks_of(heights, VehicleBody(0.5, 1.4, 1.4, brush_stem_m=0.5)))


def test_points_of_a_boulder_that_was_taken_for_ground_make_an_obstacle_across_tiles():
    rng = np.random.default_rng(2)
    x, y = rng.uniform(0, 6, (2, 3600))
    stone = 0.45 * np.sqrt(np.maximum(0, 1 - ((x - 3.1) ** 2 + (y - 2.9) ** 2) / 0.6**2))
    # West of the origin, with indices of tiles below zero.
    z = 0.2 * x + stone + 0.01 * rng.normal(size=len(x))
    points = block_of(x - 48.0, y - 48.0, z, np.ones(len(x), bool))
    patches = measure(points, SETTINGS, ground_only=True)
    stack = find_objects(*take_off_standing(points, patches, BODY), BODY)
    assert np.all(stack.obstacle > 0)
    assert stack.obstacle.sum() * 9 == pytest.approx(np.pi * 0.6**2 * (1 - (0.25 / 0.45) ** 2), rel=0.4)
    assert stack.obstacle_height.max() == pytest.approx(0.45, abs=0.06)
    assert np.all(find_objects(points, patches, BODY).objects % SEEN != OBSTACLE)
    bare = replace(points, upward=0.2 * points.easting)
    apart, _ = take_off_standing(bare, measure(bare, SETTINGS, ground_only=True), BODY)
    assert np.all(apart.flag == 1)


def bare_tiles(ground, density):
    """Points of a block of 16 x 16 tiles, without classes: obstacles, tiles, and what is left without what stands."""
    rng = np.random.default_rng(3)
    x, y = rng.uniform(0, 48, (2, int(density * 48**2)))
    points = block_of(x, y, ground(x, y) + 0.01 * rng.normal(size=len(x)))
    patches = measure(points, SETTINGS, ground_only=False)
    found = find_in_relief(points, patches, BODY)
    return found[0].objects == OBSTACLE, patches, *leave_out_standing(points, patches, found, SETTINGS)


def test_beside_a_car_that_fills_half_a_tile_the_ride_is_that_of_the_ground():
    """What it hides is wider than the holes that are filled in a survey."""
    things, _, _, bare = bare_tiles(lambda x, y: 1.5 * ((x % 12 > 7.3) & (x % 12 < 9.1) & ((y - 3) % 12 < 4.4)), 60)
    filled = things.mean(axis=(1, 2))
    assert ((filled > 0.3) & (filled < 0.6)).any()
    assert bare.relief[filled < 0.6].max() < 0.25  # what is lower than the belly is left on it


def test_a_single_pixel_of_a_wall_stands_on_noisy_ground():
    rng = np.random.default_rng(4)
    heights = np.where(rng.random(X.shape) < 0.4, np.nan, 0.05 * rng.normal(size=X.shape)).astype(np.float32)
    places = np.s_[5::10, 5::10]
    heights[places] += 2.0
    marks = find_standing(heights, BODY, Grid(), width=2.6, least=0.25)
    known = np.isfinite(heights[places])
    assert known.sum() > 10
    assert marks[places][known].all()
    assert marks.sum() < 2 * known.sum()


def test_tiles_of_which_little_is_left_or_where_the_vehicle_fits_nowhere_stay_as_they_are():
    # Of some tiles of a chequered field, one half stands on the other.
    things, patches, _, bare = bare_tiles(lambda x, y: 1.0 * ((x // 2.1 + y // 2.1) % 2 < 1), 60)
    left = bare.coverage < patches.coverage
    assert things.any(axis=(1, 2)).sum() > left.sum() > 0
    np.testing.assert_array_equal(bare.relief_map[~left], patches.relief_map[~left])
    assert np.isfinite(bare.relief).all()
    # Rubble.
    things, patches, _, bare = bare_tiles(lambda x, y: 0.25 * np.sin(9 * x) * np.sin(8 * y), 60)
    assert things.mean() > 0.1
    stays = (bare.relief_map == patches.relief_map).all(axis=(1, 2))
    assert stays.mean() > 0.98  # in the outermost tiles, fewer things are seen
    # A terrace of 2 m and more, cut by the edge of the block.
    things, patches, _, bare = bare_tiles(lambda x, y: 0.1 * x + 0.03 * np.sin(2 * y) + 1.0 * (x > 46.0), 60)
    assert not things.any()
    np.testing.assert_array_equal(bare.relief_map, patches.relief_map)


@pytest.mark.parametrize(("height", "reason"), [(2.0, 0), (-2.0, 5)])
def test_a_few_points_of_a_wall_that_ends_in_a_tile_are_no_noise_but_points_below_the_ground_are(height, reason):
    """Strays of the tile east of a wall's end, where they lie beside it."""
    rng = np.random.default_rng(5)
    x, y = rng.uniform(0, 6, (2, 20 * 36))
    on_wall = (np.abs(y - 4.5) < 0.15) & (x < 3.0)
    corner = np.array([[3.02, 4.45], [3.25, 4.5], [3.48, 4.55]])  # pixels beside one another, the first beside the wall
    z = np.concatenate([0.01 * rng.normal(size=len(x)) + 2.0 * on_wall, np.full(3, height)])
    points = block_of(np.append(x, corner[:, 0]), np.append(y, corner[:, 1]), z)
    patches = measure(points, SETTINGS, ground_only=False)
    tile = (patches.col == 1) & (patches.row == 1)
    assert patches.reason[tile] == 5
    _, bare = leave_out_standing(points, patches, find_in_relief(points, patches, BODY), SETTINGS)
    assert bare.reason[tile] == reason


# ---- solids on made-up ground that are seen only from above are closed; level ground and that under crowns is not ----


BY_NAME = {scene.name: seen_from_above(scene) for scene in SCENES}


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
        middle = 0.2 * (np.arange(len(image)) + 0.5)
        x, y = Place(20.0 * seed).in_scene(*np.meshgrid(west + middle, south + middle[::-1]))
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


pytestmark = pytest.mark.usefixtures("without_views")

needs_filter = pytest.mark.skipif(importlib.util.find_spec("CSF") is None, reason="no cloth-simulation-filter")
CORNER = np.array([480_000.0, 4_000_032.0, 300.0])
"""Of a block."""


@pytest.fixture(autouse=True)
def _rested():
    yield
    close_filter()


@pytest.fixture(scope="module")
def wood():
    """Points of 96 m x 48 m on a grid of 1 / 1024 m, and which of them are ground.

    Rough in the east half, under crowns that begin 3 m above the ground, in every other strip of 12 m.
    """
    rng = np.random.default_rng(5)
    n = 160_000
    x, y = rng.uniform(0.01, 95.99, n), rng.uniform(0.01, 47.99, n)
    ground = 0.03 * x + 0.16 * np.sin(4 * x) * np.sin(5 * y) * (x > 48) + 0.004 * rng.normal(size=n)
    crown = (x // 12 % 2 == 1) & (rng.random(n) < 0.4)
    z = ground + crown * rng.uniform(3, 9, n)
    return np.round(np.column_stack([x, y, z]) * 1024) / 1024, ~crown


def write(path, points):
    return write_las(path, *(points + CORNER).T, offset=CORNER, scales=np.full(3, 1 / 1024))


def run(*arguments, code=0):
    with alike_surveys():
        return small_surveys.run(*arguments, code=code)


@pytest.fixture(scope="module")
def mapped(wood, tmp_path_factory):
    """Folder of the layers of the wood that the cloth gives."""
    folder = tmp_path_factory.mktemp("wood")
    survey = write(folder / "wood.las", wood[0])
    run("map", survey, "--ground", "csf", "--out", folder / "csf")
    return folder


def standing(folder):
    """Where obstacles are, by tile and pixel."""
    pixels = band(folder / "rasters/obstacle.tif") == OBSTACLE
    return pixels.reshape(len(pixels) // 15, 15, -1, 15).swapaxes(1, 2)


@needs_filter
def test_the_map_under_trees_is_that_of_the_ground_alone(wood, mapped):
    points, is_ground = wood
    alone = write(mapped / "ground.las", points[is_ground])
    for survey, name in ((alone, "alone"), (mapped / "wood.las", "everything")):
        run("map", survey, "--ground", "all", "--out", mapped / name)
    class_id, wanted = (band(mapped / name / "rasters/class.tif") for name in ("csf", "alone"))
    c_r, wanted_c_r = (band(mapped / name / "rasters/roughness.tif", "c_r") for name in ("csf", "alone"))
    assert class_id.shape == (16, 32)
    np.testing.assert_array_equal(class_id, wanted)
    # Without other points, a narrow hump of the ground may be a thing that the ride is rated without.
    bare = ~standing(mapped / "alone").any(axis=(2, 3))
    assert bare.mean() > 0.9
    np.testing.assert_allclose(c_r[bare], wanted_c_r[bare], rtol=5e-3)  # the noise of thin tiles is that of all
    assert set(np.unique(wanted)) >= {0, 2}  # nothing would be held were it all of one class
    # Crowns are part of the relief where nobody takes them away: what stands out of it bars the way.
    assert (band(mapped / "everything/rasters/barred.tif")[:, 4:8] != Barred.NO).all()
    assert standing(mapped / "everything")[:, 4:8].mean() > 0.5
    assert (wanted[:, 4:8] == 0).all()


@pytest.mark.slow
@needs_filter
def test_no_order_of_the_points_and_no_budget_changes_a_byte(wood, mapped, tmp_path, monkeypatch):
    survey = write(tmp_path / "other.laz", np.random.default_rng(3).permutation(wood[0]))
    monkeypatch.setattr(Budget, "chunk_points", 9_000)
    monkeypatch.setattr(Budget, "waiting_points", 30_000)
    run("map", survey, "--ground", "csf", "--out", tmp_path / "csf", "--threads", 3)
    assert layers_of(tmp_path / "csf") == layers_of(mapped / "csf")


@needs_filter
def test_neither_the_environment_nor_the_place_on_earth_changes_a_mark(wood, monkeypatch):
    """With more than one thread the filter gives other marks each time; both places are exact in binary."""
    points = wood[0].copy()
    points[:, 2] += np.random.default_rng(1).exponential(1.0, len(points))  # bushes, so that marks are in doubt
    points = np.round(points * 1024) / 1024

    def marks(place):
        block = block_of(*(points + place).T)
        there = np.column_stack([block.easting, block.northing, block.upward]) - place
        return np.column_stack([there, mark_ground(block, CsfSettings())])[np.lexsort(there.T)]

    expected = marks(np.zeros(3))
    np.testing.assert_array_equal(marks(CORNER), expected)
    for threads in ("1", "4"):
        close_filter()
        monkeypatch.setenv("OMP_NUM_THREADS", threads)
        for _ in range(2):
            np.testing.assert_array_equal(marks(np.zeros(3)), expected)


@needs_filter
def test_settings_reach_the_filter(wood):
    """A cloth that marks all within 20 m leaves nothing out; one of 1 cm leaves out what waves rise above it."""
    block = block_of(*wood[0].T)
    everything = mark_ground(block, CsfSettings(class_threshold=10.0))
    usual, little = (mark_ground(block, CsfSettings(class_threshold=limit)) for limit in (0.5, 0.01))
    assert everything.all()
    assert little.sum() < 0.5 * usual.sum()
    assert (usual | ~little).all()


@needs_filter
def test_a_block_may_hold_next_to_nothing():
    for points in (1, 2, 3):
        marks = mark_ground(block_of(*np.arange(3.0 * points).reshape(-1, 3).T), CsfSettings())
        assert marks.shape == (points,)
        assert marks.any()


@needs_filter
def test_a_filter_that_died_is_told_and_replaced(wood):
    block = block_of(*wood[0].T)
    marks = mark_ground(block, CsfSettings())
    (child,) = cloth.idle
    child.process.kill()
    child.process.wait()
    with pytest.raises(UsageError, match=r"was ended by SIGKILL.*lower `memory`"):
        mark_ground(block, CsfSettings())
    np.testing.assert_array_equal(mark_ground(block, CsfSettings()), marks)


@needs_filter
def test_a_boulder_goes_as_a_tree_does_and_is_an_obstacle(tmp_path):
    rng = np.random.default_rng(2)
    x, y = rng.uniform(0.01, 47.99, (2, 150_000))
    far = np.hypot(x - 22.5, y - 22.5) / 0.5
    points = np.column_stack([x, y, 2.0 * np.sqrt(np.maximum(0, 1 - far**2)) + 0.004 * rng.normal(size=len(x))])
    survey = write(tmp_path / "boulder.las", np.round(points * 1024) / 1024)
    for ground in ("all", "csf"):
        run("map", survey, "--ground", ground, "--out", tmp_path / ground)
        assert standing(tmp_path / ground)[8, 7].mean() == pytest.approx(np.pi * 0.5**2 / 9, rel=0.3)
        assert band(tmp_path / ground / "rasters/class.tif")[8, 7] <= 1  # the ride is that of the ground beside it
    obstacle, height = (band(tmp_path / "csf/rasters/roughness.tif", name) for name in ("obstacle", "obstacle_height"))
    assert obstacle[8, 7] == pytest.approx(np.pi * 0.5**2 / 9, rel=0.2)  # its top too, which is higher than the vehicle
    assert height[8, 7] == pytest.approx(1.38, abs=0.1)  # up to that of the vehicle


@needs_filter
def test_blocks_that_would_be_shared_out_or_are_too_large_for_the_cloth_are_refused(mapped, tmp_path, monkeypatch):
    monkeypatch.setattr(Budget, "block_points", 50_000)
    result = run("map", mapped / "wood.las", "--ground", "csf", "--out", tmp_path / "csf", code=2)
    assert "--ground csf takes squares of 48 m as a whole" in result.output
    assert "room for 50,000. Raise --memory" in result.output
    require_filter(CsfSettings(), Grid(15.0))
    with pytest.raises(UsageError, match=r"blocks are 320 m wide, it must be at least 0.64 m"):
        require_filter(CsfSettings(), Grid(20.0))


def test_without_the_filter_the_user_is_told_what_to_install(wood, tmp_path, monkeypatch):
    monkeypatch.setattr(cloth.importlib.util, "find_spec", lambda _: None)
    survey = write(tmp_path / "wood.las", wood[0][:5000])
    assert install_command("csf") in run("map", survey, "--ground", "csf", "--out", tmp_path / "csf", code=2).output
    assert not (tmp_path / "csf").exists()
