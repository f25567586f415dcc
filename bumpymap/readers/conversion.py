"""Convert raw records or table rows of a chunk to points in metres, drop unusable ones, and count all of them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Georeference, PointCloud
from bumpymap.readers._kernel import (
    KEPT,
    STRIP,
    CountedPoints,
    FilePoints,
    RecordNumbers,
    WatchCounts,
    WatchRules,
    convert_records,
    filter_points,
)
from bumpymap.readers._line_kernel import LinedPoints
from bumpymap.readers.line_sums import LineRules, LineSums
from bumpymap.readers.point_stats import OUTSIDE, PointStats
from bumpymap.readers.protocol import ChunkPoints
from bumpytiles import Bounds

__all__ = ["NO_POINTS", "PointChecks", "RawPoints", "RecordLayout", "convert_las_points", "convert_table_points"]


NO_POINTS = PointCloud(np.empty(0), np.empty(0), np.empty(0), np.empty(0, np.bool_))
_ANYWHERE = np.array([-np.inf, -np.inf, np.inf, np.inf])


@dataclass(frozen=True, slots=True)
class RawPoints:
    """Points of a table in metres, before any are dropped."""

    easting: NDArray[np.float64]
    northing: NDArray[np.float64]
    upward: NDArray[np.float64]
    class_id: NDArray[np.number] | None = None
    """LAS class codes, of any number type; None if the file has none."""


@dataclass(frozen=True, slots=True)
class RecordLayout:
    """Position of the needed fields in a LAS point record, and scale and offset of its coordinates."""

    scales: tuple[float, float, float]
    offsets: tuple[float, float, float]
    class_byte: int
    class_mask: int
    withheld_byte: int
    withheld_mask: int
    line_byte: int
    """First of two bytes of the point source id."""
    line: int
    """Flight line of points whose point source id is 0: the id of the file."""


@dataclass(frozen=True, slots=True)
class PointChecks:
    """How the points of a chunk are checked."""

    first: int
    """Index of the chunk's first point in the file."""
    file_bounds: Bounds | None
    nan_is_no_return: bool = False
    """Whether a row with NaN coordinates is a beam without return, as in PCD, rather than an error."""


def convert_las_points(
    records: NDArray[np.uint8],
    layout: RecordLayout,
    place: Georeference,
    checks: PointChecks,
    lines: LineRules | None = None,
) -> ChunkPoints:
    """Convert LAS point records.

    Parameters
    ----------
    records : uint8 (n, bytes of a point)
    layout : RecordLayout
    place : Georeference
        Its units are used.
    checks : PointChecks
    lines : LineRules, optional
    """
    units = (place.metres_per_unit, place.metres_per_unit, place.metres_per_unit_z)
    numbers = np.array([*layout.scales, *layout.offsets, *units])
    places = np.array(
        [
            layout.class_byte,
            layout.class_mask,
            layout.withheld_byte,
            layout.withheld_mask,
            layout.line_byte,
            layout.line,
        ]
    )
    x, y, z = np.empty((3, STRIP))
    strip = FilePoints(x, y, z, np.empty(STRIP, np.uint8), np.empty(STRIP, np.bool_), np.empty(STRIP, np.uint16))
    size = len(records)
    out = CountedPoints(
        np.empty(size), np.empty(size), np.empty(size), np.empty(size, np.bool_), np.empty(size, np.uint16)
    )
    seen_stats = _empty_stats()
    convert_records(records, RecordNumbers(numbers, places), _rules(checks), strip, out, seen_stats)
    return _chunk_points(out, size, seen_stats, lines)


def convert_table_points(raw: RawPoints, checks: PointChecks) -> ChunkPoints:
    """Convert rows of a table; the coordinate arrays of ``raw`` are overwritten."""
    axes = (raw.easting, raw.northing, raw.upward)
    size = raw.easting.size
    points = FilePoints(*axes, _codes(raw), np.zeros(size, np.bool_), np.zeros(size, np.uint16))
    out = CountedPoints(*axes, np.empty(size, np.bool_), np.empty(size, np.uint16))
    seen_stats = _empty_stats()
    filter_points(points, _rules(checks), out, seen_stats)
    return _chunk_points(out, size, seen_stats)


def _empty_stats() -> WatchCounts:
    empty = PointStats()
    extremes = np.array([empty.west, empty.south, empty.east, empty.north, empty.highest])
    return WatchCounts(extremes, np.array([0, 0, 0, 0, 0, empty.first_not_finite, 0]))


def _rules(checks: PointChecks) -> WatchRules:
    return WatchRules(_limits(checks.file_bounds), checks.nan_is_no_return, checks.first)


def _limits(bounds: Bounds | None) -> NDArray[np.float64]:
    if bounds is None:
        return _ANYWHERE
    return np.array([bounds.west - OUTSIDE, bounds.south - OUTSIDE, bounds.east + OUTSIDE, bounds.north + OUTSIDE])


def _codes(raw: RawPoints) -> NDArray[np.uint8]:
    """Return class codes as bytes; codes other than ground (2) and noise (7, 18) become 0."""
    codes = np.zeros(raw.easting.size, np.uint8)
    for code in (2, 7, 18) if raw.class_id is not None else ():
        codes[raw.class_id == code] = code
    return codes


def _chunk_points(
    out: CountedPoints, seen: int, seen_stats: WatchCounts, lines: LineRules | None = None
) -> ChunkPoints:
    counts = seen_stats.counts
    withheld, noise, no_return, outside, bad, first = counts[:KEPT].tolist()
    # Points outside their octree node are counted by `count_points_outside_node`.
    stats = PointStats(seen, withheld, noise, no_return, outside, 0, bad, first, *seen_stats.extremes.tolist())
    kept = 0 if stats.bad else int(counts[KEPT])
    points = LinedPoints(out.x[:kept], out.y[:kept], out.z[:kept], out.ground[:kept], out.line[:kept])
    sums = LineSums() if lines is None else lines.apply(points)
    cloud = PointCloud(out.x[:kept], out.y[:kept], out.z[:kept], out.ground[:kept])
    if kept < seen // 2:
        # A view would keep the memory of the dropped points.
        cloud = PointCloud(cloud.easting.copy(), cloud.northing.copy(), cloud.upward.copy(), cloud.is_ground.copy())
    return ChunkPoints(cloud, stats, sums)
