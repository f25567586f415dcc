"""Classes of points and cells: what the sectors of a frame say of ground like that about each place.

A sector has one class, and another one if the robot turns by part of it. What is measured in small bins about a place
(`SectorStack.places`) hardly changes. So the classes of the sectors, or their probabilities, are fitted as linear
functions of the means of these measures, by least squares over the frame; the functions then give the class of every
place. Hundreds of sectors decide together, and a single one moves no border.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CLASSES, NOT_TRAVERSABLE, ClassedSectors, ScanMethod, SectorStack, loops

_PULL = 10.0
"""Sectors that would say the mean of all, whatever is measured there: where few were measured, they decide (chosen)."""
_LEAST_SPREAD = 0.02
"""Spread of a measure over the sectors that means nothing (chosen)."""
_AT_ONCE = 128
"""Bins of one matrix product: those of a ring."""
_LEAST_GROUND = 0.004
"""Least weight of the ground points about a place whose ground is known: of one that is two bins away (chosen)."""


def with_places(
    stack: SectorStack,
    class_id: NDArray[np.uint8],
    stripes: NDArray[np.float32] | None,
    method: ScanMethod,
    says: NDArray[np.floating],
    confidence: NDArray[np.float32] | None = None,
) -> ClassedSectors:
    """Return classified sectors with the classes of all places; ``says`` (n, CLASSES): share of each class in them."""
    known = np.flatnonzero(stack.traversable)
    field = np.zeros((len(stack.places), CLASSES + 1), np.float32)
    if len(known):
        slopes = _fit(stack.measures[known], says[known], np.sqrt(stack.count[known])).astype(np.float32)
        linear = np.zeros((stack.places.shape[1], CLASSES + 1), np.float32)
        linear[:-1, :-1], linear[-1, -1] = slopes[:-1], 1.0
        # In parts: for a larger product the library would start threads.
        field = (stack.places.reshape(-1, _AT_ONCE, len(linear)) @ linear).reshape(field.shape)
        field[:, :-1] += slopes[-1]
    point_class = np.empty(len(stack.point_place), np.uint8)
    loops.find_classes(stack.point_place, class_field(field), point_class)
    return ClassedSectors(stack, class_id, stripes, method, field, point_class, confidence)


def class_field(field: NDArray[np.float32]) -> dict[str, Any]:
    """Return the field of a frame, as the loops read it."""
    return {"says": field, "least": _LEAST_GROUND, "unknown": NOT_TRAVERSABLE}


def _fit(measures: NDArray[np.float64], says: NDArray[np.floating], weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """Fit what sectors say (n, CLASSES) to their measures (n, m); return the slopes and constants (m + 1, CLASSES)."""
    weight = weight / weight.mean()
    middle, mean = (np.average(values, 0, weight) for values in (measures, says))
    spread = measures.std(axis=0) + _LEAST_SPREAD
    terms = (measures - middle) / spread
    # Without a product of matrices, whose library would start threads.
    squares = np.einsum("nf,n,ng->fg", terms, weight, terms) + _PULL * np.eye(len(middle))
    slopes = np.linalg.solve(squares, np.einsum("nf,n,nc->fc", terms, weight, says - mean)) / spread[:, None]
    return np.vstack([slopes, mean - middle @ slopes])
