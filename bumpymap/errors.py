"""Failures that a user can cause. Each message says what came, what is allowed and what to do."""

__all__ = ["BadInputError", "BumpymapError", "OutputError", "UsageError"]


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
