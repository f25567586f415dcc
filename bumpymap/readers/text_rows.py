"""Read the rows of a text table sequentially."""

import io
import warnings
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.readers.serial_rows import SerialRows

__all__ = ["TextRows"]


@dataclass(slots=True)
class TextRows(SerialRows):
    """Lines of numbers separated by whitespace; empty lines are skipped."""

    skipped: int
    """Lines before the first row."""
    dtype: np.dtype[np.void]
    """Type of a row; only these columns are read."""
    columns: list[int]
    """Index of each of its fields in a line, without lists."""
    lists: tuple[bool, ...] = ()
    """Whether each entry of a line is a list, which starts with its length; empty: there are no lists."""
    _lines: Any = field(init=False, default=None)

    def _open(self) -> None:
        binary: Any = self.file.open()
        binary.seek(self.data_at)
        self._stream = io.TextIOWrapper(binary, "ascii", errors="replace")
        deque(islice(self._stream, self.skipped), maxlen=0)
        self._lines = self._without_lists() if any(self.lists) else self._stream

    def _load(self, count: int) -> NDArray[np.void]:
        with warnings.catch_warnings():
            # "no data": the point count is checked at the end.
            warnings.simplefilter("ignore", UserWarning)
            rows: NDArray[np.void] = np.loadtxt(
                self._lines, dtype=self.dtype, comments=None, usecols=self.columns, max_rows=count, ndmin=1
            )
        return rows

    def _without_lists(self) -> Iterator[str]:
        for line in self._stream:
            yield " ".join(_scalars(line.split(), self.lists))


def _scalars(words: list[str], lists: tuple[bool, ...]) -> list[str]:
    """Return the words of a line that are not in a list."""
    kept, at = [], 0
    for is_list in lists if words else ():
        word = words[at] if at < len(words) else ""
        at += 1
        if not is_list:
            kept.append(word)
        elif word.isdecimal():
            at += int(word)
        else:
            raise ValueError(f"a row of {len(words)} words has {word[:20]!r} instead of the length of a list")
    if at != len(words):
        raise ValueError(f"a row has {len(words)} words but its lists require {at}")
    return kept
