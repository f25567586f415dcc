"""Convert raw records or table rows of a chunk to points in metres, drop unusable ones, and count all of them."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import POINT_BUILDING, POINT_GROUND, POINT_PLANT, Georeference, PointCloud
from bumpymap.readers._kernels import (
    KEPT,
    CountedPoints,
    CountedRecords,
    FilePoints,
    LinedPoints,
    RecordCounts,
    RecordRules,
    ScaledLinedPoints,
    WatchCounts,
    WatchRules,
    filter_points,
    filter_records,
)
from bumpymap.readers.point_stats import OUTSIDE, LineRules, LineSums, PointStats
from bumpymap.readers.protocol import ChunkPoints
from bumpytiles import Bounds, ScaledPoints, Scaling

__all__ = ["NO_POINTS", "PointChecks", "RawPoints", "RecordLayout", "convert_las_points", "convert_table_points"]


NO_POINTS = PointCloud(np.empty(0), np.empty(0), np.empty(0), np.empty(0, np.uint8))
_LOWEST, _HIGHEST = -(1 << 31), (1 << 31) - 1
_ANYWHERE = np.array([-np.inf, -np.inf, np.inf, np.inf])
_KINDS = np.zeros(256, np.uint8)
_KINDS[2], _KINDS[3:6], _KINDS[6] = POINT_GROUND, POINT_PLANT, POINT_BUILDING


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
    pieces: Iterable[NDArray[np.uint8]],
    points: int,
    layout: RecordLayout,
    place: Georeference,
    checks: PointChecks,
    lines: LineRules | None = None,
) -> ChunkPoints:
    """Convert LAS point records.

    Parameters
    ----------
    pieces : iterable of uint8 (n, bytes of a point)
        The records; may be iterated again. Each piece is only valid until the next is taken.
    points : int
        Number of records at most.
    layout : RecordLayout
    place : Georeference
        Its units are used.
    checks : PointChecks
    lines : LineRules, optional
    """
    units = (place.metres_per_unit, place.metres_per_unit, place.metres_per_unit_z)
    scaling = Scaling(layout.scales, layout.offsets, units)
    bytes_of_fields = (layout.class_byte, layout.class_mask, layout.withheld_byte, layout.withheld_mask)
    rules = RecordRules(
        np.array([*bytes_of_fields, layout.line_byte, layout.line]),
        np.array([_integers_inside(scaling, axis, checks.file_bounds) for axis in (0, 1)]).reshape(-1),
        _KINDS,
    )
    x, y, z = (np.empty(points, np.int32) for _ in range(3))
    out = CountedRecords(x, y, z, np.empty(points, np.uint8), np.empty(points, np.uint16))
    seen = RecordCounts(np.array([_HIGHEST, _LOWEST] * 3), np.zeros(4, np.int64), np.zeros(256, np.int64))
    number = 0
    for records in pieces:
        filter_records(records, rules, out, seen)
        number += len(records)
    stats = _stats_of_records(seen, number, scaling)
    if not math.isfinite(max(abs(side) for side in (stats.west, stats.south, stats.east, stats.north, stats.highest))):
        stats = replace(stats, **_not_finite(pieces, scaling, checks.first))
    kept = 0 if stats.bad else int(seen.counts[3])
    x, y, z, kind, line = out.x[:kept], out.y[:kept], out.z[:kept], out.kind[:kept], out.line[:kept]
    if lines is not None and lines.corrects:
        scaled = ScaledPoints(x, y, z, kind, scaling)
        in_metres = LinedPoints(*scaled.coordinates(), kind, line)
        lines.correct(in_metres)
        cloud = PointCloud(in_metres.x, in_metres.y, in_metres.z, kind)
        return ChunkPoints(cloud, stats, lines.sums(in_metres), seen.classes)
    sums = LineSums() if lines is None else lines.sums(ScaledLinedPoints(x, y, z, kind, line), scaling)
    if kept < number // 2:
        # A view would keep the memory of the dropped points.
        x, y, z, kind = x.copy(), y.copy(), z.copy(), kind.copy()
    return ChunkPoints(ScaledPoints(x, y, z, kind, scaling), stats, sums, seen.classes)


def _stats_of_records(seen: RecordCounts, number: int, scaling: Scaling) -> PointStats:
    """Return the statistics of records. Coordinates grow, or fall, with their integers: the ends are enough."""
    if not number:
        return PointStats()
    (west, east), (south, north), (low, high) = (
        sorted(scaling.coordinates(axis, seen.extremes[2 * axis : 2 * axis + 2]).tolist()) for axis in range(3)
    )
    withheld, noise, outside, _ = seen.counts.tolist()
    highest = max(abs(low), abs(high))
    return PointStats(number, withheld, noise, 0, outside, 0, 0, -1, west, south, east, north, highest)


def _not_finite(pieces: Iterable[NDArray[np.uint8]], scaling: Scaling, first: int) -> dict[str, int]:
    """Count the points with infinite coordinates, and find the first; ``first`` is the number of the first point."""
    bad, first_bad = 0, -1
    for records in pieces:
        words = np.ascontiguousarray(records[:, :12]).view("<i4")
        places = np.stack([scaling.coordinates(axis, words[:, axis]) for axis in range(3)])
        found = np.flatnonzero(~np.isfinite(places).all(axis=0))
        if len(found) and first_bad < 0:
            first_bad = first + int(found[0])
        bad += len(found)
        first += len(records)
    return {"not_finite": bad, "first_not_finite": first_bad}


@lru_cache(64)
def _integers_inside(scaling: Scaling, axis: int, bounds: Bounds | None) -> tuple[int, int]:
    """Return the lowest and the highest integer of an axis that lie in the box of a file; low > high: none do."""
    west, south, east, north = _limits(bounds).tolist()
    low, high = ((west, east), (south, north))[axis]
    rising = scaling.scales[axis] > 0

    def first(is_past: Callable[[float], bool]) -> int:
        """Return the first integer whose coordinate passes a test that holds for all after it."""
        before, at = _LOWEST - 1, _HIGHEST + 1
        while at - before > 1:
            middle = (before + at) // 2
            before, at = (before, middle) if is_past(float(scaling.coordinates(axis, middle))) else (middle, at)
        return at

    if rising:
        return first(lambda place: place >= low), first(lambda place: place > high) - 1
    return first(lambda place: place <= high), first(lambda place: place < low) - 1


def convert_table_points(raw: RawPoints, checks: PointChecks) -> ChunkPoints:
    """Convert rows of a table; the coordinate arrays of ``raw`` are overwritten."""
    axes = (raw.easting, raw.northing, raw.upward)
    size = raw.easting.size
    points = FilePoints(*axes, _codes(raw), np.zeros(size, np.bool_), np.zeros(size, np.uint16))
    out = CountedPoints(*axes, np.empty(size, np.uint8), np.empty(size, np.uint16))
    seen_stats = _empty_stats()
    filter_points(points, _rules(checks), out, seen_stats)
    return _chunk_points(out, size, seen_stats)


def _empty_stats() -> WatchCounts:
    empty = PointStats()
    extremes = np.array([empty.west, empty.south, empty.east, empty.north, empty.highest])
    return WatchCounts(extremes, np.array([0, 0, 0, 0, 0, empty.first_not_finite, 0]), np.zeros(256, np.int64))


def _rules(checks: PointChecks) -> WatchRules:
    return WatchRules(_limits(checks.file_bounds), checks.nan_is_no_return, checks.first, _KINDS)


def _limits(bounds: Bounds | None) -> NDArray[np.float64]:
    if bounds is None:
        return _ANYWHERE
    return np.array([bounds.west - OUTSIDE, bounds.south - OUTSIDE, bounds.east + OUTSIDE, bounds.north + OUTSIDE])


def _codes(raw: RawPoints) -> NDArray[np.uint8]:
    """Return class codes as bytes; what is no class becomes 0."""
    if raw.class_id is None:
        return np.zeros(raw.easting.size, np.uint8)
    codes = raw.class_id
    valid = (codes >= 0) & (codes <= 255) & (codes % 1 == 0)
    return np.where(valid, codes, 0).astype(np.uint8)


def _chunk_points(out: CountedPoints, seen: int, seen_stats: WatchCounts) -> ChunkPoints:
    counts = seen_stats.counts
    withheld, noise, no_return, outside, bad, first = counts[:KEPT].tolist()
    # Points outside their octree node are counted by `count_points_outside_node`.
    stats = PointStats(seen, withheld, noise, no_return, outside, 0, bad, first, *seen_stats.extremes.tolist())
    kept = 0 if stats.bad else int(counts[KEPT])
    cloud = PointCloud(out.x[:kept], out.y[:kept], out.z[:kept], out.kind[:kept])
    if kept < seen // 2:
        # A view would keep the memory of the dropped points.
        cloud = PointCloud(cloud.easting.copy(), cloud.northing.copy(), cloud.upward.copy(), cloud.kind.copy())
    return ChunkPoints(cloud, stats, classes=seen_stats.classes)
