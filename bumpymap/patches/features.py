"""Points of tiles in, measured patches out: heightmap, spread, z-variance, RANSAC residual, slope, reason.

Thinly surveyed tiles are measured from their points too, beyond their pixels; see ``docs/pages/measuring.md``. Objects
that stand on the ground or hang over it are found in the points that are no ground, by their height above it.

Some the ground filter has left standing, as it keeps what lies close to its cloth, up to half a metre above: boulders
and bushes lower than that are found in heightmaps. They belong to the relief, and are also in the way of a vehicle
whose belly is lower.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    DENSE_COVERAGE,
    EMPTY,
    HOLE_POINTS,
    HOLE_SHARE,
    LONE,
    OBSTACLE,
    OBSTACLE_SHARE,
    POINT_DECK,
    POINT_GROUND,
    POINT_OTHER,
    STEEP,
    THIN_SEEN,
    FeatureSettings,
    Mask,
    ObjectStack,
    PatchStack,
    Reason,
    VehicleBody,
    loops,
    within,
)
from bumpytiles import BLOCK_TILES, Grid, TilePoints, TileWindow

_SCALARS = 9
"""Numbers that are measured of a tile: z_min, z_max, z_variance, residual, slope, z_range, coverage, relief, strays."""
THIN = 0.4
"""Points on a pixel in a thin survey, at most; as in ``points_by_tile.hpp``."""


def measure(points: TilePoints, settings: FeatureSettings, *, ground_only: bool) -> PatchStack:
    """Measure the tiles of a block, one row a tile, in their order.

    ``points``: in canonical order; ``flag`` holds their kind. ``ground_only``: measure the points of the ground alone;
    tiles without any get reason ``NO_GROUND``.
    """
    grid = points.grid
    measured = _measured_points(points, ground_only=ground_only)
    count = np.diff(measured.starts)
    depth = max(1, round(settings.max_hole / grid.pixel_size))
    scalars, heights, variance, relief_map, pixel_count = _measured(measured, settings, depth)
    reason = _reasons(count, scalars, settings)
    relief_map[reason != Reason.OK] = np.nan
    z_min, z_max, z_variance, residual, slope, z_range, coverage, relief, _ = scalars.T.copy()
    return PatchStack(
        grid=grid,
        col=points.col,
        row=points.row,
        count=count,
        z_min=z_min,
        z_max=z_max,
        z_variance=z_variance,
        ransac_residual=residual,
        slope=slope,
        z_range=z_range,
        density=count / grid.tile_size**2,
        coverage=np.nan_to_num(coverage),
        heights=heights,
        spread_count=pixel_count,
        spread_variance=variance,
        relief_map=relief_map,
        relief=np.where(reason == Reason.OK, relief, np.nan),
        reason=reason,
    )


def _measured(points: TilePoints, settings: FeatureSettings, depth: int) -> tuple[NDArray[Any], ...]:
    """Measure n tiles; holes of up to ``depth`` pixels are filled.

    Returns (n, 9) scalars, NaN where a tile has no points or no plane; and (n, pixels, pixels) mean height [m],
    variance about the tile's plane [m^2], relief map [m] and points of each pixel.
    """
    shape = (len(points.col), points.grid.pixels, points.grid.pixels)
    heights, variance, relief = (np.empty(shape, np.float32) for _ in range(3))
    out = np.empty((shape[0], _SCALARS)), heights, variance, relief, np.empty(shape, np.int32)
    loops.measure_tiles(points, settings, depth, *out)
    return out


def choose_tiles(points: TilePoints, wanted: NDArray[np.bool_]) -> TilePoints:
    """Return some tiles with their points."""
    count = np.diff(points.starts)
    kept = np.repeat(wanted, count)
    arrays = {name: getattr(points, name)[kept] for name in ("easting", "northing", "upward", "flag")}
    starts = np.concatenate(([0], np.cumsum(count[wanted])))
    return replace(points, starts=starts, col=points.col[wanted], row=points.row[wanted], **arrays)


def _measured_points(points: TilePoints, *, ground_only: bool) -> TilePoints:
    """Return the points that are measured: all, or those of the ground alone."""
    if not ground_only or (ground := points.flag == POINT_GROUND).all():
        return points
    taken = np.flatnonzero(ground)
    place = {name: getattr(points, name)[taken] for name in ("easting", "northing", "upward")}
    return replace(points, starts=np.searchsorted(taken, points.starts), **place)


def _reasons(count: NDArray[np.int64], scalars: NDArray[np.float64], settings: FeatureSettings) -> NDArray[np.uint8]:
    """Why tiles cannot be judged: the first of no ground, too few points, outlier relief, too many holes; else 0."""
    coverage, relief, strays = scalars[:, 6], scalars[:, 7], scalars[:, 8]
    return np.select(
        [
            count == 0,
            count < settings.min_points,
            strays > settings.stray_share * count,
            np.isnan(relief) | (coverage < settings.min_coverage),
        ],
        [Reason.NO_GROUND, Reason.TOO_FEW_POINTS, Reason.OUTLIER_RELIEF, Reason.TOO_MANY_HOLES],
        Reason.OK,
    ).astype(np.uint8)


def join_stacks(stacks: Sequence[PatchStack]) -> PatchStack:
    """Put stacks of one grid (at least one) together; tiles keep their order."""
    names = [f.name for f in fields(PatchStack) if f.name != "grid"]
    return PatchStack(stacks[0].grid, **{n: np.concatenate([getattr(stack, n) for stack in stacks]) for n in names})


_SEEN = 1
"""Column of the share of a tile's nine parts that hold a point."""
_MOST_POINTS = 128
"""Points of a thin tile whose pairs are measured: 8,128 pairs."""
_NOISE_POINTS = 32
"""Points of a dense tile whose pairs are measured: they only help to tell the noise."""
_CLOSE_PX = 1.0
"""Distance up to which points are a close pair, px."""
_PAIR_MEASURES = 5
"""Numbers that are measured of the pairs of a tile, see `measure_thin`."""


