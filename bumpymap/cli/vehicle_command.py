"""``bumpymap vehicle``: list, check and create vehicle profiles."""

import shlex
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bumpymap.cli._options import PATH
from bumpymap.cli._text import print_line

if TYPE_CHECKING:
    from bumpymap.rating import Vehicle

__all__ = ["command"]


@click.group("vehicle")
def command() -> None:
    """List, create and check vehicle profiles.

    \b
    bumpymap vehicle list
    bumpymap vehicle new my_vehicle
    bumpymap vehicle check my_vehicle.toml
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped


@command.command("list")
def list_command() -> None:
    """List the included vehicles."""
    from bumpymap.rating import load_profile, shipped_profiles

    for name in shipped_profiles():
        print_line(f"{name:12s} {load_profile(name).description}")


@command.command("check")
@click.argument("vehicle", metavar="NAME_OR_FILE")
def check_command(vehicle: str) -> None:
    """Report the errors in a profile, or a summary of the vehicle and what was estimated.

    NAME_OR_FILE is a TOML file or the name of an included vehicle. The exit code is 3 if the profile has errors.
    """
    from bumpymap.rating import estimated_values, load_profile

    profile = load_profile(vehicle)
    for name, value in (*_meaning(profile), ("calibration", _calibration(vehicle))):
        print_line(f"{name:13s} {value}")  # one line each, so that a command in it can be copied
    estimates = estimated_values(vehicle)
    if estimates:
        print_line("estimated from mass, size and suspension; each may be set in the profile:")
    for name, value in estimates.items():
        print_line(f"  {name} = {value}")


@command.command("new")
@click.argument("name", metavar="NAME")
@click.option("--out", type=PATH, metavar="FILE", help="File to write [default: NAME.toml].")
@click.option("--like", metavar="NAME_OR_FILE", help="Copy all values of this vehicle instead.")
def new_command(name: str, out: Path | None, like: str | None) -> None:
    """Write a vehicle profile to fill in: ten values, with units and ranges; the rest is estimated from them.

    NAME is the name of the vehicle.
    """
    from bumpymap.rating import write_profile_template

    path = out or Path(f"{name}.toml")
    write_profile_template(name, path, like)
    what = "change what differs" if like else "fill it in"
    print_line(f"wrote {path}: {what}, then: bumpymap vehicle check {shlex.quote(str(path))}")


def _meaning(profile: "Vehicle") -> list[tuple[str, str]]:
    wheel, belly = profile.wheel, profile.belly
    return [
        ("vehicle", f"{profile.name}: {profile.description}"),
        ("mass", f"{profile.mass_kg:,.6g} kg"),
        ("footprint", f"{profile.length_m:.3g} m long, {profile.width_m:.3g} m wide"),
        ("wheels", f"radius {wheel.radius_m:g} m, {profile.wheelbase_m:g} m from axle to axle"),
        ("belly", f"{belly.length_m:g} m x {belly.width_m:g} m, {belly.clearance_m:g} m above level ground"),
        ("driven at", f"{profile.speed_mps:g} m/s, on slopes up to {profile.slope_limit_deg:g} degrees"),
        ("floor", _floor(profile.floor.c_r_radpm)),
        ("ride weight", f"{profile.ride_weight:g} m/rad: acceptable detour to avoid one radian of pitch motion"),
        ("fail weight", f"{profile.fail_weight:g} m: acceptable detour to avoid one failure"),
    ]


def _floor(c_r: float) -> str:
    if c_r == 0.0:
        return "none: C_r is that of the ground alone, and even ground reads as almost free"
    return f"{c_r:g} rad/m ({degrees(c_r):.1f} degrees of pitch motion per metre) on even, level ground"


def _calibration(vehicle: str) -> str:
    """Return the calibration of the vehicle and how to use it, or why there is none."""
    from bumpymap.core import BadInputError
    from bumpymap.rating import find_calibration

    try:
        found: Any = find_calibration(vehicle)
    except BadInputError as error:
        return str(error)
    tiles = f"tiles of {found.tile_size:g} m with {found.pixels} pixels"
    return f"{found.id}, {tiles}; bumpymap map --vehicle {shlex.quote(vehicle)}"
