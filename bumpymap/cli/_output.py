r"""Printing to the terminal: all output of the command line goes through this module, which makes it safe.

Text and tables go to standard output; errors, log records and the events of ``--json`` to standard error.

A file name may hold escape sequences that a terminal executes, line breaks that forge a message, and marks that change
the direction of text. They are printed escaped (``\x1b``, ``\n``, ``\u202e``), so that callers need not do it. One call
prints one line.

The progress of a run is bars on a terminal, lines in the log of a batch system, or JSON events.
"""

import json
import logging
import math
import os
import re
import shlex
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from shutil import get_terminal_size
from textwrap import wrap
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol, TextIO

import click

from bumpymap.core import Progress as BaseProgress, SilentProgress, escape_controls

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress, TaskID

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


def _as_shown(text: str) -> str:
    return escape_controls(as_options(text))


Style = Literal["", "bold", "yellow"]


class Styled(NamedTuple):
    """A line of which a terminal shows the label in a style, or all of it if there is no label."""

    text: str
    style: Style
    label: str = ""


class Table(NamedTuple):
    """A table with titles and right-aligned numbers; without titles, indented names and their values."""

    rows: Iterable[Sequence[str]]
    titles: Sequence[str] = ()


def print_lines(lines: Iterable[str | Styled | Table]) -> None:
    """Print lines and tables to standard output."""
    for line in lines:
        if isinstance(line, Table):
            print_table(*line)
        else:
            print_line(*([line] if isinstance(line, str) else line))


def print_line(text: str = "", style: Style = "", label: str = "") -> None:
    """Print one line to standard output, see `Styled`."""
    shown = _in_style(label, style) + _as_shown(text) if label else _in_style(text, style)
    _write(f"{shown}\n")


def _in_style(text: str, style: Style) -> str:
    shown = _as_shown(text)
    if not style or is_plain() or os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb":
        return shown
    return click.style(shown, bold=style == "bold", fg=None if style == "bold" else style)


def print_table(rows: Iterable[Sequence[str]], titles: Sequence[str] = ()) -> None:
    """Print a table, see `Table`. On a terminal, values that follow a name are wrapped."""
    shown = [[_as_shown(cell) for cell in row] for row in ([titles, *rows] if titles else rows)]
    widths = [max(map(len, column)) for column in zip(*shown, strict=True)]
    for place, (first, *others) in enumerate(shown):
        if titles:
            cells = [first.ljust(widths[0]), *(cell.rjust(w) for cell, w in zip(others, widths[1:], strict=True))]
            print_line("  ".join(cells).rstrip(), "" if place else "bold")
        else:
            room = max(get_terminal_size().columns - widths[0] - 4, 20)
            lines = others if is_plain() else wrap(others[0], room, break_on_hyphens=False) or others
            for line in lines:
                print_line(f"  {(first if line is lines[0] else '').ljust(widths[0])}  {line}")


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
    except OSError:
        _silence(sys.stdout)
        raise


def is_plain(*, error: bool = False) -> bool:
    """Return whether standard output (or error) is no terminal, nor to be treated as one: no colours, no bars."""
    stream = sys.stderr if error else sys.stdout
    return not (
        any(os.environ.get(name, "0") != "0" for name in _AS_TERMINAL) or (stream is not None and stream.isatty())
    )


def _write(text: str) -> None:
    stream = sys.stdout
    if stream is None:
        return
    try:
        stream.write(_encodable(text, stream))
        stream.flush()
    except OSError:
        _silence(stream)
        raise


def _encodable(text: str, stream: TextIO) -> str:
    """Escape characters that the encoding of the stream does not have."""
    encoding = getattr(stream, "encoding", None) or "utf-8"
    return text.encode(encoding, "backslashreplace").decode(encoding)


def _silence(stream: TextIO) -> None:
    """Discard the buffer of a broken stream, which the interpreter would otherwise report at exit."""
    with suppress(OSError, ValueError):  # a stream of a caller, without a file
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, stream.fileno())
        os.close(nothing)


def cell(value: float, form: str, unknown: str = "") -> str:
    """Return a number for a table in a form such as ``.1f``; ``unknown`` where it is not known."""
    return format(value, form) if math.isfinite(value) else unknown


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


ALREADY_DONE = "holds a complete run of these inputs and settings. Nothing was written; --overwrite replaces it"


@contextmanager
def interrupt_note(note: str) -> Iterator[None]:
    """Add a note to the message after Ctrl-C or SIGTERM."""
    try:
        yield
    except KeyboardInterrupt as end:
        end.add_note(note)
        raise


