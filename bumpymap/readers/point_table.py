"""The readers of PLY and PCD files, tables of points with named columns, for surveys and for scans.

Text and binary are read in chunks; compressed PCD files are unpacked as a whole by pypcd4.
"""

import io
import struct
import warnings
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import islice
from typing import Any, BinaryIO, ClassVar

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import PLY_TYPES, BadInputError, CrsStatement, Floats, Place, PointCloud, georeference
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
from bumpymap.readers.source import Location, decoding, open_source, read_range, refuse_count, refuse_points
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
    sequential: bool
    """True if rows can only be read sequentially from the start of the file: of text, and if they are packed."""
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

    def __init__(self, path: Location, options: ReadOptions, kind: str) -> None:
        self._kind = kind
        super().__init__(path, options)

    def _open(self, options: ReadOptions) -> SurveyInfo:
        self._kinds = options.kinds
        wanted = _CLASSES | (_COLOURS if options.colour else {})
        self._table = table = open_table(self._kind, self._path, wanted, options.memory)
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
                lost = f"its coordinates lie on steps of {max(step, step_z):g} m: fine relief is lost"
                notes += (f"as they are stored, {lost}. Export it with double coordinates, or as LAS",)
        notes += head.notes
        has_classes = self._class_column is not None
        info = SurveyInfo(table.path, head.format, head.size, head.count, place, None, has_classes, notes)
        return replace(info, sequential=head.sequential)

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


_PLY_LINE, _PLY_HEADER = 4096, 4096
"""Bytes of a line, and lines of a header, at most. Chosen: several times those of any program's files."""
_BYTE_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True, slots=True)
class PlyElement:
    """An element as declared in the header."""

    name: str
    count: int
    properties: dict[str, str | None] = field(default_factory=dict)
    """Name -> NumPy type code of its values, without byte order; None for a list. Lists make rows differ in size."""

    @property
    def lists(self) -> list[str]:
        """Names of the properties that are lists."""
        return [name for name, code in self.properties.items() if code is None]

    def dtype(self, byte_order: str) -> np.dtype[np.void]:
        """Return the dtype of its rows, without lists."""
        return np.dtype([(name, byte_order + code) for name, code in self.properties.items() if code is not None])


def _ply_lines(stream: BinaryIO, path: Location) -> tuple[list[bytes], int]:
    """Return the lines of the header without comments, and the offset of its end."""
    lines: list[bytes] = []
    while len(lines) < _PLY_HEADER:
        line = stream.readline(_PLY_LINE)
        if not line:
            break
        line = line.strip()
        if line and not line.startswith((b"comment", b"obj_info")):
            lines.append(line)
        if line == b"end_header":
            return lines, stream.tell()
    raise BadInputError(f"the header of {path} has no end (no line 'end_header'): truncated? Copy or download it again")


def _parse_ply(lines: list[str]) -> tuple[str, list[PlyElement]]:
    """Return encoding and elements; raise ValueError if the lines are not a PLY header."""
    if len(lines) < 2 or lines[0] != "ply":
        raise ValueError("its first line is not 'ply'")
    match lines[1].split():
        case ["format", encoding, "1.0"] if encoding in _BYTE_ORDERS:
            pass
        case _:
            raise ValueError(f"{lines[1]!r} is not a PLY format; allowed are: {', '.join(_BYTE_ORDERS)}, each 1.0")
    elements: list[PlyElement] = []
    for line in lines[2:-1]:
        match line.split():
            case ["element", name, count] if count.isdecimal():
                known: Iterable[str] = [other.name for other in elements]
                elements.append(PlyElement(name, int(count)))
            case ["property", *words] if elements:
                name, code = _property(words, line)
                known = list(elements[-1].properties)
                elements[-1].properties[name] = code
            case _:
                raise ValueError(f"{line!r} is neither an element with a count nor a property of one")
        if name in known:
            raise ValueError(f"{line!r} declares the name {name} a second time")
    return encoding, elements


def _property(words: list[str], line: str) -> tuple[str, str | None]:
    """Return the name, and the type code of the values; None for a list."""
    match words:
        case [kind, name] if kind in PLY_TYPES:
            return name, PLY_TYPES[kind]
        case ["list", length, kind, name] if {length, kind} <= set(PLY_TYPES):
            return name, None
    raise ValueError(
        f"{line!r} is neither 'property TYPE NAME' nor 'property list TYPE TYPE NAME'; the types are "
        f"{', '.join(PLY_TYPES)}"
    )


