"""The command line: arguments to settings, one call, a printed summary. Commands are imported when they run."""

import sys
from collections.abc import Sequence
from functools import partial
from importlib import import_module
from typing import Any

import click

from bumpymap.cli._exit_code import RunInterrupted, exit_code_of
from bumpymap.cli._options import COMMON_OPTIONS
from bumpymap.core import Terminated, interruptible

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
    "report": "make the page of a map again, or compare two maps",
    "route": "find the cheapest way over mapped ground, and what can be reached",
    "scan": "classify the ground in LiDAR scans of a robot, and map its drive",
    "settings": "print every setting of a command, as a TOML file",
    "train": "train the texture network or the scan network",
    "vehicle": "list, create and check vehicle profiles",
    "view": "look at a map in three dimensions",
}


_TOGETHER = {
    **dict.fromkeys(("calibrate", "evaluate", "train"), "lab_commands"),
    **dict.fromkeys(("diff", "report", "settings", "vehicle", "view"), "short_commands"),
    "demo": "map_command",
}
"""Module of each command, ``NAME_command`` in it, that has none of its own."""
_INTERRUPTED, _TERMINATED = 130, 143
"""Exit codes after Ctrl-C (SIGINT) and after SIGTERM, as shells expect them."""


class _LazyGroup(click.Group):
    """A group whose commands live in ``bumpymap.cli.NAME_command``, or as below, and are imported when they run."""

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return a command; None if there is none of that name."""
        if cmd_name not in _COMMANDS:
            return None
        if (module := _TOGETHER.get(cmd_name)) is not None:
            command = getattr(import_module(f"bumpymap.cli.{module}"), f"{cmd_name}_command")
        else:
            command = import_module(f"bumpymap.cli.{cmd_name}_command").command
        if not isinstance(command, click.Command):
            raise TypeError(f"the command {cmd_name} is not one of click")
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
