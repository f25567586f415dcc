"""Split a file into chunks."""

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import UsageError
from bumpymap.readers.protocol import Chunk
from bumpytiles import Bounds

__all__ = ["chunk_capacity", "group_laz_chunks", "split_rows"]

_MOST_BYTES = 1 << 26
"""Bytes of a chunk in memory at most, unless a single LAZ chunk is larger."""


def chunk_capacity(points: int, point_size: int) -> int:
    """Return how many points of ``point_size`` bytes a chunk may hold: at most ``points``, which must be 1 or more."""
    if points < 1:
        raise UsageError(f"chunks of {points} points were requested; a chunk must hold at least 1")
    return max(min(points, _MOST_BYTES // point_size), 1)


def split_rows(total: int, points: int, point_size: int) -> list[Chunk]:
    """Return the chunks of a file that can be split between any two points."""
    step = chunk_capacity(points, point_size)
    return [Chunk(index, first, min(step, total - first)) for index, first in enumerate(range(0, total, step))]


def group_laz_chunks(
    ends: NDArray[np.int64], points: int, point_size: int, boxes: NDArray[np.float64] | None = None
) -> list[Chunk]:
    """Return chunks made of whole LAZ chunks, with at most ``points`` points or a single LAZ chunk each.

    Parameters
    ----------
    ends : int64 (n,)
        Number of points in the file up to the end of each LAZ chunk.
    points : int
    point_size : int
        Bytes of a point.
    boxes : float64 (n, 4), optional
        West, south, east and north of each LAZ chunk, m; the bounds of a chunk enclose those of its LAZ chunks.
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
