"""How a memory budget is divided: how many points may wait, and how many are read and sorted at a time.

The shares were measured: a waiting point takes 14 or 26 bytes, one that is being read up to 95 (its record, its
coordinates, its index in a block), one that is being sorted 63. Waiting points may reach one and a half times their
limit while the older half is written to disk.
"""

import math
from dataclasses import dataclass, replace

from bumpymap.core import MapConfig, auto_memory, is_auto, memory_bytes

__all__ = [
    "FLOAT_POINT_BYTES",
    "POINT_BYTES",
    "Budget",
    "requests_at_once",
    "with_memory",
]

_ELSEWHERE = 1 << 30
"""``auto`` for a worker of a scheduler, bytes: it may be on another machine."""
POINT_BYTES = 14
"""Size of a waiting point of LAS or LAZ, in memory or on disk."""
FLOAT_POINT_BYTES = 26
"""The same for points whose coordinates are no integers: of PLY and PCD, and corrected ones."""
_READING_BYTES, _SORTING_BYTES = 95, 63
_DECODING_BYTES = 45
"""Size of a point that is being decoded: its record, compressed and not."""
_MOST_WAITING, _READING, _SORTING = 0.55, 0.15, 0.15
_PIECE_POINTS = 500_000
_LEAST_PIECE = 50_000
_LAZ_CHUNK, _LAZ_CHUNKS_A_THREAD, _MOST_REQUESTS = 50_000, 3, 8
"""Usual points of a LAZ chunk, which one thread decodes; how many of them are decoded at a time."""


def with_memory(config: MapConfig) -> MapConfig:
    """Return settings of which ``memory`` is a size: ``auto`` is replaced by that of this machine at this moment.

    It is a quarter of the free memory, within the limits above; for the workers of a scheduler it is always the same.

    Raises
    ------
    UsageError
        ``memory`` is neither a size nor ``auto``.
    """
    if not is_auto(config.memory):
        memory_bytes(config.memory)
        return config
    size = _ELSEWHERE if config.scheduler is not None else auto_memory()
    return replace(config, memory=f"{size >> 20}MB")


def requests_at_once(points: int, threads: int) -> int:
    """Return how many chunks of so many points are fetched at a time, so that every thread has LAZ chunks to decode."""
    wanted = math.ceil(_LAZ_CHUNKS_A_THREAD * threads * _LAZ_CHUNK / max(points, 1))
    return max(min(wanted, threads, _MOST_REQUESTS), 1)


@dataclass(frozen=True, slots=True)
class Budget:
    """Shares of a memory budget, in points."""

    memory: int
    """Bytes, in addition to what the interpreter and its libraries take."""
    threads: int

    @property
    def waiting_points(self) -> int:
        """Most points of LAS or LAZ that wait in memory until their block is complete."""
        return int(_MOST_WAITING / 1.5 * self.memory / POINT_BYTES)

    @property
    def waiting_bytes(self) -> int:
        """Most memory for points that wait."""
        return self.waiting_points * POINT_BYTES

    @property
    def block_points(self) -> int:
        """Most points of one block that a thread sorts together."""
        return int(_SORTING * self.memory / _SORTING_BYTES / self.threads)

    @property
    def chunk_points(self) -> int:
        """Points in a chunk of a file; each thread holds one chunk, and one or more are being decoded."""
        fitting = int(_READING * self.memory / _READING_BYTES / (self.threads + 1))
        return max(_LEAST_PIECE, min(_PIECE_POINTS, fitting))

    def most_bytes(self, points: int, waiting: int) -> int:
        """Return the most bytes of the budget that a survey can take; ``waiting``: those of all its points."""
        waiting = min(waiting, int(1.5 * self.waiting_bytes))
        reading = _READING_BYTES * min(points, self.chunk_points * (self.threads + 1))
        further = requests_at_once(self.chunk_points, self.threads) - 1
        reading += _DECODING_BYTES * min(points, self.chunk_points * further)
        sorting = _SORTING_BYTES * min(points, self.block_points * self.threads)
        return max(reading, min(self.memory, waiting + reading + sorting))
