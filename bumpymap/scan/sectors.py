"""From a scan to measured sectors of the concentric-zone polar grid: their ground, and the objects on it.

The ground is a smooth surface, found from small bins around the sensor, so that it is the same wherever sectors lie.
The origin may be at the sensor, the robot's base or below it, and the frame may lean. A scan that hangs from its ground
has none: its z axis points down.

Sectors are fixed fractions of a turn, so the ground is divided differently when the robot turns by part of a sector.
Where its heading is known, the grid keeps its directions: sector 0 starts at heading 0. A direction that is found from
the points themselves is no substitute: in a straight street their mean wanders by 20 degrees from frame to frame.
"""

import math
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, PolarSettings, Scan, SectorStack, cell_numbers, loops

PLACE_MEASURES = 7
"""Number of measures of a bin: see sectors.cpp."""
NEIGHBOURS = 8
"""Most neighbours of a cell."""
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

    @property
    def bins(self) -> int:
        """Number of small bins around the sensor."""
        return int(loops.count_bins(self))


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
        "places": np.empty((grid.bins, PLACE_MEASURES + 1), np.float32),
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
    most: NDArray[np.int16] = ids[votes.argmax(axis=1)].astype(np.int16)
    return most


OPEN_SHARE = 0.55
"""Least share of ground among the points of an open sector, whose ground alone makes its class (chosen)."""


def open_neighbours(stack: SectorStack) -> tuple[NDArray[np.bool_], NDArray[np.int32]]:
    """Return which sectors are open (n,), and rows of the open ones around each (n, NEIGHBOURS); n where none is."""
    near, cell = neighbours(stack.settings), cell_numbers(stack)
    is_open: NDArray[np.bool_] = stack.traversable & (stack.ground_count >= OPEN_SHARE * stack.count)
    row = np.full(len(near) + 1, len(cell), np.int32)  # the last one is for neighbours that do not exist
    row[cell[is_open]] = np.flatnonzero(is_open)
    return is_open, row[near[cell]]


@cache
def neighbours(settings: PolarSettings) -> NDArray[np.int64]:
    """Return the cells around each cell (cells, NEIGHBOURS): three inwards, two beside, three outwards; -1: none."""
    counts = np.repeat(settings.sectors, settings.rings)  # cells of each ring
    starts = np.cumsum(counts) - counts
    line = np.repeat(np.arange(len(counts)), counts)
    turn = (np.arange(len(line)) - starts[line] + 0.5) / counts[line]
    near = np.full((len(line), NEIGHBOURS), -1)
    for column, step, beside in ((0, -1, (-1, 0, 1)), (3, 0, (-1, 1)), (5, 1, (-1, 0, 1))):
        there = (line + step >= 0) & (line + step < len(counts))
        to = (line + step)[there]
        opposite = (turn[there] * counts[to]).astype(int)
        for k, side in enumerate(beside):
            near[there, column + k] = starts[to] + (opposite + side) % counts[to]
    return near
