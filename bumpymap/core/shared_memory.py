"""Memory that this process and its children see: arrays in it are handed out, and their place is used again later.

It is one file without a name that every child maps once. Were each array a file of its own, mapping and clearing them
would take a tenth of the time of decoding. ``multiprocessing.shared_memory`` needs room in ``/dev/shm``, which
containers limit to 64 MB, and starts a process to remove what is left there.
"""

import mmap
import os
import tempfile
import threading
import weakref
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["SharedBytes", "SharedMemory"]

_PAGE = 4096
_GROWTH = 1 << 22
"""The memory grows by multiples of so many bytes."""


@dataclass(frozen=True, slots=True)
class SharedBytes:
    """Some bytes of the shared memory."""

    start: int
    """Where they lie in it."""
    data: NDArray[np.uint8]
    """(n,)"""


class SharedMemory:
    """Arrays are placed into the first gap that is wide enough. From any thread."""

    def __init__(self) -> None:
        if hasattr(os, "memfd_create"):
            self.descriptor = os.memfd_create("bumpymap")
        else:
            with tempfile.TemporaryFile() as file:
                self.descriptor = os.dup(file.fileno())
        # The interpreter drops arrays at any instant, so their starts are noted without a lock.
        self._dropped: deque[int] = deque()
        self._ends: dict[int, int] = {}
        self._lock = threading.Lock()
        self._map: mmap.mmap | None = None
        self.size = 0
        """Bytes by now."""

    def allocate(self, size: int) -> SharedBytes:
        """Give ``size`` bytes, of any content. They are given back when their last array is gone."""
        length = max(-(-size // _PAGE), 1) * _PAGE
        with self._lock:
            self._collect()
            start = self._gap(length)
            if start + length > self.size or self._map is None:
                self.size = -(-(start + length) // _GROWTH) * _GROWTH
                os.ftruncate(self.descriptor, self.size)
                # Arrays that are in use keep the map through which they were given.
                self._map = mmap.mmap(self.descriptor, self.size)
            self._ends[start] = start + length
            whole = np.frombuffer(self._map, np.uint8, length, start)
        weakref.finalize(whole, self._dropped.append, start).atexit = False
        return SharedBytes(start, whole[:size])

    def trim(self) -> None:
        """Give all memory back, where no array is in use."""
        with self._lock:
            self._collect()
            if not self._ends:
                self._map, self.size = None, 0
                os.ftruncate(self.descriptor, 0)

    def _collect(self) -> None:
        while self._dropped:
            del self._ends[self._dropped.popleft()]

    def _gap(self, length: int) -> int:
        at = 0
        for start in sorted(self._ends):
            if start - at >= length:
                break
            at = self._ends[start]
        return at
