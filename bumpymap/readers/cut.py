"""Cutting a file into pieces."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import UsageError
from bumpymap.readers.protocol import Chunk

__all__ = ["chunk_points", "cut_chunks", "cut_rows"]

_PIECE_BYTES = 1 << 26
"""No piece is larger in memory, however long a point is, unless one chunk of the file is."""


def chunk_points(points: int, point_size: int) -> int:
    """Points that a piece may hold when a point takes so many bytes. Raises UsageError for less than one."""
    if points < 1:
        raise UsageError(f"a piece of {points} points was asked for; it must hold at least 1")
    return max(min(points, _PIECE_BYTES // point_size), 1)


def cut_rows(total: int, points: int, point_size: int) -> list[Chunk]:
    """Pieces of a file that can be cut anywhere."""
    step = chunk_points(points, point_size)
    return [Chunk(index, first, min(step, total - first)) for index, first in enumerate(range(0, total, step))]


def cut_chunks(ends: NDArray[np.int64], points: int, point_size: int) -> Sequence[tuple[int, int]]:
    """Cut into runs of whole chunks that hold at most so many points, or one chunk.

    Parameters
    ----------
    ends : int64 (n,)
        Points of the file up to the end of each chunk.

    Returns
    -------
    sequence of (int, int)
        First chunk, and the one behind the last.
    """
    step = chunk_points(points, point_size)
    runs: list[tuple[int, int]] = []
    first, before = 0, 0
    while first < ends.size:
        last = max(int(np.searchsorted(ends, before + step, side="right")), first + 1)
        runs.append((first, last))
        first, before = last, int(ends[last - 1])
    return runs
