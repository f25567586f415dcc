"""Types of paths on the command line, events of ``--log-json``, and the note that says how to resume a command."""

import json
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click

from bumpymap.cli._text import print_error
from bumpymap.core import parse_share, path_fault

__all__ = [
    "DRIVES_KEPT",
    "FILE",
    "LOCATION",
    "PATH",
    "SHARE",
    "NumberList",
    "WordList",
    "emit",
    "interrupt_note",
    "restored_logging",
    "set_up_logging",
]


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


class _NamedPath(click.Path):
    """A path that is not empty: an unset shell variable must not mean the current folder."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Convert a string to a Path."""
        if value == "":
            self.fail("the path is empty; is a variable unset? The current folder is called .", param, ctx)
        if isinstance(value, str) and (reason := path_fault(value)):
            self.fail(reason, param, ctx)
        if isinstance(value, str) and "://" in value:
            self.fail(f"{value} is a URL; URLs can be surveys, and the --out of batch", param, ctx)
        return super().convert(value, param, ctx)


PATH = _NamedPath(path_type=Path)
"""Type of every path on the command line."""
FILE = _NamedPath(dir_okay=False, path_type=Path)
"""Type of a path that must not be a folder."""


class _Location(_NamedPath):
    """A path, or a URL, which stays a string."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Convert a string to a Path, unless it is a URL."""
        return value if isinstance(value, str) and "://" in value else super().convert(value, param, ctx)


LOCATION = _Location(path_type=Path)
"""Type of surveys on the command line."""


class _Share(click.ParamType):  # type: ignore[type-arg]
    """A share, as a number from 0 to 1 or as a percentage."""

    name = "share"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Convert a string to a number from 0 to 1."""
        share = parse_share(str(value))
        if share is None:
            self.fail(f"{value!r} is no share; give one such as 50% or 0.5", param, ctx)
        return share


SHARE = _Share()
"""Type of a share on the command line."""


class NumberList(click.ParamType):  # type: ignore[type-arg]
    """Numbers with commas between them."""

    name = "list"

    def __init__(self, kind: type[int] | type[float] = float) -> None:
        self._kind = kind

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        """Convert a string to numbers."""
        try:
            return tuple(self._kind(word) for word in str(value).split(","))
        except ValueError:
            whole = "whole " if self._kind is int else ""
            self.fail(f"{value!r} is no list of {whole}numbers; give one such as 1,2,5", param, ctx)


class WordList(click.ParamType):  # type: ignore[type-arg]
    """Words with commas between them."""

    name = "list"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, ...]:
        """Convert a string to words."""
        return tuple(word.strip() for word in str(value).split(",") if word.strip())


@contextmanager
def interrupt_note(note: str) -> Iterator[None]:
    """Add a note to the message after Ctrl-C or SIGTERM."""
    try:
        yield
    except KeyboardInterrupt as end:
        end.add_note(note)
        raise
