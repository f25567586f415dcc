"""Events of ``--log-json``: one JSON object per line on standard error."""

import json
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import Any

from bumpymap.cli._text import print_error

__all__ = ["emit", "restored_logging", "set_up_logging"]


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
