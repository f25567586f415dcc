"""Convert columns of a PLY or PCD table to points in metres, and warn of large coordinates in float32."""

import io
import warnings
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Georeference
from bumpymap.readers.conversion import RawPoints
from bumpymap.readers.source import OpenFile, decoding
from bumpytiles import DECIMALS

__all__ = ["CLASS_COLUMNS", "SerialRows", "TextRows", "metres", "precision_note", "read_rows"]

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


CLASS_COLUMNS = ("classification", "scalar_classification", "class")
"""Names, in lower case, of columns that hold LAS class codes."""
_LARGE = 1e5
"""From here on the resolution of float32 is 1 cm or coarser, in the file's unit."""


def metres(rows: Any, columns: tuple[str, str, str], class_column: str | None, place: Georeference) -> RawPoints:
    """Convert table rows to points.

    Parameters
    ----------
    rows : structured array (n,)
    columns : (str, str, str)
        Names of x, y and z.
    class_column : str or None
    place : Georeference
        Its units are used.

    Returns
    -------
    RawPoints
    """
    # Rounded like LAS coordinates, so that a point is identical in a LAS and a PLY file.
    units = (place.metres_per_unit, place.metres_per_unit, place.metres_per_unit_z)
    x, y, z = (_coordinate(rows[name], unit) for name, unit in zip(columns, units, strict=True))
    return RawPoints(x, y, z, None if class_column is None else np.asarray(rows[class_column]))


def read_rows(file: OpenFile, data_at: int, dtype: np.dtype[np.void], first: int, count: int) -> NDArray[np.void]:
    """Read ``count`` rows of a binary table from row ``first``; fewer at the end of the file."""
    data = file.read(data_at + first * dtype.itemsize, count * dtype.itemsize)
    return data[: data.size // dtype.itemsize * dtype.itemsize].view(dtype)


def _coordinate(column: Any, unit: float) -> NDArray[np.float64]:
    # Overflow becomes infinity; infinity and NaN are rejected later.
    with np.errstate(over="ignore", invalid="ignore"):
        value: NDArray[np.float64] = np.asarray(column, np.float64).round(DECIMALS)
        return value if unit == 1.0 else value * unit


def precision_note(first: tuple[float, float, float] | None, types: Sequence[Any]) -> tuple[str, ...]:
    """Return a note if float32 is too coarse for the coordinates: for UTM, the error is centimetres to half a metre.

    Parameters
    ----------
    first : (float, float, float) or None
        The first point, in the file's unit.
    types : sequence of 3 dtypes
        Types of x, y and z.
    """
    if first is None:
        return ()
    lost = [
        float(np.spacing(np.float32(abs(value))))
        for value, kind in zip(first, types, strict=True)
        if np.dtype(kind) == np.dtype(np.float32) and abs(value) > _LARGE
    ]
    if not lost:
        return ()
    note = (
        f"its coordinates are stored as float32 and are so large that they lie on steps of {max(lost):g} units: fine "
        "relief is lost. Export it with double coordinates, or as LAS"
    )
    return (note,)
