"""Records to metres, and which points count: one pass over the bytes, without the interpreter's lock.

``convert_records`` decodes LAS records in strips that stay in the processor's cache and hands each to ``sift``, which
watches every point and moves those that count to the front. Tables (PLY, PCD) come with their coordinates and need
``sift`` alone. Points keep their order.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["FIRST", "FLOATS", "INTS", "convert_records", "sift"]

FLOATS = 5
"""Numbers that ``sift`` keeps as float64: lowest easting and northing, highest easting and northing, highest height."""
INTS = 7
"""Numbers that ``sift`` keeps as int64, in the order of the counts in ``Tally``; the first bad point comes last."""
FIRST = 6
"""Place of the first bad point among them; -1 where there is none."""

_STRIP = 1024
_ROUND = 1e8
"""10 to the power of the decimals that a coordinate keeps (``columns.DECIMALS``)."""
_FINITE = np.finfo(np.float64).max

Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Flags = NDArray[np.bool_]
Counts = NDArray[np.int64]


def _compiled(function: Callable[..., Any]) -> Any:
    """Compile once and keep the result beside the module or in the user's cache; without either, in every run."""
    try:
        return njit(cache=True, nogil=True)(function)
    except RuntimeError:  # nowhere to write: a read-only installation and no home
        return njit(nogil=True)(function)


@_compiled
def sift(
    x: Floats, y: Floats, z: Floats, klass: Bytes, withheld: Flags,
    box: Floats, cube: Floats, nan_is_no_return: bool, start: int,
    to_x: Floats, to_y: Floats, to_z: Floats, to_ground: Flags, to: int,
    floats: Floats, ints: Counts,
) -> int:  # fmt: skip
    """Watch points and keep those that count.

    Parameters
    ----------
    x, y, z : float64 (n,)
        m.
    klass : uint8 (n,)
        LAS classes; 7 and 18 are noise, 2 is ground.
    withheld : bool (n,)
    box, cube : float64 (4,)
        West, south, east, north that every point, and every point of this piece, must lie in; m.
    nan_is_no_return : bool
        A row with NaN does not count; otherwise it is bad, as infinite ones are.
    start : int
        Number of the first point in the file.
    to_x, to_y, to_z : float64 (m,), to_ground : bool (m,)
        Where points that count go, from ``to`` on; may be the arrays that they come from.
    floats : float64 (FLOATS,), ints : int64 (INTS,)
        Brought up to date.

    Returns
    -------
    int
        ``to`` behind the last point that was kept.
    """
    west, south, east, north, highest = floats[0], floats[1], floats[2], floats[3], floats[4]
    held, noise, no_return, outside, astray, bad = ints[0], ints[1], ints[2], ints[3], ints[4], ints[5]
    # Nothing is wrong with a point in here; the others are looked at closely.
    inner_west, inner_south = max(box[0], cube[0], -_FINITE), max(box[1], cube[1], -_FINITE)
    inner_east, inner_north = min(box[2], cube[2], _FINITE), min(box[3], cube[3], _FINITE)
    for i in range(len(x)):
        e, n, u = x[i], y[i], z[i]
        # In this order NaN leaves the extremes alone, as comparisons with it are false; it lies nowhere, too.
        west, east = min(west, e), max(east, e)
        south, north = min(south, n), max(north, n)
        highest = max(highest, abs(u))
        if not (inner_west <= e <= inner_east and inner_south <= n <= inner_north and abs(u) <= _FINITE):
            if e < box[0] or n < box[1] or e > box[2] or n > box[3]:
                outside += 1
            elif e < cube[0] or n < cube[1] or e > cube[2] or n > cube[3]:
                astray += 1
            if not (np.isfinite(e) and np.isfinite(n) and np.isfinite(u)):
                if nan_is_no_return and (np.isnan(e) or np.isnan(n) or np.isnan(u)):
                    no_return += 1
                    continue
                bad += 1
                if ints[6] < 0:
                    ints[6] = start + i
        if withheld[i]:
            held += 1
            continue
        code = klass[i]
        if code == 7 or code == 18:  # noqa: PLR1714 (numba builds no set in a loop)
            noise += 1
            continue
        to_x[to], to_y[to], to_z[to], to_ground[to] = e, n, u, code == 2
        to += 1
    floats[0], floats[1], floats[2], floats[3], floats[4] = west, south, east, north, highest
    ints[0], ints[1], ints[2], ints[3], ints[4], ints[5] = held, noise, no_return, outside, astray, bad
    return to


@_compiled
def _axis(records: Bytes, at: int, first: int, scale: float, offset: float, unit: float, out: Floats) -> None:
    """Coordinates of a strip: ``integer * scale + offset``, rounded to 1e-8 units, in metres.

    The same steps as ``numpy.round`` takes, so the same bits.
    """
    for i in range(len(out)):
        record = records[first + i]
        word = (
            np.uint32(record[at])
            | np.uint32(record[at + 1]) << np.uint32(8)
            | np.uint32(record[at + 2]) << np.uint32(16)
            | np.uint32(record[at + 3]) << np.uint32(24)
        )
        out[i] = np.rint((np.int32(word) * scale + offset) * _ROUND) / _ROUND
    if unit != 1.0:
        for i in range(len(out)):
            out[i] *= unit


@_compiled
def convert_records(
    records: Bytes, place: Floats, layout: Counts, box: Floats, cube: Floats, start: int,
    to_x: Floats, to_y: Floats, to_z: Floats, to_ground: Flags,
    floats: Floats, ints: Counts,
) -> int:  # fmt: skip
    """Turn LAS records into points in metres and keep those that count; see ``sift``.

    Parameters
    ----------
    records : uint8 (n, size)
    place : float64 (9,)
        Scales, offsets and metres per unit of x, y and z.
    layout : int64 (4,)
        Byte and mask of the class, byte and mask of the withheld flag.
    """
    total = len(records)
    size = min(_STRIP, total)
    x, y, z = np.empty(size), np.empty(size), np.empty(size)
    klass, withheld = np.empty(size, np.uint8), np.empty(size, np.bool_)
    to = 0
    for first in range(0, total, _STRIP):
        count = min(_STRIP, total - first)
        _axis(records, 0, first, place[0], place[3], place[6], x[:count])
        _axis(records, 4, first, place[1], place[4], place[7], y[:count])
        _axis(records, 8, first, place[2], place[5], place[8], z[:count])
        for i in range(count):
            klass[i] = records[first + i, layout[0]] & layout[1]
            withheld[i] = (records[first + i, layout[2]] & layout[3]) != 0
        to = sift(
            x[:count], y[:count], z[:count], klass[:count], withheld[:count],
            box, cube, False, start + first, to_x, to_y, to_z, to_ground, to, floats, ints,
        )  # fmt: skip
    return to
