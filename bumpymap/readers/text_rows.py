"""Rows of a text table, read in order in constant memory; a place further back starts again."""

import io
import warnings
from collections import deque
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.readers.checks import decoding
from bumpymap.readers.source import Location, open_source

__all__ = ["TextRows"]

_BLOCK = 100_000


@dataclass(slots=True)
class TextRows:
    """Lines of numbers, apart by blanks; empty lines do not count."""

    path: Location
    data_at: int
    """Byte where the text starts."""
    skipped: int
    """Lines that come before the rows."""
    dtype: np.dtype[np.void]
    """What is read."""
    columns: list[int]
    """Places of its fields in a line."""
    _stream: Any = None
    _next: int = 0

    def read(self, first: int, count: int) -> NDArray[np.void]:
        """Rows from ``first`` on; fewer than ``count`` where the file ends."""
        with decoding(self.path, f"the points from {first:,} on"):
            if self._stream is None or first < self._next:
                self._open()
            while self._next < first and self._load(min(_BLOCK, first - self._next)).size:
                pass
            return self._load(count)

    def close(self) -> None:
        """Leave the file alone until the next ``read``."""
        if self._stream is not None:
            self._stream.close()
            self._stream = None

    def _open(self) -> None:
        self.close()
        binary: Any = open_source(self.path)
        binary.seek(self.data_at)
        self._stream, self._next = io.TextIOWrapper(binary, "ascii", errors="replace"), 0
        deque(islice(self._stream, self.skipped), maxlen=0)

    def _load(self, count: int) -> NDArray[np.void]:
        with warnings.catch_warnings():
            # "no data": the count of points tells, at the end.
            warnings.simplefilter("ignore", UserWarning)
            rows: NDArray[np.void] = np.loadtxt(
                self._stream, dtype=self.dtype, comments=None, usecols=self.columns, max_rows=count, ndmin=1
            )
        self._next += len(rows)
        return rows
