"""Classes of points and cells: what the sectors of a frame say of ground like that about each place.

A sector has one class, and another one if the robot turns by part of it. What is measured in small bins about a place
(`SectorStack.places`) hardly changes. So the classes of the sectors, or their probabilities, are fitted as linear
functions of the means of these measures, by least squares over the frame; the functions then give the class of every
place. Hundreds of sectors decide together, and a single one moves no border.
"""

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CLASSES, NOT_TRAVERSABLE, ClassedSectors, PolarSettings, ScanMethod, SectorStack, loops
from bumpymap.scan.ground import ZoneGrid

_PULL = 10.0
"""Sectors that would say the mean of all, whatever is measured there: where few were measured, they decide (chosen)."""
_LEAST_SPREAD = 0.02
"""What a measure differs by from sector to sector without a meaning (chosen)."""
_LEAST_GROUND = 0.004
"""Least weight of the ground points about a place whose ground is known: of one that is two bins away (chosen)."""


def with_places(
    stack: SectorStack,
    class_id: NDArray[np.uint8],
    stripes: NDArray[np.float32] | None,
    method: ScanMethod,
    probability: NDArray[np.float32] | None = None,
) -> ClassedSectors:
    """Return classified sectors with the classes of all places; ``probability`` (n, CLASSES): of the classes."""
    known = np.flatnonzero(stack.traversable)
    field = np.zeros((len(stack.places), CLASSES + 1), np.float32)
    if len(known):
        says = np.eye(CLASSES)[class_id[known]] if probability is None else probability[known]
        loops.spread_classes(stack.places, _fit(stack.measures[known], says, np.sqrt(stack.count[known])), field)
    confidence = None if probability is None else probability.max(axis=1)
    return ClassedSectors(stack, class_id, stripes, method, field, classes_at(stack.point_place, field), confidence)


def places_of(points: NDArray[np.float64], settings: PolarSettings) -> NDArray[np.uint16]:
    """Return the places (k, 2), as ``point_place``, of points (k, 2) in the frame of a sensor, m."""
    place = np.empty((len(points), 2), np.uint16)
    loops.find_places(points, ZoneGrid.of(settings), place)
    return place


def classes_at(place: NDArray[np.uint16], field: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return the class (k,) at places (k, 2), as ``point_place``; ``NOT_TRAVERSABLE`` where no ground is known."""
    class_id = np.empty(len(place), np.uint8)
    loops.find_classes(place, field, _LEAST_GROUND, NOT_TRAVERSABLE, class_id)
    return class_id


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
