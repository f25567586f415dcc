"""Sequential access to the rows of a table, in constant memory; going back means reading from the start again."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.readers.checks import decoding
from bumpymap.readers.source import OpenFile

__all__ = ["SerialRows"]

_BLOCK = 100_000


@dataclass(slots=True)
class SerialRows(ABC):
    """Sequential reader of rows; subclasses parse them."""

    file: OpenFile
    data_at: int
    """Offset of the data, bytes."""
    _stream: Any = field(init=False, default=None)
    _next: int = field(init=False, default=0)

    def read(self, first: int, count: int) -> NDArray[np.void]:
        """Return ``count`` rows from row ``first``; fewer at the end of the file."""
        with decoding(self.file.path, f"the points from {first:,} on"):
            if self._stream is None or first < self._next:
                self.close()
                self._open()
                self._next = 0
            while self._next < first and self._advance(min(_BLOCK, first - self._next)).size:
                pass
            return self._advance(count)

    def close(self) -> None:
        """Close the file until the next ``read``."""
        if self._stream is not None:
            self._stream.close()
            self._stream = None

    def _advance(self, count: int) -> NDArray[np.void]:
        rows = self._load(count)
        self._next += len(rows)
        return rows

    @abstractmethod
    def _open(self) -> None:
        """Open ``_stream`` at the start of the rows."""

    @abstractmethod
    def _load(self, count: int) -> NDArray[np.void]:
        """Read the next rows; fewer at the end of the file."""
