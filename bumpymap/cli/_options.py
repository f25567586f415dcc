"""Options that several commands have, and which options were given on the command line."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar, get_args

import click
from click.core import ParameterSource

from bumpymap.cli._terminal import PATH, SHARE, NumberList
from bumpymap.core import Align, Clash, Compat, Ground, Rating, ZUnit, override_settings, refuse_clashes

__all__ = [
    "crs_option",
    "force_crs_option",
    "given_options",
    "jobs_option",
    "merge_settings",
    "option_name",
    "output_options",
    "rating_options",
    "sheets_option",
    "tolerance_options",
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


crs_option = click.option("--crs", metavar="CRS", help="CRS of surveys that have none, such as EPSG:32614.")
force_crs_option = click.option("--force-crs", metavar="CRS", help="CRS of all surveys, whatever they state.")

_RATING = (
    crs_option,
    force_crs_option,
    click.option("--local", is_flag=True, help="Map surveys without a CRS in their own coordinates."),
    click.option("--z-unit", type=click.Choice(get_args(ZUnit)), help="Unit of heights if the CRS does not define it."),
    click.option("--ground", type=click.Choice(get_args(Ground)), help="Points to use [default: auto]."),
    click.option("--align", type=click.Choice(get_args(Align)), help="Height steps of flight lines [default: report]."),
    click.option(
        "--vehicle", metavar="NAME_OR_FILE", help="Name of an included vehicle, or a TOML file [default: warthog]."
    ),
    click.option("--calibration", type=PATH, metavar="FILE", help="Calibration file of your own vehicle."),
    click.option(
        "--speed", type=float, metavar="SPEED", help="Speed to rate the ride at, in m/s [default: the vehicle's]."
    ),
    click.option(
        "--speeds", type=NumberList(), metavar="LIST", help="Write pitch, roll and a_w at these speeds, in m/s."
    ),
    click.option("--model", type=PATH, metavar="FILE", help="ONNX file of your own texture network."),
    click.option(
        "--rating", type=click.Choice(get_args(Rating)), help="How the ride cost is predicted [default: ride]."
    ),
    click.option("--compat", type=click.Choice(get_args(Compat)), help="paper: use the rules of the BumpyPatch paper."),
    click.option("--tile-size", type=float, metavar="M", help="Tile size in metres [default: 3]."),
    click.option("--pixels", type=int, metavar="N", help="Heightmap pixels along a side of a tile [default: 15]."),
)
_TOLERANCE = (
    click.option("--trust-points", is_flag=True, help="Accept files whose points contradict the extent in the header."),
    click.option("--skip-bad", is_flag=True, help="Skip files that cannot be read (exit code 4)."),
    click.option(
        "--max-unknown", type=SHARE, metavar="SHARE", help="Fail (exit code 4) if more tiles are unknown: 50% or 0.5."
    ),
)
sheets_option = click.option(
    "--sheets", type=float, metavar="KM", help="Write a large site in square sheets of this side, in km."
)


def rating_options(command: _Command) -> _Command:
    """Add the options that say what surveys are, and how their tiles are measured and rated."""
    for option in reversed(_RATING):
        command = option(command)
    return command


def tolerance_options(command: _Command) -> _Command:
    """Add the options that say which faults of surveys are accepted."""
    for option in reversed(_TOLERANCE):
        command = option(command)
    return command
