"""How a command ends: one message and an exit code for every failure that is not a bug."""

import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress

import click

from bumpymap.cli._text import emit, flush, print_error, restored_logging
from bumpymap.core import BumpymapError, error_chain, join_lines, missing_resource, refused_write

_BAD = 3
"""Exit code for a bad input file."""
_BROKEN_PIPE = 141
"""Exit code if the reader of a pipe has closed it (SIGPIPE), as after ``| head -1``."""
_FAULT = 1
"""A bug of bumpymap: printed with a traceback, so that it can be reported."""
_WANT = (
    "the machine has no {what} left for this. Give a smaller --memory and fewer --threads or --jobs, or raise the "
    "limit that the process runs under (ulimit, a batch system's, a container's)"
)


class RunInterrupted(Exception):  # noqa: N818 (not an error: a user ended the run)
    """A signal ended the run."""

    def __init__(self, message: str, exit_code: int) -> None:
        super().__init__(message)
        self.exit_code = exit_code


def exit_code_of(run: Callable[[], object], words: Sequence[str]) -> int:
    """Run a command, print the message of a failure, and return the exit code.

    ``run``: raises click's exceptions; an integer that it returns is the exit code; ``words``: arguments of the command
    line. With ``--json`` among them, everything is printed as events.
    """
    options = list(words[: words.index("--")] if "--" in words else words)
    as_json = "--json" in options
    begin = time.monotonic()
    if as_json:
        from importlib.metadata import version

        emit("start", arguments=list(words), version=version("bumpymap"))
    try:
        with restored_logging():
            code = _call(run)
    except Exception as error:
        code, lines = _message(error)
        lines += getattr(error, "__notes__", [])
        if code == _FAULT and not as_json:
            raise
        if as_json:
            more = {"traceback": traceback.format_exc()} if code == _FAULT else {}
            emit("error", exit_code=code, kind=type(error).__name__, message=join_lines(lines), **more)
        else:
            _print_failure(error, lines)
        return code
    if as_json:
        emit("done", exit_code=code, seconds=round(time.monotonic() - begin, 3))
    return code


def _call(run: Callable[[], object]) -> int:
    try:
        code = run()
        flush()
    except BrokenPipeError:
        return _BROKEN_PIPE
    except OSError:
        # click has written to a full output: drop what its buffer holds, which the interpreter would report at exit.
        with suppress(OSError):
            flush()
        raise
    except SystemExit as end:
        return _BROKEN_PIPE if end.code == _FAULT else int(end.code or 0)  # click's exit code for it
    return code if isinstance(code, int) else 0


def _message(error: Exception) -> tuple[int, list[str]]:
    """Return exit code and message of a failure; its notes say how to continue."""
    if what := missing_resource(error):
        return _BAD, [_WANT.format(what=what)]
    if isinstance(error, BumpymapError | RunInterrupted):
        return error.exit_code, [str(line) for line in error.args]
    if isinstance(error, click.ClickException):
        # click puts the choices of an option that is missing into lines of their own.
        text = error.format_message().replace("\n\t", " ")
        return error.exit_code, [
            text.replace("is not a valid float", "is not a number").replace(
                "is not a valid integer", "is not a whole number"
            )
        ]
    if isinstance(error, click.Abort):
        return 130, ["Interrupted."]
    for cause in error_chain(error):
        full = refused_write(cause)
        if isinstance(cause, OSError) and (cause is error or full):
            named = f"{cause.filename!s}: " if cause.filename is not None else ""
            where = f" ({full})" if full and not named else ""
            return _BAD, [f"system error: {named}{cause.strerror or cause}{where}"]
    return _FAULT, [f"{type(error).__name__}: {error}"]


def _print_failure(error: Exception, lines: Sequence[str]) -> None:
    if type(error).__name__ == "NoArgsIsHelpError" and isinstance(error, click.UsageError):
        error.show()  # prints the help
        return
    if isinstance(error, click.UsageError) and error.ctx is not None:
        print_error(error.ctx.get_usage())
        print_error(f"Try '{error.ctx.command_path} --help' for help.")
        print_error("")
    first, *rest = lines
    print_error(first if isinstance(error, RunInterrupted | click.Abort) else f"Error: {first}")
    for line in rest:
        print_error(line)
