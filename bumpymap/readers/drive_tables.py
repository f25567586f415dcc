"""Samples of tables of text: CSV, tracks of RTKLIB, messages of ArduPilot logs as CSV."""

import csv
import io
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, Floats
from bumpymap.readers.drive_signals import (
    ACCELERATIONS,
    ANGLES,
    DIMENSIONS,
    DOWN,
    EASTING_NORTHING,
    LOCAL,
    LONLAT,
    RATES,
    SIDES,
    UNITS,
    DriveColumn,
    Samples,
    chosen_columns,
    named_columns,
)
from bumpymap.readers.source import decoding, open_source, size_of

_MOST_BYTES = 2 << 30
"""Of a table of a drive. Chosen: an IMU at 200 Hz for two days."""
_MOST_REWRITTEN = 1 << 30
"""Files with blanks between their values are rewritten in memory."""
_HEAD_BYTES = 1 << 18
"""Bytes at the start of a file in which its header line is looked for."""
_SEPARATORS = (";", "\t", ",")
"""A header line without any of these has blanks between its names."""
_DATE_AND_TIME = re.compile(rb"(\b\d{4}[-/]\d\d[-/]\d\d)[ \t]+(\d\d?:\d\d)")
"""A date and a time of day that blanks separate, in a table whose values blanks separate: one value."""
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_LONGEST, _MOST_COLUMNS = 500, 10_000
"""Characters of a name, and columns."""
_COMMENT_SIGNS = "#%"
_COMMENT_LINES = re.compile(rb"^[ \t]*[#%][^\n]*(?:\n|\Z)", re.MULTILINE)
_INDENT = re.compile(rb"^[ \t]+|(?<![ \t])[ \t]+$", re.MULTILINE)
_BLANKS = re.compile(rb"[ \t]+")
_NULLS = ["", "nan", "NaN", "NAN", "-nan", "null", "NULL", "None", "N/A", "NA", "n/a", "-", "#N/A"]
_MOST_BROKEN = 0.01
"""Share of rows with too many or too few values, remarks among them, that may be left out."""
_FORMATS = (
    "A drive is a CSV file in UTF-8 with a header line, a bag of ROS 2 (.mcap, .db3, or its folder) or ROS 1 (.bag), "
    "or a ULog (.ulg); ogr2ogr and gpsbabel make CSV of other tracks"
)


class DriveTable(NamedTuple):
    """A text file with one row per line, and its format."""

    path: Path
    names: tuple[str, ...]
    """Of the columns, each different."""
    separator: str
    first_line: int
    """Number of lines before the first row."""

    def read(self, names: Sequence[str]) -> tuple[dict[str, Any], int]:
        """Return columns as arrays of pyarrow, by name, and how many rows were left out because they are broken.

        Raises BadInputError: more rows are broken than a recording that was cut off explains, or
        the file is damaged.
        """
        from pyarrow import csv as arrow

        widths: list[int] = []

        def leave_out(row: Any) -> str:
            widths.append(row.actual_columns)
            return "skip"

        blanks = self.separator == " "
        with self._tabs() if blanks else open_source(self.path) as rows, decoding(self.path, "the table"):
            table = arrow.read_csv(
                rows,
                read_options=arrow.ReadOptions(
                    column_names=list(self.names),
                    skip_rows=0 if blanks else self.first_line,
                    block_size=1 << 23,
                    encoding="latin-1",  # any byte is a letter: only numbers and dates are read
                ),
                parse_options=arrow.ParseOptions(
                    delimiter="\t" if blanks else self.separator, invalid_row_handler=leave_out
                ),
                convert_options=arrow.ConvertOptions(
                    include_columns=list(names), null_values=_NULLS, strings_can_be_null=True
                ),
            )
        if len(widths) > max(1.0, _MOST_BROKEN * table.num_rows):
            raise BadInputError(
                f"{self.path} is no table: {len(widths):,} of {table.num_rows + len(widths):,} lines do not have the "
                f"{len(self.names)} values of its header line but, for example, {widths[0]}. Give a CSV file with one "
                "line per sample"
            )
        return {name: table.column(name) for name in names}, len(widths)

    def _tabs(self) -> io.BytesIO:
        """Return the rows of a table whose values blanks separate, with tabs between them."""
        with open_source(self.path) as stream:
            lines = stream.read().replace(b"\r\n", b"\n").split(b"\n", self.first_line)
        rows = _COMMENT_LINES.sub(b"", lines[self.first_line] if len(lines) > self.first_line else b"")
        return io.BytesIO(_BLANKS.sub(b"\t", _DATE_AND_TIME.sub(rb"\1T\2", _INDENT.sub(b"", rows))))


