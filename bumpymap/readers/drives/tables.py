"""Samples of tables of text: CSV with any separator, tracks of RTKLIB, messages of ArduPilot logs as CSV."""

import csv
import io
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError
from bumpymap.readers.drives.quantities import (
    ACCELERATIONS,
    ANGLES,
    DIMENSIONS,
    DOWN,
    EASTING_NORTHING,
    LOCAL,
    LONLAT,
    QUATERNION,
    RATES,
    SIDES,
    UNITS,
    DriveColumn,
    chosen_columns,
    guess_columns,
)
from bumpymap.readers.drives.signals import Floats, Samples
from bumpymap.readers.source import decoding, open_source, size_of

_MOST_BYTES = 2 << 30
_MOST_REWRITTEN = 1 << 30
"""Files with blanks between their values are rewritten in memory."""
_HEAD_BYTES = 1 << 18
"""Bytes at the start of a file in which its header line and its first row are looked for."""
_SEPARATORS = (";", "\t", ",", "|", " ")
_DATE_AND_TIME = re.compile(rb"(\b\d{4}[-/]\d\d[-/]\d\d)[ \t]+(\d\d?:\d\d)")
"""A date and a time of day that blanks separate, in a table whose values blanks separate: one value."""
_NUMBER = re.compile(
    r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|[-+]?(nan|inf)|\d{4}[-/]\d\d[-/]\d\d.*|\d\d?:\d\d.*", re.IGNORECASE
)
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+([eE][-+]?\d+)?")
_LONGEST, _MOST_COLUMNS = 500, 10_000
"""Characters of a name or number, and columns: patterns take the square of the one, guesses of each column time."""
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

        Raises
        ------
        BadInputError
            More rows are broken than a recording that was cut off explains, or the file is damaged.
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


def refuse_large(path: Path, most: int = _MOST_BYTES) -> int:
    """Return the size of a file.

    Raises BadInputError: it has more bytes than are read at once.
    """
    size = size_of(path)
    if size > most:
        raise BadInputError(
            f"{path} has {size / 1e9:,.1f} GB; at most {most / 1e9:,.1f} GB are read at once. Cut it into several "
            "drives"
        )
    return size


def open_table(path: Path) -> DriveTable:
    """Read the header of a table.

    Raises
    ------
    BadInputError
        The file is empty, too large, no text, has decimal commas, or no header line.
    """
    size = refuse_large(path, _MOST_BYTES)
    with open_source(path) as stream:
        data = stream.read(_HEAD_BYTES)
    if not data.strip():
        raise BadInputError(f"{path} is empty. {_FORMATS}")
    if b"\0" in data:
        raise BadInputError(f"{path} is not a text file, and of no format that holds a drive. {_FORMATS}")
    data = data if size <= _HEAD_BYTES else data[: data.rfind(b"\n") + 1]
    try:
        lines = data.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        lines = data.decode("cp1252", "replace").splitlines()  # as older programs of Windows write degree signs
    first, separator = _first_row(path, lines)
    if separator == " ":
        refuse_large(path, _MOST_REWRITTEN)
    row = _cells(lines[first], separator)
    head = next((line for line in reversed(lines[:first]) if line.strip()), "")
    names = _cells(head.strip().lstrip(_COMMENT_SIGNS), separator)
    if not head or sum(map(_is_number, names)) * 2 >= len(names):
        raise BadInputError(
            f"{path} has no header line: its first row is '{lines[first][:80]}'. Put the names of the columns before "
            "it, such as time,gyro_x,gyro_y,gyro_z"
        )
    if max(map(len, names)) > _LONGEST or len(names) > _MOST_COLUMNS:
        raise BadInputError(
            f"{path} is no table of a drive: its header line has {len(names):,} columns, and the longest name "
            f"{max(map(len, names)):,} characters; at most {_MOST_COLUMNS:,} columns and {_LONGEST} characters are "
            "read. Is the file damaged?"
        )
    if names[-1:] == [""] and len(names) == len(row) + 1:
        names = names[:-1]
    elif row[-1] == "" and len(row) == len(names) + 1:
        names = [*names, ""]
    different: list[str] = []
    for place, name in enumerate(names, 1):
        bare = name or f"column {place}"
        different.append(bare if bare not in different else f"{bare} (column {place})")
    return DriveTable(path, tuple(different), separator, first)


