"""Names and colours of the classes of a scan, the same in every file."""

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CLASS_NAMES, CLASSES, NOT_TRAVERSABLE
from bumpymap.layers.geotiff import CLASS_COLOURS

__all__ = ["NO_SECTOR", "SCAN_CLASS_NAMES", "SCAN_COLOURS", "style_index"]

NO_SECTOR = CLASSES + 1
"""Look of a point that no measured sector holds; ``CLASSES`` is that of sectors that are not traversable."""
SCAN_CLASS_NAMES: tuple[str, ...] = (*CLASS_NAMES[:CLASSES], "not traversable", "in no sector")
SCAN_COLOURS: NDArray[np.uint8] = np.array(
    # The red is that of the worst class of a map: neither is to be driven on.
    [*(CLASS_COLOURS[class_id][:3] for class_id in (*range(CLASSES), 3)), (140, 140, 140)],
    np.uint8,
)
"""(5, 3) red, green, blue of each look."""


def style_index(class_id: NDArray[np.uint8], place: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return the look of points, (m,): an index into ``SCAN_CLASS_NAMES`` and ``SCAN_COLOURS``.

    Parameters
    ----------
    klass : (n,) uint8
        Of the sectors.
    place : (m,) int32
        Sector of each point, -1 where none holds it.
    """
    look = np.append(np.where(class_id == NOT_TRAVERSABLE, CLASSES, class_id), NO_SECTOR).astype(np.int64)
    picked: NDArray[np.int64] = look[place]
    return picked
