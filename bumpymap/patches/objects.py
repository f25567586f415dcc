"""What stands on the ground or hangs over it: the points that are no ground, by their height above it."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import EMPTY, POINT_GROUND, POINT_OTHER, STEEP, ObjectStack, PatchStack, VehicleBody
from bumpymap.patches import kernels
from bumpytiles import BLOCK_TILES, Grid, TilePoints

__all__ = ["find_objects", "find_standing", "find_steep", "settle_solids", "take_off_standing"]

_SCALARS = 4
_STEEP = 0.7
"""Spread of the points of a pixel that no slope has, as a share of the lowest obstacle."""
_SHARE = 0.02
"""Share of a neighbourhood's points that makes an obstacle: at 100 points/m2 and more a bird has more than one."""


def find_objects(points: TilePoints, patches: PatchStack, body: VehicleBody) -> ObjectStack:
    """Find obstacles and canopy in tiles whose ground is known point by point.

    The height of a point counts from the ground beneath it: the heightmap, continued by a plane and the nearest
    heights where no ground was seen. A pixel is an obstacle if it holds a point from the belly (or the height of the
    plants that the vehicle brushes aside) up to the vehicle's height, or one of a building, however high, and its 3 x 3
    pixels hold two points from there upward; so under a crown, whose leaves hide the trunk, one is enough. In surveys
    of more than 278 points/m2 it takes 2 % of the points that 3 x 3 pixels have on average. Pixels with as many higher
    points are canopy. In tiles with less than three pixels of ground everything that is seen is an obstacle.

    Parameters
    ----------
    points : TilePoints
        All points of n tiles, in canonical order; ``flag`` holds their kind.
    patches : PatchStack
        The same tiles, measured from the ground points alone.
    body : VehicleBody
        Outline of the vehicle.

    Returns
    -------
    ObjectStack
        One row a tile, before its neighbours are known. `settle_solids` decides what is overhead and what holds no
        point; pixels at a tile's border whose points would make an obstacle only with company from the neighbour are
        ``UNDECIDED``, see `bumpymap.rating.settle_objects`.
    """
    tiles, pixels = len(points.col), points.grid.pixels
    state = np.empty((tiles, pixels, pixels), np.uint8)
    scalars = np.empty((tiles, _SCALARS))
    kernels.find_in_tiles(
        kernels.PointsByTile(points.starts, points.easting, points.northing, points.upward, points.col, points.row),
        kernels.ObjectLimits(
            tile_size=points.grid.tile_size,
            low=body.lowest_obstacle_m,
            high=body.height_m,
            share=_SHARE,
        ),
        kernels.TileObjects(
            np.ascontiguousarray(points.flag, np.uint8), patches.heights, patches.spread_count, state, scalars
        ),
        kernels.object_scratch(pixels),
    )
    return ObjectStack(state, *scalars.T.astype(np.float32))


def find_steep(patches: PatchStack, body: VehicleBody) -> ObjectStack:
    """Find the pixels whose points lie far above one another, in tiles where all points count as ground.

    These hold a part of a fence, or the side of a wall: `settle_solids` makes two side by side, or a line of them, an
    obstacle. The other pixels with points are ``FREE``; of the tile as a whole nothing is known.
    """
    stack = ObjectStack.empty(*patches.heights.shape[:2])
    stack.objects[patches.spread_count == 0] = EMPTY
    stack.objects[patches.spread_variance > (_STEEP * body.lowest_obstacle_m) ** 2] = STEEP
    return stack


def settle_solids(objects: NDArray[np.uint8], grid: Grid, max_hole: float) -> NDArray[np.uint8]:
    """Decide by the pixels around them what is overhead, what was not seen, and which single points are a line.

    - Canopy is an obstacle if part of it lets no pulse through and no ground is seen beneath. Ground lies beneath if
      canopy is met on all sides of it: beside a wall, and between two vans, it is not.
    - A pixel without points belongs to the nearest with points: what is believed free was seen free.
    - Points in a line with gaps of up to six pixels are one obstacle.

    Parameters
    ----------
    objects : uint8 (rows, cols)
        States from `find_objects`, tiles side by side, north row first; ``UNSEEN`` where a tile is missing.
    grid : Grid
        Tiles and pixels.
    max_hole : float
        Farther than this from every point a pixel is unseen, m; in thin surveys, than the radius of a disc that holds
        8 points on average.

    Returns
    -------
    uint8 (rows, cols)
        ``FREE``, ``OBSTACLE``, ``CANOPY``, ``UNSEEN``, and ``UNDECIDED``; in the outer ring of tiles as good as the
        ring tells.
    """
    out = np.empty_like(objects)
    kernels.settle_solids(
        np.ascontiguousarray(objects),
        grid.pixels,
        max_hole / grid.pixel_size,
        kernels.solid_scratch(*objects.shape),
        out,
    )
    return out


