"""From a scan to measured sectors of the concentric-zone polar grid.

Sectors are fixed fractions of a turn, so the ground is divided differently when the robot turns by part of a sector.
Where its heading is known, the grid keeps its directions: sector 0 starts at heading 0. A direction that is found from
the points themselves is no substitute: in a straight street their mean wanders by 20 degrees from frame to frame.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, PolarSettings, Scan, SectorStack, loops
from bumpymap.scan.ground import CellPoints, SectorBuffers, ZoneGrid, cell_layout, find_ground, ground_drops

RANSAC_THRESHOLD_M = 0.1
"""Points nearer to a plane than this are its inliers; as for the patches of a survey."""
_LABELS = 32_768
"""Number of labels that 16 bits with a sign hold."""
_LEAST_GROUND_POINTS = 10
"""Fewest ground points of a sector that has ground (chosen)."""
_LINE_M = 0.05
"""Ground points that spread less than this about a plane, and have another principal normal, lie on one or two scan
lines, m: their plane tells the tilt. Points of a wall spread more."""
_LEAST_OBSTACLE_POINTS = 2
"""Fewest points that are an obstacle: a single one may be an error."""


def polar_sectors(
    scan: Scan, settings: PolarSettings | None = None, buffers: SectorBuffers | None = None
) -> SectorStack:
    """Cut a scan into sectors, find the ground in those that hold enough points, and measure it.

    ``settings``: the default is the paper's grid with a zone before it; ``buffers``: reused from earlier scans; the
    returned arrays do not share their memory. Sectors are sorted by zone, ring, sector; there are none if none
    holds enough points. Raises BadInputError: a label is 32,768 or more.
    """
    settings = settings or PolarSettings()
    points = np.ascontiguousarray(scan.points, np.float32)
    start = -scan.heading_rad % (2.0 * math.pi)
    grid = ZoneGrid.of(settings, start / (2.0 * math.pi))
    buffers = buffers or SectorBuffers()
    size = len(points)
    cell, order, pixel, bins = (buffers.empty(name, size, np.int32) for name in ("cell", "order", "pixel", "bin"))
    xyz = buffers.empty("accumulated", size, np.float32, rows=3)
    by_cell = CellPoints(np.zeros(int(grid.sectors @ grid.rings) + 2, np.int64), order, xyz, pixel, bins)
    place = np.empty((size, 2), np.uint16)
    loops.place_points(points, grid, cell, place, by_cell)
    counts = np.diff(by_cell.starts[:-1])
    cells = np.flatnonzero(counts > settings.least_points)
    ground = find_ground(by_cell, size, grid, settings, buffers)
    ground_count = ground.held[cells]
    there = ground_count >= _LEAST_GROUND_POINTS
    measured, pixels = cells[there], settings.pixels
    scalars, normal = np.empty((len(measured), 6)), np.empty((len(measured), 3), np.float32)
    heights = np.empty((len(measured), pixels, pixels), np.float32)
    loops.measure_sectors(by_cell, ground.kept, measured, RANSAC_THRESHOLD_M, scalars, normal, heights)
    for row in np.flatnonzero(normal[:, 2] < settings.least_normal_z):
        own = slice(*by_cell.starts[measured[row] :][:2])
        if ground.height[order[own][ground.kept[own]]].std() < _LINE_M:
            a, b, _ = ground.surface[measured[row]]
            normal[row] = np.array([-a, -b, 1.0]) / math.sqrt(a * a + b * b + 1.0)
    over = scalars[:, 3] - max(float(np.median(scalars[: len(scalars) // 2 + 1, 3])) if len(scalars) else 0.0, 0.0)
    is_level = (normal[:, 2] >= settings.least_normal_z) & (over <= settings.overhead_m)
    obstacles = ground.obstacles[cells]
    stands = there & (obstacles >= _LEAST_OBSTACLE_POINTS)
    slope = np.column_stack([ground.surface[:, :2], ground.surface[:, :2]])
    slope[measured, :2] = np.where(is_level[:, None], scalars[:, 4:], 0.0)
    height = -float(np.median(scalars[is_level, 3])) if is_level.any() else 0.0
    level = -ground.surface[measured[is_level], 2]
    drops = ground_drops(ground, slope, by_cell, grid, settings, height)
    rows = np.full(len(counts) + 1, -1, np.int32)  # the last one is for points outside of the grid
    rows[cells] = np.arange(len(cells), dtype=np.int32)
    point_sector = rows.take(cell, mode="wrap")
    layout = cell_layout(settings)
    return SectorStack(
        settings=settings,
        azimuth_start_rad=start,
        origin_height=float(np.median(level[: len(level) // 4 + 1])) if len(level) else math.nan,  # from the nearest
        zone=layout.zone[cells].astype(np.int16),
        ring=layout.ring[cells].astype(np.int16),
        sector=layout.sector[cells].astype(np.int16),
        count=counts[cells].astype(np.int32),
        normal=_spread(normal, there, 0.0),
        traversable=_spread(is_level, there, False),
        heights=_spread(heights, there, 0.0),
        coverage=_spread(scalars[:, 2].astype(np.float32), there, 0.0),
        variance=_spread(scalars[:, 0].astype(np.float32), there, np.nan),
        residual=_spread(scalars[:, 1].astype(np.float32), there, np.nan),
        label=_labels(scan, point_sector, len(cells)),
        ground_count=np.where(there, ground_count, 0).astype(np.int32),
        obstacle_count=obstacles,
        overhead_count=ground.overhead[cells],
        obstacle=stands | there & drops[cells],
        drop=there & drops[cells],
        obstacle_height=np.where(stands, ground.top[cells], np.float32(np.nan)),
        clearance=np.where(ground.overhead[cells] > 0, ground.clearance[cells], np.float32(np.nan)),
        objects=ground.objects[cells].reshape(-1, 2, settings.pixels, settings.pixels),
        measures=ground.measures[cells],
        places=ground.places,
        point_place=place,
        point_sector=point_sector,
        point_ground=ground.ground,
        point_airborne=ground.airborne,
        point_height=ground.height,
    )


def _spread(values: NDArray[Any], rows: NDArray[np.bool_], gap: float) -> NDArray[Any]:
    """Return values in the rows that are True, ``gap`` in the others."""
    if rows.all():
        return values
    full = np.full((len(rows), *values.shape[1:]), gap, values.dtype)
    full[rows] = values
    return full


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
