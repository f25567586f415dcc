"""What is kept of the points to compare flight lines: sums of each line in a sample of the cells of a grid.

Lines are told apart by the point source id of LAS. The sample is chosen by a hash of the cells and halved whenever it
grows too large, so its memory is bounded, and it is the same however the points are cut into chunks and files.
"""

import base64
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from bumpymap.readers._line_kernel import (
    AXIS_BITS,
    CELL,
    LINE_BITS,
    QUANTA,
    SLOTS,
    STRIP,
    SUMS,
    CellTable,
    Corrections,
    LinedPoints,
    ScaledLinedPoints,
    StripPlaces,
    add_points,
    add_scaled_points,
    correct_heights,
)
from bumpytiles import Scaling

__all__ = ["CELL", "QUANTA", "LineCorrection", "LineRules", "LineSums", "cell_indices"]

MOST_ROWS = 50_000
"""Rows of the sample at most: 4.4 MB."""
_WAITING_ROWS = 2 * MOST_ROWS
"""From this many rows on the parts are merged."""
_LARGEST_STEP = 1 << 24
_MIX = np.uint64(0x9E3779B97F4A7C15)

Rows = NDArray[np.int64]
"""(n, 1 + ``SUMS``) keys and sums, see `bumpymap.readers._line_kernel`."""


class LineCorrection(NamedTuple):
    """What is subtracted from the heights of a flight line: ``offset + slope . (point - place)``."""

    line: int
    offset: float
    """m, at the place that follows."""
    east: float
    """m, as the next one."""
    north: float
    slope_east: float
    """m/m, as the next one."""
    slope_north: float


@dataclass(frozen=True, slots=True, eq=False)
class LineSums:
    """Sums of flight lines in one of ``step`` cells; can be sent and stored. The order of merging does not matter."""

    step: int = 1
    """A power of two."""
    parts: tuple[Rows, ...] = ()
    """Rows with increasing keys in each part; a key may be in several of them."""

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
        rows = _summed(rows[_sampled(rows[:, 0], step)])
        while len(rows) > MOST_ROWS and step < _LARGEST_STEP:
            step *= 2
            rows = rows[_sampled(rows[:, 0], step)]
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
    def of(cls, points: "LinedPoints | ScaledLinedPoints", scaling: Scaling | None = None) -> Self:
        """Return the sums of some points; ``scaling`` is that of scaled ones."""
        parts = []
        done = 0
        while done < len(points.x):
            table = CellTable(
                np.full(SLOTS, -1, np.int64), np.zeros((SLOTS, SUMS), np.int64), np.array([done, 0], np.int64)
            )
            if isinstance(points, LinedPoints):
                add_points(points, table)
            elif scaling is not None:
                add_scaled_points(points, scaling.numbers(), StripPlaces(*np.empty((3, STRIP))), table)
            done = int(table.state[0])
            held = np.flatnonzero(table.keys >= 0)
            held = held[np.argsort(table.keys[held])]
            parts.append(np.column_stack([table.keys[held], table.sums[held]]))
        return cls(1, tuple(parts))


class LineRules:
    """What a reader does with flight lines.

    Parameters
    ----------
    measure : bool
        Whether sums are made.
    corrections : sequence of LineCorrection
        What is subtracted from heights, before sums are made.
    """

    def __init__(self, *, measure: bool, corrections: Sequence[LineCorrection]) -> None:
        self._measure = measure
        place = np.full(1 << 16, -1, np.int32)
        place[[own.line for own in corrections]] = np.arange(len(corrections))
        self._corrections = Corrections(place, np.array([own[1:] for own in corrections], np.float64).reshape(-1, 5))

    @property
    def corrects(self) -> bool:
        """Whether heights are corrected."""
        return len(self._corrections.numbers) > 0

    def correct(self, points: LinedPoints) -> None:
        """Correct the heights of points in place."""
        correct_heights(points, self._corrections)

    def sums(self, points: LinedPoints | ScaledLinedPoints, scaling: Scaling | None = None) -> LineSums:
        """Return the sums of points, if they are asked for; ``scaling`` is that of scaled ones."""
        return LineSums.of(points, scaling) if self._measure else LineSums()


def cell_indices(cells: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return column and row of cells by the leading bits of their keys; both are between -2^22 and 2^22."""
    half, mask = 1 << (AXIS_BITS - 1), (1 << AXIS_BITS) - 1
    col, row = ((((cells >> shift) & mask) ^ half) - half for shift in (AXIS_BITS, 0))
    return col, row


def _sampled(keys: NDArray[np.int64], step: int) -> NDArray[np.bool_]:
    """Return which cells are in a sample of one in ``step``."""
    mixed = ((keys >> LINE_BITS).astype(np.uint64) * _MIX) >> np.uint64(40)
    chosen: NDArray[np.bool_] = (mixed & np.uint64(step - 1)) == 0
    return chosen


def _summed(rows: Rows) -> Rows:
    """Add the rows that have the same key."""
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    first = np.flatnonzero(np.diff(rows[:, 0], prepend=-1))
    if len(first) == len(rows):
        return rows
    return np.column_stack([rows[first, 0], np.add.reduceat(rows[:, 1:], first, axis=0)])