def measure_thin(
    points: TilePoints, patches: PatchStack, settings: FeatureSettings, *, ground_only: bool
) -> tuple[NDArray[np.float64], tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.float32]]]:
    """Measure the close pairs of points of n tiles, and the filled heightmaps of thin ones.

    ``patches``: the same tiles, measured by `measure`; ``settings``, ``ground_only``: as for that. Returns (n, 5):
    points used; share of the tile's nine parts that hold one; slope of the plane (tangent); sum of the squared
    differences of close pairs [m^2], and their number; NaN where the points span no plane. And three maps (n, pixels,
    pixels): plane-removed heights with all holes filled from their neighbours, however wide, m, NaN for tiles that are
    not thin; points of each pixel; variance of their heights about the plane, m^2.
    """
    grid = points.grid
    thin = (patches.coverage > 0) & (patches.coverage < DENSE_COVERAGE)
    limit = np.where(thin, _MOST_POINTS, _NOISE_POINTS)
    pairs, close = np.empty((len(points.col), _PAIR_MEASURES)), (_CLOSE_PX * grid.pixel_size) ** 2
    loops.measure_pairs(_measured_points(points, ground_only=ground_only), settings, limit, close, pairs)
    at_random = -np.expm1(-patches.count / patches.grid.pixels**2)
    clustered = patches.coverage < HOLE_SHARE * at_random
    real_holes = (patches.reason == Reason.TOO_MANY_HOLES) & (patches.count >= HOLE_POINTS) & clustered
    pairs[real_holes, _SEEN] = 0.0
    if settings.min_points > FeatureSettings().min_points:
        pairs[patches.count < settings.min_points] = np.nan
    shape = len(points.col), grid.pixels, grid.pixels
    relief_map, variance, count = (np.full(shape, fill, kind) for fill, kind in ((np.nan, "f4"), (0, "f4"), (0, "i4")))
    if thin.any():
        chosen = _measured_points(choose_tiles(points, thin), ground_only=ground_only)
        _, _, variance[thin], relief_map[thin], count[thin] = _measured(chosen, settings, grid.pixels)
    return pairs, (relief_map, count, variance)


_OBJECT_SCALARS = 4
"""Numbers of a tile beside the states of its pixels, see `ObjectStack`."""


