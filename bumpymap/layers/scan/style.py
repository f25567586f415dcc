"""Names and colours of what is in a scan, shared by all its files."""

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CLASS_NAMES, CLASSES, NOT_TRAVERSABLE, ClassedSectors
from bumpymap.layers.colours import CLASS_COLOURS

__all__ = [
    "OBSTACLE_POINT",
    "OTHER_POINT",
    "SCAN_CLASS_NAMES",
    "SCAN_COLOURS",
    "SECTOR_STATES",
    "class_index",
    "point_styles",
    "sector_states",
]

SCAN_CLASS_NAMES: tuple[str, ...] = (*CLASS_NAMES[:CLASSES], "not traversable")
"""Name of each class of a sector; see `class_index`."""
SECTOR_STATES = ("free", "obstacle", "rough", "not ground")
"""What a sector is to a robot; see `sector_states`."""
OBSTACLE_POINT, OTHER_POINT = CLASSES, CLASSES + 1
"""Styles of points that are not ground. Those of ground points are the classes of their sectors."""
SCAN_COLOURS: NDArray[np.uint8] = np.array(
    # Obstacles have the red of the worst class of a map.
    [*(CLASS_COLOURS[class_id][:3] for class_id in (*range(CLASSES), 3)), (140, 140, 140)],
    np.uint8,
)
"""(5, 3) red, green, blue of each style of a point."""


def class_index(classed: ClassedSectors) -> NDArray[np.int64]:
    """Return the place of each sector's class in ``SCAN_CLASS_NAMES``, (n,)."""
    return np.where(classed.class_id == NOT_TRAVERSABLE, CLASSES, classed.class_id).astype(np.int64)


def sector_states(classed: ClassedSectors) -> NDArray[np.int64]:
    """Return the place of each sector's state in ``SECTOR_STATES``, (n,).

    Free: class 0 or 1, and nothing stands on it. Obstacle: ground of any class on which something stands. Rough: class
    2 without an obstacle. Not ground: no class.
    """
    rough, no_ground = classed.class_id == CLASSES - 1, classed.class_id == NOT_TRAVERSABLE
    return np.select([no_ground, classed.sectors.obstacle, rough], [3, 1, 2], 0).astype(np.int64)


def point_styles(classed: ClassedSectors) -> NDArray[np.uint8]:
    """Return the style of each point, (m,): an index into ``SCAN_COLOURS``.

    Ground has the class of its sector; an obstacle is a point between belly and vehicle height above the ground;
    everything else is of one style: overhead, low but not ground, without a class or a sector.
    """
    stack, settings = classed.sectors, classed.sectors.settings
    with np.errstate(invalid="ignore"):
        stands = (stack.point_height >= settings.belly_m) & (stack.point_height <= settings.height_m)
    style = np.where(stands & ~stack.point_ground, np.uint8(OBSTACLE_POINT), np.uint8(OTHER_POINT))
    own = np.append(classed.class_id, np.uint8(NOT_TRAVERSABLE))[stack.point_sector]
    return np.where(stack.point_ground & (own < CLASSES), own, style)
