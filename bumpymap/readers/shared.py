"""Memory that two processes see: arrays in it are handed out, and their place is used again when nobody holds them."""

import mmap
import os
import tempfile
import threading
import weakref
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Block", "SharedMemory"]

Bytes = NDArray[np.uint8]

_PAGE = 4096
_GROWTH = 1 << 22
"""The memory grows by multiples of so many bytes."""


@dataclass(frozen=True, slots=True)
class Block:
    """Some bytes, and where they lie in the shared memory."""

    start: int
    data: Bytes

    @property
    def span(self) -> tuple[int, int]:
        """Start and bytes."""
        return self.start, self.data.size


class SharedMemory:
    """A file without a name, as long as it must be. Blocks go to the first gap that is wide enough."""

    def __init__(self) -> None:
        if hasattr(os, "memfd_create"):
            self.descriptor = os.memfd_create("bumpymap")
        else:
            with tempfile.TemporaryFile() as file:
                self.descriptor = os.dup(file.fileno())
        # Dropped arrays are noted wherever the interpreter finds them, so without a lock.
        self._dropped: deque[int] = deque()
        self._used: dict[int, int] = {}
        self._lock = threading.Lock()
        self._map: mmap.mmap | None = None
        self.size = 0
        """Bytes by now."""

    def take(self, size: int) -> Block:
        """Give a block of ``size`` bytes, of any content. It is given back when its last array is gone."""
        room = max(-(-size // _PAGE), 1) * _PAGE
        with self._lock:
            self._collect()
            start = self._gap(room)
            if start + room > self.size or self._map is None:
                self.size = -(-(start + room) // _GROWTH) * _GROWTH
                os.ftruncate(self.descriptor, self.size)
                # Blocks that are in use keep the map through which they were given.
                self._map = mmap.mmap(self.descriptor, self.size)
            self._used[start] = start + room
            whole = np.frombuffer(self._map, np.uint8, room, start)
        weakref.finalize(whole, self._dropped.append, start).atexit = False
        return Block(start, whole[:size])

    def put(self, data: bytes) -> Block:
        """Give a block of these bytes."""
        block = self.take(len(data))
        block.data[:] = np.frombuffer(data, np.uint8)
        return block

    def trim(self) -> None:
        """Give all memory back, where no block is in use."""
        with self._lock:
            self._collect()
            if not self._used:
                self._map, self.size = None, 0
                os.ftruncate(self.descriptor, 0)

    def _collect(self) -> None:
        while self._dropped:
            del self._used[self._dropped.popleft()]

    def _gap(self, size: int) -> int:
        at = 0
        for start in sorted(self._used):
            if start - at >= size:
                break
            at = self._used[start]
        return at