_LINE_SECONDS, _EVENT_SECONDS = 30.0, 10.0
"""Time between two lines of progress without a terminal, and between two JSON events, s."""


class CommandProgress(BaseProgress, Protocol):
    """A progress that can also report the result of a step."""

    def note(self, text: str, event: str, **facts: Any) -> None:
        """Report the result of a step, as a line of text or as an event."""


class _Quiet(SilentProgress):
    """Prints nothing."""

    def note(self, text: str, event: str, **facts: Any) -> None:
        """Do nothing."""


class _Bars:
    """One bar per stage, with the remaining time."""

    def __init__(self, bars: "Progress") -> None:
        self._bars = bars
        self._task: TaskID | None = None

    def start(self, stage: str, total: int | None) -> None:
        """Begin a stage: a new bar."""
        if self._bars.tasks and self._bars.tasks[-1].total is None:
            self._bars.update(self._bars.tasks[-1].id, total=1, completed=1)
        self._task = self._bars.add_task(escape_controls(stage), total=total)

    def advance(self, steps: int) -> None:
        """Advance the bar of this stage."""
        if self._task is not None:
            self._bars.advance(self._task, steps)

    def note(self, text: str, event: str, **facts: Any) -> None:
        """Print a line above the bars."""
        print_error(text)


class TickedProgress:
    """Counts the steps of a stage; each `tick` prints a line with the time since the run began, or an event."""

    def __init__(self, clock: Callable[[], float] = time.monotonic, *, as_json: bool = False) -> None:
        self._clock, self._begun, self._as_json = clock, clock(), as_json
        self._lock = Lock()
        self._stage, self._done, self._total = "", 0, None  # type: tuple[str, int, int | None]

    def start(self, stage: str, total: int | None) -> None:
        """Begin a stage."""
        with self._lock:
            self._stage, self._done, self._total = stage, 0, total
        if self._as_json:
            emit("stage", stage=stage, total=total)

    def advance(self, steps: int) -> None:
        """Count steps."""
        with self._lock:
            self._done += steps

    def tick(self) -> None:
        """Print what is being done."""
        if not self._stage:
            return
        with self._lock:
            stage, done, total, seconds = self._stage, self._done, self._total, self._clock() - self._begun
        share = min(done / total, 1.0) if total else None
        shown = f"{done:,}" if share is None else f"{share:.0%} ({done:,} of {total:,})"
        facts = {"done": done, "total": total, "share": share and round(share, 4), "seconds": round(seconds, 1)}
        hours, minutes = divmod(int(seconds) // 60, 60)
        text = f"{hours}:{minutes:02d}:{int(seconds) % 60:02d} {stage}: {shown}"
        self.note(text, "progress", stage=stage, **facts)

    def note(self, text: str, event: str, **facts: Any) -> None:
        """Print a line, or an event."""
        if self._as_json:
            emit(event, **facts)
        else:
            print_error(text)


@contextmanager
def show_progress(*, quiet: bool = False, as_json: bool = False) -> Iterator[CommandProgress]:
    """Yield the progress to pass to a run.

    ``quiet``: print nothing; ``as_json``: print events; otherwise show bars on a terminal, and print lines if standard
    error is not a terminal.
    """
    if quiet:
        yield _Quiet()
    elif as_json or is_plain(error=True):
        ticked = TickedProgress(as_json=as_json)
        every = _EVENT_SECONDS if as_json else _LINE_SECONDS
        with _calling_every(ticked.tick, every):
            yield ticked
    else:
        from rich.console import Console

        with moving_bars(Console(stderr=True, highlight=False, markup=False, emoji=False)) as bars:
            yield bars


@contextmanager
def moving_bars(console: "Console") -> Iterator[_Bars]:
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    name = TextColumn("{task.description}", markup=False)
    bars = Progress(name, BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), console=console)
    with suppress(RuntimeError):  # no thread can be started: the run goes on with still bars
        bars.start()
    try:
        yield _Bars(bars)
    finally:
        bars.stop()


@contextmanager
def _calling_every(tick: Callable[[], None], seconds: float) -> Iterator[None]:
    """Call ``tick`` at this interval, from another thread, during the body of the ``with``."""
    ended = Event()

    def run() -> None:
        while not ended.wait(seconds):
            tick()

    thread = Thread(target=run, daemon=True, name="progress")
    with suppress(RuntimeError):  # no thread can be started: the run goes on without progress
        thread.start()
    try:
        yield
    finally:
        ended.set()
        if thread.ident is not None:
            thread.join()
