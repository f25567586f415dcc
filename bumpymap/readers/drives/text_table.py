"""Read tables of text: CSV with any separator, with comments."""

import csv
import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from bumpymap.core import BadInputError
from bumpymap.readers.drives.signals import UNITS, plain_unit
from bumpymap.readers.source import decoding, open_source, size_of

__all__ = ["DATE_AND_TIME", "HEAD_BYTES", "TableHead", "TextTable", "open_table", "read_head"]

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
_COMMENT_SIGNS = "#%"
_NMEA = re.compile(rb"\$[A-Z]{5},")
_FORMATS = (
    "A drive is a CSV file with a header line, a bag of ROS 2 (.mcap, .db3, or its folder) or ROS 1 (.bag), "
    "or a ULog (.ulg)"
)


class TableHead(NamedTuple):
    """Format of a table, from the start of its file."""

    names: tuple[str, ...]
    """Of the columns, each different."""
    separator: str
    first_line: int
    """Number of lines before the first row."""
    rewrite: bool
    """True if there are remarks between the rows, or blanks between the values."""


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
    rewrite = separator == " " or any(line.lstrip()[:1] in _COMMENT_SIGNS for line in lines[first:] if line.strip())
    heads = [_cells(line.strip().lstrip(_COMMENT_SIGNS), separator) for line in reversed(lines[:first]) if line.strip()]
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
        if line.strip()[:1] in _COMMENT_SIGNS:
            continue
        for separator in _SEPARATORS:
            cells = [cell for cell in _cells(line, separator) if cell]
            commas = separator != "," and sum(map(_has_decimal_comma, cells))
            if len(cells) > 1 and (sum(map(_is_number, cells)) + commas) * 2 > len(cells):
                return place, separator
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


_MOST_BYTES = 2 << 30
_MOST_REWRITTEN = 1 << 30
"""Files with remarks between their rows, or with blanks between their values, are rewritten in memory."""
_NULLS = ["", "nan", "NaN", "NAN", "-nan", "null", "NULL", "None", "N/A", "NA", "n/a", "-", "#N/A"]
_COMMENT_LINES = re.compile(rb"^[ \t]*[#%][^\n]*(?:\n|\Z)", re.MULTILINE)
_INDENT = re.compile(rb"^[ \t]+|(?<![ \t])[ \t]+$", re.MULTILINE)
_BLANKS = re.compile(rb"[ \t]+")
_MOST_BROKEN = 0.01
"""Share of rows with too many or too few values that may be left out."""


class TextTable(NamedTuple):
    """A text file with one row per line."""

    path: Path
    head: TableHead

    def read(self, names: Sequence[str]) -> tuple[dict[str, Any], int]:
        """Return columns as arrays of pyarrow, by name, and how many rows were left out because they are broken.

        Raises
        ------
        BadInputError
            More rows are broken than a recording that was cut off explains, or the file is damaged.
        """
        from pyarrow import csv

        widths: list[int] = []

        def leave_out(row: Any) -> str:
            widths.append(row.actual_columns)
            return "skip"

        with self._rows() as rows, decoding(self.path, "the table"):
            table = csv.read_csv(
                rows,
                read_options=csv.ReadOptions(
                    column_names=list(self.head.names),
                    skip_rows=0 if self.head.rewrite else self.head.first_line,
                    block_size=1 << 23,
                    encoding="latin-1",  # any byte is a letter: only numbers and dates are read
                ),
                parse_options=csv.ParseOptions(
                    delimiter="\t" if self.head.separator == " " else self.head.separator,
                    invalid_row_handler=leave_out,
                ),
                convert_options=csv.ConvertOptions(
                    include_columns=list(names), null_values=_NULLS, strings_can_be_null=True
                ),
            )
        if len(widths) > max(1.0, _MOST_BROKEN * table.num_rows):
            raise BadInputError(
                f"{self.path} is no table: {len(widths):,} of {table.num_rows + len(widths):,} lines do not have the "
                f"{len(self.head.names)} values of its header line but, for example, {widths[0]}. Give a CSV file with "
                "one line per sample"
            )
        return {name: table.column(name) for name in names}, len(widths)

    def _rows(self) -> Any:
        """Return what pyarrow reads: the file, or its rows rewritten."""
        stream = open_source(self.path)
        if not self.head.rewrite:
            return stream
        with stream:
            lines = stream.read().replace(b"\r\n", b"\n").split(b"\n", self.head.first_line)
        rows = _COMMENT_LINES.sub(b"", lines[self.head.first_line] if len(lines) > self.head.first_line else b"")
        if self.head.separator == " ":
            rows = _BLANKS.sub(b"\t", DATE_AND_TIME.sub(rb"\1T\2", _INDENT.sub(b"", rows)))
        return io.BytesIO(rows)


def open_table(path: Path) -> TextTable:
    """Read the header of a table.

    Raises
    ------
    BadInputError
        The file is empty, too large, no text, has decimal commas, or no header line.
    """
    size = size_of(path)
    if size > _MOST_BYTES:
        raise BadInputError(
            f"{path} has {size / 1e9:,.1f} GB; at most {_MOST_BYTES / 1e9:,.1f} GB are read at once. Cut it into "
            "several drives"
        )
    with open_source(path) as stream:
        data = stream.read(HEAD_BYTES)
    head = read_head(path, data, whole=size <= HEAD_BYTES)
    if head.rewrite and size > _MOST_REWRITTEN:
        raise BadInputError(
            f"{path} has {size / 1e9:,.1f} GB and remarks between its rows, or blanks between its values; at most "
            f"{_MOST_REWRITTEN / 1e9:,.1f} GB of such a file are read. Separate its values by commas, without remarks"
        )
    return TextTable(path, head)
