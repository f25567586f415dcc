"""Find the ground of a scan: which points lie on it, how high the others are above it, and where it drops."""

import math
import threading
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import PolarSettings, SectorStack, cell_numbers, first_cells, loops

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int32]
Flags = NDArray[np.bool_]

MEASURES = 7
"""Number of measures of a bin: see ground.cpp."""
NEIGHBOURS = 8
"""Most neighbours of a cell: three inwards, two beside it, three outwards."""


class ZoneGrid(NamedTuple):
    """The polar grid."""

    edges: Floats
    """(zones + 1,) where zones begin, and the last one ends, m; half-open."""
    sectors: NDArray[np.int64]
    """(zones,) of each zone, as the next."""
    rings: NDArray[np.int64]
    start: float
    """Where sector 0 starts, as a share of a turn."""
    pixels: int
    """Rows (outwards) and columns (counter-clockwise) of a sector."""

    @classmethod
    def of(cls, settings: PolarSettings, start: float = 0.0) -> "ZoneGrid":
        """Return the grid of some settings."""
        edges, sectors = np.array([*settings.zone_starts_m, settings.end_m]), np.array(settings.sectors, np.int64)
        return cls(edges, sectors, np.array(settings.rings, np.int64), start, settings.pixels)


class CellPoints(NamedTuple):
    """The points by cell, side by side, in the scan's order inside each."""

    starts: NDArray[np.int64]
    """(cells + 2,) cell c has those from ``starts[c]`` to ``starts[c + 1]``; zeros on entry; the last is scratch."""
    order: Integers
    """(points,) their numbers in the scan."""
    xyz: Singles
    """(3, points) m."""
    pixel: Integers
    """(points,) ``row * pixels + column``."""
    bin: Integers
    """(points,) bin that it lies in: small ones, whose columns start at the x axis, whatever the grid."""


class CellLayout(NamedTuple):
    """Where the cells of the grid lie; (cells,) where nothing else is said."""

    distance: Floats
    """Of the centre, m."""
    azimuth: Floats
    """Of the centre, from where sector 0 starts, rad."""
    near: Integers
    """(cells, NEIGHBOURS) neighbours: columns 0 to 2 inwards, 3 and 4 beside, 5 to 7 outwards; -1: none."""
    zone: Integers
    ring: Integers
    sector: Integers


class GroundLabels(NamedTuple):
    """Ground points, and what the others are; filled in place."""

    height: Singles
    """(scan's points,) height above the ground, m; comes as NaN."""
    ground: Flags
    """(scan's points,) comes as False."""
    obstacles: Integers
    """(cells,) points between belly and height that lie beside others; zeros."""
    overhead: Integers
    """(cells,) points from ``height`` on; zeros."""
    airborne: Flags
    """(scan's points,) points of ``objects`` that lie alone; comes as False."""
    top: Singles
    """(cells,) the highest obstacle point, m; comes as -inf."""
    clearance: Singles
    """(cells,) lowest point from ``height`` on, m; comes as inf."""
    objects: Singles
    """(cells, 2, pixels^2) of the points that are not ground, up to twice ``height``: the highest in each pixel above
    the ground, m, and their number. As the next, filled in cells with points."""
    lowest: Singles
    """(cells, pixels^2, 2) z of the lowest ground point and of the lowest other one, m; inf without any."""
    kept: Flags
    """(points,) by cell: whether it is ground."""
    held: Integers
    """(cells,) ground points; zeros."""
    surface: Floats
    """(cells, 3) of the ground at their centres: slope along x and y, and what it says of the height at the origin, m;
    where no point is, as the ground around it leads to expect."""
    whole: Floats
    """(3,) of the whole ground, as ``surface``."""
    places: Singles
    """(bins, `MEASURES` + 1) of small bins around the sensor and the bins about them: measures of what is there, and
    the number of ground points."""
    measures: Floats
    """(cells, `MEASURES`) mean of those measures over the points."""


class SectorBuffers(threading.local):
    """Scratch arrays that are reused from scan to scan and grow to the largest one; each thread has its own."""

    def __init__(self) -> None:
        self._arrays: dict[str, NDArray[Any]] = {}

    def empty(self, name: str, length: int, dtype: type, rows: int = 1) -> NDArray[Any]:
        """Return an uninitialised array (length,), or (rows, length) if ``rows`` is more than one."""
        size = rows * length
        kept = self._arrays.get(name)
        if kept is None or len(kept) < size:
            kept = self._arrays[name] = np.empty(size, dtype)
        part = kept[:size]
        return part if rows == 1 else part.reshape(rows, length)


_DIRECTIONS = 360
"""Number of directions in which the ground is followed, a degree apart (chosen)."""
_SLOPE = 0.08
"""A drop is steeper than this, against the slope of the ground before it; hills are not. The view over an edge is as
steep 15 m away from a sensor that is 1.2 m high, so edges farther away are not found."""
_BELOW_M = -0.1
"""Beams to what lies behind an edge pass above the ground before it, or less below it than this, m (chosen: an
error)."""
_SENSOR_M = 0.25
"""Height above the ground below which the origin is not where the sensor is, m (chosen)."""
_SHARE = 0.2
"""Share of the directions of a cell in which a drop is seen, at least (chosen)."""


