"""What the ground filter left standing: boulders and bushes lower than its threshold, found in heightmaps.

The filter keeps what lies close to its cloth, up to half a metre above. That belongs to the relief, and it
is also in the way of a vehicle whose belly is lower.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import POINT_GROUND, POINT_OTHER, PatchStack, VehicleBody
from bumpytiles import BLOCK_TILES, TilePoints

__all__ = ["find_standing", "take_off_standing"]

_WIDTH = 1.8
"""Width of what the ground filter may have left, m; wider things are above its threshold."""
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
    standing: Marks = _by_tile(find_standing(_mosaic(points, patches.heights), body, points.grid.pixel_size), points)
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
    from scipy import ndimage

    known = ~np.isnan(heights)
    level = _level(heights, known)
    above = level - _open(level, _disc(0.5 * width / pixel))
    raised = known & (above > _RAISED * body.lowest_obstacle_m)
    near = _disc(_REACH / pixel)
    foot = ndimage.grey_erosion(np.where(known, above, np.inf), footprint=near, mode="constant", cval=np.inf)
    steep = raised & (above - foot > _DROP * body.lowest_obstacle_m)
    things, count = ndimage.label(raised, np.ones((3, 3)))
    sizes, sides = (np.bincount(things[marks], minlength=count + 1) for marks in (raised, steep))
    return np.asarray(raised & (above >= least) & (sides > _STEEP * sizes)[things])


def _level(heights: Mosaic, known: Marks) -> Mosaic:
    """Take the plane through all heights off: at an edge above a slope, a disc touches only what lies lower."""
    rows, cols = np.nonzero(known)
    if len(rows) == 0:
        return heights
    axes = [rows - np.mean(rows), cols - np.mean(cols)]
    values = heights[known] - np.mean(heights[known], dtype=np.float64)
    (rr, rc, rv), (_, cc, cv) = [[np.sum(one * other) for other in (*axes, values)] for one in axes]
    det = rr * cc - rc * rc
    if det <= 0.0:
        return heights
    out = np.full(heights.shape, np.nan, np.float32)
    out[known] = values - (rv * cc - cv * rc) / det * axes[0] - (cv * rr - rv * rc) / det * axes[1]
    return out


def _open(heights: Mosaic, disc: Marks) -> Mosaic:
    """Return the highest surface below the heights on which a disc fits everywhere."""
    from scipy import ndimage

    low = _over_disc(ndimage.minimum_filter1d, np.minimum, np.where(np.isnan(heights), np.inf, heights), disc, np.inf)
    low[np.isinf(low)] = -np.inf
    return _over_disc(ndimage.maximum_filter1d, np.maximum, low, disc, -np.inf)


def _over_disc(along: Any, of_two: Any, values: Mosaic, disc: Marks, beyond: float) -> Mosaic:
    """Return the lowest, or highest, value within a disc around each pixel: that of its rows, one by one."""
    reach, (rows, cols) = len(disc) // 2, values.shape
    out = np.full((rows + 2 * reach, cols), np.float32(beyond))
    widths = disc.sum(axis=1).tolist()
    rowwise = {width: along(values, width, axis=1, mode="constant", cval=beyond) for width in set(widths)}
    for down, width in enumerate(widths):
        part = out[down : down + rows]
        of_two(part, rowwise[width], out=part)
    return out[reach:-reach]


def _disc(radius: float) -> Marks:
    """Return the pixels within a radius [px] of the middle one, at least its eight neighbours."""
    reach = max(1.5, radius)
    offsets = np.arange(-int(reach), int(reach) + 1)
    return np.asarray(offsets[:, None] ** 2 + offsets**2 <= reach * reach)


def _corner(points: TilePoints) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the rows from the north and the columns of tiles in their block."""
    return BLOCK_TILES - 1 - points.row % BLOCK_TILES, points.col % BLOCK_TILES


def _mosaic(points: TilePoints, maps: Mosaic) -> Mosaic:
    """Lay the maps of tiles (n, pixels, pixels) side by side over their block, north up; NaN: no tile."""
    pixels = points.grid.pixels
    tiles = np.full((BLOCK_TILES, BLOCK_TILES, pixels, pixels), np.nan, np.float32)
    tiles[_corner(points)] = maps
    return np.asarray(tiles.swapaxes(1, 2).reshape(BLOCK_TILES * pixels, BLOCK_TILES * pixels))


def _by_tile(mosaic: Marks, points: TilePoints) -> Marks:
    """Cut a mosaic into the maps of tiles, (n, pixels, pixels)."""
    pixels = points.grid.pixels
    tiles = mosaic.reshape(BLOCK_TILES, pixels, BLOCK_TILES, pixels).swapaxes(1, 2)
    return np.asarray(tiles[_corner(points)])
