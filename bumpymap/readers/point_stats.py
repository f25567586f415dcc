"""Statistics of the points of a file, and the check of these against its header.

The extent and point count in a header can only be checked when all points have been read, and the chunks of a file may
be read in any order, by several machines. Each chunk has a ``PointStats``; they are merged, and ``verify`` compares the
result with the header.
"""

import base64
import math
import zlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    DECK_CLASS,
    POINT_BUILDING,
    POINT_CLASSED,
    POINT_DECK,
    POINT_GROUND,
    POINT_OTHER,
    POINT_PLANT,
    BadInputError,
    PointCloud,
    loops,
)
from bumpymap.readers.source import TRUST, Location, box_text, refuse_count
from bumpytiles import Bounds, Scaling

MOST_ROWS = 50_000
"""Rows of the sample at most: 4.4 MB."""
_WAITING_ROWS = 2 * MOST_ROWS
"""From this many rows on the parts are merged."""
_LARGEST_STEP = 1 << 24
"""Tiles along a side of the squares of the coarsest count: they span every survey on Earth."""
CELL, QUANTA = 3.0, 1e4
"""Side of a cell of flight lines, m; steps of a coordinate in a metre."""
SUMS, AXIS_BITS, LINE_BITS = loops.SUMS, loops.AXIS_BITS, loops.LINE_BITS
"""Sums of a cell; bits of column and row, and of line and ground flag, in a key: see `LineSums`."""
_MIX = np.uint64(0x9E3779B97F4A7C15)


def kinds_of(ground_classes: tuple[int, ...]) -> NDArray[np.uint8]:
    """Return the kind of the points of each LAS class, (256,)."""
    kinds = np.full(256, POINT_CLASSED, np.uint8)
    kinds[:2], kinds[3:6], kinds[6] = POINT_OTHER, POINT_PLANT, POINT_BUILDING
    for code in ground_classes:
        kinds[code] = POINT_DECK if code == DECK_CLASS else POINT_GROUND
    return kinds


Rows = NDArray[np.int64]
"""(n, 1 + ``SUMS``) keys and sums, see `LineSums`."""


class LinedPoints(NamedTuple):
    """Points with their flight line, (n,) each; coordinates in m, or as integers of the file's own grid."""

    x: NDArray[Any]
    y: NDArray[Any]
    z: NDArray[Any]
    kind: NDArray[np.uint8]
    line: NDArray[np.uint16]


@dataclass(frozen=True, slots=True, eq=False)
class LineSums:
    """Sums of flight lines in one of ``step`` cells; can be sent and stored. The order of merging does not matter."""

    step: int = 1
    """A power of two."""
    parts: tuple[Rows, ...] = ()
    """Rows of cells, 3 m wide, with increasing keys in each part; a key may be in several of them.

    A key: column and row of the cell, 23 bits each, line and ground flag, 17 bits. Sums: number of points, x, y, z,
    x x, x y, y y, x z, y z, z z, by steps of 0.1 mm from the south-west corner of the cell.
    """

    @property
    def size(self) -> int:
        """Number of rows in all parts."""
        return sum(len(part) for part in self.parts)

    def merge(self, other: "LineSums") -> "LineSums":
        """Return the sums of both sets of points."""
        joined = LineSums(max(self.step, other.step), (*self.parts, *other.parts))
        return joined.merged() if joined.size > _WAITING_ROWS else joined

    def merged(self) -> "LineSums":
        """Return the same with one part, reduced to the size of the sample."""
        step, rows = self.step, np.concatenate([np.zeros((0, 1 + SUMS), np.int64), *self.parts])
        rows = rows[sampled(rows[:, 0] >> LINE_BITS, step)]
        rows = np.column_stack(summed(rows[:, 0], rows[:, 1:]))
        while len(rows) > MOST_ROWS and step < _LARGEST_STEP:
            step *= 2
            rows = rows[sampled(rows[:, 0] >> LINE_BITS, step)]
        return LineSums(step, (rows,))

    def rows(self) -> Rows:
        """Return keys and sums with increasing keys."""
        return self.merged().parts[0]

    def to_record(self) -> dict[str, Any]:
        """Return a dict for JSON."""
        merged = self.merged()
        data = zlib.compress(np.ascontiguousarray(merged.parts[0].T, "<i8").tobytes(), 1)
        return {"step": merged.step, "rows": base64.b64encode(data).decode("ascii")}

    @classmethod
    def from_record(cls, record: dict[str, Any]) -> Self:
        """Restore the sums from the dict of ``to_record``."""
        data = np.frombuffer(zlib.decompress(base64.b64decode(record["rows"])), "<i8").reshape(1 + SUMS, -1)
        return cls(record["step"], (np.ascontiguousarray(data.T, np.int64),))

    @classmethod
    def of(cls, points: LinedPoints, scaling: Scaling | None = None) -> Self:
        """Return the sums of some points; ``scaling`` is that of points of a file's own grid."""
        parts, slots = [], loops.SLOTS
        numbers = np.empty(0) if scaling is None else scaling.numbers()
        add = loops.add_points if scaling is None else loops.add_scaled_points
        state = np.zeros(2, np.int64)  # the next point to add, and the rows of the table in use
        while state[0] < len(points.x):
            keys, sums, state[1] = np.full(slots, -1), np.zeros((slots, SUMS), np.int64), 0
            add(points, numbers, keys, sums, state)
            held = np.flatnonzero(keys >= 0)
            held = held[np.argsort(keys[held])]
            parts.append(np.column_stack([keys[held], sums[held]]))
        return cls(1, tuple(parts))


