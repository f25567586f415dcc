"""What was fetched, made into batches: points that count, in metres, and the tally of all."""

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
from bumpymap.readers.point_stats import OUTSIDE, PointStats
from bumpymap.readers.protocol import ChunkPoints
from bumpytiles import Bounds

__all__ = ["NO_POINTS", "RawPoints", "RecordLayout", "Watch", "batch_of_points", "batch_of_records"]


NO_POINTS = PointCloud(np.empty(0), np.empty(0), np.empty(0), np.empty(0, np.bool_))
_ANYWHERE = np.array([-np.inf, -np.inf, np.inf, np.inf])


@dataclass(frozen=True, slots=True)
class RawPoints:
    """Points as a table holds them, before any is left out; metres."""

    easting: NDArray[np.float64]
    northing: NDArray[np.float64]
    upward: NDArray[np.float64]
    class_id: NDArray[np.number] | None = None
    """LAS class codes, of any number type; None where the file has none."""


@dataclass(frozen=True, slots=True)
class RecordLayout:
    """Where a LAS record keeps what is needed, and how its integers become coordinates."""

    scales: tuple[float, float, float]
    offsets: tuple[float, float, float]
    class_byte: int
    class_mask: int
    withheld_byte: int
    withheld_mask: int


@dataclass(frozen=True, slots=True)
class Watch:
    """What the points of a piece are held to."""

    first: int
    """Number of its first point in the file."""
    file_bounds: Bounds | None
    nan_is_no_return: bool = False
    """Whether a row with NaN coordinates is a beam without return, as in PCD, or a fault."""


def batch_of_records(
    records: NDArray[np.uint8], layout: RecordLayout, place: Georeference, watch: Watch
) -> ChunkPoints:
    """Convert LAS records.

    Parameters
    ----------
    records : uint8 (n, bytes of a point)
    layout : RecordLayout
    place : Georeference
        Gives the units.
    watch : Watch
    """
    units = (place.metres_per_unit, place.metres_per_unit, place.metres_per_unit_z)
    numbers = np.array([*layout.scales, *layout.offsets, *units])
    places = np.array([layout.class_byte, layout.class_mask, layout.withheld_byte, layout.withheld_mask])
    x, y, z = np.empty((3, STRIP))
    strip = FilePoints(x, y, z, np.empty(STRIP, np.uint8), np.empty(STRIP, np.bool_))
    size = len(records)
    out = CountedPoints(np.empty(size), np.empty(size), np.empty(size), np.empty(size, np.bool_))
    watched = _start()
    convert_records(records, RecordNumbers(numbers, places), _rules(watch), strip, out, watched)
    return _batch(out, size, watched)


def batch_of_points(raw: RawPoints, watch: Watch) -> ChunkPoints:
    """Convert rows of a table; the coordinates of ``raw`` are used up."""
    axes = (raw.easting, raw.northing, raw.upward)
    size = raw.easting.size
    points = FilePoints(*axes, _codes(raw), np.zeros(size, np.bool_))
    out = CountedPoints(*axes, np.empty(size, np.bool_))
    watched = _start()
    filter_points(points, _rules(watch), out, watched)
    return _batch(out, size, watched)


def _start() -> WatchCounts:
    empty = PointStats()
    extremes = np.array([empty.west, empty.south, empty.east, empty.north, empty.highest])
    return WatchCounts(extremes, np.array([0, 0, 0, 0, 0, empty.first_not_finite, 0]))


def _rules(watch: Watch) -> WatchRules:
    return WatchRules(_sides(watch.file_bounds), watch.nan_is_no_return, watch.first)


def _sides(bounds: Bounds | None) -> NDArray[np.float64]:
    if bounds is None:
        return _ANYWHERE
    return np.array([bounds.west - OUTSIDE, bounds.south - OUTSIDE, bounds.east + OUTSIDE, bounds.north + OUTSIDE])


def _codes(raw: RawPoints) -> NDArray[np.uint8]:
    """Class codes of any number type as bytes; only ground and noise are told apart."""
    codes = np.zeros(raw.easting.size, np.uint8)
    for code in (2, 7, 18) if raw.class_id is not None else ():
        codes[raw.class_id == code] = code
    return codes


def _batch(out: CountedPoints, seen: int, watched: WatchCounts) -> ChunkPoints:
    counts = watched.counts
    withheld, noise, no_return, outside, bad, first = counts[:KEPT].tolist()
    # What is astray in an octree is found elsewhere, see `count_astray`.
    tally = PointStats(seen, withheld, noise, no_return, outside, 0, bad, first, *watched.extremes.tolist())
    kept = 0 if tally.bad else int(counts[KEPT])
    cloud = PointCloud(out.x[:kept], out.y[:kept], out.z[:kept], out.ground[:kept])
    if kept < seen // 2:
        # A view would keep the room of the points that were left out.
        cloud = PointCloud(cloud.easting.copy(), cloud.northing.copy(), cloud.upward.copy(), cloud.is_ground.copy())
    return ChunkPoints(cloud, tally)
