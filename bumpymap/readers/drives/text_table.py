"""Read tables of text: CSV with any separator, with remarks, and what ``ros2 topic echo --csv`` writes."""

import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from bumpymap.core import BadInputError
from bumpymap.readers.drives.table_head import DATE_AND_TIME, HEAD_BYTES, TableHead, read_head
from bumpymap.readers.source import decoding, open_source, size_of

__all__ = ["TextTable", "open_table"]

_MOST_BYTES = 2 << 30
_MOST_REWRITTEN = 1 << 30
"""Files with remarks between their rows, or with blanks between their values, are rewritten in memory."""
_NULLS = ["", "nan", "NaN", "NAN", "-nan", "null", "NULL", "None", "N/A", "NA", "n/a", "-", "#N/A"]
_REMARK = re.compile(rb"^[ \t]*[#%][^\n]*(?:\n|\Z)", re.MULTILINE)
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
        rows = _REMARK.sub(b"", lines[self.head.first_line] if len(lines) > self.head.first_line else b"")
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
