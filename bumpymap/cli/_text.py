r"""Printing to the terminal: all output of the command line goes through this module, which makes it safe.

Text and tables go to standard output; errors, log records and the events of ``--json`` to standard error.

A file name may hold escape sequences that a terminal executes, line breaks that forge a message, and marks that change
the direction of text. They are printed escaped (``\x1b``, ``\n``, ``\u202e``), so that callers need not do it. One call
prints one line.
"""

import errno
import io
import json
import logging
import os
import re
import shlex
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, TextIO

from bumpymap.core import OutputError, escape_controls

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

__all__ = [
    "DRIVES_KEPT",
    "LostOutputError",
    "about",
    "as_options",
    "emit",
    "error_console",
    "flush",
    "interrupt_note",
    "is_plain",
    "option_name",
    "print_error",
    "print_json",
    "print_labelled",
    "print_line",
    "print_table",
    "restored_logging",
    "set_up_logging",
    "spell_settings",
]

_NAMES: dict[str, str] = {}
"""Setting -> how the command that runs takes it, where that is not ``--setting``: ``--from``, ``--set pixels``."""
_SETTING = re.compile(r"`([a-z][a-z_]*)(?:=(?:'([^`]*)'|([^`'\s]+)))?`")


def spell_settings(names: Mapping[str, str]) -> None:
    """Note how the command that runs takes each of its settings, for messages."""
    _NAMES.clear()
    _NAMES.update(names)


def option_name(name: str) -> str:
    """Return the option of a setting, such as ``--tile-size``; of one that has none, ``--set KEY``."""
    return _NAMES.get(name, f"--{name.replace('_', '-')}")


def as_options(text: str) -> str:
    """Replace the settings in backquotes by options: ``--crs EPSG:32614``, ``--overwrite``."""
    return _SETTING.sub(_option, text) if "`" in text else text


def _option(found: re.Match[str]) -> str:
    name, quoted, plain = found.groups()
    option = option_name(name)
    if option.startswith("--set "):
        value = f"'{quoted}'" if quoted is not None else {None: "", "True": "true", "False": "false"}.get(plain, plain)
        return f"{option}={value}" if value else option
    if quoted is not None:
        return f"{option} {shlex.quote(quoted)}"
    return option if plain in {None, "True"} else f"{option} {plain}"


_AS_TERMINAL = ("FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE")
"""Environment variables by which rich treats a file as a terminal."""
BROKEN_PIPE = 141
"""Exit code if the reader of a pipe has closed it (SIGPIPE), as after ``| head -1``."""


class LostOutputError(OutputError):
    """Standard output cannot be written."""

    def __init__(self, error: OSError) -> None:
        super().__init__(
            f"cannot write to standard output: {error.strerror}. What was printed is cut off; send it elsewhere"
        )
        if error.errno == errno.EPIPE:  # not a failure: the reader has seen enough
            self.exit_code = BROKEN_PIPE


def _as_shown(text: str) -> str:
    return escape_controls(as_options(text))


def print_line(text: str = "", style: str = "") -> None:
    """Print one line to standard output; ``style`` is a style of rich, used on terminals."""
    if is_plain():
        _write(_as_shown(text) + "\n")
        return
    from rich.text import Text

    _print(Text(_as_shown(text), style))


def print_labelled(label: str, text: str, style: str) -> None:
    """Print a line that begins with a styled label."""
    from rich.text import Text

    _print(Text(escape_controls(label), style).append(_as_shown(text), "default"))


def print_table(rows: Iterable[Sequence[str]], titles: Sequence[str] = ()) -> None:
    """Print a table with titles and right-aligned numbers; without titles, indented names and their values."""
    if titles and is_plain():
        lines = _laid_out([titles, *([_as_shown(cell) for cell in row] for row in rows)])
        _write("".join(f"{line}\n" for line in lines))
        return
    from rich.table import Table
    from rich.text import Text

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
    """Print one line to standard error; ignore a failure, which must not end a run."""
    stream = sys.stderr
    if stream is None:
        return
    try:
        stream.write(_encodable(_as_shown(text), stream) + "\n")
        stream.flush()
    except (OSError, ValueError):  # full, or closed
        _silence(stream)


