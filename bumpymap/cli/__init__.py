"""The command line: arguments to settings, one call, a printed summary. Commands are imported when they run.

A command ends with one message and an exit code for every failure that is not a bug.
"""

import sys
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from importlib import import_module
from typing import Any

import click

from bumpymap.cli._options import COMMON_OPTIONS
from bumpymap.cli._output import emit, flush, print_error, restored_logging
from bumpymap.core import (
    BumpymapError,
    Terminated,
    error_chain,
    interruptible,
    join_lines,
    missing_resource,
    refused_write,
)

__all__ = ["main"]

_COMMANDS = {
    "batch": "map many surveys, each to a folder of its own",
    "calibrate": "calibrate the ride cost of a vehicle by simulated drives",
    "check": "compare a map with real drives over it",
    "demo": "map a synthetic quarry as an example",
    "diff": "find what has changed between two surveys of a site",
    "evaluate": "compare classes of scans with labels",
    "export": "write a map for robots: Nav2, grid_map, a mission",
    "info": "report what a survey contains and what a run needs",
    "map": "make roughness layers and a cost map from surveys",
    "report": "make the page of a map again",
    "route": "find the cheapest way over mapped ground",
    "scan": "classify the ground in LiDAR scans of a robot, and map its drive",
    "settings": "print every setting of a command, as a TOML file",
    "train": "train the texture network or the scan network",
    "vehicle": "list, create and check vehicle profiles",
    "view": "look at a map in three dimensions",
}


_TOGETHER = {
    **dict.fromkeys(("calibrate", "evaluate", "train"), "lab_commands"),
    **dict.fromkeys(("diff", "export", "report", "settings", "vehicle", "view"), "short_commands"),
    **dict.fromkeys(("batch", "demo"), "map_command"),
}
"""Module of each command, ``NAME_command`` in it, that has none of its own."""
_BROKEN_PIPE = 141
"""Exit code if the reader of a pipe has closed it (SIGPIPE), as after ``| head -1``."""
_FAULT = 1
"""A bug of bumpymap: printed with a traceback, so that it can be reported."""
_WANT = (
    "the machine has no {what} left for this. Give a smaller --memory and fewer --threads or --jobs, or raise the "
    "limit that the process runs under (ulimit, a batch system's, a container's)"
)
_INTERRUPTED, _TERMINATED = 130, 143
"""Exit codes after Ctrl-C (SIGINT) and after SIGTERM, as shells expect them."""


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
        return BumpymapError.exit_code, [_WANT.format(what=what)]
    if isinstance(error, BumpymapError | RunInterrupted):
        return error.exit_code, [str(line) for line in error.args]
    if isinstance(error, click.ClickException):
        # click puts the choices of an option that is missing into lines of their own.
        text = error.format_message().replace("\n\t", " ").replace("is not a valid float", "is not a number")
        return error.exit_code, [text.replace("is not a valid integer", "is not a whole number")]
    if isinstance(error, click.Abort):
        return _INTERRUPTED, ["Interrupted."]
    for cause in error_chain(error):
        full = refused_write(cause)
        if isinstance(cause, OSError) and (cause is error or full):
            named = f"{cause.filename!s}: " if cause.filename is not None else ""
            where = f" ({full})" if full and not named else ""
            return BumpymapError.exit_code, [f"system error: {named}{cause.strerror or cause}{where}"]
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


class _LazyGroup(click.Group):
    """A group whose commands live in ``bumpymap.cli.NAME_command``, or as below, and are imported when they run."""

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return a command; None if there is none of that name."""
        if cmd_name not in _COMMANDS:
            return None
        if (module := _TOGETHER.get(cmd_name)) is not None:
            command: click.Command = getattr(import_module(f"bumpymap.cli.{module}"), f"{cmd_name}_command")
        else:
            command = import_module(f"bumpymap.cli.{cmd_name}_command").command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl(list(_COMMANDS.items()))
        with formatter.section("Options of each command"):
            formatter.write_dl([record for each in COMMON_OPTIONS if (record := each.get_help_record(ctx))])

    def invoke(self, ctx: click.Context) -> object:
        """Run a command; Ctrl-C and SIGTERM become one message and its exit code."""
        try:
            with interruptible():
                return super().invoke(ctx)
        except KeyboardInterrupt as end:
            terminated = isinstance(end, Terminated)
            sentences = ["Terminated." if terminated else "Interrupted.", "No file is half-written."]
            message = " ".join(sentences + getattr(end, "__notes__", []))
            raise RunInterrupted(message, _TERMINATED if terminated else _INTERRUPTED) from None

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        **extra: Any,
    ) -> Any:
        """Run a command line; a failure becomes one message and the exit code, see `exit_code_of`.

        ``obj`` of the context is True if the arguments are those of the process, which then runs only this command.
        """
        extra.setdefault("obj", args is None)
        words = list(sys.argv[1:] if args is None else args)
        run = partial(super().main, words, prog_name, complete_var, standalone_mode=False, **extra)
        if not standalone_mode:
            return run()
        sys.exit(exit_code_of(run, words))


@click.group(
    cls=_LazyGroup,
    commands=dict.fromkeys(_COMMANDS, click.Command(None)),
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(package_name="bumpymap", prog_name="bumpymap")
def main() -> None:
    """Find the ground that shakes a vehicle least: point clouds in, GIS layers and ride costs out."""