def _first_row(path: Path, lines: Sequence[str]) -> tuple[int, str]:
    """Return the place of the first line of numbers, and what separates them."""
    for place, line in enumerate(lines):
        if line.strip()[:1] in _COMMENT_SIGNS:
            continue
        for separator in _SEPARATORS:
            cells = [cell for cell in _cells(line, separator) if cell]
            odd = [cell for cell in cells if separator != "," and _DECIMAL_COMMA.fullmatch(cell[:_LONGEST])]
            if len(cells) > 1 and (sum(map(_is_number, cells)) + len(odd)) * 2 > len(cells):
                if odd:
                    raise BadInputError(
                        f"{path} has decimal commas ('{odd[0]}'). Write numbers with a point, such as 0.25"
                    )
                return place, separator
    shown = next((line for line in lines if line.strip()), "")
    raise BadInputError(
        f"{path} is no table: no line of its first {_HEAD_BYTES // 1024} KiB consists of numbers; it begins with "
        f"'{shown.strip()[:80]}'. {_FORMATS}"
    )


def _cells(line: str, separator: str) -> list[str]:
    if separator == " ":
        return _DATE_AND_TIME.sub(rb"\1T\2", line.encode()).decode().replace('"', "").split()
    try:
        parts = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:  # a quote that does not end
        parts = line.split(separator)
    return [part.strip() for part in parts] or [""]


def _is_number(cell: str) -> bool:
    return len(cell) <= _LONGEST and _NUMBER.fullmatch(cell) is not None


_PLACE_GROUPS = (LONLAT, EASTING_NORTHING, LOCAL)
_SENSOR = re.compile(r"gyroscope|gyro|acceleration|accelerometer|accel", re.IGNORECASE)
_LEAST_FIX = {"fix_type": 2.0, "fix": 1.0, "quality": 1.0, "gps_qual": 1.0}
"""Name -> least value of a position that was measured; 0 for others (``status`` of ROS)."""
_TIME_US, _INSTANCE = "TimeUS", "I"
"""Columns of the messages of ArduPilot logs: the time, by which they are known, and the number of the sensor."""
_ARDUPILOT_UNITS = {
    **dict.fromkeys(RATES, "rad/s"),
    **dict.fromkeys(ACCELERATIONS, "m/s2"),
    **dict.fromkeys(ANGLES, "deg"),
    "speed": "m/s",
}
_ARDUPILOT_FIX = 2.0
"""0 is no receiver, 1 no fix."""


def find_columns(table: DriveTable, columns: Mapping[str, str]) -> dict[str, DriveColumn]:
    """Return which columns of a table hold what: as named, the others as their names tell.

    Raises
    ------
    BadInputError
        Several columns may hold the same quantity.
    UsageError
        A named unit is unknown.
    """
    chosen = chosen_columns(columns, table.names)
    known = (set(columns) - {"time"}) | set(chosen)
    for group in _PLACE_GROUPS:
        if set(group) & set(columns):
            known |= {quantity for other in _PLACE_GROUPS if other != group for quantity in other}
    if "speed" in columns or set(SIDES) & set(columns):
        known |= {"speed"} if set(SIDES) & set(columns) else set(SIDES)
    # A file may be named after its sensor: x of Gyroscope.csv.
    sensor = _SENSOR.search(table.path.stem)
    axis = f"{sensor.group().lower()}_" if sensor else ""
    spelled = {axis * (name.strip().lower() in {"x", "y", "z"}) + name: name for name in table.names}
    guessed = guess_columns(table.path.name, list(spelled), known)
    found = {**{quantity: each._replace(name=spelled[each.name]) for quantity, each in guessed.items()}, **chosen}
    if _TIME_US in table.names:
        for quantity in set(found) & set(_ARDUPILOT_UNITS):
            found[quantity] = found[quantity]._replace(unit=found[quantity].unit or _ARDUPILOT_UNITS[quantity])
    return found


