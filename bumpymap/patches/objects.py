"""What stands on the ground or hangs over it: the points that are no ground, by their height above it."""

import numpy as np

from bumpymap.core import FeatureSettings, ObjectStack, PatchStack, VehicleBody
from bumpymap.patches import kernels
from bumpytiles import TilePoints

__all__ = ["find_objects"]

_SCALARS = 4
_SHARE = 0.02
"""Share of a neighbourhood's points that makes an obstacle: at 100 points/m2 and more a bird has more than one."""
_HOLE_POINTS = 8.0
"""A disc with so many points on average is empty by chance once in 3,000 times."""
_ROOF = 0.6
"""Radius of the largest disc in which a tree crown lets no pulse through, in a dense survey, m."""
_ROOF_POINTS, _ROOF_GROUND = 100.0, 8.0
"""With fewer points the disc is larger: a crown that lets one pulse in twenty through leaves five ground points."""


def find_objects(points: TilePoints, patches: PatchStack, body: VehicleBody, settings: FeatureSettings) -> ObjectStack:
    """Find obstacles and canopy in tiles whose ground is known point by point.

    The height of a point counts from the ground beneath it: the heightmap, continued by a plane and the nearest
    heights where no ground was seen. A pixel is an obstacle if it holds a point from the belly (or the height of the
    plants that the vehicle brushes aside) up to the vehicle's height, and its 3 x 3 pixels hold two points from there
    upward; so under a crown, whose leaves hide the trunk, one is enough. In surveys of more than 278 points/m2 it takes
    2 % of the points that 3 x 3 pixels have on average. Pixels with as many higher points are canopy, unless they lie
    in a disc of 0.6 m or more without any ground beneath: a roof stands on something. In tiles with less than three
    pixels of ground everything that is seen is an obstacle.

    Parameters
    ----------
    points : TilePoints
        All points of n tiles, in canonical order; ``flag`` marks ground.
    patches : PatchStack
        The same tiles, measured from the ground points alone.
    body : VehicleBody
        Outline of the vehicle.
    settings : FeatureSettings
        ``max_hole``: farther than this from every point a pixel is unseen (in thin surveys, than a disc of 8 points).

    Returns
    -------
    ObjectStack
        One row a tile. Pixels at a tile's border whose points would make an obstacle only with company from the
        neighbour are ``UNDECIDED``; see `bumpymap.rating.settle_objects`.
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
            hole=settings.max_hole,
            hole_points=_HOLE_POINTS,
            roof=_ROOF,
            roof_points=_ROOF_POINTS,
            roof_ground=_ROOF_GROUND,
        ),
        kernels.TileObjects(points.flag, patches.heights, state, scalars),
        kernels.object_scratch(pixels),
    )
    return ObjectStack(state, *scalars.T.astype(np.float32))