def find_objects(points: TilePoints, patches: PatchStack, body: VehicleBody) -> ObjectStack:
    """Find obstacles and canopy in tiles whose ground is known point by point.

    The height of a point counts from the ground beneath it: the heightmap, continued by a plane and the nearest heights
    where no ground was seen. A pixel is an obstacle if it holds a point from the belly (or the height of the plants
    that the vehicle brushes aside) up to the vehicle's height, or one of a building, however high, and its 3 x 3 pixels
    hold two points from there upward; so under a crown, whose leaves hide the trunk, one is enough. In surveys of more
    than 278 points/m2 it takes 2 % of the points that 3 x 3 pixels have on average. Pixels with as many higher points
    are canopy. It hides the ground if its points outweigh those beneath, three to one, in a part of a square or of a
    strip that they lie along, by more than chance has where half of the pulses get through; the strip is as long as it
    takes at the density of the tile, which may be 3 m. In tiles with less than three pixels of ground everything that
    is seen is an obstacle.

    ``points``: all points of n tiles, in canonical order; ``flag`` holds their kind. ``patches``: the same tiles,
    measured from the ground points alone. Returns one row a tile, before its neighbours are known. `settle_solids`
    decides what is overhead and what holds no point; pixels at a tile's border whose points would make an obstacle only
    with company from the neighbour are ``UNDECIDED``, see `bumpymap.rating.settle_objects`.
    """
    tiles, pixels = len(points.col), points.grid.pixels
    state = np.empty((tiles, pixels, pixels), np.uint8)
    scalars = np.empty((tiles, _OBJECT_SCALARS))
    loops.find_in_tiles(
        points, np.ascontiguousarray(points.flag, np.uint8), patches, body, OBSTACLE_SHARE, state, scalars
    )
    return ObjectStack(state, *scalars.T.astype(np.float32))


def settle_solids(objects: NDArray[np.uint8], grid: Grid, max_hole: float) -> NDArray[np.uint8]:
    """Decide by the pixels around them what is overhead, what was not seen, and which single points are a line.

    - Canopy is an obstacle if part of it hides the ground (`find_objects`) and no ground is seen beneath. Ground lies
      beneath if canopy is met on all sides of it: beside a wall, in its corner, and between two vans, it is not.
    - A pixel without points belongs to the nearest with points: what is believed free was seen free.
    - Points in a line with gaps of up to six pixels are one obstacle.

    ``objects`` (rows, cols): states from `find_objects`, tiles side by side, north row first; ``UNSEEN`` where a tile
    is missing. ``max_hole``: farther than this from every point a pixel is unseen, m; in thin surveys, than the radius
    of a disc that holds 8 points on average. Returns uint8 (rows, cols): ``FREE``, ``OBSTACLE``, ``CANOPY``,
    ``UNSEEN``, and ``UNDECIDED``; in the outer ring of tiles as good as the ring tells.
    """
    objects = np.ascontiguousarray(objects)
    out = np.empty_like(objects)
    loops.settle_solids(objects, grid.pixels, max_hole / grid.pixel_size, out)
    return out


_WIDTH = 1.8
"""Width of what the ground filter may have left, m; wider objects are above its threshold."""
_WIDEST = 2.6
"""Width of an object that stands on relief, m: a van, up to 0.3 m off the grid of the pixels."""
_HOLLOW = 1.8
"""Width of a ditch of which the sides are no walls, m; those of a wider one are ground at another level."""
_RAISED = 0.5
"""Height of the sides above the ground, as a share of the lowest obstacle."""
_DROP, _REACH = 0.8, 0.3
"""A side drops by this share of the lowest obstacle within this reach, m."""
_SPREAD = 0.7
"""Spread of the points of a pixel that no slope has, as a share of the lowest obstacle."""
_LEAST_DISC = 1.5
"""Radius of a disc that holds the eight pixels around one, px."""
_STEEP = 0.3
"""Share of the raised pixels that lie so close to the foot of a side, at least: a swell of the ground has none."""
_AROUND = 1.5
"""Radius of the square in which they are counted, as a multiple of that of the widest object."""

_LEAST_PIXELS = 15
"""With fewer pixels of ground a tile does not show its standing objects."""
_LOW = 3.0
"""Strays so far above the vehicle may be the top of a wall, m."""
_BENEATH = 0.5
"""Ground so far beneath the lowest point of a bridge deck in its pixel is not that of the deck, m."""

Mosaic = NDArray[np.float32]