def cell_indices(cells: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return column and row of cells by the leading bits of their keys; both are between -2^22 and 2^22."""
    half, mask = 1 << (AXIS_BITS - 1), (1 << AXIS_BITS) - 1
    col, row = ((((cells >> shift) & mask) ^ half) - half for shift in (AXIS_BITS, 0))
    return col, row


def sampled(codes: NDArray[np.int64], step: int) -> NDArray[np.bool_]:
    """Return which cells, or tiles, are in a sample of one in ``step``, a power of two, by a hash of their codes."""
    mixed = (codes.astype(np.uint64) * _MIX) >> np.uint64(40)
    return np.asarray((mixed & np.uint64(step - 1)) == 0)


def summed(
    keys: NDArray[np.int64], values: NDArray[Any], join: np.ufunc = np.add
) -> tuple[NDArray[np.int64], NDArray[Any]]:
    """Join the values, (n, ...), of equal keys, (n,), at least 0; return increasing keys and their sums, or other."""
    order = np.argsort(keys, kind="stable")
    keys, values = keys[order], values[order]
    first = np.flatnonzero(np.diff(keys, prepend=-1))
    return (keys, values) if len(first) == len(keys) else (keys[first], join.reduceat(values, first, axis=0))


_DROPPED = ("withheld", "noise", "not_a_number")
"""Reasons for dropping a point: flagged as withheld; class 7 or 18; PCD rows of NaN, which mean "no return"."""

OUTSIDE = 1.0
"""How far a point may lie outside the bounds of its file or chunk, m, since headers are rounded."""
EARTH_LIMIT = 3e9
"""Coordinates beyond this, m, are not a location on Earth in any CRS or unit."""
_ROUNDED_M = 0.02
"""The extent in a header may be rounded by this much."""
_FAR_TOO_LARGE, _FAR_TOO_LARGE_RATIO = 10_000.0, 10.0
"""A side of the header's bounds longer than this, m, and than this multiple of the points' extent is wrong."""
_REMOVE = "Remove them, such as with: pdal translate IN OUT.laz range --filters.range.limits="


_SQUARE_M, _TALL_M, _TALL_SHARE, _SQUARE_POINTS = 15.0, 35.0, 0.02, 10
"""Side of a square; if the heights in it, without a tenth at either end, span more than the second in more than this
share of the squares, the unit is hardly the metre. In metres: 0 of woods, towns, quarries and slopes (10 surveys), 1.5
% of one in steep mountains; in feet: 8 to 72 % of woods and towns. Squares of fewer points do not count."""
_FOOT_M, _POLE_M = 0.3048, 10_001_966.0
"""Northing of the pole, m, which no CRS in metres of a survey exceeds."""


def likely_feet(clouds: Sequence[PointCloud]) -> str:
    """Return why points that are taken as metres may be feet; empty if they may not."""
    most, squares, tall = 0.0, 0, 0
    for cloud in clouds:
        most = max(most, cloud.northing.max(initial=0.0))
        col, row = (np.floor(axis / _SQUARE_M).astype(np.int64) for axis in (cloud.easting, cloud.northing))
        order = np.lexsort((cloud.upward, row, col))
        first = np.flatnonzero((np.diff(col[order], prepend=np.nan) != 0) | (np.diff(row[order], prepend=np.nan) != 0))
        count = np.diff(first, append=order.size)
        first, count = first[count >= _SQUARE_POINTS], count[count >= _SQUARE_POINTS]
        height = cloud.upward[order]
        squares += count.size
        tall += int(np.count_nonzero(height[first + count * 9 // 10] - height[first + count // 10] > _TALL_M))
    if _POLE_M < most < _POLE_M / _FOOT_M:
        return f"taken as metres, its northings of up to {most:,.0f} lie beyond the pole"
    if tall > _TALL_SHARE * squares:
        return (
            f"taken as metres, heights in {tall / squares:.0%} of its squares of 15 m lie more than {_TALL_M:g} m apart"
        )
    return ""


@dataclass(frozen=True, slots=True)
class PointStats:
    """Statistics of some points of one file; plain numbers, so that it can be sent and stored."""

    points: int = 0
    """All points, dropped ones included."""
    withheld: int = 0
    noise: int = 0
    not_a_number: int = 0
    """Beams without return (PCD)."""
    outside: int = 0
    """Points more than ``OUTSIDE`` outside the header's bounds."""
    not_finite: int = 0
    """Points with NaN or infinite coordinates, except beams without return."""
    first_not_finite: int = -1
    """Index of the first such point in the file; -1: none."""
    west: float = math.inf
    south: float = math.inf
    east: float = -math.inf
    north: float = -math.inf
    """Extent of the points, m; inverted (west = inf, east = -inf) if there are none."""
    lowest: float = math.inf
    top: float = -math.inf
    """Lowest and highest point, m; inverted if there are none."""
    coloured: int = 0
    """Points with a colour, among those that are not dropped."""

    @classmethod
    def within(cls, ends: Sequence[Any], points: int, **counts: int) -> Self:
        """Return the statistics of points between the ends of easting, northing and height, m."""
        (west, east), (south, north), (low, high) = (map(float, pair) for pair in ends)
        return cls(points, west=west, south=south, east=east, north=north, lowest=low, top=high, **counts)

    def merge(self, other: "PointStats") -> "PointStats":
        """Return the statistics of both sets of points; the order does not matter."""
        firsts = [first for first in (self.first_not_finite, other.first_not_finite) if first >= 0]
        join: dict[str, Callable[..., Any]] = {"west": min, "south": min, "east": max, "north": max}
        join |= {"lowest": min, "top": max}
        both = {f.name: (getattr(self, f.name), getattr(other, f.name)) for f in fields(self)}
        joined = {name: join[name](*pair) if name in join else sum(pair) for name, pair in both.items()}
        return PointStats(**joined | {"first_not_finite": min(firsts, default=-1)})

    @property
    def dropped(self) -> dict[str, int]:
        """Number of dropped points, by reason."""
        return {reason: getattr(self, reason) for reason in _DROPPED}

    @property
    def bad(self) -> bool:
        """True if points make the file unusable; ``verify`` raises the error."""
        return bool(self.not_finite or self.outside or self.off_earth or self.highest > EARTH_LIMIT)

    @property
    def highest(self) -> float:
        """Largest absolute height, m."""
        return max(0.0, -self.lowest, self.top)

    @property
    def off_earth(self) -> bool:
        """True if a point has an easting or northing that is not on Earth."""
        return max(-self.west, -self.south, self.east, self.north) > EARTH_LIMIT

    @property
    def bounds(self) -> Bounds:
        """Extent of the points, m."""
        return Bounds(self.west, self.south, self.east, self.north)

    def to_record(self) -> dict[str, Any]:
        """Return a dict for JSON, with infinite numbers as str."""
        return {name: str(value) if math.isinf(value) else value for name, value in asdict(self).items()}

    @classmethod
    def from_record(cls, record: dict[str, Any]) -> Self:
        """Restore the statistics from the dict of ``to_record``."""
        numbers: dict[str, Any] = {name: float(v) if isinstance(v, str) else v for name, v in record.items()}
        return cls(**numbers)


def verify(stats: PointStats, path: Location, declared: int, bounds: Bounds | None) -> None:
    """Check the points of a file against its header.

    ``stats``: statistics of all points; ``declared``: number of points that the header declares;
    ``bounds``: bounds in the header, m; None: there are none to check. Raises BadInputError: the
    points are unusable, or contradict the header.
    """
    if stats.not_finite:
        raise BadInputError(
            f"{path} holds {stats.not_finite:,} points whose coordinates are not a number or infinite; the first is "
            f"point {stats.first_not_finite:,} (counted from 0). {_REMOVE}'X[-1e9:1e9],Y[-1e9:1e9],Z[-1e9:1e9]'"
        )
    refuse_count(path, declared, stats.points)
    if stats.off_earth:
        raise BadInputError(
            f"the points of {path} lie in {box_text(stats.bounds)}, which is not a location on Earth: are scale, "
            "offset and CRS of the file right?"
        )
    if stats.highest > EARTH_LIMIT:
        raise BadInputError(
            f"{path} holds heights of up to {stats.highest:g} m from zero, which is not a location on Earth: a nodata "
            f"value, or a wrong scale? {_REMOVE}'Z[-1e4:1e4]'"
        )
    if bounds is not None and stats.points:
        _verify_extent(stats, path, bounds)


def header_doubt(stats: PointStats, bounds: Bounds | None, heights: tuple[float, float] | None) -> str:
    """Return where the extent in a header, which `verify` accepts, is not that of all points; empty if it is.

    A damaged LAZ file decodes to other points: it has no checksum, but its header knows where they lay.
    """
    if bounds is None or heights is None or not stats.points:
        return ""
    said = {"easting": (bounds.west, bounds.east), "northing": (bounds.south, bounds.north), "height": heights}
    own = ((stats.west, stats.east), (stats.south, stats.north), (stats.lowest, stats.top))
    wrong = [
        f"{name} of {low:,.2f} to {high:,.2f} m, and its points have {least:,.2f} to {most:,.2f} m"
        for (name, (low, high)), (least, most) in zip(said.items(), own, strict=True)
        if not (abs(low - least) <= _ROUNDED_M and abs(high - most) <= _ROUNDED_M)
    ]
    if not wrong:
        return ""
    return (
        f"its header gives {'; '.join(wrong)}. Is the file damaged, or were points cut out of it or moved without "
        "updating the header? If in doubt, compare it with the original"
    )


def _verify_extent(stats: PointStats, path: Location, bounds: Bounds) -> None:
    claimed = (bounds.east - bounds.west, bounds.north - bounds.south)
    own = (stats.east - stats.west, stats.north - stats.south)
    far_too_large = any(
        side > _FAR_TOO_LARGE and side > _FAR_TOO_LARGE_RATIO * length
        for side, length in zip(claimed, own, strict=True)
    )
    if stats.outside or far_too_large:
        count = f"; {stats.outside:,} of {stats.points:,} points are outside" if stats.outside else ""
        raise BadInputError(
            f"the header of {path} says that the points lie in {box_text(bounds)}, but they lie in "
            f"{box_text(stats.bounds)}{count}. Is the file damaged, or was it cut out of another "
            f"file without updating the header? {TRUST}"
        )
