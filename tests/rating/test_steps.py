"""Steps of the ground and what they leave of a tile; ways through tiles of made-up mosaics, for any cut into blocks."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import PIXELS, TILE_SIZE, Wall, crossed, mosaic
from scipy import ndimage
from scipy.ndimage import distance_transform_edt
from scipy.stats import binned_statistic_2d

from bumpymap.core import CANOPY, FREE, OBSTACLE, UNDECIDED, UNSEEN, BadInputError, Barred, VehicleBody, loops
from bumpymap.rating import THIN_COLUMNS, Calibration, crossing_fails, find_steps
from bumpymap.rating.passable import close_split_tiles, find_passable, free_areas, settle_objects
from bumpymap.rating.steps import STEP_COLUMNS, apply_steps, closing_height, edge_usable, rate_beside_steps

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


ROWS, COLS = np.indices((PIXELS, PIXELS))
NOTHING = np.zeros((1, PIXELS, PIXELS), bool)
WORST = np.array([0.9], np.float32), np.array([1.0], np.float32)


def rated(heights, line, noise=0.0):
    rng = np.random.default_rng(3)
    thin = np.full((1, len(THIN_COLUMNS)), np.nan, np.float32)
    own = {"points": 225.0, "squares": 2.0 * noise**2 * 500, "pairs": 500.0}
    thin[0, [THIN_COLUMNS.index(name) for name in own]] = list(own.values())
    noisy = (heights + rng.normal(0, noise, heights.shape))[None].astype(np.float32)
    return rate_beside_steps(noisy, line[None], NOTHING, WORST, thin, SHIPPED)


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("slope", [0.0, 0.2])
def test_beside_a_drop_the_ground_is_as_good_as_it_is(noise, slope):
    heights = np.where(COLS < 3, -1.2, 0.0) + slope * 0.2 * ROWS
    closed, c_r, p_fail = rated(heights, COLS == 2, noise)
    assert not closed.any()
    assert p_fail[0] < 0.1
    assert c_r[0] < (0.03 if noise == 0.0 else 0.1)


def test_what_is_too_steep_or_fails_stays_closed():
    steep = rated(np.where(COLS < 3, -1.2, 0.0) + 0.2 * np.tan(np.radians(40)) * ROWS, COLS == 2)
    blocks = np.where(COLS < 3, -1.2, 0.5 * ((ROWS // 3 + COLS // 3) % 2))
    failing = rated(blocks, COLS == 2)
    for closed, c_r, p_fail in (steep, failing):
        assert closed[0, :, 6:].all()
        assert np.isnan([c_r[0], p_fail[0]]).all()


def test_the_larger_of_two_rests_is_open_and_the_ditch_is_not_asked_for():
    """A ditch of 1 m, of whose floor 0.2 m lie apart from its sides: nothing can stand there."""
    heights = np.where((COLS > 3) & (COLS < 9), -1.0, 0.0)
    closed, _, p_fail = rated(heights, (COLS == 3) | (COLS == 9))
    assert closed[0, :, 6].all()
    assert not closed[0, :, 14].any()
    assert p_fail[0] < 0.1


def test_the_nearest_mark_is_that_of_a_distance_transform():
    marks = np.random.default_rng(5).random((40, PIXELS, PIXELS)) < np.linspace(0.01, 0.5, 40)[:, None, None]
    marks = np.concatenate([marks[marks.any(axis=(1, 2))], NOTHING])
    place, square = (np.empty(marks.shape, np.int32) for _ in range(2))
    loops.find_nearest(marks, place, square)
    for tile, own, far in zip(marks[:-1], place, square, strict=False):
        distance, (row, col) = distance_transform_edt(~tile, return_indices=True)
        np.testing.assert_array_equal(own, PIXELS * row + col)
        np.testing.assert_allclose(np.sqrt(far), distance)
    assert (place[-1] == -1).all()


BODY = VehicleBody(clearance_m=0.25, height_m=1.4, width_m=1.0, brush_stem_m=0.25)  # with margins 1.2 m: 6 pixels


def judged(inner, *, edges=None, known=True, too_steep=False, fails=False, ring=FREE, body=BODY):
    """What bars the tiles of ``inner`` (pixels), with a ring of tiles of one state."""
    tiles = len(inner) // PIXELS
    objects = np.pad(inner, PIXELS, constant_values=ring)
    alone = np.broadcast_to(barred_alone(known, too_steep, fails), (tiles, tiles))
    usable = np.ones((tiles, tiles, 4), bool) if edges is None else edges
    return find_passable(objects, alone, usable, body, 3.0)


def barred_alone(known, too_steep, fails):
    reasons = [Barred.UNKNOWN, Barred.SLOPE, Barred.FAILS]
    return np.select([np.logical_not(known), too_steep, fails], reasons, Barred.NO).astype(np.uint8)


def free(tiles=1):
    return np.full((tiles * PIXELS, tiles * PIXELS), FREE, np.uint8)


def only(found):
    assert found.shape == (1, 1)
    assert found.dtype == np.uint8
    return Barred(int(found[0, 0]))


def test_obstacles_and_missing_tiles_around_count():
    # A wall in the neighbouring tiles, all around: the middle keeps 0.6 m from it, and reaches no side.
    for ring, reason in ((OBSTACLE, Barred.OBSTACLE), (UNSEEN, Barred.LITTLE_SEEN)):
        assert only(judged(free(), ring=ring)) == reason
        inner = judged(free(3), ring=ring) == Barred.NO
        assert inner.tolist() == [[True] * 3] * 3


def test_the_first_reason_that_holds_is_named():
    wall = np.full_like(free(), OBSTACLE)
    everything = {"known": False, "too_steep": True, "fails": True, "edges": np.zeros((1, 1, 4), bool)}
    order = [Barred.UNKNOWN, Barred.SLOPE, Barred.FAILS, Barred.OBSTACLE, Barred.STEP]
    changes = [{"known": True}, {"too_steep": False}, {"fails": False}]
    for wanted, change in zip(order[:3], changes, strict=True):
        assert only(judged(wall, **everything)) == wanted
        everything |= change
    assert only(judged(wall, **everything)) == Barred.OBSTACLE
    assert only(judged(free(), **everything)) == Barred.STEP


def test_undecided_pixels_need_company_across_the_border():
    objects = free(2)
    objects[3, 14] = objects[4, 15] = UNDECIDED  # neighbours, over the border between two columns of tiles
    objects[9, 14] = UNDECIDED  # alone
    objects[20, 14], objects[21, 15] = UNDECIDED, OBSTACLE
    objects[25, 14] = objects[26, 14] = UNDECIDED  # neighbours in one tile: together still too few
    settled = settle_objects(objects, PIXELS)
    assert np.argwhere(settled == OBSTACLE).tolist() == [[3, 14], [4, 15], [20, 14], [21, 15]]
    assert not np.any(settled == UNDECIDED)


@pytest.mark.parametrize("width", [0.3, 1.0, 1.7, 4.0])
def test_random_obstacles_bar_as_distances_and_regions_tell(width):
    rng = np.random.default_rng(int(10 * width))
    body = replace(BODY, width_m=width)
    inner = rng.choice([FREE, OBSTACLE, UNSEEN, CANOPY], (4 * PIXELS,) * 2, p=[0.97, 0.01, 0.005, 0.015])
    inner = inner.astype(np.uint8)
    usable = rng.random((4, 4, 4)) < 0.7
    found = judged(inner, edges=usable, body=body)
    objects = np.pad(inner, PIXELS, constant_values=FREE)
    radius = (0.5 * width + 0.1) * 5
    bad = np.isin(objects, (OBSTACLE, UNSEEN))
    open_ground = ndimage.distance_transform_edt(~bad) >= radius if bad.any() else ~bad
    near = ndimage.distance_transform_edt(objects != OBSTACLE) < radius
    for row, col in np.ndindex(4, 4):
        part = np.s_[(row + 1) * PIXELS : (row + 2) * PIXELS, (col + 1) * PIXELS : (col + 2) * PIXELS]
        # Over a corner, half the width must be free; a disc as small as a pixel may meet a diagonal line there.
        corners = radius**2 >= 2.0 and radius**2 - 0.5 >= (2.5 * width) ** 2
        regions, number = ndimage.label(open_ground[part], ndimage.generate_binary_structure(2, 1 + corners))
        least = 2 if bad[part].any() else 1
        sides = [{0: regions[0], 1: regions[:, -1], 2: regions[-1], 3: regions[:, 0]}[side] for side in range(4)]
        touched = np.array([[n in side for side in sides] for n in range(1, number + 1)], bool).reshape(-1, 4)
        passes = (touched & usable[row, col]).sum(axis=1) >= least
        blocked = not (touched.sum(axis=1) >= least).any()
        reason = Barred.OBSTACLE if near[part].any() else Barred.LITTLE_SEEN
        assert found[row, col] == (Barred.NO if passes.any() else reason if blocked else Barred.STEP)


def random_mosaic(rng, tiles):
    """Obstacles of all sizes on a mosaic: dots, and thin walls in any direction."""
    side = tiles * PIXELS
    objects = np.full((side, side), FREE, np.uint8)
    objects[rng.random((side, side)) < 0.002] = OBSTACLE
    for _ in range(tiles):
        r, c, angle, length = *rng.uniform(0, side, 2), rng.uniform(0, np.pi), rng.uniform(5, 60)
        along = np.arange(0, length, 0.4)
        row, col = (r + along * np.sin(angle)).astype(int), (c + along * np.cos(angle)).astype(int)
        kept = (row >= 0) & (row < side) & (col >= 0) & (col < side)
        objects[row[kept], col[kept]] = OBSTACLE
    return objects


def passage(objects, by_ground):
    """Barred and areas of the tiles of a mosaic without its two outermost."""
    alone = by_ground[1:-1, 1:-1]
    edges = np.ones((*alone.shape, 4), bool)
    barred = find_passable(objects, alone, edges, BODY, 3.0)
    areas = free_areas(objects, by_ground, barred, BODY, 3.0)
    return close_split_tiles(areas, barred, BODY, 3.0), areas[1:-1, 1:-1], barred


def distances(marked):
    """From the middle of each pixel to that of the nearest marked one, px; those of the tiles two from the rim."""
    inner = slice(2 * PIXELS, -2 * PIXELS)
    return ndimage.distance_transform_edt(~marked)[inner, inner]


@pytest.mark.parametrize("seed", range(12))
def test_steps_between_passable_tiles_are_ways_on_pixels(seed):
    rng = np.random.default_rng(seed)
    tiles = 12
    objects = random_mosaic(rng, tiles)
    by_ground = np.where(rng.random((tiles, tiles)) < 0.1, Barred.FAILS, Barred.NO).astype(np.uint8)
    barred, areas, _ = passage(objects, by_ground)
    free = distances(objects == OBSTACLE) >= 3.0
    ground = distances(np.repeat(np.repeat(by_ground != Barred.NO, PIXELS, 0), PIXELS, 1))
    found = areas.swapaxes(1, 2).reshape(free.shape) > 0
    assert not (found & ~(free & (ground >= 3.0))).any()
    assert found[free & (ground >= 4.0)].all()
    assert (barred == Barred.SPLIT).any()
    # The pieces in which passable tiles hang together lie each in one piece of the ground where the vehicle can be.
    pieces, count = ndimage.label(barred == Barred.NO, np.ones((3, 3)))
    around, _ = ndimage.label(found, np.ones((3, 3)))
    for piece in range(1, count + 1):
        largest = []
        for row, col in np.argwhere(pieces == piece):
            tile = around[row * PIXELS : (row + 1) * PIXELS, col * PIXELS : (col + 1) * PIXELS]
            largest.append(np.bincount(tile[tile > 0]).argmax())
        assert len(set(largest)) == 1


@pytest.mark.parametrize(("width", "walls", "pieces"), [(1.0, (-5, 5), 1), (0.2, (0,), 2)])
def test_pixels_that_touch_at_corners_are_joined_but_not_across_a_diagonal_line(width, walls, pieces):
    """Between two diagonal walls the middle of the vehicle has a diagonal line of pixels; a small one could slip
    through between the pixels of a diagonal wall."""
    objects = free(5)
    row, col = np.indices(objects.shape)
    objects[np.isin(col - row, walls)] = OBSTACLE
    areas = free_areas(
        objects, np.zeros((5, 5), np.uint8), np.zeros((3, 3), np.uint8), replace(BODY, width_m=width), 3.0
    )[1, 1]
    row, col = np.indices(areas.shape)
    between = np.abs(col - row) < 5
    assert len(np.unique(areas[between & (areas > 0)])) == pieces
    if pieces == 1:
        assert (areas[between] > 0).sum() == PIXELS  # a line, which hangs together by its corners alone


def test_areas_are_numbered_by_size_within_each_tile():
    inner = free(5)
    inner[:, 2 * PIXELS + 9] = OBSTACLE  # a wall through the tile in the middle, off its middle
    by_ground = np.zeros((5, 5), np.uint8)
    barred, areas, before = passage(inner, by_ground)
    assert only(areas.max(axis=(2, 3))) == 2
    assert (areas == 1).sum() > (areas == 2).sum() > 0
    assert only(before[1:-1, 1:-1]) == Barred.NO
    assert only(barred) == Barred.SPLIT
