"""Scratch arrays that live from scan to scan."""

import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["SectorBuffers"]


class SectorBuffers(threading.local):
    """Scratch arrays that are reused from scan to scan and grow to the largest one; each thread has its own."""

    def __init__(self) -> None:
        self._arrays: dict[str, NDArray[Any]] = {}

    def empty(self, name: str, length: int, dtype: type, rows: int = 1) -> NDArray[Any]:
        """Return an uninitialised array (length,), or (rows, length) if ``rows`` is more than one."""
        size = rows * length
        kept = self._arrays.get(name)
        if kept is None or len(kept) < size:
            kept = self._arrays[name] = np.empty(size, dtype)
        part = kept[:size]
        return part if rows == 1 else part.reshape(rows, length)
