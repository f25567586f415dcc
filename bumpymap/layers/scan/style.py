"""Names and colours of the classes of a scan, shared by all its files."""

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CLASS_NAMES, CLASSES, NOT_TRAVERSABLE
from bumpymap.layers.colours import CLASS_COLOURS

__all__ = ["NO_SECTOR", "SCAN_CLASS_NAMES", "SCAN_COLOURS", "style_index"]

NO_SECTOR = CLASSES + 1
"""Style of a point outside all measured sectors; ``CLASSES`` is that of sectors that are not traversable."""
SCAN_CLASS_NAMES: tuple[str, ...] = (*CLASS_NAMES[:CLASSES], "not traversable", "in no sector")
SCAN_COLOURS: NDArray[np.uint8] = np.array(
    # "Not traversable" has the red of the worst class of a map.
    [*(CLASS_COLOURS[class_id][:3] for class_id in (*range(CLASSES), 3)), (140, 140, 140)],
    np.uint8,
)
"""(5, 3) red, green, blue of each style."""


def style_index(class_id: NDArray[np.uint8], point_sector: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return the style of points, (m,): an index into ``SCAN_CLASS_NAMES`` and ``SCAN_COLOURS``.

    Parameters
    ----------
    class_id : (n,) uint8
        Classes of the sectors.
    point_sector : (m,) int32
        Sector of each point, -1 if none.
    """
    style = np.append(np.where(class_id == NOT_TRAVERSABLE, CLASSES, class_id), NO_SECTOR).astype(np.int64)
    picked: NDArray[np.int64] = style[point_sector]
    return picked