def table_samples(table: DriveTable, columns: Mapping[str, DriveColumn]) -> Samples:
    """Read the samples of a table.

    Parameters
    ----------
    table : DriveTable
    columns : mapping
        Of `find_columns`.

    Raises
    ------
    BadInputError
        There is no time, or values cannot be meant.
    """
    source, notes = table.path.name, list[str]()
    listing = f"{source}: {', '.join(table.names)}"
    if not set(columns) - {"time", "nanosec", "date", "fix", "error"}:
        return Samples(source, listing=listing)
    if "time" not in columns:
        raise BadInputError(
            f"{table.path} has no column of times that is known by its name; its columns are {', '.join(table.names)}. "
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
        name = columns["fix"].name.lower()
        least = next((least for key, least in _LEAST_FIX.items() if key in name), 0.0)
        values["fix"] = values["fix"] - (_ARDUPILOT_FIX if is_ardupilot else least)
    _guess_units(values, columns, source, notes)
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
    """Return a column in the unit of `DriveLog`, where its unit is known; None if it is text that may be left out."""
    from pyarrow import types

    if types.is_integer(column.type) or types.is_floating(column.type) or types.is_null(column.type):
        values: Floats = column.to_numpy().astype(np.float64)
        return values * (stated.sign * UNITS[DIMENSIONS[quantity]].get(stated.unit or "", 1.0))
    if quantity == "fix":
        return None
    word = next((str(word) for word in column.drop_null().to_pylist() if not _is_number(str(word))), "")
    raise BadInputError(
        f"the column {stated.name} of {source} ({quantity}) holds '{word}' among its numbers. Leave such cells empty, "
        f"name another column (`columns='{quantity}=NAME'`), or none (`columns='{quantity}='`)"
    )


def _guess_units(values: dict[str, Floats], columns: Mapping[str, DriveColumn], source: str, notes: list[str]) -> None:
    """Bring quantities whose unit no name tells to rad/s, m/s2 and rad, as their size tells, and say so."""

    def unknown(group: tuple[str, ...]) -> list[str]:
        held = [quantity for quantity in group if quantity in values]
        return [] if all(columns[quantity].unit is not None for quantity in held) else held

    if set(RATES) <= set(unknown(RATES)):
        names = ", ".join(columns[quantity].name for quantity in RATES)
        notes.append(f"angular rates of {source} ({names}) name no unit and are taken as rad/s")
    if set(ACCELERATIONS) <= set(unknown(ACCELERATIONS)):
        finite = [values[quantity][np.isfinite(values[quantity])] for quantity in ACCELERATIONS]
        middle = float(np.linalg.norm([np.median(part) if len(part) else 0.0 for part in finite]))
        for unit, factor in UNITS["acceleration"].items():
            if unit != "m/s2" and 7.0 < middle * factor < 13.0:
                values.update({quantity: values[quantity] * factor for quantity in ACCELERATIONS})
                notes.append(f"accelerations of {source} are taken as {unit}")
    if held := unknown(ANGLES):
        in_degrees = (
            max(float(np.nanmax(np.abs(values[quantity]), initial=0.0)) for quantity in held) > 2 * np.pi + 0.01
        )
        unit = "deg" if in_degrees else "rad"
        values.update({quantity: values[quantity] * UNITS["angle"][unit] for quantity in held})
        notes.append(f"roll, pitch and yaw of {source} name no unit and are taken as {unit}")


_TIME = (
    r"^\s*(?:(?P<year>\d{4})[-/.](?P<month>\d\d?)[-/.](?P<day>\d\d?))?[ T]*"
    r"(?:(?P<hour>\d\d?):(?P<minute>\d\d):(?P<second>\d\d(?:\.\d+)?)"
    r"\s*(?:Z| ?UTC|(?P<zone>[-+]\d\d)(?::?(?P<zone_minute>\d\d))?)?)?\s*$"
)
"""A date, a time of day, or both."""
_DAY_S = 86_400.0
_EPOCH = (("s", 1e8, 1e10), ("ms", 1e11, 1e13), ("us", 1e14, 1e16), ("ns", 1e17, 1e19))
"""Unit, from, to: times since 1970 (from 1973 on) tell their unit by their size."""
_STEP_S = {True: (2e-4, 0.3, 0.6), False: (0.004, 5.0, 60.0)}
"""Of rates, and of positions: time between two samples, from and to, s: other times between them are in another unit.
A time longer than the last one says that times are not since 1970, but since a start, in a smaller unit."""
_GPS_AHEAD_S = 18.0
"""Leap seconds between the time of GPS and UTC, since 2017."""


def _times(arrays: Mapping[str, Any], columns: Mapping[str, DriveColumn], source: str, notes: list[str]) -> Floats:
    """Return the times of the samples, s."""
    column = columns["time"]
    numbers, unit, has_date = _time_numbers(arrays[column.name], source, column.name)
    if "nanosec" in columns:
        rest, _, _ = _time_numbers(arrays[columns["nanosec"].name], source, columns["nanosec"].name)
        return numbers.astype(np.float64) + rest * np.float64(1e-9)
    finite = numbers[np.isfinite(numbers)] if numbers.dtype.kind == "f" else numbers
    if len(numbers) and not len(finite):
        raise BadInputError(
            f"the column {column.name} of {source} holds no times. Name the right one: `columns='time=NAME'`"
        )
    stated = unit or column.unit
    if stated is None and len(finite):
        is_fast = set(RATES) <= set(columns) or set(QUATERNION) <= set(columns)
        stated = _time_unit(finite, is_fast, source, column.name)
        if stated != "s":
            notes.append(f"times of {source} (column {column.name}) are taken as {stated}")
    seconds: Floats = numbers * np.float64(UNITS["time"][stated or "s"])
    if unit is None:
        return seconds
    if not has_date and "date" in columns:
        days, day_unit, has_date = _time_numbers(arrays[columns["date"].name], source, columns["date"].name)
        seconds = seconds + days * UNITS["time"][day_unit or "s"]
    if not has_date:
        notes.append(f"times of {source} (column {column.name}) are times of day")
    elif column.name.strip().lower() == "gpst":
        notes.append(f"times of {source} are those of GPS; {_GPS_AHEAD_S:g} s are taken off for UTC")
        seconds = seconds - _GPS_AHEAD_S
    return seconds


def _time_unit(numbers: NDArray[Any], is_fast: bool, source: str, name: str) -> str:
    """Tell the unit of times by the size of times since 1970, else by the time between two samples."""
    steps = np.diff(np.unique(numbers))
    middle, step = float(np.median(numbers)), float(np.median(steps)) if len(steps) else np.nan
    least_s, most_s, slowest_s = _STEP_S[is_fast]
    factors = UNITS["time"]
    since_1970 = next((unit for unit, least, most in _EPOCH if least <= middle < most), None)
    if since_1970 is not None and not step * factors[since_1970] > slowest_s:
        return since_1970
    # The first unit that will do: the next one differs by a factor of 1000, almost the whole range.
    unit = next((unit for unit in ("s", "ms", "us", "ns") if least_s <= step * factors[unit] <= most_s), None)
    if unit is None:
        raise BadInputError(
            f"the unit of the times of {source} (column {name}) cannot be determined: between two samples it rises by "
            f"{step:g} (median). State it: `columns='time={name}[ms]'` (s, ms, us or ns)"
        )
    return unit


def _time_numbers(column: Any, source: str, name: str) -> tuple[NDArray[Any], str | None, bool]:
    """Return a column of times as float64, NaN where missing, or int64; the unit of text; whether that has a date.

    Text is ``2026-05-01 12:00:00.250``, ``2026/05/01T12:00:00+02:00``, a date, or a time of day ``12:00:00.250``.

    Raises BadInputError: it holds text that is no time.
    """
    import pyarrow as pa
    from pyarrow import compute, types

    kind = column.type
    if types.is_timestamp(kind):
        stamps = column.to_numpy().astype("datetime64[ns]")
        whole = stamps.astype(np.int64)
        return np.where(np.isnat(stamps), np.nan, whole) if np.isnat(stamps).any() else whole, "ns", True
    if types.is_integer(kind) or types.is_floating(kind) or types.is_null(kind):
        exact = types.is_integer(kind) and column.null_count == 0
        return column.to_numpy() if exact else column.to_numpy().astype(np.float64), None, True
    words = column.cast(pa.string())
    found = compute.extract_regex(words, _TIME)
    if found.null_count > words.null_count:
        odd = column.drop_null()[0]
        raise BadInputError(
            f"the times of {source} (column {name}) are text such as '{odd}'. Write seconds, or dates such as "
            "2026-05-01 12:00:00.250"
        )
    part = {
        field.name: np.asarray(
            compute.if_else(compute.equal(values, ""), None, values).cast(pa.float64()).to_numpy(zero_copy_only=False)
        )
        for field, values in zip(found.type, found.flatten(), strict=True)
    }
    months = (np.nan_to_num(part["year"], nan=1970.0) - 1970) * 12 + np.nan_to_num(part["month"], nan=1.0) - 1
    days = months.astype(np.int64).astype("datetime64[M]").astype("datetime64[D]").astype(np.int64)
    seconds = (days + np.nan_to_num(part["day"], nan=1.0) - 1.0) * _DAY_S
    for unit, factor in (("hour", 3600.0), ("minute", 60.0), ("second", 1.0), ("zone", -3600.0)):
        seconds += factor * np.nan_to_num(part[unit])
    seconds -= np.copysign(60.0 * np.nan_to_num(part["zone_minute"]), part["zone"])
    missing = np.isnan(part["day"]) & np.isnan(part["hour"])
    return np.where(missing, np.nan, seconds), "s", bool(np.isfinite(part["day"]).any())
