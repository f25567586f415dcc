"""Points that lie outside the part of an octree that is said to hold them."""

import numpy as np
from numpy.typing import NDArray

from bumpymap.readers.batch import RecordLayout
from bumpymap.readers.columns import DECIMALS
from bumpymap.readers.las_points import Cubes
from bumpymap.readers.point_stats import OUTSIDE
from bumpytiles import Bounds

__all__ = ["count_points_outside_node"]

_MARGIN = np.array([-OUTSIDE, -OUTSIDE, OUTSIDE, OUTSIDE])


def count_points_outside_node(
    records: NDArray[np.uint8], layout: RecordLayout, metres_per_unit: float, box: Bounds, cubes: Cubes
) -> int:
    """Count points inside the file's box and more than ``OUTSIDE`` outside the cube of their node.

    Node by node, so that the verdict does not depend on how the file is cut. Only nodes whose extremes lie outside are
    looked at point by point.

    Parameters
    ----------
    records : uint8 (n, bytes of a point)
    layout : RecordLayout
    metres_per_unit : float
    box : Bounds
        Of the file, m.
    cubes : Cubes
        Of the nodes that the points come from.
    """
    starts = np.cumsum(cubes.counts) - cubes.counts
    sides = (cubes.sides + _MARGIN).T
    words = [np.ascontiguousarray(records[:, at : at + 4]).view("<i4")[:, 0] for at in (0, 4)]
    extremes = [
        _metres(extreme.reduceat(word, starts), layout, axis, metres_per_unit)
        for extreme in (np.minimum, np.maximum)
        for axis, word in enumerate(words)
    ]
    # Of a negative scale the largest number is the lowest coordinate.
    low, high = np.minimum(extremes[:2], extremes[2:]), np.maximum(extremes[:2], extremes[2:])
    suspect = ~((low >= sides[:2]) & (high <= sides[2:])).all(axis=0)
    if not suspect.any():
        return 0
    rows = np.repeat(suspect, cubes.counts)
    points = np.array([_metres(word[rows], layout, axis, metres_per_unit) for axis, word in enumerate(words)])
    own = np.repeat(sides[:, suspect], cubes.counts[suspect], axis=1)
    whole = (np.array([box.west, box.south, box.east, box.north]) + _MARGIN)[:, None]
    return int(np.count_nonzero(_outside(points, own) & ~_outside(points, whole)))


def _metres(words: NDArray[np.int32], layout: RecordLayout, axis: int, unit: float) -> NDArray[np.float64]:
    """Coordinates, in the steps of the kernel that converts all of them, so with the same bits."""
    with np.errstate(over="ignore"):
        value: NDArray[np.float64] = np.round(words * layout.scales[axis] + layout.offsets[axis], DECIMALS) * unit
        return value


def _outside(points: NDArray[np.float64], sides: NDArray[np.float64]) -> NDArray[np.bool_]:
    beyond: NDArray[np.bool_] = (points < sides[:2]) | (points > sides[2:])
    either: NDArray[np.bool_] = beyond[0] | beyond[1]
    return either
