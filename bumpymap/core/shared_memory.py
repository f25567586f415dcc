"""Memory shared between this process and its children, from which arrays are allocated.

It is one anonymous file that every child maps once. With one file for each array, mapping and clearing them would take
a tenth of the decoding time. ``multiprocessing.shared_memory`` needs space in ``/dev/shm``, which containers limit to
64 MB, and starts a process to clean up there.
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
"""The memory grows in multiples of this, bytes."""


@dataclass(frozen=True, slots=True)
class SharedBytes:
    """A range of bytes of the shared memory."""

    start: int
    """Offset of the first byte."""
    data: NDArray[np.uint8]
    """(n,)"""


class SharedMemory:
    """First-fit allocator of shared memory. Thread-safe."""

    def __init__(self) -> None:
        if hasattr(os, "memfd_create"):
            self.descriptor = os.memfd_create("bumpymap")
        else:
            with tempfile.TemporaryFile() as file:
                self.descriptor = os.dup(file.fileno())
        # Arrays may be garbage-collected at any moment, so their offsets are recorded without a lock.
        self._freed: deque[int] = deque()
        self._ends: dict[int, int] = {}
        self._lock = threading.Lock()
        self._map: mmap.mmap | None = None
        self.size = 0
        """Current size, bytes."""

    def allocate(self, size: int) -> SharedBytes:
        """Allocate ``size`` uninitialized bytes, which are freed when the last array that uses them is deleted."""
        length = max(-(-size // _PAGE), 1) * _PAGE
        with self._lock:
            self._collect()
            start = self._first_gap(length)
            if start + length > self.size or self._map is None:
                self.size = -(-(start + length) // _GROWTH) * _GROWTH
                os.ftruncate(self.descriptor, self.size)
                # Arrays in use keep the map that they were created from.
                self._map = mmap.mmap(self.descriptor, self.size)
            self._ends[start] = start + length
            whole = np.frombuffer(self._map, np.uint8, length, start)
        weakref.finalize(whole, self._freed.append, start).atexit = False
        return SharedBytes(start, whole[:size])

    def trim(self) -> None:
        """Return all memory to the operating system, if no array is in use."""
        with self._lock:
            self._collect()
            if not self._ends:
                self._map, self.size = None, 0
                os.ftruncate(self.descriptor, 0)

    def _collect(self) -> None:
        while self._freed:
            del self._ends[self._freed.popleft()]

    def _first_gap(self, length: int) -> int:
        at = 0
        for start in sorted(self._ends):
            if start - at >= length:
                break
            at = self._ends[start]
        return at
