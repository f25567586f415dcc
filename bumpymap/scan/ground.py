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

PARTS = 5
"""Parts of a cell along each side: outwards and around; also in ground.hpp."""
NEIGHBOURS = 8
"""Most neighbours of a cell: three inwards, two beside it, three outwards; also in ground.cpp."""
FOUND = 2
"""Kind of a plane that was fitted to the cell's own points; also in ground.hpp."""


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
    part: Integers
    """(points,) part of the cell, as `part_of_pixel` says."""


class CellGeometry(NamedTuple):
    """Where the cells of the grid lie; (cells,) where nothing else is said."""

    x: Floats
    """Centre, m."""
    y: Floats
    near: Integers
    """(cells, NEIGHBOURS) neighbours: columns 0 to 2 inwards, 3 and 4 beside, 5 to 7 outwards; -1: none."""
    zone: Integers
    ring: Integers
    sector: Integers
    first: Integers
    """(zones,) number of the first cell."""
    rings: Integers
    """(zones,)"""
    sectors: Integers
    """(zones,)"""


class GroundPlanes(NamedTuple):
    """The planes of the cells."""

    plane: Floats
    """(cells, 3) slope along x and y, height at the origin [m]."""
    centre: Floats
    """(cells, 3) x and y of the mean of its points, distance that it was passed on [m]."""
    spread: Floats
    """(cells,) root mean square of its points about it, m."""
    kind: Integers
    """(cells,) 0: none; 1: passed on by a neighbour; ``FOUND``; 3: guessed."""


class SearchRule(NamedTuple):
    """Limits of the search for planes."""

    reach: Floats
    """(zones,) distance within which a point belongs to a plane, m; 0: by the spread of the points."""
    least_points: int
    """Cells with this many points or fewer take their neighbours' plane."""
    neighbours: int
    """Columns of ``CellGeometry.near`` that count: 0 in a first round, NEIGHBOURS after the largest set is known."""
    slope: Floats
    """(2,) slope of the whole ground, which planes that are passed on approach."""


class GroundRule(NamedTuple):
    """Limits that separate ground from objects on it."""

    reach: Floats
    """(zones,) distance from a plane within which a point is ground, m."""
    noise: Floats
    """(zones,) usual root mean square of ground points about their plane, m."""
    least_points: int
    """Cells with more points than this are judged by their own plane alone."""
    belly: float
    """Heights above the ground between which a point is an obstacle, m."""
    height: float


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


class DropRule(NamedTuple):
    """Limits of a drop."""

    least: float
    """Less is none, m."""
    slope: float
    """A drop is steeper than this, against the slope of the ground before it."""
    below: float
    """The beam to what lies below passes the last ground before it above this, against that ground, m. If not, the
    ground goes on, and what is seen below is a reflection in it; -inf where the height of the sensor is not known."""
    slope_x: float
    """Of the whole ground, as the next: what lies below it by less than half of ``least`` is no drop, but a terrace."""
    slope_y: float
    directions: int
    """In which the ground is followed."""


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


_DIRECTIONS = 720
"""Number of directions in which the ground is followed, half a degree apart (chosen)."""
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
    lowest: NDArray[np.float32],
    slope: NDArray[np.float64],
    points: CellPoints,
    grid: ZoneGrid,
    settings: PolarSettings,
    planes: GroundPlanes,
    height_m: float,
) -> NDArray[np.bool_]:
    """Find the cells in which the ground drops by more than the clearance of the belly.

    ``lowest`` (cells, pixels^2, 2): as in `GroundLabels`; unknown in cells without points; ``slope`` (cells, 2): of the
    ground along x and y; 0 where it is not known; ``height_m``: of the origin above the ground, of the ``planes``.
    """
    drops = np.zeros(len(slope), np.int32)
    below = _BELOW_M if height_m > _SENSOR_M else -np.inf
    x, y = _slope(planes).tolist()
    rule = DropRule(settings.belly_m, _SLOPE, below, x, y, _DIRECTIONS)
    loops.find_drops(lowest, slope, points.starts, grid, rule, drops)
    seen = np.repeat(_DIRECTIONS / grid.sectors, grid.sectors * grid.rings)
    return np.asarray(drops >= _SHARE * seen)


_REACH_OF_NOISE, _REACH_M, _USUAL_NOISE_M = 4.0, (0.12, 0.25), 0.03
"""Distance from its plane up to which a point is ground: in standard deviations of ground points, and its limits, m;
the standard deviation where a zone has no plane, m (chosen)."""
_MANY = 16
"""Planes of a zone that bounds the noise of those before it (chosen): nearer, ground is seen no less exactly."""
_LEANS = math.tan(math.radians(10.0))
"""Slope of the whole ground from which it is searched for again along it (chosen)."""
_HIGHEST_M, _STANDS_M = 0.5, 0.5
"""Height above the origin, m, from which ground must have objects on it, and their height above it, m (chosen): a frame
may have its origin below the robot, or z may point down."""