_WIDTH = 1.8
"""Width of what the ground filter may have left, m; wider things are above its threshold."""
_RAISED = 0.5
"""Height of the sides above the ground, as a share of the lowest obstacle."""
_DROP, _REACH = 0.8, 0.3
"""A side drops by this share of the lowest obstacle within so many m."""
_STEEP_FOOT = 0.3
"""Share of the raised pixels that lie so close to the foot of a side, at least: a swell of the ground has none."""

Mosaic = NDArray[np.float32]
Marks = NDArray[np.bool_]


def take_off_standing(
    points: TilePoints, patches: PatchStack, body: VehicleBody
) -> tuple[TilePoints, PatchStack]:  # fmt: skip
    """Take the pixels that stand out of the ground for no ground, so that `find_objects` sees what is in them.

    Parameters
    ----------
    points : TilePoints
        All points of one block; ``flag`` holds their kind.
    patches : PatchStack
        The same tiles, measured from the ground points.
    body : VehicleBody
        Outline of the vehicle.

    Returns
    -------
    points : TilePoints
        The same with the points in such pixels as no ground.
    patches : PatchStack
        The same with NaN for their ``heights``.
    """
    px, corner = points.grid.pixels, _corner(points)
    block = np.full((BLOCK_TILES, BLOCK_TILES, px, px), np.nan, np.float32)
    block[corner] = patches.heights
    mosaic = block.swapaxes(1, 2).reshape(BLOCK_TILES * px, BLOCK_TILES * px)  # side by side, north up
    found = find_standing(mosaic, body, points.grid.pixel_size)
    standing: Marks = found.reshape(BLOCK_TILES, px, BLOCK_TILES, px).swapaxes(1, 2)[corner]
    tiles = np.repeat(np.arange(len(points.col)), np.diff(points.starts))
    asked = np.flatnonzero((points.flag == POINT_GROUND) & np.asarray(standing.any(axis=(1, 2)))[tiles])
    tile, grid = tiles[asked], points.grid
    across = points.easting[asked] - points.col[tile] * grid.tile_size
    along = points.northing[asked] - points.row[tile] * grid.tile_size
    col, north = (
        np.minimum(grid.pixels - 1, (grid.pixels * offset / grid.tile_size).astype(np.int64))
        for offset in (across, along)
    )
    flag = points.flag.astype(np.uint8)
    flag[asked] = np.where(standing[tile, grid.pixels - 1 - north, col], POINT_OTHER, POINT_GROUND)
    return replace(points, flag=flag), replace(patches, heights=np.where(standing, np.float32(np.nan), patches.heights))


def find_standing(
    heights: Mosaic, body: VehicleBody, pixel: float, *, width: float = _WIDTH, least: float = 0.0
) -> Marks:  # fmt: skip
    """Find narrow things with steep sides in a heightmap.

    The surface beneath them is what a disc of ``width`` can touch from below (a morphological opening). A group of
    pixels that are more than half the height of the lowest obstacle above it is a thing if at least 30 % of them lie
    within 0.3 m of a place that is 80 % of that height lower.

    Parameters
    ----------
    heights : float32 (rows, cols)
        Mean height of the ground in each pixel, m; NaN where none is known.
    body : VehicleBody
        Its ``lowest_obstacle_m``, m.
    pixel : float
        Side of a pixel, m.
    width : float
        What is narrower stands on the ground, m; what is wider is ground at another level.
    least : float
        What of a thing is lower than this is left out, m.

    Returns
    -------
    bool (rows, cols)
        True in the pixels of such things.
    """
    disc, foot = max(1.5, 0.5 * width / pixel), max(1.5, _REACH / pixel)  # at least the eight neighbours
    belly = body.lowest_obstacle_m
    raised, drop, lowest = (float(np.float32(limit)) for limit in (_RAISED * belly, _DROP * belly, least))
    limits = kernels.StandingLimits(disc, foot, raised, drop, lowest, _STEEP_FOOT)
    marks = np.empty(heights.shape, np.bool_)
    rows, cols = heights.shape
    scratch = kernels.standing_scratch(rows, cols, disc)
    kernels.mark_standing(np.ascontiguousarray(heights, np.float32), limits, scratch, marks)
    return marks


def _corner(points: TilePoints) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the rows from the north and the columns of tiles in their block."""
    return BLOCK_TILES - 1 - points.row % BLOCK_TILES, points.col % BLOCK_TILES
