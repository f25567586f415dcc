"""Tables of points with named columns (PLY and PCD), for surveys and for scans."""

import io
import warnings
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, CrsStatement, Floats, Place, PointCloud, georeference
from bumpymap.readers.point_stats import PointStats
from bumpymap.readers.protocol import (
    CHUNK_POINTS,
    Chunk,
    ChunkPoints,
    ReadOptions,
    SurveyInfo,
    SurveyReader,
    refuse_coarse,
    split_rows,
)
from bumpymap.readers.source import Location, decoding, open_source, read_range, refuse_count
from bumpytiles import DECIMALS

_BLOCK = 100_000
"""Points of text that are parsed at once."""


CLASS_COLUMNS = ("classification", "scalar_classification", "class")
"""Names, in lower case, of columns that hold LAS class codes."""
_FINE_M = 0.01
"""Steps between coordinates up to which nothing is said, m."""


def convert_points(
    axes: tuple[Floats, Floats, Floats],
    class_id: NDArray[Any] | None,
    first: int,
    *,
    nan_is_no_return: bool,
    kinds: NDArray[np.uint8],
    colour: NDArray[np.uint32] | None = None,
) -> ChunkPoints:
    """Drop unusable points of a table, and count all of them.

    ``axes`` three float64 (n,): Easting, northing and height, m; ``class_id`` (n,) numbers or None:
    LAS classes; what is none becomes 0. None: the table has no classes; ``first``: number of the
    first point in the file; ``nan_is_no_return``: whether a point with NaN is a beam without
    return, rather than an error; ``kinds`` array (256,): the kind of the points of each class, see
    `ReadOptions.kinds`; ``colour`` uint32 (n,): their colours.
    """
    size = len(axes[0])
    codes = np.zeros(size, np.uint8)
    if class_id is not None:
        codes = np.where((class_id >= 0) & (class_id <= 255) & (class_id % 1 == 0), class_id, 0).astype(np.uint8)
    bad, no_return = np.zeros((2, size), np.bool_)
    ends = [(axis.min(initial=np.inf), axis.max(initial=-np.inf)) for axis in axes]
    if size and not np.isfinite(ends).all():
        ends = [(np.fmin.reduce(axis, initial=np.inf), np.fmax.reduce(axis, initial=-np.inf)) for axis in axes]
        if nan_is_no_return:
            no_return = np.logical_or.reduce([np.isnan(axis) for axis in axes])
        bad = ~np.logical_and.reduce([np.isfinite(axis) for axis in axes]) & ~no_return
    noise = ((codes == 7) | (codes == 18)) & ~no_return
    lost = {"noise": int(noise.sum()), "not_a_number": int(no_return.sum()), "not_finite": int(bad.sum())}
    first_bad = first + int(bad.argmax()) if bad.any() else -1
    stats = PointStats.within(ends, size, **lost, first_not_finite=first_bad)
    kept = ~(noise | no_return) & (not stats.bad)
    if not kept.all():
        axes, codes = (axes[0][kept], axes[1][kept], axes[2][kept]), codes[kept]
        colour = None if colour is None else colour[kept]
    if colour is not None:
        stats = replace(stats, coloured=int(np.count_nonzero(colour)))
    return ChunkPoints(PointCloud(*axes, kinds[codes], colour), stats)


def _steps(points: Floats, types: Sequence[Any]) -> list[float]:
    """Return the steps between numbers of x, y and z that their types hold: at the median of some points (n, 3)."""
    typical = np.median(np.abs(points), axis=0) if len(points) else np.zeros(3)
    numbers = [(kind, kind.type(size)) for size, kind in zip(typical, types, strict=True)]
    return [float(np.spacing(number)) if kind.kind == "f" else 1.0 for kind, number in numbers]


Wanted = dict[str, tuple[str, ...]]
"""Optional quantities beside x, y and z: a key, and names (in lower case) of columns that may hold the quantity."""
_CLASSES: Wanted = {"class": CLASS_COLUMNS}
_COLOURS: Wanted = {name: (name, f"diffuse_{name}") for name in ("red", "green", "blue")}
_PLACE: Wanted = {axis: (axis,) for axis in "xyz"}


