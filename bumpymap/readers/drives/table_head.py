"""Find the header line of a table of text, its separator and its first row."""

import csv
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from bumpymap.core import BadInputError
from bumpymap.readers.drives.quantities import UNITS, plain_unit
from bumpymap.readers.drives.ros_echo import echo_names

__all__ = ["DATE_AND_TIME", "HEAD_BYTES", "TableHead", "read_head"]

HEAD_BYTES = 1 << 18
"""Bytes at the start of a file in which its header line and its first row are looked for."""
_SEPARATORS = (";", "\t", ",", "|", " ")
DATE_AND_TIME = re.compile(rb"(\b\d{4}[-/]\d\d[-/]\d\d)[ \t]+(\d\d?:\d\d)")
"""A date and a time of day that blanks separate, in a table whose values blanks separate: one value."""
_NUMBER = re.compile(
    r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|[-+]?(nan|inf)|\d{4}[-/]\d\d[-/]\d\d.*|\d\d?:\d\d.*", re.IGNORECASE
)
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+([eE][-+]?\d+)?")
_LONGEST, _MOST_COLUMNS = 500, 10_000
"""Characters of a name or number, and columns: patterns take the square of the one, guesses of each column time."""
_REMARK = "#%"
_NMEA = re.compile(rb"\$[A-Z]{5},")
_FORMATS = (
    "A drive is a CSV file with a header line, a bag of ROS 2 (.mcap, .db3, or its folder) or ROS 1 (.bag), "
    "or a ULog (.ulg)"
)


class TableHead(NamedTuple):
    """What the start of a file says about its table."""

    names: tuple[str, ...]
    """Of the columns, each different."""
    separator: str
    first_line: int
    """Number of lines before the first row."""
    rewrite: bool
    """Whether there are remarks between the rows, or blanks between the values."""


def read_head(path: Path, data: bytes, *, whole: bool) -> TableHead:
    """Read the header line at the start of a file.

    Parameters
    ----------
    path : Path
        For messages.
    data : bytes
        The start of the file.
    whole : bool
        Whether this is the whole file.

    Raises
    ------
    BadInputError
        The file is empty, no text, has decimal commas, or no header line.
    """
    lines = _text(path, data, whole=whole).splitlines()
    first, separator = _first_row(path, lines)
    row = _cells(lines[first], separator)
    rewrite = separator == " " or any(line.lstrip()[:1] in _REMARK for line in lines[first:] if line.strip())
    echoed = echo_names(row)
    if echoed is not None:
        return TableHead(echoed, separator, first, rewrite)
    heads = [_cells(line.strip().lstrip(_REMARK), separator) for line in reversed(lines[:first]) if line.strip()]
    names = _with_units(heads)
    _refuse_decimal_commas(path, separator, names, row)
    if not heads or sum(map(_is_number, names)) * 2 >= len(names):
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
    return TableHead(_different(names), separator, first, rewrite)


def _text(path: Path, data: bytes, *, whole: bool) -> str:
    if not data.strip():
        raise BadInputError(f"{path} is empty. {_FORMATS}")
    if data[:2] in {b"\xff\xfe", b"\xfe\xff"}:
        raise BadInputError(f"{path} is text in UTF-16. Save it as UTF-8: iconv -f UTF-16 -t UTF-8 IN.csv > OUT.csv")
    start = data.lstrip(b"\xef\xbb\xbf \r\n\t")[:200]
    if start.startswith(b"<") and b"gpx" in data[:2000].lower():
        raise BadInputError(
            f"{path} is a GPX track. Make a CSV file of it: ogr2ogr -f CSV {path.stem}.csv {path.name} track_points "
            "-lco GEOMETRY=AS_XY, and give this with `columns='longitude=X,latitude=Y'`"
        )
    if _NMEA.match(start):
        raise BadInputError(
            f"{path} holds sentences of NMEA. Make a CSV file of it: gpsbabel -i nmea -f {path.name} -o unicsv -F "
            f"{path.stem}.csv"
        )
    if b"\0" in data:
        raise BadInputError(f"{path} is not a text file, and of no format that holds a drive. {_FORMATS}")
    try:
        return (data if whole else data[: data.rfind(b"\n") + 1]).decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", "replace")  # as older programs of Windows write degree signs


def _first_row(path: Path, lines: Sequence[str]) -> tuple[int, str]:
    """Return the place of the first line of numbers, and what separates them."""
    for place, line in enumerate(lines):
        if line.strip()[:1] in _REMARK:
            continue
        for separator in _SEPARATORS:
            cells = [cell for cell in _cells(line, separator) if cell]
            commas = separator != "," and sum(map(_has_decimal_comma, cells))
            if len(cells) > 1 and (sum(map(_is_number, cells)) + commas) * 2 > len(cells):
                return place, separator
        if echo_names(_cells(line, ",")) is not None:
            return place, ","
    shown = next((line for line in lines if line.strip()), "")
    raise BadInputError(
        f"{path} is no table: no line of its first {HEAD_BYTES // 1024} KiB consists of numbers; it begins with "
        f"'{shown.strip()[:80]}'. {_FORMATS}"
    )


def _cells(line: str, separator: str) -> list[str]:
    if separator == " ":
        return DATE_AND_TIME.sub(rb"\1T\2", line.encode()).decode().replace('"', "").split()
    try:
        parts = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:  # a quote that does not end
        parts = line.split(separator)
    return [part.strip() for part in parts] or [""]


def _with_units(heads: Sequence[Sequence[str]]) -> list[str]:
    """Return the names of the header, whose nearest line comes first; with units, if these have a line of their own."""
    names = list(heads[0]) if heads else [""]
    if len(heads) < 2 or len(heads[1]) != len(names) or not any(names):
        return names
    if not all(not cell or any(plain_unit(cell.strip("[]()"), dimension) for dimension in UNITS) for cell in names):
        return names
    units = [cell.strip("[]()") for cell in names]
    return [f"{name} [{unit}]" if unit else name for name, unit in zip(heads[1], units, strict=True)]


def _is_number(cell: str) -> bool:
    return len(cell) <= _LONGEST and _NUMBER.fullmatch(cell) is not None


def _has_decimal_comma(cell: str) -> bool:
    return _DECIMAL_COMMA.fullmatch(cell) is not None


def _refuse_decimal_commas(path: Path, separator: str, names: Sequence[str], row: Sequence[str]) -> None:
    odd = next((cell for cell in row if _has_decimal_comma(cell)), None)
    if odd is not None or (separator == "," and len(names) > 2 and len(row) == 2 * len(names)):
        example = f"'{odd}'" if odd is not None else f"{len(names)} columns, and {len(row)} values in a row"
        raise BadInputError(
            f"{path} has decimal commas ({example}). Write numbers with a point, such as 0.25: in a spreadsheet choose "
            "English as the language before the export; in pandas read with decimal=',' and write again"
        )


def _different(names: Sequence[str]) -> tuple[str, ...]:
    """Return names with a number behind those that are empty or repeat an earlier one."""
    found: list[str] = []
    for place, name in enumerate(names, 1):
        bare = name or f"column {place}"
        found.append(bare if bare not in found else f"{bare} (column {place})")
    return tuple(found)
