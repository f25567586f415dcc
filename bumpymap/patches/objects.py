"""Things that stand on the ground or hang over it: the points that are no ground, by their height above it."""

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import ObjectStack, PatchStack, VehicleBody
from bumpymap.patches import _solid_kernels as solids
from bumpymap.patches._measure_kernels import PointsByTile
from bumpymap.patches._object_kernels import ObjectLimits, TileObjects, find_in_tiles, object_scratch
from bumpytiles import Grid, TilePoints

_SCALARS = 4
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
    places = PointsByTile(points.starts, points.easting, points.northing, points.upward, points.col, points.row)
    limits = ObjectLimits(points.grid.tile_size, body.lowest_obstacle_m, body.height_m, _SHARE)
    kind = np.ascontiguousarray(points.flag, np.uint8)
    found = TileObjects(kind, patches.heights, patches.spread_count, state, scalars)
    find_in_tiles(places, limits, found, object_scratch(pixels))
    return ObjectStack(state, *scalars.T.astype(np.float32))


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
    out, hole = np.empty_like(objects), max_hole / grid.pixel_size
    scratch = solids.solid_scratch(*objects.shape)
    solids.settle_solids(np.ascontiguousarray(objects), grid.pixels, hole, scratch, out)
    return out