def refuse_missing_axes(path: Location, columns: Sequence[str]) -> None:
    """Raise BadInputError if x, y or z is not among the columns of numbers of a table."""
    missing = [axis for axis in "xyz" if axis not in map(str.lower, columns)]
    if missing:
        raise BadInputError(
            f"the points of {path} have no {', '.join(missing)}; they have {', '.join(columns) or 'no numbers'}. "
            "bumpymap needs x, y and z"
        )


@dataclass(frozen=True, slots=True)
class TableInfo:
    """Contents of the header of a table."""

    format: str
    """For example ``PCD 0.7, ascii``."""
    size: int
    """Size of the file, bytes."""
    count: int
    row: np.dtype[np.void]
    """Type of a row, as declared."""
    row_bytes: int
    """Size of a row in memory, bytes."""
    is_text: bool
    notes: tuple[str, ...] = ()
    """Notes for the user."""

    @property
    def types(self) -> dict[str, np.dtype[Any]]:
        """Name -> type of each column, in order."""
        return {name: self.row[name] for name in self.row.names or ()}

    def find(self, wanted: Wanted) -> dict[str, str]:
        """Return the column names of x, y, z and of those wanted quantities that the table has."""
        column_of = {name.lower(): name for name in reversed(self.types)}
        held = {
            what: [column_of[name] for name in names if name in column_of] for what, names in (_PLACE | wanted).items()
        }
        return {what: names[0] for what, names in held.items() if names}


