"""The command line: argv to settings, one call, a printed summary. Commands are loaded when they are asked for."""

import sys
from importlib import import_module

import click

from bumpymap.errors import BumpymapError
from bumpymap.interrupts import Terminated, interruptible

__all__ = ["main"]

_COMMANDS = {
    "calibrate": "drive a vehicle over simulated terrain: what each kind of ground costs it",
    "demo": "map a made-up quarry: see what bumpymap writes",
    "evaluate": "hold the map against drives over the same ground",
    "info": "what is in a survey, and what a run would need",
    "map": "make roughness layers and a cost map from surveys",
    "scan": "class the ground around a robot in its LiDAR scans, and map its drive",
    "train": "train the texture network, or that of scans",
}


_INTERRUPTED, _TERMINATED = 130, 143
"""What shells expect after Ctrl-C (SIGINT) and after SIGTERM."""


class _LazyGroup(click.Group):
    """A group whose commands live in ``bumpymap.cli.NAME`` and are imported when they run."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of the commands."""
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return a command; None where there is none of that name."""
        if cmd_name not in _COMMANDS:
            return None
        command = import_module(f"bumpymap.cli.{cmd_name}_command").command
        if not isinstance(command, click.Command):
            raise TypeError(f"bumpymap.cli.{cmd_name}_command.command is not a click command")
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl(list(_COMMANDS.items()))

    def invoke(self, ctx: click.Context) -> object:
        """Run a command; a failure that a user can cause becomes one message and its exit code."""
        try:
            with interruptible():
                return super().invoke(ctx)
        except BumpymapError as error:
            click.echo(f"Error: {error}", err=True)
            sys.exit(error.exit_code)
        except KeyboardInterrupt as end:
            terminated = isinstance(end, Terminated)
            said = ["Terminated." if terminated else "Interrupted.", "No file is half-written."]
            click.echo(" ".join(said + getattr(end, "__notes__", [])), err=True)
            sys.exit(_TERMINATED if terminated else _INTERRUPTED)


@click.group(cls=_LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="bumpymap", prog_name="bumpymap")
def main() -> None:
    """Find the ground that shakes a vehicle least: point clouds in, GIS layers and ride costs out."""