def refuse_large(path: Path, most: int = _MOST_BYTES) -> None:
    """Raise BadInputError if a file has more bytes than are read at once."""
    size = size_of(path)
    if size > most:
        raise BadInputError(
            f"{path} has {size / 1e9:,.1f} GB; at most {most / 1e9:,.1f} GB are read at once. Cut it into several "
            "drives"
        )


def open_table(path: Path) -> DriveTable:
    """Read the header of a table.

    Raises BadInputError: the file is empty, too large, no text, or has no header line.
    """
    refuse_large(path, _MOST_BYTES)
    with open_source(path) as stream:
        data = stream.read(_HEAD_BYTES)
    if not data.strip():
        raise BadInputError(f"{path} is empty. {_FORMATS}")
    if b"\0" in data:
        raise BadInputError(f"{path} is not a text file, and of no format that holds a drive. {_FORMATS}")
    lines = data.decode("utf-8-sig", "replace").splitlines()
    written = (number for number, line in enumerate(lines) if line.strip() and line.strip()[0] not in _COMMENT_SIGNS)
    place = next(written, 0)
    # The header of RTKLIB is the last of its comments.
    header = place - 1 if place and lines[0].startswith("%") else place
    separator = next((each for each in _SEPARATORS if each in lines[header]), " ")
    if separator == " ":
        refuse_large(path, _MOST_REWRITTEN)
    names = _cells(lines[header].strip().lstrip(_COMMENT_SIGNS), separator)
    if max(map(len, names)) > _LONGEST or len(names) > _MOST_COLUMNS:
        raise BadInputError(
            f"{path} is no table of a drive: its header line has {len(names):,} columns, and the longest name "
            f"{max(map(len, names)):,} characters; at most {_MOST_COLUMNS:,} columns and {_LONGEST} characters are "
            "read. Is the file damaged?"
        )
    if sum(map(_is_number, names)) * 2 >= len(names):
        raise BadInputError(
            f"{path} has no header line: it begins with '{lines[header][:80]}'. Put the names of the columns before "
            "it, such as time,gyro_x,gyro_y,gyro_z"
        )
    if len(names) < 2 or names[0][:1] in {"<", "{", "["}:
        raise BadInputError(f"{path} is no table: it begins with '{lines[header].strip()[:80]}'. {_FORMATS}")
    different: list[str] = []
    for number, name in enumerate(names, 1):
        bare = name or f"column {number}"
        different.append(bare if bare not in different else f"{bare} (column {number})")
    return DriveTable(path, tuple(different), separator, header + 1)


def _cells(line: str, separator: str) -> list[str]:
    if separator == " ":
        return line.split()
    try:
        parts = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:  # a quote that does not end
        parts = line.split(separator)
    return [part.strip() for part in parts] or [""]


def _is_number(cell: str) -> bool:
    return len(cell) <= _LONGEST and _NUMBER.fullmatch(cell) is not None


