"""Tables of points with named columns (PLY and PCD), for surveys and for scans."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CrsStatement, Place, georeference
from bumpymap.readers.chunking import split_rows
from bumpymap.readers.columns import CLASS_COLUMNS, metres, precision_note
from bumpymap.readers.conversion import PointChecks, convert_table_points
from bumpymap.readers.protocol import CHUNK_POINTS, Chunk, ChunkPoints, ReadOptions, SurveyBase, SurveyInfo
from bumpymap.readers.source import Location, refuse_count

__all__ = ["CLASSES", "PointTable", "TableInfo", "TableSurvey", "Wanted"]

Wanted = dict[str, tuple[str, ...]]
"""Optional quantities beside x, y and z: a key, and names (in lower case) of columns that may hold the quantity."""
CLASSES: Wanted = {"class": CLASS_COLUMNS}
_PLACE: Wanted = {axis: (axis,) for axis in "xyz"}


@dataclass(frozen=True, slots=True)
class TableInfo:
    """Contents of the header of a table."""

    format: str
    """For example ``PCD 0.7, ascii``."""
    size: int
    """Size of the file, bytes."""
    count: int
    row_bytes: int
    """Size of a row in memory, bytes."""
    types: dict[str, np.dtype[Any]]
    """Name -> type of each column, in order, without lists."""
    is_text: bool
    notes: tuple[str, ...] = ()
    """Notes for the user."""

    def find(self, wanted: Wanted) -> dict[str, str]:
        """Return the column names of x, y, z and of those wanted quantities that the table has."""
        column_of = {name.lower(): name for name in reversed(self.types)}
        held = {
            what: [column_of[name] for name in names if name in column_of] for what, names in (_PLACE | wanted).items()
        }
        return {what: names[0] for what, names in held.items() if names}


class PointTable(ABC):
    """An open table; subclasses for the formats read its header and rows."""

    nan_is_no_return: ClassVar[bool]
    """Whether a row with NaN coordinates is a beam without return, rather than an error."""
    searched: ClassVar[int]
    """Rows that are searched for the first valid point."""

    def __init__(self, path: Location, info: TableInfo) -> None:
        self.path, self.info = path, info

    @property
    @abstractmethod
    def sequential(self) -> bool:
        """Whether rows can only be read sequentially from the start of the file."""

    @abstractmethod
    def rows(self, first: int, count: int) -> Any:
        """Return a structured array of ``count`` rows from row ``first``; fewer at the end of the file."""

    @abstractmethod
    def close(self) -> None:
        """Close the file until rows are read again."""

    def whole(self) -> Any:
        """Return all rows. Raises BadInputError if there are fewer than the header declares."""
        rows = self.rows(0, self.info.count)
        self.close()
        refuse_count(self.path, self.info.count, len(rows))
        return rows


class TableSurvey(SurveyBase):
    """A survey in a table. These formats have neither CRS nor units: metres are assumed, unless ``--crs`` is given."""

    def __init__(self, table: PointTable, options: ReadOptions) -> None:
        self._table, head = table, table.info
        names = head.find(CLASSES)
        self._columns, self._class_column = (names["x"], names["y"], names["z"]), names.get("class")
        first = self._first()
        place, notes = georeference(Place(table.path, first), CrsStatement(), options.given_crs, options.z_unit)
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
        """Split between any two rows."""
        return split_rows(self._table.info.count, points, self._table.info.row_bytes)

    def fetch(self, chunk: Chunk) -> Any:
        """Return the rows of a chunk: a structured array with at least the needed columns."""
        return self._table.rows(chunk.first, chunk.points)

    def convert(self, chunk: Chunk, fetched: Any) -> ChunkPoints:
        """Convert the rows of a chunk to points in metres."""
        raw = metres(fetched, self._columns, self._class_column, self.info.georeference)
        return convert_table_points(raw, PointChecks(chunk.first, None, self._table.nan_is_no_return))

    def _first(self) -> tuple[float, float, float] | None:
        """Return the first point with finite coordinates among the first ``searched`` rows; None if there is none."""
        rows = self._table.rows(0, min(self._table.searched, self._table.info.count))
        self._table.close()
        with np.errstate(invalid="ignore"):  # NaN: beams without return
            table: NDArray[np.float64] = np.column_stack([np.asarray(rows[name], np.float64) for name in self._columns])
        good = np.isfinite(table).all(axis=1)
        if not good.any():
            return None
        x, y, z = table[int(good.argmax())].tolist()
        return x, y, z
