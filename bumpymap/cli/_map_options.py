"""Options of ``map`` that ``batch`` has too."""

from collections.abc import Callable
from typing import Any, TypeVar, get_args

import click

from bumpymap.cli._terminal import PATH, SHARE, NumberList
from bumpymap.core import Align, Compat, Ground, Rating, ZUnit

__all__ = ["crs_option", "force_crs_option", "rating_options", "sheets_option", "tolerance_options"]

_Command = TypeVar("_Command", bound=Callable[..., Any])

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
