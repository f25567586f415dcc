r"""The one place where text leaves for the terminal: it is shown, whatever a file name or a library put into it.

A name may hold escapes that a terminal obeys, line breaks that forge a message, and marks that turn the direction of
writing. All of them are shown escaped (``\x1b``, ``\n``, ``\u202e``) here, so that no caller has to think of it. One
call is one line.
"""

import errno
import io
import json
import os
import sys
import unicodedata
from collections.abc import Iterable, Sequence
from typing import Any, TextIO

from rich.console import Console
from rich.table import Table
from rich.text import Text

from bumpymap.cli._wording import as_options
from bumpymap.core import OutputError

__all__ = [
    "LostOutputError",
    "error_console",
    "escape",
    "flush",
    "print_error",
    "print_json",
    "print_labelled",
    "print_line",
    "print_table",
]

_SHOWN_ESCAPED = {"Cc", "Cf", "Cs", "Zl", "Zp"}
"""Unicode categories: controls, marks without a shape (directions of writing among them), surrogates, line breaks."""


BROKEN_PIPE = 141
"""What shells expect of a program whose reader has left (SIGPIPE), as after ``| head -1``."""


class LostOutputError(OutputError):
    """Standard output takes no more."""

    def __init__(self, error: OSError) -> None:
        super().__init__(
            f"cannot write to standard output: {error.strerror}. What was printed is cut off; send it elsewhere"
        )
        if error.errno == errno.EPIPE:  # nothing went wrong
            self.exit_code = BROKEN_PIPE


def escape(text: str) -> str:
    r"""Escape what a terminal would act on.

    Parameters
    ----------
    text : str
        Any; bytes that Python could not decode in a file name (surrogate escapes) are shown as ``\xNN``.

    Returns
    -------
    str
        Printable, in one line.
    """
    return text if text.isprintable() else "".join(map(_escaped, text))


def _as_shown(text: str) -> str:
    return escape(as_options(text))


def _escaped(letter: str) -> str:
    if unicodedata.category(letter) not in _SHOWN_ESCAPED:
        return letter
    if "\udc80" <= letter <= "\udcff":
        return f"\\x{ord(letter) - 0xDC00:02x}"
    return letter.encode("unicode_escape").decode("ascii")


def print_line(text: str = "", style: str = "") -> None:
    """Print one line to standard output; ``style`` is rich's, for terminals."""
    _print(Text(_as_shown(text), style))


def print_labelled(label: str, text: str, style: str) -> None:
    """Print a line whose beginning is styled."""
    _print(Text(escape(label), style).append(_as_shown(text), "default"))


def print_table(rows: Iterable[Sequence[str]], titles: Sequence[str] = ()) -> None:
    """Print a table: numbers under titles, the first column to the left; else names, indented, and what they name."""
    if titles:
        table = Table(box=None, pad_edge=False)
        for column, title in enumerate(titles):
            table.add_column(title, justify="right" if column else "left")
    else:
        table = Table.grid(padding=(0, 2))
        table.add_column(style="cyan", no_wrap=True)
        table.add_column(overflow="fold")
    for row in rows:
        first, *others = (Text(_as_shown(cell)) for cell in row)
        table.add_row(first if titles else Text("  ").append_text(first), *others)
    _print(table)


def print_json(record: Any, indent: int | None = None) -> None:
    """Print JSON to standard output, in ASCII."""
    _write(as_options(json.dumps(record, indent=indent)) + "\n")


def print_error(text: str) -> None:
    """Print one line to standard error, if that still takes any: a run does not end for want of a reader."""
    stream = sys.stderr
    if stream is None:
        return
    try:
        stream.write(_encodable(_as_shown(text), stream) + "\n")
        stream.flush()
    except (OSError, ValueError):  # full, or closed
        _silence(stream)


def flush() -> None:
    """Bring to an end what is written to standard output, while a failure can still be told."""
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError as error:
        raise _stdout_error(error) from error


def error_console() -> Console:
    """Give a console on standard error, for bars."""
    return Console(stderr=True, highlight=False, markup=False, emoji=False)


class _Rendered(io.StringIO):
    """Takes what rich makes of a text for standard output."""

    def isatty(self) -> bool:
        """Say whether it will be shown on a terminal, and so with colours."""
        return sys.stdout is not None and sys.stdout.isatty()


def _print(what: Text | Table) -> None:
    rendered = _Rendered()
    Console(file=rendered, highlight=False).print(what, soft_wrap=isinstance(what, Text))
    _write(rendered.getvalue())


def _write(text: str) -> None:
    stream = sys.stdout
    if stream is None:
        return
    try:
        stream.write(_encodable(text, stream))
        stream.flush()
    except OSError as error:
        raise _stdout_error(error) from error


def _stdout_error(error: OSError) -> LostOutputError:
    _silence(sys.stdout)
    return LostOutputError(error)


def _encodable(text: str, stream: TextIO) -> str:
    """Escape what the stream's encoding does not know."""
    encoding = getattr(stream, "encoding", None) or "utf-8"
    return text.encode(encoding, "backslashreplace").decode(encoding)


def _silence(stream: TextIO) -> None:
    """Let what is left in a stream's buffer go nowhere, or the interpreter would complain of it at its end."""
    try:
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, stream.fileno())
        os.close(nothing)
    except (OSError, ValueError):  # a stream of a caller, without a file
        pass
