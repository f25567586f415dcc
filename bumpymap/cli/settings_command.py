"""``bumpymap settings``: print every setting of a command, with its description and default, as a TOML file."""

from importlib import import_module

import click

from bumpymap.cli._text import print_line
from bumpymap.core import settings_template

__all__ = ["command"]

_COMMANDS = ("map", "batch", "info", "scan", "route", "check", "diff", "export", "calibrate", "evaluate", "train")


@click.command("settings")
@click.argument("command_name", type=click.Choice(_COMMANDS), metavar="COMMAND")
def command(command_name: str) -> None:
    """Print a settings file of COMMAND: every setting with its description and default, commented out.

    Remove the # before a line to set it, and give the file with --config. One setting alone is given with --set
    KEY=VALUE, that of a table with --set TABLE.KEY=VALUE.

    \b
    bumpymap settings map > map.toml
    bumpymap map site.laz --out layers --config map.toml
    bumpymap map site.laz --out layers --set pixels=21 --set csf.rigidness=2
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    print_line(
        f"# Settings of `bumpymap {command_name}`, with their defaults. Remove the # before a line to set it, and give"
    )
    print_line("# the file with --config. Options override it; paths are relative to this file.")
    print_line()
    owners = import_module(f"bumpymap.cli.{command_name}_command").command.owners
    for line in settings_template(owners).splitlines():
        print_line(line)
