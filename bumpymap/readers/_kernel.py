"""Records to metres, and which points count: one pass over the bytes, without the interpreter's lock.

``convert_records`` decodes LAS records in strips that stay in the processor's cache and hands each to ``_sift``, which
watches every point and moves those that count to the front. Tables (PLY, PCD) come with their coordinates and need
``sift_points`` alone. Points keep their order.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpytiles import entry, inner

__all__ = ["KEPT", "STRIP", "convert_records", "filter_points"]

_FIRST = 5
"""Place in ``counts`` of the number of the first point that is not finite; -1 where there is none."""
KEPT = 6
"""Place in ``counts`` of the points that count, so far."""
STRIP = 1024
"""Points that are decoded at once."""

_ROUND = 1e8
"""10 to the power of the decimals that a coordinate keeps (``columns.DECIMALS``)."""
_FINITE = float(np.finfo(np.float64).max)

Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Flags = NDArray[np.bool_]
Counts = NDArray[np.int64]


@inner
def _filter_point(
    x: Any, y: Any, z: Any, class_id: Any, withheld: Any, total: int,
    box: Any, nan_is_no_return: bool, start: int,
    to_x: Any, to_y: Any, to_z: Any, to_ground: Any,
    extremes: Any, counts: Any,
) -> None:  # fmt: skip
    """Watch ``total`` points and append those that count; see ``sift_points``."""
    west, south, east, north, highest = extremes[0], extremes[1], extremes[2], extremes[3], extremes[4]
    # Nothing is wrong with a point in here; the others are looked at closely.
    inner_west, inner_south = max(box[0], -_FINITE), max(box[1], -_FINITE)
    inner_east, inner_north = min(box[2], _FINITE), min(box[3], _FINITE)
    to = counts[KEPT]
    for i in range(total):
        e, n, u = x[i], y[i], z[i]
        # In this order NaN leaves the extremes alone, as comparisons with it are false; it lies nowhere, too.
        west, east = min(west, e), max(east, e)
        south, north = min(south, n), max(north, n)
        highest = max(highest, abs(u))
        if not (inner_west <= e <= inner_east and inner_south <= n <= inner_north and abs(u) <= _FINITE):
            if e < box[0] or n < box[1] or e > box[2] or n > box[3]:
                counts[3] += 1
            if not (np.isfinite(e) and np.isfinite(n) and np.isfinite(u)):
                if nan_is_no_return and (np.isnan(e) or np.isnan(n) or np.isnan(u)):
                    counts[2] += 1
                    continue
                counts[4] += 1
                if counts[_FIRST] < 0:
                    counts[_FIRST] = start + i
        if withheld[i]:
            counts[0] += 1
            continue
        code = class_id[i]
        if code == 7 or code == 18:  # noqa: PLR1714 (numba builds no set in a loop)
            counts[1] += 1
            continue
        to_x[to], to_y[to], to_z[to], to_ground[to] = e, n, u, code == 2
        to += 1
    counts[KEPT] = to
    extremes[0], extremes[1], extremes[2], extremes[3], extremes[4] = west, south, east, north, highest


@entry("f8:1 f8:1 f8:1 u1:1 ?:1 f8:1 ? i8 f8:1 f8:1 f8:1 ?:1 f8:1 i8:1")
def filter_points(
    x: Floats, y: Floats, z: Floats, class_id: Bytes, withheld: Flags,
    box: Floats, nan_is_no_return: bool, start: int,
    to_x: Floats, to_y: Floats, to_z: Floats, to_ground: Flags,
    extremes: Floats, counts: Counts,
) -> None:  # fmt: skip
    """Watch points and keep those that count.

    Parameters
    ----------
    x, y, z : float64 (n,)
        m.
    klass : uint8 (n,)
        LAS classes; 7 and 18 are noise, 2 is ground.
    withheld : bool (n,)
    box : float64 (4,)
        West, south, east, north that every point must lie in, m.
    nan_is_no_return : bool
        A row with NaN does not count; otherwise it is bad, as infinite ones are.
    start : int
        Number of the first point in the file.
    to_x, to_y, to_z : float64 (n,), to_ground : bool (n,)
        Where points that count go; may be the arrays that they come from.
    extremes : float64 (5,)
        Lowest easting and northing, highest easting and northing, largest distance of a height from zero, m; brought
        up to date, as are the counts.
    counts : int64 (7,)
        Withheld, noise, not a number, outside, not finite, first not finite: as in ``PointStats``; last, those kept.
    """
    _filter_point(
        x, y, z, class_id, withheld, len(x), box, nan_is_no_return, start,
        to_x, to_y, to_z, to_ground, extremes, counts,
    )  # fmt: skip


@inner
def _axis(
    records: Any, at: int, first: int, count: int, scale: float, offset: float, unit: float, out: Any
) -> None:  # fmt: skip
    """Coordinates of a strip: ``integer * scale + offset``, rounded to 1e-8 units, in metres.

    The same steps as ``numpy.round`` takes, so the same bits.
    """
    for i in range(count):
        record = first + i
        word = (
            np.uint32(records[record, at])
            | np.uint32(records[record, at + 1]) << np.uint32(8)
            | np.uint32(records[record, at + 2]) << np.uint32(16)
            | np.uint32(records[record, at + 3]) << np.uint32(24)
        )
        out[i] = np.rint((np.int32(word) * scale + offset) * _ROUND) / _ROUND
    if unit != 1.0:
        for i in range(count):
            out[i] *= unit


@entry("u1:2 f8:1 i8:1 f8:1 i8 f8:1 f8:1 f8:1 u1:1 ?:1 f8:1 f8:1 f8:1 ?:1 f8:1 i8:1")
def convert_records(
    records: Bytes, place: Floats, layout: Counts, box: Floats, start: int,
    x: Floats, y: Floats, z: Floats, class_id: Bytes, withheld: Flags,
    to_x: Floats, to_y: Floats, to_z: Floats, to_ground: Flags,
    extremes: Floats, counts: Counts,
) -> None:  # fmt: skip
    """Turn LAS records into points in metres and keep those that count; see ``sift_points``.

    Parameters
    ----------
    records : uint8 (n, size)
    place : float64 (9,)
        Scales, offsets and metres per unit of x, y and z.
    layout : int64 (4,)
        Byte and mask of the class, byte and mask of the withheld flag.
    x, y, z : float64 (STRIP,), klass : uint8 (STRIP,), withheld : bool (STRIP,)
        Scratch.
    """
    total = len(records)
    for first in range(0, total, STRIP):
        count = min(STRIP, total - first)
        _axis(records, 0, first, count, place[0], place[3], place[6], x)
        _axis(records, 4, first, count, place[1], place[4], place[7], y)
        _axis(records, 8, first, count, place[2], place[5], place[8], z)
        for i in range(count):
            class_id[i] = records[first + i, layout[0]] & layout[1]
            withheld[i] = (records[first + i, layout[2]] & layout[3]) != 0
        _filter_point(
            x, y, z, class_id, withheld, count, box, False, start + first,
            to_x, to_y, to_z, to_ground, extremes, counts,
        )  # fmt: skip
