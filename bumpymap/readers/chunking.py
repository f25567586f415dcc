"""Cut a file into pieces."""

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import UsageError
from bumpymap.readers.protocol import Chunk
from bumpytiles import Bounds

__all__ = ["chunk_capacity", "group_laz_chunks", "split_rows"]

_PIECE_BYTES = 1 << 26
"""No piece is larger in memory, however long a point is, unless one chunk of the file is."""


def chunk_capacity(points: int, point_size: int) -> int:
    """Points that a piece may hold when a point takes so many bytes. Raises UsageError for less than one."""
    if points < 1:
        raise UsageError(f"a piece of {points} points was asked for; it must hold at least 1")
    return max(min(points, _PIECE_BYTES // point_size), 1)


def split_rows(total: int, points: int, point_size: int) -> list[Chunk]:
    """Pieces of a file that can be cut anywhere."""
    step = chunk_capacity(points, point_size)
    return [Chunk(index, first, min(step, total - first)) for index, first in enumerate(range(0, total, step))]


def group_laz_chunks(
    ends: NDArray[np.int64], points: int, point_size: int, boxes: NDArray[np.float64] | None = None
) -> list[Chunk]:
    """Pieces of whole chunks that hold at most so many points, or one chunk.

    Parameters
    ----------
    ends : int64 (n,)
        Points of the file up to the end of each chunk.
    points : int
    point_size : int
        Bytes of a point.
    boxes : float64 (n, 4), optional
        West, south, east and north of each chunk, m; pieces get the box around those of theirs.
    """
    step = chunk_capacity(points, point_size)
    chunks: list[Chunk] = []
    first, before = 0, 0
    while first < ends.size:
        last = max(int(np.searchsorted(ends, before + step, side="right")), first + 1)
        end = int(ends[last - 1])
        bounds = None if boxes is None else _around(boxes[first:last])
        chunks.append(Chunk(len(chunks), before, end - before, bounds))
        first, before = last, end
    return chunks


def _around(boxes: NDArray[np.float64]) -> Bounds:
    return Bounds(*boxes[:, :2].min(axis=0).tolist(), *boxes[:, 2:].max(axis=0).tolist())