class StandingLimits(NamedTuple):
    """Sizes of objects; heights are as single precision has them, like the heights that they are compared with."""

    width: float
    """Radius of the disc that touches the surface beneath objects, px."""
    foot: float
    """Farthest from a side to its foot, px; more where too few pixels so close are known."""
    raised: float
    """Pixels so high above that surface are those of objects, m."""
    drop: float
    """Drop at a side, m."""
    least: float
    """Pixels of objects that are lower are left out, m."""
    share: float
    """Share of the raised pixels around one that lie on sides, at least."""
    around: int
    """Farthest of these along a row or column, px."""
    pixels: int
    """Pixels along a side of a tile."""


ReliefObjects = tuple[ObjectStack, Mask, Mask]
"""Objects that stand on n tiles where all points count as ground: the stack; (n, pixels, pixels) pixels with a narrow,
steep object, or beside one; (n,) True where the middle of the vehicle fits somewhere between such objects."""


def take_off_standing(
    points: TilePoints, patches: PatchStack, body: VehicleBody
) -> tuple[TilePoints, PatchStack]:  # fmt: skip
    """Take the pixels that stand out of the ground for no ground, so that `find_objects` sees what is in them.

    ``points``: all points of one block; ``flag`` holds their kind. ``patches``: the same tiles, measured from the
    ground points. Returns both, the points in such pixels as no ground, and NaN for their ``heights``.
    """
    at = BLOCK_TILES - 1 - patches.row % BLOCK_TILES, patches.col % BLOCK_TILES
    mosaic = _mosaic(patches.heights, at, (BLOCK_TILES, BLOCK_TILES))
    standing = _of_tiles(find_standing(mosaic, body, points.grid), at, points.grid.pixels)
    heights = np.where(standing, np.float32(np.nan), patches.heights)
    return _points_apart(points, standing), replace(patches, heights=heights)


def find_in_relief(
    points: TilePoints, patches: PatchStack, body: VehicleBody, around: Mapping[str, NDArray[Any]] | None = None
) -> ReliefObjects:
    """Find standing objects on tiles where all points count as ground.

    Narrow, steep objects in the relief are obstacles. Other pixels whose points lie far above one another hold a part
    of a fence, or the side of a wall: `settle_solids` makes two side by side, or a line of them, an obstacle. But the
    sides of a narrow ditch, over which a wheel rolls, are none; what it does in a wide one, the steps and the ride of
    its tile tell. In tiles of fewer than 10 points/m2 an object may have so few points that they are strays: at the
    height of the vehicle they are ``LONE``, which `settle_solids` closes. The other pixels with points are ``FREE``; of
    the tile as a whole nothing is known.

    ``points``: all points of n tiles; ``patches``: the same tiles, measured from all points; ``around``: ``col``,
    ``row`` and ``heights`` of these tiles and of those up to `relief_margin` tiles around them: beyond it nothing has a
    part in what is found. Without, nothing lies around them.
    """
    stack = ObjectStack.empty(*patches.heights.shape[:2])
    grid, objects = patches.grid, stack.objects
    objects[patches.spread_count == 0] = EMPTY
    steep = patches.spread_variance > (_SPREAD * body.lowest_obstacle_m) ** 2
    standing, near, in_hollow = (np.zeros(patches.heights.shape, np.bool_) for _ in range(3))
    has_room = np.ones(len(standing), np.bool_)
    around = around or {name: getattr(patches, name) for name in ("col", "row", "heights")}
    for tiles, mosaic, at in _mosaics(patches, around, relief_margin(grid)):
        if steep[tiles].any():
            hollow = find_standing(-mosaic, body, grid, width=_HOLLOW)
            in_hollow[tiles] = _of_tiles(_with_neighbours(hollow), at, grid.pixels)
        found = find_standing(mosaic, body, grid, width=_WIDEST, least=body.lowest_obstacle_m)
        if found.any():
            standing[tiles] = _of_tiles(found, at, grid.pixels)
            near[tiles] = _of_tiles(_with_neighbours(found), at, grid.pixels)
            closed = within(found, 0.5 * body.width_m / grid.pixel_size)
            has_room[tiles] = ~_of_tiles(closed, at, grid.pixels).all(axis=(1, 2))
    objects[steep & ~in_hollow] = STEEP
    objects[standing] = OBSTACLE
    has_strays = patches.spread_count.sum(axis=(1, 2)) < patches.count
    for t in np.flatnonzero(has_strays).tolist():
        _mark_strays(t, points, patches, body, objects[t], near[t])
    return stack, near, has_room


