"""Points as rows with named columns, as PLY and PCD hold them: once for surveys, once for the scans of a robot."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CrsStatement, georeference
from bumpymap.readers.base import SurveyBase
from bumpymap.readers.checks import refuse_count
from bumpymap.readers.chunking import split_rows
from bumpymap.readers.columns import CLASS_COLUMNS, metres, precision_note
from bumpymap.readers.conversion import PointChecks, convert_table_points
from bumpymap.readers.protocol import CHUNK_POINTS, Chunk, ChunkPoints, ReadOptions, SurveyInfo
from bumpymap.readers.source import Location, place_of

__all__ = ["CLASSES", "PointTable", "TableInfo", "TableSurvey", "Wanted"]

Wanted = dict[str, tuple[str, ...]]
"""What a reader would like beside x, y and z: a name of its own, and the columns that may hold it, in lower case."""
CLASSES: Wanted = {"class": CLASS_COLUMNS}
_PLACE: Wanted = {axis: (axis,) for axis in "xyz"}


@dataclass(frozen=True, slots=True)
class TableInfo:
    """What the header of a table says."""

    format: str
    """Such as ``PCD 0.7, ascii``."""
    size: int
    """Bytes of the file."""
    count: int
    row_bytes: int
    """Bytes that a row takes in memory."""
    types: dict[str, np.dtype[Any]]
    """Of each column in their order, by name as it is spelled; lists left out."""
    is_text: bool
    notes: tuple[str, ...] = ()
    """What a user should know."""

    def find(self, wanted: Wanted) -> dict[str, str]:
        """Give the names, as they are spelled, of x, y and z, and of what is wanted as far as it is there."""
        spelled = {name.lower(): name for name in reversed(self.types)}
        held = {what: [spelled[name] for name in names if name in spelled] for what, names in (_PLACE | wanted).items()}
        return {what: names[0] for what, names in held.items() if names}


class PointTable(ABC):
    """An open table; a format adds its header and how rows are read."""

    nan_is_no_return: ClassVar[bool]
    """Whether a row with NaN coordinates is a beam without return, or a fault."""
    searched: ClassVar[int]
    """Rows that are searched for a first point."""

    def __init__(self, path: Location, info: TableInfo) -> None:
        self.path, self.info = path, info

    @property
    @abstractmethod
    def sequential(self) -> bool:
        """Whether rows can only be read from the start of the file on."""

    @abstractmethod
    def rows(self, first: int, count: int) -> Any:
        """Structured array (n,) of rows from ``first`` on, fewer than ``count`` where the file ends."""

    @abstractmethod
    def close(self) -> None:
        """Leave the file alone until the next reading."""

    def whole(self) -> Any:
        """All rows. Raises BadInputError where there are fewer than the header promises."""
        rows = self.rows(0, self.info.count)
        self.close()
        refuse_count(self.path, self.info.count, len(rows))
        return rows


class TableSurvey(SurveyBase):
    """A survey in a table. Such formats know neither CRS nor units: metres, unless ``--crs`` says otherwise."""

    def __init__(self, table: PointTable, options: ReadOptions) -> None:
        self._table, head = table, table.info
        names = head.find(CLASSES)
        self._columns, self._class_column = (names["x"], names["y"], names["z"]), names.get("class")
        first = self._first()
        place, notes = georeference(place_of(table.path, first), CrsStatement(), options.crs, options.z_unit)
        if not head.is_text:
            notes += precision_note(first, [head.types[name] for name in self._columns])
        notes += head.notes
        has_classes = self._class_column is not None
        super().__init__(
            SurveyInfo(
                table.path,
                head.format,
                head.size,
                head.count,
                place,
                None,
                has_classes,
                notes,
                sequential=table.sequential,
            )
        )

    def chunks(self, points: int = CHUNK_POINTS) -> Sequence[Chunk]:
        """Cut anywhere."""
        return split_rows(self._table.info.count, points, self._table.info.row_bytes)

    def fetch(self, chunk: Chunk) -> Any:
        """Rows of a piece: a structured array with at least the columns that are needed."""
        return self._table.rows(chunk.first, chunk.points)

    def convert(self, chunk: Chunk, fetched: Any) -> ChunkPoints:
        """Points of a piece that count, in metres."""
        raw = metres(fetched, self._columns, self._class_column, self.info.georeference)
        return convert_table_points(raw, PointChecks(chunk.first, None, self._table.nan_is_no_return))

    def _first(self) -> tuple[float, float, float] | None:
        """Give the first point that is one, looking at the first rows alone."""
        rows = self._table.rows(0, min(self._table.searched, self._table.info.count))
        self._table.close()
        with np.errstate(invalid="ignore"):  # NaN of any kind are beams without return
            table: NDArray[np.float64] = np.column_stack([np.asarray(rows[name], np.float64) for name in self._columns])
        good = np.isfinite(table).all(axis=1)
        if not good.any():
            return None
        x, y, z = table[int(good.argmax())].tolist()
        return x, y, z
