"""Ways through tiles: made-up mosaics of pixels, closed forms, and any division into blocks."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from bumpymap.core.types import CANOPY, FREE, OBSTACLE, UNDECIDED, UNSEEN, Barred, VehicleBody
from bumpymap.rating.passable import close_split_tiles, find_passable, free_areas, settle_objects

PIXELS = 15
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
