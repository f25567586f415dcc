"""Options that several commands have, and which options were given on the command line."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import click
from click.core import ParameterSource

from bumpymap.core import Clash, override_settings, refuse_clashes

__all__ = [
    "given_options",
    "jobs_option",
    "merge_settings",
    "option_name",
    "output_options",
]

_Command = TypeVar("_Command", bound=Callable[..., Any])


def output_options(what: str = "Print no progress and no summary.") -> Callable[[_Command], _Command]:
    """Add ``--quiet`` and ``--log-json``; ``what`` is the help text of ``--quiet``."""

    def add(command: _Command) -> _Command:
        log_json = click.option("--log-json", is_flag=True, help="Print events, warnings and errors as JSON lines.")
        return click.option("--quiet", is_flag=True, help=what)(log_json(command))

    return add


def jobs_option(command: _Command) -> _Command:
    """Add ``--jobs`` for drives of the simulation."""
    text = "Processes of this machine that drive at a time [default: one per core]."
    return click.option("--jobs", type=click.IntRange(min=1), metavar="N", help=text)(command)


def given_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options that were given on the command line, even with an empty value; leave out defaults.

    Parameters
    ----------
    options : mapping
        Name -> value of all options of the current command.
    """
    source = click.get_current_context().get_parameter_source
    return {name: value for name, value in options.items() if source(name) is ParameterSource.COMMANDLINE}


def option_name(name: str) -> str:
    """Return the option of a setting, such as ``--tile-size``."""
    return f"--{name.replace('_', '-')}"


def merge_settings(from_file: dict[str, Any], given: dict[str, Any], clashes: Sequence[Clash]) -> dict[str, Any]:
    """Merge the settings of a file and of the command line, which also override settings that contradict them.

    Raises
    ------
    UsageError
        Settings of one source contradict each other.
    """
    refuse_clashes(from_file, clashes)
    refuse_clashes(given, clashes, option_name)
    return override_settings(from_file, given, clashes)
