"""Points of tiles in, measured patches out: heightmap, spread, z-variance, RANSAC residual, slope, reason.

Thinly surveyed tiles are measured from their points too, beyond their pixels; see ``docs/pages/measuring.md``. Objects
that stand on the ground or hang over it are found in the points that are no ground, by their height above it.
"""

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    DENSE_COVERAGE,
    HOLE_POINTS,
    HOLE_SHARE,
    OBSTACLE_SHARE,
    POINT_GROUND,
    FeatureSettings,
    ObjectStack,
    PatchStack,
    Reason,
    VehicleBody,
    loops,
)
from bumpytiles import Grid, TilePoints

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
