r"""Errors that a user can cause, and text that people read: counts, shares that add up, names of strangers.

Each message says what was given, what is allowed and what to do.

A name of a file, a survey or a CRS may hold escape sequences that a terminal executes, line breaks that forge a
message, and marks that change the direction of text. They are shown escaped (``\x1b``, ``\n``, ``\u202e``).
"""

import errno
import math
import unicodedata
from collections.abc import Collection, Iterable, Iterator, Sequence

_SHOWN_ESCAPED = {"Cc", "Cf", "Cs", "Zl", "Zp"}
"""Unicode categories: control characters, format characters (such as text direction), surrogates, line breaks."""


def escape_controls(text: str) -> str:
    r"""Escape characters that are not shown as they are, or that a terminal would interpret.

    ``text``: any text; bytes of a file name that Python could not decode (surrogate escapes) become ``\xNN``. Returns
    printable text in one line.
    """
    return text if text.isprintable() else "".join(map(_escaped, text))


def _escaped(letter: str) -> str:
    if unicodedata.category(letter) not in _SHOWN_ESCAPED:
        return letter
    if "\udc80" <= letter <= "\udcff":
        return f"\\x{ord(letter) - 0xDC00:02x}"
    return letter.encode("unicode_escape").decode("ascii")


def count_text(count: int, one: str, many: str = "") -> str:
    """Return a number with what it counts: ``1 survey``, ``1,200 surveys``; ``many`` if it is not ``one`` and an s."""
    return f"{count:,} {one if count == 1 else many or f'{one}s'}"


def join_lines(lines: Iterable[object]) -> str:
    """Return the lines of a message as one: sentences end, and indented lines are the items of a list."""
    joined, was_item = "", False
    for line in map(str, lines):
        text, is_item = line.strip(), line.startswith(" ")
        if not text:
            continue
        if joined and joined[-1] not in ".:;!?":
            joined += ";" if is_item and was_item else ":" if is_item else "."
        joined += f" {text}" if joined else text
        was_item = is_item
    return joined


def share_text(share: float, decimals: int = 0, percent: str = "%") -> str:
    """Return a share, 0 to 1, in per cent; a small one is not rounded to nothing, nor a large one to all."""
    return _shown(share, _rounded(share, decimals), decimals, percent)


def shares_text(
    counts: Sequence[float], alone: Collection[int] = (), decimals: int = 0, percent: str = "%"
) -> list[str]:
    """Return the shares of all parts of a whole, rounded so that together they make 100 %.

    ``counts``: size of each part; ``alone``: parts whose share is shown elsewhere too: they are rounded as `share_text`
    does. The others are rounded down, and those with the largest remainders get what is left. ``percent`` follows each
    number.
    """
    total = sum(counts)
    if not total:
        return [share_text(0.0, decimals, percent) for _ in counts]
    exact = [count / total * 10.0 ** (2 + decimals) for count in counts]
    units = [
        _rounded(count / total, decimals) if place in alone else math.floor(exact[place] + 1e-9)
        for place, count in enumerate(counts)
    ]
    left = round(10.0 ** (2 + decimals)) - sum(units)
    others = sorted(set(range(len(counts))) - set(alone), key=lambda place: units[place] - exact[place])
    for place in others[:left] if left > 0 else others[len(others) + left :]:
        units[place] += 1 if left > 0 else -1
    return [_shown(count / total, unit, decimals, percent) for count, unit in zip(counts, units, strict=True)]


def _rounded(share: float, decimals: int) -> int:
    """Return a share in units of the last digit shown."""
    return round(share * 10.0 ** (2 + decimals))


def _shown(share: float, units: int, decimals: int, percent: str) -> str:
    least = 10.0**-decimals
    if 0 < 100 * share < least:
        return f"under {least:.{decimals}f}{percent}"
    if 100 - least < 100 * share < 100:
        return f"over {100 - least:.{decimals}f}{percent}"
    return f"{units * least:.{decimals}f}{percent}"


def write_remedy(error: BaseException, remedy: str) -> str:
    """Return what helps after a failed write: a higher limit on the size of files if that was met, else ``remedy``."""
    if any(isinstance(cause, OSError) and cause.errno == errno.EFBIG for cause in error_chain(error)):
        return f"Raise {_REFUSED[errno.EFBIG]}"
    return remedy


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