_PLACE_GROUPS = (LONLAT, EASTING_NORTHING, LOCAL)
_TIME_US, _INSTANCE = "TimeUS", "I"
"""Columns of the messages of ArduPilot logs: the time, by which they are known, and the number of the sensor."""
_ARDUPILOT = {
    "timestamp": ("time", "s"),
    **{f"Gyr{axis}": (f"rate_{axis.lower()}", "rad/s") for axis in "XYZ"},
    **{f"Acc{axis}": (f"acc_{axis.lower()}", "m/s2") for axis in "XYZ"},
    **{angle.title(): (angle, "deg") for angle in ANGLES},
    "Lng": ("longitude", "deg"),
    "Lat": ("latitude", "deg"),
    "Spd": ("speed", "m/s"),
    "HAcc": ("error", "m"),
    "Status": ("fix", ""),
}
"""Column of its messages, as mavlogdump.py writes them -> quantity and unit."""
_GPST = "GPST"
_RTKLIB = {
    _GPST: ("time", "s"),
    "UTC": ("time", "s"),
    "longitude(deg)": ("longitude", "deg"),
    "latitude(deg)": ("latitude", "deg"),
    "sdn(m)": ("error", "m"),
}
_LEAST_FIX, _ARDUPILOT_FIX = 1.0, 2.0
"""Least ``fix`` of a position that was measured; of ArduPilot, 0 is no receiver, 1 no fix."""


def find_columns(table: DriveTable, columns: Mapping[str, str]) -> dict[str, DriveColumn]:
    """Return which columns of a table hold what: as named, the others by their names.

    Raises BadInputError: two columns have the name of one quantity, or a name states an unknown
    unit; UsageError: a named unit is unknown.
    """
    chosen = chosen_columns(columns, table.names)
    known = (set(columns) - {"time"}) | set(chosen)
    for group in _PLACE_GROUPS:
        if set(group) & set(columns):
            known |= {quantity for other in _PLACE_GROUPS if other != group for quantity in other}
    if "speed" in columns or set(SIDES) & set(columns):
        known |= {"speed"} if set(SIDES) & set(columns) else set(SIDES)
    fields = _ARDUPILOT if _TIME_US in table.names else _RTKLIB if "latitude(deg)" in table.names else {}
    if fields:
        found = {fields[name][0]: DriveColumn(name, fields[name][1]) for name in table.names if name in fields}
    else:
        taken = {column.name for column in chosen.values()}
        found = named_columns(table.path.name, [name for name in table.names if name not in taken], known)
    return {quantity: each for quantity, each in found.items() if quantity not in known} | chosen


def table_samples(table: DriveTable, columns: Mapping[str, DriveColumn]) -> Samples:
    """Read the samples of a table.

    ``columns``: of `find_columns`. Raises BadInputError: there is no time, or values cannot be
    meant.
    """
    source, notes = table.path.name, list[str]()
    listing = f"{source}: {', '.join(table.names)}"
    if not set(columns) - {"time", "fix", "error"}:
        return Samples(source, listing=listing)
    if "time" not in columns:
        raise BadInputError(
            f"{table.path} has no column named time; its columns are {', '.join(table.names)}. "
            "Name it, with its unit: `columns='time=NAME[s]'`"
        )
    is_ardupilot = _TIME_US in table.names
    instance = [_INSTANCE] if is_ardupilot and _INSTANCE in table.names else []
    arrays, broken = table.read(list(dict.fromkeys([*(column.name for column in columns.values()), *instance])))
    if broken:
        notes.append(f"{broken:,} lines of {source} are cut off, broken or remarks, and are left out")
    values = {"time": _times(arrays, columns, source, notes)}
    if not len(values["time"]):
        raise BadInputError(f"{table.path} has a header line, but no samples")
    for quantity, column in columns.items():
        numbers = None if DIMENSIONS[quantity] == "time" else _numbers(arrays[column.name], quantity, column, source)
        if numbers is not None:
            values[quantity] = numbers * (-1.0 if is_ardupilot and quantity in DOWN else 1.0)
    if "fix" in values:
        values["fix"] = values["fix"] - (_ARDUPILOT_FIX if is_ardupilot else _LEAST_FIX)
    if is_ardupilot and set(columns) & {*RATES, *ACCELERATIONS, *ANGLES}:
        notes.append(f"{source} is of ArduPilot: x forward, y right, z down is turned into x forward, y left, z up")
    if instance:
        values = _of_first_sensor(values, arrays[_INSTANCE].to_numpy().astype(np.float64), source, notes)
    said = {
        quantity: name if unit is None or unit in name or is_ardupilot else f"{name} [{unit}]"
        for quantity, (name, unit, _) in columns.items()
    }
    return Samples(source, values, said, notes, listing)