def relief_margin(grid: Grid) -> int:
    """Return how many tiles around a tile have a part in its standing objects, at most a block.

    The square around a pixel, and what lies beneath each pixel in it; or the foot of its side, and the slope there, in
    which one tile more has a part.
    """
    disc = max(0.5 * _WIDEST, _LEAST_DISC * grid.pixel_size)
    beneath, side = (2.0 + _AROUND) * disc, _AROUND * disc + loops.FARTHEST_FOOT * grid.pixel_size
    return min(max(math.ceil(beneath / grid.tile_size), 1 + math.ceil(side / grid.tile_size)), BLOCK_TILES)


def _mark_strays(
    t: int, points: TilePoints, patches: PatchStack, body: VehicleBody, states: NDArray[np.uint8], near: Mask
) -> None:
    """Mark the pixels of strays at the height of the vehicle as ``LONE``, and in a thin tile ``near`` around them."""
    known = np.isfinite(patches.heights[t])
    if known.sum() < _LEAST_PIXELS:
        return
    row, col, ground, above = _above_plane(t, points, patches, known)
    held, found = np.zeros(states.shape, np.int64), np.zeros(states.shape, np.bool_)
    np.add.at(held, (row, col), 1)
    # In a dense tile they close only what lies in a line with others, such as the top of a wall.
    is_thin = -np.log1p(-np.minimum(np.mean(states != EMPTY), 0.99)) < THIN  # as `settle_solids` takes for thin
    strays = (above > max(ground.max(), body.lowest_obstacle_m)) & (above <= body.height_m + (0.0 if is_thin else _LOW))
    strays &= (held > patches.spread_count[t])[row, col]
    found[row[strays], col[strays]] = True
    states[found & (states != OBSTACLE)] = LONE
    if is_thin:
        near |= _with_neighbours(found)


def leave_out_standing(
    points: TilePoints, patches: PatchStack, objects: ReliefObjects, settings: FeatureSettings
) -> tuple[TilePoints, PatchStack]:
    """Leave standing objects out of tiles, so that the ride is that of their ground.

    A tile of which too little is left to be rated stays as it is, and so does one in which the vehicle fits nowhere
    between objects: that is rough ground. Strays beside an object are no noise, but the few points of it that a tile
    has at its edge.

    ``points``: all points of n tiles; all count as ground. ``patches``: the same tiles, measured; ``objects``: of
    `find_in_relief`. Returns the points, all of them ground but those of objects in thin tiles, which are rated from
    their points; and the patches without the pixels of objects: in all but ``heights`` and what describes all points
    (lowest and highest point, variance, residual, range, density).
    """
    points = replace(points, flag=np.full(len(points.flag), POINT_GROUND, np.uint8))
    stack, near, has_room = objects
    points, patches = _without_strays(points, patches, near, settings)
    standing = (stack.objects == OBSTACLE) & has_room[:, None, None]
    if not standing.any():
        return points, patches
    # As in `measure_thin`: a larger number than usual holds for thin tiles too.
    least = max(_LEAST_PIXELS, settings.min_points * (settings.min_points > FeatureSettings().min_points))
    changed = {name: getattr(patches, name).copy() for name in ("spread_count", "spread_variance", "relief_map")}
    bare, side = replace(patches, **changed), patches.grid.tile_size
    scalars, is_bare = np.empty((len(standing), 4)), np.empty(len(standing), np.bool_)
    loops.leave_out_objects(standing, bare, side, settings, least, THIN_SEEN, scalars, is_bare)
    _, coverage, relief, slope = scalars.T
    bare = replace(
        bare,
        count=np.where(is_bare, bare.spread_count.sum(axis=(1, 2)), patches.count),
        coverage=np.where(is_bare, coverage, patches.coverage),
        relief=np.where(is_bare & np.isfinite(bare.relief_map[:, 0, 0]), relief, patches.relief),
        slope=np.where(is_bare & np.isfinite(slope), slope, patches.slope),
    )
    is_thin = is_bare & (patches.coverage < DENSE_COVERAGE)
    return _points_apart(points, standing & is_thin[:, None, None]), bare