class PlyTable(PointTable):
    """A PLY file. Text is read as float64 whatever the header declares, since it may have more digits than a float32.

    ``wanted``: see `Wanted`. Raises BadInputError: not a PLY header, without vertex element or x, y
    and z, or with more than the file can hold.
    """

    nan_is_no_return, searched = False, 1000

    def __init__(self, path: Location, wanted: Wanted) -> None:
        with open_source(path) as stream, decoding(path, "the header"):
            lines, data_at = _ply_lines(stream, path)
            encoding, elements = _parse_ply([line.decode("ascii") for line in lines])
            size = stream.seek(0, io.SEEK_END)
        vertex = _vertices(path, elements)
        before, is_text, order = elements[: elements.index(vertex)], encoding == "ascii", _BYTE_ORDERS[encoding]
        _refuse_lists(path, vertex, [] if is_text else before)
        room = size - data_at
        for element in (*before, vertex):
            row = element.dtype(order)
            least = max(2 * len(element.properties) - 1 if is_text else row.itemsize, 1)
            held = max(room // least, 0)
            if element is vertex:
                refuse_points(path, element.count, held)
            else:
                refuse_count(path, element.count, held, f"'{element.name}'")
            room -= element.count * least
        types = " ".join(dict.fromkeys(row[name].name for name in row.names or () if name.lower() in "xyz"))
        kind = f"PLY, {encoding.replace('_', ' ')}, {types}"
        info = TableInfo(kind, size, vertex.count, row, 24 if is_text else row.itemsize, is_text, is_text)
        if not is_text:
            data_at += sum(element.count * element.dtype(order).itemsize for element in before)
        skipped = sum(element.count for element in before)
        super().__init__(path, info, data_at, wanted, skipped=skipped, text_type=np.float64)


def _vertices(path: Location, elements: list[PlyElement]) -> PlyElement:
    """Return the element of the vertices; refuse one without points or without x, y and z."""
    vertex = next((head for head in elements if head.name.lower() in {"vertex", "vertices"}), None)
    if vertex is None:
        held = ", ".join(head.name for head in elements) or "nothing"
        raise BadInputError(f"{path} is a PLY file without a 'vertex' element (it holds {held}): no points to map")
    refuse_missing_axes(path, [name for name, code in vertex.properties.items() if code is not None])
    return vertex


def _refuse_lists(path: Location, vertex: PlyElement, before: list[PlyElement]) -> None:
    """Refuse lists in the vertices, or before them, where rows must be of one size."""
    listed = [head for head in (*before, vertex) if head.lists]
    if listed:
        where = "" if listed[0] is vertex else f" of its element '{listed[0].name}', before its vertices,"
        raise BadInputError(
            f"{path} has lists ({', '.join(listed[0].lists)}){where} and is not read: rows of vertices must be of one "
            "size and come before lists. Export it again with vertices first, and without lists in them"
        )


_PCD_LINE, _PCD_HEADER = 65_536, 200
"""Bytes of a line and lines of a header at most. Chosen: several times those of any program's files."""
_NO_POSE = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
"""Translation [m] and quaternion (w, x, y, z) of a VIEWPOINT that says nothing."""
_DENSEST = 100
"""Compression ratio at most: LZF packs 264 bytes into 3 at best."""
_PLAUSIBLE, _SMALL = 20, 1 << 28
"""Compression ratio of clouds at most (two to four are usual), and the unpacked bytes up to which more is accepted."""
_MOST_VALUES = 10_000
"""Values of a point at most; no point descriptor is longer."""
_UNPACKED_COPIES, _PACKED_COPIES = 2, 3
"""Number of copies of the unpacked and packed bytes in memory while a compressed file is unpacked."""


class PcdTable(PointTable):
    """A PCD file, in metres. A row with NaN is a beam without return, and is dropped.

    ``wanted``: see `Wanted`; ``memory``: memory limit for unpacking, bytes; ``text_type``: type of
    the numbers of a text file; None: as declared in the header.
    """

    nan_is_no_return, searched = True, 100_000

    def __init__(
        self, path: Location, wanted: Wanted, memory: int, text_type: type[np.float64] | None = None
    ) -> None:  # fmt: skip
        with decoding(path, "the header"), open_source(path) as stream:
            size = stream.seek(0, io.SEEK_END)
            stream.seek(0)
            self._head = head = _read_pcd_header(stream, path)
            data_at = stream.tell()
            row: np.dtype[np.void] = head.build_dtype()
            refuse_missing_axes(path, row.names or ())
            _refuse_size(stream, path, head, size - data_at, memory)
        is_text = head.data.value == "ascii"
        pose_note = ("its header gives the pose of the sensor (VIEWPOINT), which is not applied",)
        notes = pose_note if head.viewpoint != _NO_POSE else ()
        kind = f"PCD {head.version}, {head.data.value}"
        info = TableInfo(kind, size, head.points, row, row.itemsize, is_text, head.data.value != "binary", notes)
        super().__init__(path, info, data_at, wanted, text_type=text_type)

    def rows(self, first: int, count: int) -> Any:
        """See ``PointTable.rows``."""
        if self._head.data.value in {"ascii", "binary"}:
            return super().rows(first, count)
        return self._unpacked[first : first + count]

    @cached_property
    def _unpacked(self) -> NDArray[np.void]:
        """All rows; cached, since they are compressed column by column."""
        import pypcd4

        with decoding(self.path, "the points"), open_source(self.path) as stream:
            stream.seek(self._data_at)
            # Pass the header that was checked, not that of the file, which pypcd4 might parse differently.
            whole = io.BytesIO(self._head.compose_header().encode() + stream.read())
            return np.asarray(pypcd4.PointCloud.from_fileobj(whole).pc_data)


def _read_pcd_header(stream: BinaryIO, path: Location) -> Any:
    import pypcd4  # slow to load

    lines: list[str] = []
    for _ in range(_PCD_HEADER):
        line = stream.readline(_PCD_LINE).decode("utf-8", "replace").strip()
        lines.append(line)
        if line.startswith("DATA"):
            break
    else:
        raise BadInputError(f"the header of {path} has no DATA line: truncated? Copy or download it again")
    if not any(line.startswith("COUNT") for line in lines):
        # The line is optional: one value for each field.
        fields = next((len(line.split()) - 1 for line in lines if line.startswith("FIELDS")), 0)
        lines.insert(-1, "COUNT " + " ".join(["1"] * fields))
    head = pypcd4.MetaData.parse_header(lines)
    if not len(head.fields) == len(head.size) == len(head.type) == len(head.count):
        raise BadInputError(f"the header of {path} has FIELDS, SIZE, TYPE and COUNT of different length")
    if sum(head.count) > _MOST_VALUES:
        raise BadInputError(
            f"the header of {path} declares {sum(head.count):,} values per point (COUNT); at most {_MOST_VALUES:,} are "
            "read. The file is damaged; export it again"
        )
    return head


def _refuse_size(stream: BinaryIO, path: Location, head: Any, room: int, memory: int) -> None:
    """Check the declared point count against the size of the file and the memory, before any is allocated for it."""
    row = head.build_dtype().itemsize
    if head.data.value == "ascii":
        refuse_points(path, head.points, (room + 1) // (2 * sum(head.count)))
    elif head.data.value == "binary":
        refuse_points(path, head.points, room // row)
    else:
        packed, unpacked = struct.unpack("<II", stream.read(8)) if room >= 8 else (0, 0)
        refuse_count(path, packed, max(room - 8, 0), "bytes of packed points")
        refuse_count(path, unpacked, _DENSEST * packed, "bytes of unpacked points")
        refuse_points(path, head.points, unpacked // row)
        if unpacked != head.points * row:
            raise BadInputError(
                f"{path} declares {unpacked:,} bytes of unpacked points, and {head.points:,} points of {row} bytes. "
                "The file is damaged: copy or download it again"
            )
        needed = _UNPACKED_COPIES * unpacked + _PACKED_COPIES * packed
        remedy = (
            "Write it uncompressed (DATA binary), which is read in chunks: pcl_convert_pcd_ascii_binary IN.pcd OUT.pcd "
            "1"
        )
        if needed > memory:
            raise BadInputError(
                f"{path} is compressed, so it must be unpacked as a whole, which needs {needed / 1e6:,.0f} MB; "
                f"{memory / 1e6:,.0f} MB are available. {remedy}; or raise `memory`"
            )
        if unpacked > max(_SMALL, _PLAUSIBLE * packed):
            raise BadInputError(
                f"{path} would unpack to {unpacked / 1e6:,.0f} MB, {unpacked / packed:,.0f} times its size, which no "
                f"cloud of different points does: it may be damaged, or made to fill the memory. {remedy}"
            )


def open_table(
    kind: str, path: Location, wanted: Wanted, memory: int, text_type: type[np.float64] | None = None
) -> PointTable:
    """Open a file by its format, ``ply`` or ``pcd``; see `PlyTable` and `PcdTable`."""
    return PlyTable(path, wanted) if kind == "ply" else PcdTable(path, wanted, memory, text_type)
