r"""Text that people read, on a terminal, in a page or in a spreadsheet: safe to show, and in plain English.

A name of a file, a survey or a CRS may hold escape sequences that a terminal executes, line breaks that forge a
message, and marks that change the direction of text. They are shown escaped (``\x1b``, ``\n``, ``\u202e``). A cell that
a spreadsheet would take for a formula gets an apostrophe before it, by which spreadsheets mark text.
"""

import csv
import unicodedata
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from bumpymap.core.files import atomic

__all__ = ["escape_controls", "write_csv"]

_SHOWN_ESCAPED = {"Cc", "Cf", "Cs", "Zl", "Zp"}
"""Unicode categories: control characters, format characters (such as text direction), surrogates, line breaks."""
_FORMULA = tuple("=+-@\uff1d\uff0b\uff0d\uff20")
"""First characters of formulas, in both widths."""


def escape_controls(text: str) -> str:
    r"""Escape characters that are not shown as they are, or that a terminal would interpret.

    Parameters
    ----------
    text : str
        Any text; bytes of a file name that Python could not decode (surrogate escapes) become ``\xNN``.

    Returns
    -------
    str
        Printable text in one line.
    """
    return text if text.isprintable() else "".join(map(_escaped, text))


def _escaped(letter: str) -> str:
    if unicodedata.category(letter) not in _SHOWN_ESCAPED:
        return letter
    if "\udc80" <= letter <= "\udcff":
        return f"\\x{ord(letter) - 0xDC00:02x}"
    return letter.encode("unicode_escape").decode("ascii")


def write_csv(path: Path, columns: Iterable[str], rows: Iterable[Sequence[Any]], *, end: str = "\r\n") -> None:
    """Write a table as CSV (RFC 4180, UTF-8) that a spreadsheet can open safely.

    Parameters
    ----------
    path : Path
        The file, which appears only when it is complete.
    columns : iterable of str
    rows : iterable of sequences
        Numbers, and text that is one, stay as they are. Other text is escaped, with an apostrophe before what would be
        a formula. None is an empty cell.
    end : str
        Of a line.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    with atomic(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator=end)
        writer.writerow(columns)
        writer.writerows([_cell(value) for value in row] for row in rows)


def _cell(value: Any) -> Any:
    if isinstance(value, bool):
        return "true" if value else "false"
    if not isinstance(value, str):
        return value
    text = escape_controls(value)
    if not text.lstrip().startswith(_FORMULA):
        return text
    with suppress(ValueError):
        float(text)
        return text
    return f"'{text}"
