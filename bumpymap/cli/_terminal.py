"""What the commands share: progress bars, log lines, tables."""

import json
import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

__all__ = ["DRIVES_KEPT", "LOCATION", "PATH", "BarProgress", "set_up_logging", "telling_how_to_go_on"]

DRIVES_KEPT = "The driven patches are kept: give the same command again to go on."


class _NamedPath(click.Path):
    """A path that is not the empty text: an unset shell variable must not mean the current folder."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Turn a text into a Path."""
        if value == "":
            self.fail("the path is empty; is a variable unset? The current folder is called .", param, ctx)
        return super().convert(value, param, ctx)


PATH = _NamedPath(path_type=Path)
"""Type of every path on the command line."""


class _Location(_NamedPath):
    """A path, or the text of a URL, which stays a text."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Turn a text into a Path, unless it is a URL."""
        return value if isinstance(value, str) and "://" in value else super().convert(value, param, ctx)


LOCATION = _Location(path_type=Path)
"""Type of surveys on the command line."""


class BarProgress:
    """A bar with ETA for each stage on a terminal; nothing where the output is piped."""

    def __init__(self, *, quiet: bool = False) -> None:
        console = Console(stderr=True)
        self._bars = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            console=console,
            disable=quiet or not console.is_terminal,
        )
        self._task: TaskID | None = None

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bars.stop()

    def start(self, stage: str, total: int | None) -> None:
        """Begin a stage: a new bar."""
        if self._bars.tasks and self._bars.tasks[-1].total is None:
            self._bars.update(self._bars.tasks[-1].id, total=1, completed=1)
        self._task = self._bars.add_task(stage, total=total)

    def advance(self, steps: int) -> None:
        """Go further along the bar of this stage."""
        if self._task is not None:
            self._bars.advance(self._task, steps)


@contextmanager
def telling_how_to_go_on(note: str) -> Iterator[None]:
    """Say on Ctrl-C or SIGTERM what is kept; the group of commands prints it and exits."""
    try:
        yield
    except KeyboardInterrupt as end:
        end.add_note(note)
        raise


class _JsonFormatter(logging.Formatter):
    """One JSON object a line."""

    def format(self, record: logging.LogRecord) -> str:
        """Format a record."""
        return json.dumps(
            {"level": record.levelname.lower(), "logger": record.name, "message": record.getMessage()},
            ensure_ascii=False,
        )


class _PlainFormatter(logging.Formatter):
    """``Warning: message``."""

    def format(self, record: logging.LogRecord) -> str:
        """Format a record."""
        return f"{record.levelname.capitalize()}: {record.getMessage()}"


def set_up_logging(*, as_json: bool) -> None:
    """Send the warnings of bumpymap and of its engine to standard error, as text or as JSON lines."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_JsonFormatter() if as_json else _PlainFormatter())
    for name in ("bumpymap", "bumpytiles"):
        logger = logging.getLogger(name)
        logger.handlers = [handler]
        logger.setLevel(logging.INFO if as_json else logging.WARNING)
        logger.propagate = False
