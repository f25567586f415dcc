"""From the classes of sectors to those of points."""

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import NOT_TRAVERSABLE, ClassedSectors, Scan

__all__ = ["point_classes"]


def point_classes(scan: Scan, classed: ClassedSectors) -> NDArray[np.uint8]:
    """Give every point the class of its sector.

    Returns
    -------
    (m,) uint8
        0 to 2; ``NOT_TRAVERSABLE`` where the sector is not, or where no sector holds the point.
    """
    place = classed.sectors.point_sector
    if len(place) != len(scan.points):
        raise ValueError(f"the sectors are those of a scan of {len(place)} points; this one has {len(scan.points)}")
    padded = np.append(classed.class_id, np.uint8(NOT_TRAVERSABLE))
    class_id: NDArray[np.uint8] = padded[place]
    return class_id