def flush() -> None:
    """Flush standard output while a failure can still be reported."""
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError as error:
        raise _stdout_error(error) from error


def is_plain(*, error: bool = False) -> bool:
    """Return whether standard output (or error) is no terminal, nor to be treated as one: no colours, no bars.

    Then rich, which takes as long to import as the command line itself, is not needed.
    """
    stream = sys.stderr if error else sys.stdout
    return not (any(map(os.environ.get, _AS_TERMINAL)) or (stream is not None and stream.isatty()))


def _laid_out(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a table: the first column to the left, the others to the right."""
    first, *others = (max(map(len, column)) for column in zip(*rows, strict=True))
    return [
        "  ".join([row[0].ljust(first), *(cell.rjust(width) for cell, width in zip(row[1:], others, strict=True))])
        for row in rows
    ]


def error_console() -> "Console":
    """Return a console on standard error, for progress bars."""
    from rich.console import Console

    return Console(stderr=True, highlight=False, markup=False, emoji=False)


class _Rendered(io.StringIO):
    """Receives the text that rich renders for standard output."""

    def isatty(self) -> bool:
        """Return whether standard output is a terminal, so that rich uses colours."""
        return sys.stdout is not None and sys.stdout.isatty()


def _print(what: "Text | Table") -> None:
    from rich.console import Console
    from rich.text import Text

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
    """Escape characters that the encoding of the stream does not have."""
    encoding = getattr(stream, "encoding", None) or "utf-8"
    return text.encode(encoding, "backslashreplace").decode(encoding)


def _silence(stream: TextIO) -> None:
    """Discard the buffer of a broken stream, which the interpreter would otherwise report at exit."""
    try:
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, stream.fileno())
        os.close(nothing)
    except (OSError, ValueError):  # a stream of a caller, without a file
        pass


def about(seconds: float) -> str:
    """Return a time as "about 12 min"."""
    for unit, size in (("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * size:
            return f"about {seconds / size:.0f} {unit}"
    return f"about {seconds:.0f} s"


def emit(event: str, **facts: Any) -> None:
    """Print one event with the current time."""
    time = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    print_error(json.dumps({"time": time, "event": event, **facts}))


class _Handler(logging.Handler):
    """Prints log records as lines or as events."""

    def __init__(self, *, as_json: bool) -> None:
        super().__init__()
        self._as_json = as_json

    def emit(self, record: logging.LogRecord) -> None:
        """Print a record."""
        try:
            level, message = record.levelname.lower(), record.getMessage()
        except Exception:  # noqa: BLE001 (a log call with wrong arguments must not end a run)
            self.handleError(record)
            return
        if self._as_json:
            emit(level, message=message, logger=record.name)
        else:
            print_error(f"{level.capitalize()}: {message}")


@contextmanager
def restored_logging() -> Iterator[None]:
    """Restore the log settings at the end, for a caller that continues after a command."""
    logger = logging.getLogger("bumpymap")
    before = logger.handlers, logger.level, logger.propagate
    try:
        yield
    finally:
        logger.handlers, logger.propagate = before[0], before[2]
        logger.setLevel(before[1])


def set_up_logging(*, as_json: bool) -> None:
    """Print the warnings of bumpymap and its engine to standard error, as text or as events."""
    for name in ("bumpymap", "bumpytiles"):
        logger = logging.getLogger(name)
        logger.handlers = [_Handler(as_json=as_json)]
        logger.setLevel(logging.INFO if as_json else logging.WARNING)
        logger.propagate = False


DRIVES_KEPT = "The driven patches are kept: give the same command again to continue."


@contextmanager
def interrupt_note(note: str) -> Iterator[None]:
    """Add a note to the message after Ctrl-C or SIGTERM."""
    try:
        yield
    except KeyboardInterrupt as end:
        end.add_note(note)
        raise