def _without_strays(
    points: TilePoints, patches: PatchStack, near: Mask, settings: FeatureSettings
) -> tuple[TilePoints, PatchStack]:
    """Measure tiles again that are unknown because of strays, if all of these lie near objects and above the ground."""
    asked = np.flatnonzero((patches.reason == Reason.OUTLIER_RELIEF) & near.any(axis=(1, 2)))
    if not len(asked):
        return points, patches
    flag, kept = points.flag.copy(), []
    for t in asked.tolist():
        known = np.isfinite(patches.heights[t]) & ~near[t]
        if known.sum() < _LEAST_PIXELS:
            continue
        row, col, ground, above = _above_plane(t, points, patches, known)
        low, high = ground.min() - 0.5 * settings.stray_gap, ground.max() + 0.5 * settings.stray_gap
        strays = np.zeros(near.shape[1:], np.bool_)
        strays[row[above > high], col[above > high]] = True
        if (above >= low).all() and not (strays & ~_reached(near[t], strays)).any():
            flag[points.starts[t] : points.starts[t + 1]][above > high] = POINT_OTHER
            kept.append(t)
    points = replace(points, flag=flag)
    if not kept:
        return points, patches
    again = measure(choose_tiles(points, np.isin(np.arange(len(near)), kept)), settings, ground_only=True)
    replaced = {f.name: getattr(patches, f.name).copy() for f in fields(PatchStack) if f.name != "grid"}
    for name, values in replaced.items():
        values[kept] = getattr(again, name)
    return points, replace(patches, **replaced)


def _reached(near: Mask, strays: Mask) -> Mask:
    """Mark the pixels that are near an object, or beside strays that are."""
    reached = near
    while (more := reached | _with_neighbours(reached & strays)).sum() > reached.sum():
        reached = more
    return reached