class PointTable:
    """An open table; subclasses for the formats read its header.

    A text has lines of numbers separated by whitespace, which are read one after the other; empty lines are skipped.

    ``data_at``: offset of the first row, or of the first line of a text, bytes; ``wanted``: columns
    of a text that are read beside x, y and z, see `Wanted`; ``skipped``: lines of a text before the
    first row; ``text_type``: type of the numbers of a text; None: as declared in the header.
    """

    nan_is_no_return: ClassVar[bool]
    """True if a row with NaN coordinates is a beam without return, rather than an error."""
    searched: ClassVar[int]
    """Rows that are searched for valid points, which tell where the survey is."""

    def __init__(
        self,
        path: Location,
        info: TableInfo,
        data_at: int,
        wanted: Wanted,
        *,
        skipped: int = 0,
        text_type: type[np.float64] | None = None,
    ) -> None:
        self.path, self.info, self._data_at, self._skipped = path, info, data_at, skipped
        names, places = list(info.find(wanted).values()), list(info.types)
        self._columns = [places.index(name) for name in names]
        self._text_row = np.dtype([(name, text_type or info.row[name]) for name in names])
        self._lines: Any = None
        self._next = 0

    @property
    def sequential(self) -> bool:
        """True if rows can only be read sequentially from the start of the file."""
        return self.info.is_text

    def rows(self, first: int, count: int) -> Any:
        """Return a structured array of ``count`` rows from row ``first``; fewer at the end of the file."""
        if self.info.is_text:
            return self._text_rows(first, count)
        size = self.info.row.itemsize
        data = read_range(self.path, self._data_at + first * size, count * size)
        return data[: data.size // size * size].view(self.info.row)

    def close(self) -> None:
        """Close the file until rows are read again."""
        if self._lines is not None:
            self._lines.close()
            self._lines = None

    def whole(self) -> Any:
        """Return all rows. Raises BadInputError if there are fewer than the header declares."""
        rows = self.rows(0, self.info.count)
        self.close()
        refuse_count(self.path, self.info.count, len(rows))
        return rows

    def _text_rows(self, first: int, count: int) -> NDArray[np.void]:
        with decoding(self.path, f"the points from {first:,} on"):
            if self._lines is None or first < self._next:
                self.close()
                binary: Any = open_source(self.path)
                binary.seek(self._data_at)
                self._lines, self._next = io.TextIOWrapper(binary, "ascii", errors="replace"), 0
                deque(islice(self._lines, self._skipped), maxlen=0)
            while self._next < first and self._load(min(_BLOCK, first - self._next)).size:
                pass
            return self._load(count)

    def _load(self, count: int) -> NDArray[np.void]:
        """Read the next rows of a text; fewer at the end of the file."""
        with warnings.catch_warnings():
            # "no data": the point count is checked at the end.
            warnings.simplefilter("ignore", UserWarning)
            rows: NDArray[np.void] = np.loadtxt(
                self._lines, dtype=self._text_row, comments=None, usecols=self._columns, max_rows=count, ndmin=1
            )
        self._next += len(rows)
        return rows


class TableSurvey(SurveyReader):
    """A survey in a table. These formats have neither CRS nor units: metres are assumed, unless ``--crs`` is given."""

    def __init__(
        self, path: Location, options: ReadOptions, open_table: Callable[[Location, Wanted, int], PointTable]
    ) -> None:
        self._open_table = open_table
        super().__init__(path, options)

    def _open(self, options: ReadOptions) -> SurveyInfo:
        self._kinds = options.kinds
        wanted = _CLASSES | (_COLOURS if options.colour else {})
        self._table = table = self._open_table(self._path, wanted, options.memory)
        head, names = table.info, table.info.find(wanted)
        self._colours = [names[name] for name in _COLOURS if name in names]
        if len(self._colours) < len(_COLOURS) or any(head.types[name].kind not in "ui" for name in self._colours):
            self._colours = []
        self._columns, self._class_column = (names["x"], names["y"], names["z"]), names.get("class")
        rows = table.rows(0, min(table.searched, head.count))
        table.close()
        with np.errstate(invalid="ignore"):  # NaN: beams without return
            points: Floats = np.column_stack([np.asarray(rows[name], np.float64) for name in self._columns])
        points = points[np.isfinite(points).all(axis=1)]
        first = Place(table.path, (points[0, 0], points[0, 1], points[0, 2]) if len(points) else None)
        place, notes = georeference(first, CrsStatement(), options)
        if not head.is_text:
            east, north, up = _steps(points, [head.types[name] for name in self._columns])
            step, step_z = max(east, north) * place.metres_per_unit, up * place.metres_per_unit_z
            types = " and ".join(dict.fromkeys(head.types[name].name for name in self._columns[:2]))
            refuse_coarse(table.path, step, f"they are stored as {types}", options)
            if max(step, step_z) > _FINE_M:
                lost = (
                    f"as they are stored, its coordinates lie on steps of {max(step, step_z):g} m: fine relief is lost"
                )
                notes += (f"{lost}. Export it with double coordinates, or as LAS",)
        notes += head.notes
        has_classes = self._class_column is not None
        info = SurveyInfo(table.path, head.format, head.size, head.count, place, None, has_classes, notes)
        return replace(info, sequential=table.sequential)

    def chunks(self, points: int = CHUNK_POINTS) -> Sequence[Chunk]:
        """Split between any two rows."""
        return split_rows(self._table.info.count, points, self._table.info.row_bytes)

    def _fetch(self, chunk: Chunk) -> Any:
        """Return the rows of a chunk: a structured array with at least the needed columns."""
        return self._table.rows(chunk.first, chunk.points)

    def _convert(self, chunk: Chunk, fetched: Any) -> ChunkPoints:
        place, columns = self.info.georeference, self._columns
        units = (place.metres_per_unit, place.metres_per_unit, place.metres_per_unit_z)
        # Rounded like LAS coordinates, so that a point is identical in a LAS and a PLY file. Overflow becomes infinity;
        # infinity and NaN are rejected later.
        with np.errstate(over="ignore", invalid="ignore"):
            axes = [np.asarray(fetched[name], np.float64).round(DECIMALS) for name in columns]
            x, y, z = (axis if unit == 1.0 else axis * unit for axis, unit in zip(axes, units, strict=True))
        class_id = None if self._class_column is None else np.asarray(fetched[self._class_column])
        return convert_points(
            (x, y, z),
            class_id,
            chunk.first,
            nan_is_no_return=self._table.nan_is_no_return,
            kinds=self._kinds,
            colour=self._colour(fetched) if self._colours else None,
        )

    def _colour(self, rows: Any) -> NDArray[np.uint32]:
        """Return the colours of rows, 8 bits a channel: the type of their columns tells the range."""
        colour = np.zeros(len(rows), np.uint32)
        for name in self._colours:
            shift = 8 * (self._table.info.types[name].itemsize - 1)
            colour = colour << np.uint32(8) | (np.asarray(rows[name]).astype(np.int64) >> shift & 255).astype(np.uint32)
        return colour
