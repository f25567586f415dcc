"""log.jsonl: what happened in a batch and when, one JSON object per line; every start appends to it."""

import json
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from bumpymap.core import OutputError, without_keys

__all__ = ["BatchLog"]


class BatchLog:
    """Appends events to a file. A full disk does not end a batch: an event that cannot be written is lost."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    @classmethod
    @contextmanager
    def opened(cls, path: Path) -> Iterator["BatchLog"]:
        """Open or create the file; a link is not followed.

        Raises
        ------
        OutputError
            It cannot be written, or is no plain file.
        """
        flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK
        try:
            descriptor = os.open(path, flags, 0o666)
        except OSError as error:
            raise OutputError(f"cannot write {path}: {error.strerror}. Choose another `out`") from error
        try:
            found = os.fstat(descriptor)
            if not stat.S_ISREG(found.st_mode) or found.st_nlink > 1:
                raise OutputError(f"{path} is not a plain file of its own, and was not touched. Remove it")
            if (
                found.st_size and os.pread(descriptor, 1, found.st_size - 1) != b"\n"
            ):  # a killed batch wrote half a line
                os.write(descriptor, b"\n")
            yield cls(descriptor)
        finally:
            os.close(descriptor)

    def write(self, event: str, **facts: Any) -> None:
        """Append one event with the current time; URLs in its texts without keys."""
        facts = {name: without_keys(fact) if isinstance(fact, str) else fact for name, fact in facts.items()}
        time = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        line = json.dumps({"time": time, "event": event, **facts}) + "\n"
        with suppress(OSError):
            os.write(self._descriptor, line.encode())