def _above_plane(
    t: int, points: TilePoints, patches: PatchStack, known: Mask
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Fit a plane through some heights of a tile.

    Returns row and column of the pixel of each of its points, and the heights of those pixels and of the points above
    the plane, m.
    """
    part = np.arange(points.starts[t], points.starts[t + 1])
    row, col = _pixels_of(points, part, np.full(len(part), t))
    terms, height = np.stack([*np.nonzero(known), np.ones(known.sum())], axis=1), patches.heights[t][known]
    plane = np.linalg.lstsq(terms, height.astype(np.float64), rcond=None)[0]
    above = points.upward[part] - np.stack([row, col, np.ones(len(row))], axis=1) @ plane
    return row, col, height - terms @ plane, above


def _pixels_of(
    points: TilePoints, chosen: NDArray[np.int64], tile: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return row and column of the pixels of some points in their tiles."""
    grid = points.grid
    north = grid.pixel(points.northing[chosen], points.row[tile])
    return grid.pixels - 1 - north, grid.pixel(points.easting[chosen], points.col[tile])


def _points_apart(points: TilePoints, standing: Mask) -> TilePoints:
    """Return points of which those in marked pixels, (n, pixels, pixels), are no ground."""
    if not standing.any():
        return points
    tiles = np.repeat(np.arange(len(points.col)), np.diff(points.starts))
    asked = np.flatnonzero((points.flag == POINT_GROUND) & np.asarray(standing.any(axis=(1, 2)))[tiles])
    row, col = _pixels_of(points, asked, tiles[asked])
    flag = points.flag.astype(np.uint8)
    flag[asked] = np.where(standing[tiles[asked], row, col], POINT_OTHER, POINT_GROUND)
    return replace(points, flag=flag)


def decks_as_ground(points: TilePoints) -> TilePoints:
    """Return points whose bridge decks are ground; in their pixels what lies far beneath is none.

    A map has one ground: where a road leads over another, that is the upper one.
    """
    is_deck = points.flag == POINT_DECK
    if not is_deck.any():
        return points
    tiles, pixels = np.repeat(np.arange(len(points.col)), np.diff(points.starts)), points.grid.pixels
    ground = np.flatnonzero(is_deck | (points.flag == POINT_GROUND))
    row, col = _pixels_of(points, ground, tiles[ground])
    pixel, deck, height = (tiles[ground] * pixels + row) * pixels + col, is_deck[ground], points.upward[ground]
    lowest = np.full(len(points.col) * pixels * pixels, -np.inf)
    lowest[pixel[deck]] = np.inf
    np.minimum.at(lowest, pixel[deck], height[deck])
    flag = points.flag.astype(np.uint8)
    flag[ground] = np.where(height < lowest[pixel] - _BENEATH, POINT_OTHER, POINT_GROUND)
    return replace(points, flag=flag)


def find_standing(
    heights: Mosaic, body: VehicleBody, grid: Grid, *, width: float = _WIDTH, least: float = 0.0
) -> Mask:  # fmt: skip
    """Find narrow objects with steep sides in a heightmap.

    The surface beneath them is what a disc of ``width`` can touch from below (a morphological opening). Pixels that are
    more than half the height of the lowest obstacle above it are those of an object if at least 30 % of them, in a
    square around each, lie within 0.3 m of a place that is 80 % of that height lower, once the slope of the ground is
    taken off. Where fewer than eight pixels so close are known, the nearest eight count, up to four pixels away, if
    they are lower in proportion to their distance.

    ``heights`` (rows, cols): mean height of the ground in each pixel, m; NaN where none is known; whole tiles, side by
    side. ``width``: what is narrower stands on the ground, m; what is wider is ground at another level. ``least``: what
    of an object is lower than this is left out, m. Returns bool (rows, cols): True in the pixels of such objects.
    """
    disc, foot = (max(_LEAST_DISC, side / grid.pixel_size) for side in (0.5 * width, _REACH))
    belly = body.lowest_obstacle_m
    raised, drop, lowest = (float(np.float32(limit)) for limit in (_RAISED * belly, _DROP * belly, least))
    limits = StandingLimits(disc, foot, raised, drop, lowest, _STEEP, int(_AROUND * disc), grid.pixels)
    marks = np.empty(heights.shape, np.bool_)
    loops.mark_standing(np.ascontiguousarray(heights, np.float32), limits, marks)
    return marks


def _with_neighbours(marks: Mask) -> Mask:
    """Mark the eight pixels around marked ones too."""
    wide = np.pad(marks, 1)
    rows = wide[2:] | wide[1:-1] | wide[:-2]
    return np.asarray(rows[:, 2:] | rows[:, 1:-1] | rows[:, :-2])


Places = tuple[NDArray[np.int64], NDArray[np.int64]]
"""Rows from the north and columns of tiles in a mosaic."""


def _mosaics(
    patches: PatchStack, around: Mapping[str, NDArray[Any]], margin: int
) -> Iterator[tuple[NDArray[np.int64], Mosaic, Places]]:
    """Yield the tiles of each block, the heights in and up to ``margin`` tiles around these, and their places there."""
    blocks = np.stack([patches.row, patches.col], axis=1) // BLOCK_TILES
    _, block = np.unique(blocks, axis=0, return_inverse=True)
    for tiles in map(np.flatnonzero, block.reshape(-1) == np.arange(block.max(initial=-1) + 1)[:, None]):
        own = patches.col[tiles], patches.row[tiles]
        window = TileWindow.around(*own).grown(margin)
        line, column = window.cells(around["col"], around["row"])
        inside = (line >= 0) & (line < window.rows) & (column >= 0) & (column < window.cols)
        at = line[inside], column[inside]
        yield tiles, _mosaic(around["heights"][inside], at, (window.rows, window.cols)), window.cells(*own)


def _mosaic(maps: NDArray[Any], at: Places, size: tuple[int, int]) -> NDArray[Any]:
    """Put maps of tiles, (n, pixels, pixels), side by side, north up; missing ones are NaN.

    ``size`` are the rows and columns of tiles.
    """
    px = maps.shape[1]
    block = np.full((size[0], px, size[1], px), np.nan, maps.dtype)
    block[at[0], :, at[1]] = maps
    return block.reshape(size[0] * px, size[1] * px)


def _of_tiles(mosaic: Mask, at: Places, px: int) -> Mask:
    """Cut tiles out of a mosaic again."""
    rows, cols = (side // px for side in mosaic.shape)
    return np.asarray(mosaic.reshape(rows, px, cols, px)[at[0], :, at[1]])
