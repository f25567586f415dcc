"""From a scan to measured sectors of the concentric-zone polar grid, and from their classes to those of all places.

The ground is a smooth surface, found from small bins around the sensor, so that it is the same wherever sectors lie.
The origin may be at the sensor, the robot's base or below it, and the frame may lean. A scan that hangs from its ground
has none: its z axis points down.

Sectors are fixed fractions of a turn, so the ground is divided differently when the robot turns by part of a sector.
Where its heading is known, the grid keeps its directions: sector 0 starts at heading 0. A direction that is found from
the points themselves is no substitute: in a straight street their mean wanders by 20 degrees from frame to frame.

A sector has one class, and another one if the robot turns by part of it. What is measured in small bins about a place
(`SectorStack.places`) hardly changes. So the classes of the sectors, or their probabilities, are fitted as linear
functions of the means of these measures, by least squares over the frame; the functions then give the class of every
point and cell. Hundreds of sectors decide together, and a single one moves no border.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    CLASSES,
    NOT_TRAVERSABLE,
    BadInputError,
    ClassedSectors,
    PolarSettings,
    Scan,
    ScanMethod,
    SectorStack,
    loops,
)

PLACE_MEASURES = 7
"""Number of measures of a bin: see sectors.cpp."""
_LABELS = 32_768
"""Number of labels that 16 bits with a sign hold."""


class ZoneGrid(NamedTuple):
    """The polar grid, as the loops read it."""

    edges: NDArray[np.float64]
    """(zones + 1,) where zones begin, and the last one ends, m; half-open."""
    sectors: NDArray[np.int64]
    """(zones,) of each zone, as the next."""
    rings: NDArray[np.int64]
    start: float
    """Where sector 0 starts, as a share of a turn."""

    @classmethod
    def of(cls, settings: PolarSettings, start: float = 0.0) -> "ZoneGrid":
        """Return the grid of some settings."""
        edges, sectors = np.array([*settings.zone_starts_m, settings.end_m]), np.array(settings.sectors, np.int64)
        return cls(edges, sectors, np.array(settings.rings, np.int64), start)


def polar_sectors(scan: Scan, settings: PolarSettings | None = None) -> SectorStack:
    """Cut a scan into sectors, find the ground in those that hold enough points, and measure it.

    ``settings``: the default is the paper's grid with a zone before it. Sectors are sorted by zone, ring, sector; there
    are none if none holds enough points. Raises BadInputError: a label is 32,768 or more.
    """
    settings = settings or PolarSettings()
    start = -scan.heading_rad % (2.0 * math.pi)
    grid = ZoneGrid.of(settings, start / (2.0 * math.pi))
    size, room, pixels = len(scan.points), int(grid.sectors @ grid.rings) + 1, (settings.pixels, settings.pixels)
    integers = ("count", "ground_count", "obstacle_count", "overhead_count")
    floats = ("coverage", "variance", "residual", "obstacle_height", "clearance")
    rows: dict[str, NDArray[Any]] = {
        **{name: np.empty(room, np.int16) for name in ("zone", "ring", "sector")},
        **{name: np.empty(room, np.int32) for name in integers},
        **{name: np.empty(room, np.float32) for name in floats},
        "traversable": np.empty(room, np.bool_),
        "drop": np.empty(room, np.bool_),
        "normal": np.empty((room, 3), np.float32),
        "heights": np.empty((room, *pixels), np.float32),
        "objects": np.empty((room, 2, *pixels), np.float32),
        "measures": np.empty((room, PLACE_MEASURES)),
    }
    points: dict[str, NDArray[Any]] = {
        "point_place": np.empty((size, 2), np.uint16),
        "point_sector": np.full(size, -1, np.int32),
        "point_ground": np.zeros(size, np.bool_),
        "point_airborne": np.zeros(size, np.bool_),
        "point_height": np.full(size, np.nan, np.float32),
        "places": np.empty((loops.count_bins(grid), PLACE_MEASURES + 1), np.float32),
    }
    height = np.empty(1)
    scene = np.ascontiguousarray(scan.points, np.float32)
    found = loops.find_sectors(scene, grid, settings, rows, {**points, "origin_height": height})
    rows = {name: values[:found] for name, values in rows.items()}
    return SectorStack(
        settings=settings,
        azimuth_start_rad=start,
        origin_height=float(height[0]) if rows["traversable"].any() else math.nan,
        label=_labels(scan, points["point_sector"], found),
        obstacle=np.isfinite(rows["obstacle_height"]) | rows["drop"],
        **rows,
        **points,
    )


def _labels(scan: Scan, point_sector: NDArray[np.int32], sectors: int) -> NDArray[np.int16]:
    """Return the most frequent label of each sector, the smallest of equals; -1 without labels."""
    if scan.label is None or not sectors:
        return np.full(sectors, -1, np.int16)
    if int(scan.label.max()) >= _LABELS:
        raise BadInputError(
            f"the scan {scan.name} has the label {int(scan.label.max())}; semantic ids are below {_LABELS:,}. Does its "
            "label file belong to it?"
        )
    ids = np.flatnonzero(np.bincount(scan.label))
    column = np.zeros(int(ids[-1]) + 1, np.int64)
    column[ids] = np.arange(len(ids))
    inside = point_sector >= 0
    place = point_sector[inside] * len(ids) + column[scan.label[inside]]
    votes = np.bincount(place, minlength=sectors * len(ids)).reshape(sectors, -1)
    return np.asarray(ids[votes.argmax(axis=1)], np.int16)


OPEN_SHARE = 0.55
"""Least share of ground among the points of an open sector, whose ground alone makes its class (chosen)."""
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