def ground_drops(
    ground: GroundLabels,
    slope: NDArray[np.float64],
    points: CellPoints,
    grid: ZoneGrid,
    settings: PolarSettings,
    height_m: float,
) -> NDArray[np.bool_]:
    """Find the cells in which the ground drops by more than the clearance of the belly.

    ``slope`` (cells, 4): along x and y of the sector's own ground, 0 where it is not known, and of that around it: a
    sector before a drop may hold some of what lies below. ``height_m``: of the origin above the ground.
    """
    drops = np.zeros(len(slope), np.int32)
    below = _BELOW_M if height_m > _SENSOR_M else -np.inf
    rule = {
        "least": settings.belly_m,
        "slope": _SLOPE,
        "below": below,
        "whole": ground.whole,
        "directions": _DIRECTIONS,
    }
    loops.find_drops(ground.lowest, slope, points.starts, grid, rule, drops)
    seen = np.repeat(_DIRECTIONS / grid.sectors, grid.sectors * grid.rings)
    return np.asarray(drops >= _SHARE * seen)


def find_ground(
    points: CellPoints, count: int, grid: ZoneGrid, settings: PolarSettings, buffers: SectorBuffers
) -> GroundLabels:
    """Find the ground of a scan that was placed on the polar grid.

    It is a smooth surface, found from small bins around the sensor, so that it is the same wherever sectors lie. The
    origin may be at the sensor, the robot's base or below it, and the frame may lean. A scan that hangs from its ground
    has none: its z axis points down.

    ``count``: points of the scan; ``buffers``: hold ``objects``, ``lowest`` and ``kept`` until the next call.
    """
    layout, placed = cell_layout(settings), int(points.starts[-2])
    cells, azimuth = len(layout.zone), layout.azimuth + 2.0 * math.pi * grid.start
    centres = np.column_stack([layout.distance * np.cos(azimuth), layout.distance * np.sin(azimuth)])
    objects, lowest = (
        buffers.empty(name, 2 * settings.pixels**2, np.float32, rows=cells) for name in ("objects", "lowest")
    )
    labels = GroundLabels(
        height=np.full(count, np.nan, np.float32),
        ground=np.zeros(count, np.bool_),
        obstacles=np.zeros(cells, np.int32),
        overhead=np.zeros(cells, np.int32),
        airborne=np.zeros(count, np.bool_),
        top=np.full(cells, -np.inf, np.float32),
        clearance=np.full(cells, np.inf, np.float32),
        objects=objects.reshape(cells, 2, -1),
        lowest=lowest.reshape(cells, -1, 2),
        kept=buffers.empty("kept", placed, np.bool_),
        held=np.zeros(cells, np.int32),
        surface=np.empty((cells, 3)),
        whole=np.empty(3),
        places=np.empty((loops.count_bins(grid), MEASURES + 1), np.float32),
        measures=np.empty((cells, MEASURES)),
    )
    loops.find_ground(points, grid, centres, settings, labels)
    return labels


def median(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the median along the first axis, as ``numpy.median`` does, whose checks take longer than its work."""
    ordered = np.sort(values, axis=0)
    middle: NDArray[np.float64] = 0.5 * (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2])
    return middle


OPEN_SHARE = 0.55
"""Least share of ground among the points of an open sector, whose ground alone makes its class (chosen)."""


def open_neighbours(stack: SectorStack) -> tuple[NDArray[np.bool_], NDArray[np.int32]]:
    """Return which sectors are open (n,), and rows of the open ones around each (n, NEIGHBOURS); n where none is."""
    layout, cell = cell_layout(stack.settings), cell_numbers(stack)
    is_open: NDArray[np.bool_] = stack.traversable & (stack.ground_count >= OPEN_SHARE * stack.count)
    row = np.full(len(layout.zone) + 1, len(cell), np.int32)  # the last one is for neighbours that do not exist
    row[cell[is_open]] = np.flatnonzero(is_open)
    return is_open, row[layout.near[cell]]


@cache
def cell_layout(settings: PolarSettings) -> CellLayout:
    """Return where the cells lie."""
    edges = np.array([*settings.zone_starts_m, settings.end_m])
    sectors, rings = np.array(settings.sectors, np.int32), np.array(settings.rings, np.int32)
    first = first_cells(settings).astype(np.int32)
    zone = np.repeat(np.arange(len(sectors), dtype=np.int32), sectors * rings)
    place = np.arange(len(zone), dtype=np.int32) - first[zone]
    ring, sector = place // sectors[zone], place % sectors[zone]
    width = np.diff(edges) / rings
    distance = edges[zone] + (ring + 0.5) * width[zone]
    azimuth = (sector + 0.5) / sectors[zone] * (2.0 * math.pi)
    starts = np.concatenate([first[z] + sectors[z] * np.arange(rings[z]) for z in range(len(sectors))])
    counts = np.repeat(sectors, rings)
    line = np.searchsorted(starts, np.arange(len(zone)), side="right") - 1
    near = np.full((len(zone), NEIGHBOURS), -1, np.int32)
    near[:, 3] = starts[line] + (sector - 1) % counts[line]
    near[:, 4] = starts[line] + (sector + 1) % counts[line]
    for column, step in ((0, -1), (5, 1)):
        other = line + step
        there = (other >= 0) & (other < len(starts))
        to = other[there]
        opposite = ((sector[there] + 0.5) / counts[line[there]] * counts[to]).astype(np.int64)
        for k in range(3):
            near[there, column + k] = starts[to] + (opposite + k - 1) % counts[to]
    return CellLayout(distance, azimuth, near, zone, ring.astype(np.int32), sector.astype(np.int32))
