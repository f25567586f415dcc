"""What the ground filter left standing: boulders and bushes lower than its threshold, found in heightmaps.

The filter keeps what lies close to its cloth, up to half a metre above. That belongs to the relief, and it
is also in the way of a vehicle whose belly is lower.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import FREE, OBSTACLE, POINT_GROUND, POINT_OTHER, STEEP, UNSEEN, PatchStack, VehicleBody
from bumpymap.patches.kernels.standing import StandingLimits, mark_standing, standing_scratch
from bumpytiles import BLOCK_TILES, TilePoints

__all__ = ["find_standing", "settle_relief", "take_off_standing"]

_WIDTH = 1.8
"""Width of what the ground filter may have left, m; wider things are above its threshold."""
_WIDEST = 2.6
"""Width of a thing that stands on relief, m: a van, up to 0.3 m off the grid of the pixels."""
_HOLLOW = 1.8
"""Width of a ditch of which the sides are no walls, m; those of a wider one are ground at another level."""
_RAISED = 0.5
"""Height of the sides above the ground, as a share of the lowest obstacle."""
_DROP, _REACH = 0.8, 0.3
"""A side drops by this share of the lowest obstacle within so many m."""
_STEEP = 0.3
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


def settle_relief(
    states: NDArray[np.uint8], heights: Mosaic, body: VehicleBody, pixel: float
) -> NDArray[np.uint8]:  # fmt: skip
    """Decide which pixels stand out of a relief: narrow, steep things do, and the sides of narrow hollows do not.

    The points at the side of a ditch lie as far above one another as those of a fence or of the side of a wall. But a
    wheel rolls over a narrow ditch; what it does in a wide one, the steps and the ride of its tile tell.

    Parameters
    ----------
    states : uint8 (rows, cols)
        Of `find_steep`, tiles side by side, north row first; ``UNSEEN`` where a tile is missing.
    heights : float32 (rows, cols)
        Mean height of the points in each pixel, m; NaN where there are none.
    body : VehicleBody
        Outline of the vehicle.
    pixel : float
        Side of a pixel, m.

    Returns
    -------
    uint8 (rows, cols)
        The same with ``OBSTACLE`` where something stands out, and ``FREE`` for ``STEEP`` beside a hollow.
    """
    out, steep = states.copy(), states == STEEP
    if steep.any():
        hollow = find_standing(-heights, body, pixel, width=_HOLLOW)
        out[steep & _with_neighbours(hollow)] = FREE
    standing = find_standing(heights, body, pixel, width=_WIDEST, least=body.lowest_obstacle_m)
    out[standing & (states != UNSEEN)] = OBSTACLE
    return out


def find_standing(
    heights: Mosaic, body: VehicleBody, pixel: float, *, width: float = _WIDTH, least: float = 0.0
) -> Marks:  # fmt: skip
    """Find narrow things with steep sides in a heightmap.

    The surface beneath them is what a disc of ``width`` can touch from below (a morphological opening). A group of
    pixels that are more than half the height of the lowest obstacle above it is a thing if at least 30 % of them lie
    within 0.3 m of a place that is 80 % of that height lower. Where fewer than eight pixels so close are known, the
    nearest eight count, up to four pixels away, if they are lower in proportion to their distance.

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
    limits = StandingLimits(disc, foot, raised, drop, lowest, _STEEP)
    marks = np.empty(heights.shape, np.bool_)
    rows, cols = heights.shape
    scratch = standing_scratch(rows, cols, disc)
    mark_standing(np.ascontiguousarray(heights, np.float32), limits, scratch, marks)
    return marks


def _with_neighbours(marks: Marks) -> Marks:
    """Mark the eight pixels around marked ones too."""
    out = marks.copy()
    out[1:] |= marks[:-1]
    out[:-1] |= marks[1:]
    rows = out.copy()
    out[:, 1:] |= rows[:, :-1]
    out[:, :-1] |= rows[:, 1:]
    return out


def _corner(points: TilePoints) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the rows from the north and the columns of tiles in their block."""
    return BLOCK_TILES - 1 - points.row % BLOCK_TILES, points.col % BLOCK_TILES