def _of_first_sensor(values: dict[str, Floats], numbers: Floats, source: str, notes: list[str]) -> dict[str, Floats]:
    lowest = np.fmin.reduce(numbers)
    if not (numbers > lowest).any():
        return values
    notes.append(f"{source} holds several sensors; the first one is read (I = {lowest:g})")
    return {quantity: column[numbers == lowest] for quantity, column in values.items()}


def _numbers(column: Any, quantity: str, stated: DriveColumn, source: str) -> Floats | None:
    """Return a column in the unit of `DriveLog`; None if it is text that may be left out."""
    from pyarrow import types

    if types.is_integer(column.type) or types.is_floating(column.type) or types.is_null(column.type):
        values: Floats = column.to_numpy().astype(np.float64)
        return values * (stated.sign * UNITS[DIMENSIONS[quantity]].get(stated.unit or "", 1.0))
    if quantity == "fix":
        return None
    word = next((str(word) for word in column.drop_null().to_pylist() if not _is_number(str(word))), "")
    raise BadInputError(
        f"the column {stated.name} of {source} ({quantity}) holds '{word}' among its numbers, which have a point "
        "(0.25). Leave such cells empty, "
        f"name another column (`columns='{quantity}=NAME'`), or none (`columns='{quantity}='`)"
    )


_GPS_AHEAD_S = 18.0
"""Leap seconds between the time of GPS and UTC, since 2017."""


def _times(arrays: Mapping[str, Any], columns: Mapping[str, DriveColumn], source: str, notes: list[str]) -> Floats:
    """Return the times of the samples, s, NaN where missing."""
    column = columns["time"]
    numbers, is_date = _time_numbers(arrays[column.name], source, column.name)
    if len(numbers) and not np.isfinite(numbers).any():
        raise BadInputError(
            f"the column {column.name} of {source} holds no times. Name the right one: `columns='time=NAME'`"
        )
    if not is_date:
        return numbers * np.float64(UNITS["time"][column.unit or "s"])
    if column.name == _GPST:
        notes.append(f"times of {source} are those of GPS; {_GPS_AHEAD_S:g} s are taken off for UTC")
        numbers = numbers - _GPS_AHEAD_S
    return numbers


def _time_numbers(column: Any, source: str, name: str) -> tuple[NDArray[Any], bool]:
    """Return a column of times as it is, or dates as seconds since 1970, NaN where missing; and whether it is dates.

    Raises BadInputError: it holds text that is no date.
    """
    import pyarrow as pa
    from pyarrow import compute, types

    kind = column.type
    if types.is_integer(kind) or types.is_floating(kind) or types.is_null(kind):
        exact = types.is_integer(kind) and column.null_count == 0
        return column.to_numpy() if exact else column.to_numpy().astype(np.float64), False
    if not types.is_timestamp(kind):
        words = compute.replace_substring(column.cast(pa.string()), "/", "-")
        try:
            column = words.cast(pa.timestamp("ns"))
        except pa.ArrowInvalid:
            try:
                column = words.cast(pa.timestamp("ns", tz="UTC"))
            except pa.ArrowInvalid as error:
                raise BadInputError(
                    f"the times of {source} (column {name}) are text such as '{column.drop_null()[0]}'. Write seconds, "
                    "or dates such as 2026-05-01 12:00:00.250"
                ) from error
    stamps = column.to_numpy().astype("datetime64[ns]")
    return np.where(np.isnat(stamps), np.nan, stamps.astype(np.int64) * 1e-9), True
