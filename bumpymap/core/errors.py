"""Errors that a user can cause. Each message says what was given, what is allowed and what to do."""

import errno
from collections.abc import Iterator

from bumpymap.core.text import join_lines

__all__ = [
    "BadInputError",
    "BumpymapError",
    "OutputError",
    "TooUnknownError",
    "UsageError",
    "error_chain",
    "missing_resource",
    "refused_write",
]

_RESOURCES = {
    errno.EAGAIN: "process",
    errno.EMFILE: "file that may be opened",
    errno.ENFILE: "file that may be opened",
    errno.ENOMEM: "memory",
}
_REFUSED = {
    errno.ENOSPC: "a disk, or shared memory: /dev/shm",
    errno.EDQUOT: "a disk, or shared memory: /dev/shm",
    errno.EFBIG: "the limit of the process or the file system on the size of files: ulimit -f",
}
_NO_MEMORY = ("cannot allocate memory", "failed to map segment", "unable to allocate", "out of memory")


class BumpymapError(Exception):
    """Base of all errors that bumpymap raises on purpose. ``exit_code`` is the exit status of the command line.

    Several arguments are the lines of one message. A line break inside an argument is not printed as one: it comes
    from a file name or from another library.
    """

    exit_code = 3

    def __str__(self) -> str:
        """Return the message in one line."""
        return join_lines(self.args)


class UsageError(BumpymapError):
    """Invalid settings, or settings that contradict each other."""

    exit_code = 2


class BadInputError(BumpymapError):
    """An input file that cannot be read, is damaged, or contradicts its own header."""


class OutputError(BumpymapError):
    """An output folder that cannot be written, or holds something that must not be overwritten."""


class TooUnknownError(BumpymapError):
    """A map is complete, but more of its tiles are unknown than ``max_unknown`` allows."""

    exit_code = 4


def error_chain(error: BaseException | None) -> Iterator[BaseException]:
    """Yield an error, its cause, the cause of that, and so on."""
    while error is not None:
        yield error
        error = error.__cause__ or (None if error.__suppress_context__ else error.__context__)


def missing_resource(error: BaseException) -> str:
    """Name the system resource that ran out, such as ``memory``; return an empty string for any other error.

    Libraries may raise an error of their own in response, so the causes are examined too.
    """
    for cause in error_chain(error):
        text = str(cause).lower()
        if isinstance(cause, RuntimeError) and "start new thread" in text:
            return "thread"
        if isinstance(cause, OSError) and cause.errno in _RESOURCES:
            return _RESOURCES[cause.errno]
        if isinstance(cause, MemoryError) or any(words in text for words in _NO_MEMORY):
            return "memory"
    return ""


def refused_write(error: BaseException) -> str:
    """Say what is full if the system refused to write, which is no fault of what is read; else an empty string."""
    found = (cause.errno for cause in error_chain(error) if isinstance(cause, OSError))
    return next((_REFUSED[number] for number in found if number in _REFUSED), "")