def find_ground(
    points: CellPoints, count: int, settings: PolarSettings, start: float, buffers: SectorBuffers
) -> tuple[GroundPlanes, GroundLabels]:
    """Find the ground of a scan that was placed on the polar grid.

    A plane is found in every cell by seed and refit, once with what its spread allows, and once more when the noise of
    the scan in each zone is known: a sensor that measures exactly tells ground from low plants better. The second time
    a plane has to continue those on all sides, and may step up less than down: cars and walls do. Parts of a cell
    beside its plane, thin and continuing the ground next to them, are ground as well; parts in which points rise from
    the ground without a gap are plants. The origin may be at the sensor, the robot's base or below it, and the frame
    may lean. A scan that hangs from its ground has none: its z axis points down.

    ``count``: points of the scan; ``start``: azimuth of sector 0, rad; ``buffers``: hold ``objects``, ``lowest`` and
    ``kept`` until the next call. Returns the planes, ``FOUND`` where cells have ground of their own, and what is known
    of the points and cells.
    """
    layout = cell_layout(settings)
    azimuth = layout.y + start
    geometry = layout._replace(x=layout.x * np.cos(azimuth), y=layout.x * np.sin(azimuth))
    cells, placed = len(geometry.x), int(points.starts[-2])
    planes = GroundPlanes(np.zeros((cells, 3)), np.zeros((cells, 3)), np.zeros(cells), np.zeros(cells, np.int32))
    zones = len(settings.sectors)
    slope = np.zeros(2)
    for _ in range(2):  # again, if the frame leans: the lowest points are then those at its lower side
        rule = SearchRule(np.zeros(zones), settings.least_points, 0, slope)
        loops.find_planes(points, geometry, rule, planes)
        slope = _slope(planes)
        if math.hypot(*slope) < _LEANS:
            break
    noise = _noise(planes, geometry, zones)
    loops.keep_largest(geometry, planes, noise, slope)
    reach = np.clip(_REACH_OF_NOISE * noise, *_REACH_M)
    rule = SearchRule(reach, settings.least_points, NEIGHBOURS, _slope(planes))
    loops.find_planes(points, geometry, rule, planes)
    if math.isfinite(settings.overhead_m) and _is_upside_down(planes, geometry, points.xyz[:, :placed]):
        planes.kind[:] = 0
    objects, lowest = (
        buffers.empty(name, 2 * settings.pixels**2, np.float32, rows=cells) for name in ("objects", "lowest")
    )
    labels = GroundLabels(
        np.full(count, np.nan, np.float32),
        np.zeros(count, np.bool_),
        np.zeros(cells, np.int32),
        np.zeros(cells, np.int32),
        np.zeros(count, np.bool_),
        np.full(cells, -np.inf, np.float32),
        np.full(cells, np.inf, np.float32),
        objects.reshape(cells, 2, -1),
        lowest.reshape(cells, -1, 2),
        buffers.empty("kept", placed, np.bool_),
        np.zeros(cells, np.int32),
    )
    limits = GroundRule(reach, noise, settings.least_points, settings.belly_m, settings.height_m)
    loops.label_points(points, geometry, planes, limits, labels)
    return planes, labels


def _slope(planes: GroundPlanes) -> NDArray[np.float64]:
    """Return the median slope of the planes that were found (2,), zeros without any."""
    found = planes.kind == FOUND
    return median(planes.plane[found, :2]) if found.any() else np.zeros(2)


def _is_upside_down(planes: GroundPlanes, geometry: CellGeometry, xyz: NDArray[np.float32]) -> bool:
    """Return whether the nearer ground lies above the origin, and no more stands on it than hangs from it."""
    found, slope = np.flatnonzero(planes.kind == FOUND), _slope(planes)
    near = found[: len(found) // 2 + 1]  # cells are sorted outwards
    x, y = geometry.x[near], geometry.y[near]
    a, b, c = planes.plane[near].T
    if not len(near) or (level := median((a - slope[0]) * x + (b - slope[1]) * y + c)) < _HIGHEST_M:
        return False
    height = xyz[2] - (slope[0] * xyz[0] + slope[1] * xyz[1] + level)
    return int((height > _STANDS_M).sum()) <= int((height < -_STANDS_M).sum())


def _noise(planes: GroundPlanes, geometry: CellGeometry, zones: int) -> NDArray[np.float64]:
    """Return the median spread of ground points about their plane in each zone, m."""
    found, least = planes.kind == FOUND, np.inf
    noise = np.full(zones, _USUAL_NOISE_M)
    for zone in reversed(range(zones)):
        spread = planes.spread[found & (geometry.zone == zone)]
        if len(spread):
            noise[zone] = min(median(spread), least)
        if len(spread) >= _MANY:
            least = noise[zone]
    return noise


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
def part_of_pixel(pixels: int) -> NDArray[np.int32]:
    """Return the part of the cell that each pixel of its heightmap lies in."""
    line = np.arange(pixels) * PARTS // pixels
    return (line[:, None] * PARTS + line).astype(np.int32).ravel()


@cache
def cell_layout(settings: PolarSettings) -> CellGeometry:
    """Return the cells with distances in the place of x, and azimuths from sector 0 in the place of y."""
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
    return CellGeometry(
        distance, azimuth, near, zone, ring.astype(np.int32), sector.astype(np.int32), first, rings, sectors
    )
