"""Failures that a user can cause. Each message says what came, what is allowed and what to do."""

import errno
from collections.abc import Iterator

__all__ = ["BadInputError", "BumpymapError", "OutputError", "UsageError", "error_chain", "missing_resource"]

_WANTED = {
    errno.EAGAIN: "process",
    errno.EMFILE: "file that may be opened",
    errno.ENFILE: "file that may be opened",
    errno.ENOMEM: "memory",
}
_NO_ROOM = ("cannot allocate memory", "failed to map segment", "unable to allocate", "out of memory")


class BumpymapError(Exception):
    """Base of every failure bumpymap raises on purpose. ``exit_code`` is what the command line returns.

    Several arguments are the lines of one message. A line break inside of an argument is not shown as one: it came with
    a file name or from somebody else's library.
    """

    exit_code = 3

    def __str__(self) -> str:
        """Give the message in one line."""
        return " ".join(str(line).strip() for line in self.args)


class UsageError(BumpymapError):
    """Settings that cannot be used, or do not go together."""

    exit_code = 2


class BadInputError(BumpymapError):
    """A file that cannot be read, or does not hold what it promises."""


class OutputError(BumpymapError):
    """A place that cannot be written, or already holds something that must not be overwritten."""


def error_chain(error: BaseException | None) -> Iterator[BaseException]:
    """Give an error, what caused it, what caused that, and so on."""
    while error is not None:
        yield error
        error = error.__cause__ or (None if error.__suppress_context__ else error.__context__)


def missing_resource(error: BaseException) -> str:
    """Name what the machine, or a limit set for the process, does not give; empty where it is something else.

    Whoever met the want may have told it as a failure of its own, so the error_chain count too.
    """
    for cause in error_chain(error):
        text = str(cause).lower()
        if isinstance(cause, RuntimeError) and "start new thread" in text:
            return "thread"
        if isinstance(cause, OSError) and cause.errno in _WANTED:
            return _WANTED[cause.errno]
        if isinstance(cause, MemoryError) or any(words in text for words in _NO_ROOM):
            return "memory"
    return ""
